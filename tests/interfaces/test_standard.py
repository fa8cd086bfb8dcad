from __future__ import annotations

import inspect
import sys
from importlib import resources
from pathlib import Path

import pytest

from turtleact.interfaces import get_interface, known_interfaces, standard
from turtleact.interfaces.parse import parse
from turtleact.interfaces.registry import REGISTRY
from turtleact.interfaces.standard import parameters, simulation
from turtleact.interfaces.types import Action, Message, Service, definition

GOLDEN = Path(__file__).parent / "golden"
FOLDER = Path(standard.__file__).parent
SHIPPED = sorted(
    path.relative_to(FOLDER).with_suffix("").as_posix()
    for path in FOLDER.rglob("*")
    if path.suffix in {".msg", ".srv", ".action"}
)
CLASSES = [
    getattr(module, name)
    for module in (standard, parameters, simulation)
    for name in module.__all__
]
IDS = [cls.type_name for cls in CLASSES]


def place(type_name: str) -> str:
    return f"{type_name}.{type_name.split('/')[1]}"


@pytest.mark.parametrize("cls", CLASSES, ids=IDS)
def test_a_class_says_what_its_file_says(cls):
    text = resources.files(standard).joinpath(place(cls.type_name)).read_text()
    assert definition(cls) == parse(text, cls.type_name)


@pytest.mark.parametrize("cls", CLASSES, ids=IDS)
def test_a_class_is_what_its_name_gives(cls):
    assert get_interface(cls.type_name) is cls


def test_a_class_that_is_imported_late_is_what_its_name_gives(monkeypatch):
    monkeypatch.delitem(sys.modules, parameters.__name__)
    monkeypatch.setattr(standard, "parameters", parameters)  # put back behind the test
    for cls in CLASSES:
        if cls.__module__ == parameters.__name__:
            REGISTRY.forget(cls.type_name)
    found = get_interface("rcl_interfaces/msg/Parameter")
    assert found is sys.modules[parameters.__name__].Parameter


def test_every_file_is_known():
    assert set(SHIPPED) <= set(known_interfaces())


@pytest.mark.parametrize("module", [standard, parameters, simulation])
def test_every_class_is_exported(module):
    made = {
        name
        for name, value in vars(module).items()
        if inspect.isclass(value) and value.__module__ == module.__name__
    }
    assert made == set(module.__all__)


@pytest.mark.parametrize("type_name", SHIPPED)
def test_a_file_is_a_copy_of_ros(type_name):
    shipped = resources.files(standard).joinpath(place(type_name))
    assert shipped.read_bytes() == (GOLDEN / place(type_name)).read_bytes()


@pytest.mark.parametrize("type_name", SHIPPED)
def test_a_file_makes_a_class(type_name):
    assert issubclass(get_interface(type_name), Message | Service | Action)


@pytest.mark.parametrize(
    "package",
    ["std_msgs", "geometry_msgs", "action_msgs", "std_srvs", "turtlesim", "rcl_interfaces"],
)
def test_a_package_ships_whole(package):
    names = {
        f"{package}/{path.parent.name}/{path.stem}" for path in (GOLDEN / package).glob("*/*.*")
    }
    assert names <= set(SHIPPED)
