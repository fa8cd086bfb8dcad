"""What ``serve`` is told to serve."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from turtleact.commands.serve import find_actions
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
    (tmp_path / "labelsewhere.py").write_text(OTHER)
    (tmp_path / "targetlab.py").write_text(LAB.format(other="labelsewhere"))
    return tmp_path


def names(target: str) -> list[str]:
    return [each.name for each in find_actions(target)]


@pytest.mark.parametrize(
    ("target", "found"),
    [
        ("targetlab", ["first", "second"]),
        ("targetlab:first", ["first"]),
        ("targetlab:Robot.drive", ["second"]),
        ("targetlab:aside", ["aside"]),
    ],
)
def test_a_target_means_actions(target, found):
    assert names(target) == found


@pytest.mark.parametrize(
    ("target", "problem"),
    [
        ("", "'' is not a target such as lab or lab.robot:drive"),
        ("lab-1", "'lab-1' is not a target"),
        ("targetlab:", "'targetlab:' is not a target"),
        ("targetlab:frist", "no frist is there, did you mean 'first'?"),
        (
            "targetlab:number",
            "'targetlab:number' is of type int, not an action; see turtleact.action",
        ),
        ("nowhere", "there is no module 'nowhere' here, or on the path"),
        ("targetlab.nowhere", "there is no module"),
        ("json", "module 'json' declares no action; see turtleact.action"),
    ],
)
def test_what_means_no_action_is_refused(target, problem):
    with pytest.raises(UsageError) as caught:
        find_actions(target)
    assert problem in str(caught.value)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("x = 1\ny = 1 / 0\n", "ZeroDivisionError: division by zero ({file}, line 2)"),
        (
            "import nowhere_at_all\n",
            "ModuleNotFoundError: No module named 'nowhere_at_all' ({file}, line 1)",
        ),
        ("def f(:\n", "({file}, line 1)"),
        ("raise BaseException('by hand')\n", "BaseException: by hand ({file}, line 1)"),
        ("import turtleact\n@turtleact.action\ndef f(): ...\n", "({file}, line 2)"),
    ],
)
def test_a_module_that_fails_is_told_with_its_line(folder, text, problem):
    file = folder / "broken.py"
    file.write_text(text)
    with pytest.raises(TurtleactError) as caught:
        find_actions("broken")
    assert str(caught.value).startswith("module 'broken' cannot be imported: ")
    assert str(caught.value).endswith(problem.format(file=file))


def test_a_lookup_that_fails_is_told_with_its_line(folder):
    file = folder / "failing.py"
    file.write_text("def __getattr__(name):\n    raise ValueError('by hand')\n")
    with pytest.raises(TurtleactError) as caught:
        find_actions("failing:drive")
    assert str(caught.value) == (
        f"'failing:drive' cannot be looked up: ValueError: by hand ({file}, line 2)"
    )


@pytest.mark.parametrize(
    ("declared", "problem"),
    [
        ("Fibonacci, 'f'", "the body of action 'f' must be an 'async def', not a plain function"),
        ("Fibonacci, '1'", "invalid name: a part begins with a digit\n  1\n  ^"),
        ("'f', int", "invalid name: expected text such as 'patrol'\n  <class 'int'>\n  ^"),
    ],
)
def test_a_declaration_that_is_wrong_is_told_with_its_line(folder, declared, problem):
    file = folder / "wrong.py"
    imports = "import turtleact\nfrom turtleact.interfaces.standard import Fibonacci\n"
    file.write_text(f"{imports}@turtleact.action({declared})\ndef f(goal): ...\n")
    with pytest.raises(TurtleactError) as caught:
        find_actions("wrong")
    assert str(caught.value) == f"{file}, line 3: {problem}"


def test_a_message_that_is_derived_from_another_is_told_with_its_line(folder):
    file = folder / "derived.py"
    imports = "from turtleact.interfaces.standard import Fibonacci\n"
    file.write_text(f"{imports}\nclass Mine(Fibonacci.Feedback): pass\n")
    with pytest.raises(TurtleactError) as caught:
        find_actions("derived")
    assert str(caught.value) == f"{file}, line 3: Mine: derive a message only from Message"
