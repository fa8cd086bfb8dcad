from __future__ import annotations

import json
import subprocess
import sys
from importlib import import_module, resources
from pathlib import Path

import pytest

from turtleact.interfaces import (
    get_interface,
    standard,
    type_hash,
)
from turtleact.interfaces.generator import generate
from turtleact.interfaces.parse import parse
from turtleact.interfaces.types import Action, Message, Service

from ..tables import together

GOLDEN = Path(__file__).parent / "golden"
HASHES: dict[str, str] = json.loads((GOLDEN / "type_hashes_kilted.json").read_text())
"""The hashes of interfaces of which there is no recorded text."""
FOLDER = Path(standard.__file__).parent
SHIPPED = sorted(
    path.relative_to(FOLDER).with_suffix("").as_posix()
    for path in FOLDER.rglob("*")
    if path.suffix in {".msg", ".srv", ".action"}
)


def place(type_name: str) -> str:
    return f"{type_name}.{type_name.split('/')[1]}"


def text_of(type_name: str) -> str:
    return resources.files(standard).joinpath(place(type_name)).read_text()


def declared(type_name: str) -> type:
    package, kind, name = type_name.split("/")
    found: type = getattr(import_module(f"{standard.__name__}.{package}.{kind}"), name)
    return found


def test_the_generated_modules_are_those_of_the_files():
    written = {
        path.relative_to(FOLDER).as_posix(): path.read_text() for path in FOLDER.glob("*/*.py")
    }
    assert written == generate({name: text_of(name) for name in SHIPPED})


@together
@pytest.mark.parametrize("type_name", sorted(set(SHIPPED) - set(HASHES)))
def test_a_file_says_what_ros_says(type_name):
    golden = (GOLDEN / place(type_name)).read_text()
    assert parse(text_of(type_name), type_name) == parse(golden, type_name)


@together
@pytest.mark.parametrize("type_name", HASHES)
def test_a_file_has_the_hash_of_ros(type_name):
    assert type_hash(get_interface(type_name)) == HASHES[type_name]


@together
@pytest.mark.parametrize("type_name", SHIPPED)
def test_a_class_is_what_its_name_gives(type_name):
    assert get_interface(type_name) is declared(type_name)


@together
@pytest.mark.parametrize("name", standard.__all__)
def test_a_shortcut_gives_a_class(name):
    assert issubclass(getattr(standard, name), Message | Service | Action)
    assert name in dir(standard)


def test_an_unknown_shortcut_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'Fibonaci'"):
        _ = standard.Fibonaci


def test_a_users_class_is_not_replaced_by_one_that_ships():
    code = (
        "from turtleact.interfaces import Message, get_interface, int32\n"
        "class Point(Message, type_name='geometry_msgs/msg/Point'):\n"
        "    x: int32 = 0\n"
        "from turtleact.interfaces.standard import Twist\n"
        "assert get_interface('geometry_msgs/msg/Point') is Point\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    "package",
    ["std_msgs", "geometry_msgs", "action_msgs", "std_srvs", "turtlesim", "rcl_interfaces"],
)
def test_a_package_ships_whole(package):
    names = {
        f"{package}/{path.parent.name}/{path.stem}" for path in (GOLDEN / package).glob("*/*.*")
    }
    assert names <= set(SHIPPED)
