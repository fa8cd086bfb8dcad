"""``interface python``: typed classes for the interfaces of packages."""

from __future__ import annotations

import pytest

from turtleact.interfaces.finders import Finders
from turtleact.interfaces.types import REGISTRY

from ..registry import isolated_registry


@pytest.fixture(autouse=True)
def own_registry(monkeypatch):
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    with isolated_registry():
        REGISTRY.look_in(Finders())
        yield


@pytest.fixture
def source(tmp_path):
    """A folder with a package that uses a second one, which does not ship, and one that does."""
    folder = tmp_path / "src"
    texts = {
        "arm_interfaces/action/Grip.action": "# Closes the gripper.\n\nuint8 SOFT=1\n"
        "uint8 force 3 # in newtons\n---\narm_msgs/Load load\n---\nfloat32 gap\n",
        "arm_msgs/msg/Load.msg": "geometry_msgs/Point[<=4] at\nstring<=8 from\n",
        "arm_msgs/srv/Weigh.srv": "---\nLoad load\n",
    }
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


@pytest.fixture
def generate(turtleact, source, tmp_path):
    """Runs the verb for the package; the modules go to the folder ``generated``."""

    def run(*arguments):
        folder = str(tmp_path / "generated")
        named = ("interface", "python", "arm_interfaces", "--interfaces", str(source))
        with isolated_registry():  # a process of its own would begin with none of these
            return turtleact(*named, "-o", folder, *arguments)

    return run


def test_the_modules_of_a_package_and_of_those_that_it_uses_are_written(generate, tmp_path):
    ran = generate()
    folder = tmp_path / "generated"
    files = ["__init__", "arm_interfaces/__init__", "arm_interfaces/action"]
    files += ["arm_msgs/__init__", "arm_msgs/msg", "arm_msgs/srv"]
    assert (ran.status, ran.out) == (0, "".join(f"{folder}/{name}.py\n" for name in files))
    assert sorted(folder.rglob("*.py")) == [folder / f"{name}.py" for name in files]


def test_a_check_names_the_files_that_differ_and_writes_nothing(generate, source, tmp_path):
    generate()
    assert generate("--check") == (0, "", "")
    file = source / "arm_msgs" / "msg" / "Load.msg"
    file.write_text("float32 mass\n")
    module = tmp_path / "generated" / "arm_msgs" / "msg.py"
    before = module.read_text()
    assert generate("--check") == (1, f"would change {module}\n", "")
    assert module.read_text() == before


def test_a_file_that_was_not_generated_is_kept(generate, tmp_path):
    module = tmp_path / "generated" / "arm_msgs" / "msg.py"
    module.parent.mkdir(parents=True)
    module.write_text("mine = 1\n")
    ran = generate()
    assert ran.status == 2
    assert f"{module} was not generated: choose another folder" in ran.err
    assert module.read_text() == "mine = 1\n"


def test_a_folder_that_cannot_be_written_is_named(turtleact, tmp_path):
    (tmp_path / "file").touch()
    ran = turtleact("interface", "python", "std_msgs", "-o", str(tmp_path / "file" / "made"))
    assert ran.status == 2
    assert "made/__init__.py cannot be written: Not a directory" in ran.err
