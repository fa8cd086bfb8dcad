"""What ``serve`` is told to serve."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import anyio
import pytest

from turtleact.commands.targets import Modules
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

class Robot:
    drive = second

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
        ("targetlab:Robot.drive", ["second"]),
        ("targetlab:aside", ["aside"]),
        ("targetlab.py", ["first", "second"]),
        ("./targetlab.py", ["first", "second"]),
        ("./targetlab", ["first", "second"]),
        ("targetlab.py:first", ["first"]),
        ("./targetlab.py:Robot.drive", ["second"]),
        ("inner/lab-1.py", ["aside"]),
        ("inner/lab-1", ["aside"]),
        ("inner/pack/robot.py", ["aside"]),
        ("inner/pack:far", ["aside"]),
        ("inner/pack/", ["aside"]),
    ],
)
def test_a_target_means_actions(target, found):
    assert names(target) == found


@pytest.mark.parametrize(
    ("target", "problem"),
    [
        ("", "'' is not a target such as lab.py, lab or lab.robot:drive"),
        ("lab-1", "'lab-1' is not a target"),
        ("targetlab:", "'targetlab:' is not a target: after the colon comes the name of an action"),
        ("targetlab:frist", "no frist is there, did you mean 'first'?"),
        ("targetlab:zzz", "'targetlab:zzz': no zzz is there (there are: aside, first, second)"),
        ("targetlab.py:Robot.zzz", "no zzz is there (there are: drive)"),
        (
            "targetlab:number",
            "'targetlab:number' is of type int, not an action; see turtleact.action "
            "(there are: aside, first, second)",
        ),
        ("nowhere", "there is no module 'nowhere' here, or on the path (there are: "),
        ("targetlabs", "there is no module 'targetlabs' here, or on the path, did you mean 'tar"),
        ("targetlab.nowhere", "there is no module"),
        ("targetlabs.py", "there is no file 'targetlabs.py', did you mean 'targetlab.py'?"),
        ("./targetlabs", "there is no file './targetlabs', did you mean 'targetlab.py'?"),
        ("inner/zzz.py", "there is no file 'inner/zzz.py' (there are: lab-1.py)"),
        ("inner", "module 'inner' is a folder: name a file in it (inner/lab-1.py, inner/p"),
        ("inner/", "'inner/' is a folder: name a file in it (inner/lab-1.py, inner/p"),
        ("ros", "module 'ros' is a folder: name a file in it (ros/ros/server.py)"),
        ("./ros", "'./ros' is a folder: name a file in it (ros/ros/server.py)"),
        ("ros/test", "'ros/test' is a folder: it has no file with actions"),
        ("ros/lab.py", "there is no file 'ros/lab.py' (there are: tools.py)"),
        ("outer/lab.py", "'outer/lab.py': there is no folder '"),
        ("plain.py", "'plain.py' declares no action: put @turtleact.action(TYPE, NAME) above a "),
        ("plain", "module 'plain' declares no action: put @turtleact.action(TYPE, NAME) above a b"),
        ("plain", "above a body (its functions: fibonacci)"),
        ("plain.py", "(its functions: fibonacci), or run it as a program: turtleact run plain.py"),
        ("passing", "declares no action, but imports some: serve labelsewhere"),
        ("queue.py", "'queue.py' cannot be imported: another module has its name ("),
        ("a.b.py", "'a.b.py' cannot be imported: take the dots out of its name"),
    ],
)
def test_what_means_no_action_is_refused(folder, target, problem):
    (folder / "plain.py").write_text("from json import dumps\n\ndef fibonacci(goal): ...\n")
    (folder / "passing.py").write_text("from labelsewhere import aside\n")
    for name in ("queue.py", "a.b.py"):
        (folder / name).write_text(OTHER)
    for name in ("setup.py", "conftest.py", "tools.py", "ros/server.py", "test/test_ros.py"):
        file = folder / "ros" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(OTHER if name == "ros/server.py" else "")
    with pytest.raises(UsageError) as caught:
        find_actions(target)
    assert problem in str(caught.value)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("x = 1\ny = 1 / 0\n", "2: {cannot}: ZeroDivisionError: division by zero"),
        (
            "import nowhere_at_all\n",
            "1: {cannot}: ModuleNotFoundError: No module named 'nowhere_at_all'",
        ),
        ("def f(:\n", "1: {cannot}: SyntaxError: "),
        (
            "async def f(goal):\n    yield 1\n    return 2\n",
            "3: {cannot}: SyntaxError: 'return' with value in async generator: "
            "a body that yields feedback yields its result, too: write 'yield' for 'return'",
        ),
        ("raise BaseException('by hand')\n", "1: {cannot}: BaseException: by hand"),
        (
            "import turtleact\n@turtleact.action\ndef f(): ...\n",
            "2: {cannot}: TypeError: the type and the name of the action are missing: "
            "write @turtleact.action(TYPE, 'f')",
        ),
    ],
)
def test_a_module_that_fails_is_told_with_its_line(folder, text, problem):
    (folder / "broken.py").write_text(text)
    with pytest.raises(TurtleactError) as caught:
        find_actions("broken")
    cannot = "module 'broken' cannot be imported"
    assert str(caught.value).startswith(f"broken.py:{problem.format(cannot=cannot)}")


def test_a_file_outside_the_working_directory_is_told_with_its_whole_path(folder, monkeypatch):
    (folder / "broken.py").write_text("1 / 0\n")
    monkeypatch.chdir(folder / "inner")
    with pytest.raises(TurtleactError) as caught:
        find_actions("../broken.py")
    assert str(caught.value).startswith(f"{folder / 'broken.py'}:1: module 'broken' cannot be")


def test_a_lookup_that_fails_is_told_with_its_line(folder):
    file = folder / "failing.py"
    file.write_text("def __getattr__(name):\n    raise ValueError('by hand')\n")
    with pytest.raises(TurtleactError) as caught:
        find_actions("failing:drive")
    assert str(caught.value) == (
        "failing.py:2: 'failing:drive' cannot be looked up: ValueError: by hand"
    )


@pytest.mark.parametrize(
    ("declared", "problem"),
    [
        ("Fibonacci, 'f'", "the body of action 'f' must be an 'async def', not a plain function"),
        ("Fibonacci, '1'", "invalid name: a part begins with a digit\n  1\n  ^"),
        (
            "Fibonacci, 7",
            "module 'wrong' cannot be imported: TypeError: "
            "the name of the action is 7, which is not a string",
        ),
    ],
)
def test_a_declaration_that_is_wrong_is_told_with_its_line(folder, declared, problem):
    file = folder / "wrong.py"
    imports = "import turtleact\nfrom turtleact.interfaces.standard import Fibonacci\n"
    file.write_text(f"{imports}@turtleact.action({declared})\ndef f(goal): ...\n")
    with pytest.raises(TurtleactError) as caught:
        find_actions("wrong")
    assert str(caught.value) == f"wrong.py:3: {problem}"


def test_a_message_that_is_derived_from_another_is_told_with_its_line(folder):
    file = folder / "derived.py"
    imports = "from turtleact.interfaces.standard import Fibonacci\n"
    file.write_text(f"{imports}\nclass Mine(Fibonacci.Feedback): pass\n")
    with pytest.raises(TurtleactError) as caught:
        find_actions("derived")
    assert str(caught.value) == "derived.py:3: Mine: derive a message only from Message"


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


@pytest.mark.parametrize("target", ["targetlab", "targetlab.py"])
def test_a_program_with_rclpy_is_told_how_to_be_run(folder, target, monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", None)  # as if it were not installed
    (folder / "targetlab.py").write_text("import rclpy\n")
    with pytest.raises(TurtleactError, match="to run a program with rclpy: turtleact run target"):
        find_actions(target)


def test_a_file_that_would_have_to_be_there_is_watched(folder):
    (folder / "targetlab.py").write_text("import not_yet_there\n")
    modules = Modules(["targetlab"])
    with pytest.raises(TurtleactError, match="No module named 'not_yet_there'"):
        modules.find()
    assert {folder / "targetlab.py", folder / "not_yet_there.py"} <= modules.files


@pytest.mark.parametrize(
    "program", ["asyncio.run(main())", "anyio.run(main)", "from asyncio import run; run(main())"]
)
def test_a_program_in_a_file_with_actions_is_skipped_with_a_warning(folder, caplog, program):
    (folder / "program.py").write_text(
        f"import asyncio\nimport anyio\n{OTHER}\nasync def main(): 1 / 0\n\n{program}\n"
    )
    runs = asyncio.run, anyio.run
    assert names("program.py") == ["aside"]
    assert (asyncio.run, anyio.run) == runs
    assert caplog.messages == [
        "program.py:13: the program is skipped, because serve runs the actions itself; "
        "put it below 'if __name__ == \"__main__\":'"
    ]


def test_what_a_module_has_imported_to_run_programs_still_runs_them(folder):
    (folder / "program.py").write_text(f"from asyncio import run\n{OTHER}")
    names("program.py")

    async def main():
        return 7

    assert sys.modules["program"].run(main()) == 7
