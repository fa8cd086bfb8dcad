"""What ``serve`` is told to serve."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from turtleact.commands.user_code import Modules
from turtleact.errors import TurtleactError, UsageError

LAB = """
import turtleact
from turtleact.actions.fibonacci import Fibonacci
from {other} import aside

@turtleact.action(Fibonacci, "first")
async def first(goal):
    return Fibonacci.Result()

@turtleact.action(Fibonacci, "second")
async def second(goal):
    return Fibonacci.Result()

number = 7
"""

OTHER = """
import turtleact
from turtleact.actions.fibonacci import Fibonacci

@turtleact.action(Fibonacci, "aside")
async def aside(goal):
    return Fibonacci.Result()
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch) -> Path:
    """A working directory with modules of this test alone."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(sys, "modules", dict(sys.modules))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    (tmp_path / "labelsewhere.py").write_text(OTHER)
    (tmp_path / "targetlab.py").write_text(LAB.format(other="labelsewhere"))
    (tmp_path / "inner" / "pack").mkdir(parents=True)
    (tmp_path / "inner" / "lab-1.py").write_text(OTHER)
    (tmp_path / "inner" / "pack" / "robot.py").write_text(f"from . import far\n{OTHER}")
    (tmp_path / "inner" / "pack" / "__init__.py").write_text(OTHER.replace("def aside", "def far"))
    return tmp_path


def find_actions(target: str):
    return Modules([target]).find().actions


def names(target: str) -> list[str]:
    return [each.name for each in find_actions(target)]


@pytest.mark.parametrize(
    ("target", "found"),
    [
        ("targetlab", ["first", "second"]),
        ("targetlab:first", ["first"]),
        ("targetlab:aside", ["aside"]),
        ("targetlab.py", ["first", "second"]),
        ("./targetlab", ["first", "second"]),
        ("./targetlab.py:second", ["second"]),
        ("inner/lab-1.py", ["aside"]),
        ("inner/pack/robot.py", ["aside"]),
        ("inner/pack:far", ["aside"]),
    ],
)
def test_a_target_means_actions(target, found):
    assert names(target) == found


@pytest.mark.parametrize(
    ("target", "problem"),
    [
        ("lab-1", "'lab-1' is not a target such as lab.py, lab or lab.robot:drive"),
        ("targetlab:", "'targetlab:' is not a target: after the colon comes the name of an action"),
        ("targetlab:frist", "no action frist is there, did you mean 'first'?"),
        ("targetlab:number", "no action number is there (there are: aside, first, second)"),
        ("targetlabs", "there is no module 'targetlabs' here, or on the path, did you mean 'tar"),
        ("targetlab.nowhere", "there is no module"),
        ("./targetlabs", "there is no file './targetlabs', did you mean 'targetlab.py'?"),
        ("inner/zzz.py", "there is no file 'inner/zzz.py' (there are: lab-1.py)"),
        ("inner", "'inner' is a folder: name a file in it"),
        ("outer/lab.py", "there is no file 'outer/lab.py' (there are: none)"),
        ("plain.py", "'plain.py' declares no action: put @turtleact.action(TYPE, NAME) above a "),
        ("queue.py", "'queue.py' cannot be imported: another module has its name ("),
    ],
)
def test_what_means_no_action_is_refused(folder, target, problem):
    (folder / "plain.py").write_text("from json import dumps\n\ndef fibonacci(goal): ...\n")
    (folder / "queue.py").write_text(OTHER)
    with pytest.raises(UsageError) as caught:
        find_actions(target)
    assert problem in str(caught.value)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("x = 1\ny = 1 / 0\n", "2: {cannot}: ZeroDivisionError: division by zero"),
        ("def f(:\n", "1: {cannot}: SyntaxError: "),
        (
            "import asyncio\nasyncio.run(None)\n",
            "2: {cannot}: RuntimeError: asyncio.run() cannot be called from a running event loop; "
            "put it below 'if __name__ == \"__main__\":'",
        ),
        (
            "async def f(goal):\n    yield 1\n    return 2\n",
            "3: {cannot}: SyntaxError: 'return' with value in async generator: "
            "a body that yields feedback yields its result, too: write 'yield' for 'return'",
        ),
    ],
)
def test_a_module_that_fails_is_told_with_its_line(folder, text, problem):
    (folder / "broken.py").write_text(text)
    with pytest.raises(TurtleactError) as caught:
        find_actions("broken")
    cannot = "module 'broken' cannot be imported"
    assert str(caught.value).startswith(f"broken.py:{problem.format(cannot=cannot)}")


def test_a_declaration_that_is_wrong_is_told_with_its_line(folder):
    imports = "import turtleact\nfrom turtleact.interfaces.standard import Fibonacci\n"
    (folder / "wrong.py").write_text(
        f"{imports}@turtleact.action(Fibonacci, 'f')\ndef f(goal): ...\n"
    )
    with pytest.raises(TurtleactError) as caught:
        find_actions("wrong")
    problem = "the body of action 'f' must be an 'async def', not a plain function"
    assert str(caught.value) == f"wrong.py:3: {problem}"


def test_the_parameters_of_all_modules_of_the_user_are_found_once(folder):
    (folder / "limits.py").write_text(
        "import turtleact\nmax_speed = turtleact.parameter('max_speed', 1.0)\n"
    )
    with (folder / "targetlab.py").open("a") as file:
        file.write("import limits\nfrom limits import max_speed\n")
        file.write("count = turtleact.parameter('count', 1)\n")
    found = Modules(["targetlab", "targetlab.py:first"]).find()
    assert sorted(each.name for each in found.parameters) == ["count", "max_speed"]
    assert [each.name for each in found.actions] == ["first", "second", "first"]


def test_the_files_of_all_modules_of_the_user_are_known(folder):
    modules = Modules(["targetlab.py", "inner/pack/robot.py"])
    modules.find()
    names = ["inner/pack/__init__.py", "inner/pack/robot.py", "labelsewhere.py", "targetlab.py"]
    assert modules.files == {folder / each for each in names}


def test_a_program_with_rclpy_is_told_how_to_be_run(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", None)  # as if it were not installed
    (folder / "targetlab.py").write_text("import rclpy\n")
    with pytest.raises(TurtleactError, match="to run a program with rclpy: turtleact run target"):
        find_actions("targetlab")


def test_all_files_beside_a_module_that_fails_are_watched(folder):
    (folder / "targetlab.py").write_text("import not_yet_there\n")
    modules = Modules(["targetlab"])
    with pytest.raises(TurtleactError, match="No module named 'not_yet_there'"):
        modules.find()
    assert folder / "targetlab.py" in modules.files
    (folder / "not_yet_there.py").touch()
    assert folder / "not_yet_there.py" in modules.files
