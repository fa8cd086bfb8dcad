"""Every command that a message, a help text or a sentence of a page suggests is understood.

The blocks of pages are run by ``tests/test_docs.py`` and ``test_page.py``.
"""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from turtleact.commands import app

from ..tables import together

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
QUOTED = re.compile(r"'turtleact ([^']+)'")
SHOWN = re.compile(r"^ +turtleact (.+)$", re.MULTILINE)
INLINE = re.compile(r"`turtleact ([^`]+)`")
PYTHON = re.compile(
    r"`(?:\.venv/bin/)?python3? ((?:-m )?(?:benchmarks|scripts|tests)[./][\w./]+)[^`]*`"
)

OPEN = {
    "pkg create NAME": "pkg create my_robot",
    " [PACKAGE]": "",
    "FILE.py [ARGUMENTS]": shlex.quote(__file__),
    "PACKAGE EXECUTABLE [ARGUMENTS]": "turtlesim turtlesim_node",
    "my_package talker": "turtlesim turtlesim_node",
    "VERB": "goals",
    "NAME [TYPE] [GOAL]": "fibonacci",
    "[TARGET...]": "lab",
    "NODE": "/turtlesim",
    "ID": "71a9",
    "FILE": "turtles.svg",
    "patrol_server.py": shlex.quote(__file__),
    "…": "tcp/127.0.0.1:7447",
}
NEEDS_MORE = {"send-goal": "fibonacci", "watch": "71a9", "action send_goal": "/f a/action/F {}"}
NEEDS_MORE |= {"param set": "/turtlesim background_r 100", "cancel": "71a9"}
NEEDS_MORE |= {"interface python": "std_msgs -o interfaces", "run": "turtlesim turtlesim_node"}
NEEDS_MORE |= {"serve --journal": "goals.db"}
NEEDS_MORE |= {"bag record": "-a", "bag info": "run", "bag play": "run", "bag goals": "run"}
NEEDS_MORE |= {"bag play --send-actions-as-client": "run"}
NEEDS_MORE |= {"bag convert": "-i run -o cut", "bag view": "run"}
"""What a sentence of a page leaves open, and the arguments that a command cannot do without."""


def texts_of(path: Path) -> Iterator[str]:
    """What a module can print of turtleact: its strings, without docstrings."""
    source = path.read_text("utf-8")
    if "turtleact " not in source:
        return
    tree = ast.parse(source)
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    first = [node.body[0] for node in ast.walk(tree) if isinstance(node, kinds) and node.body]
    docstrings = {id(each.value) for each in first if isinstance(each, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and id(node) not in docstrings:
            yield str(node.value)


def suggested() -> set[str]:
    """The arguments of each command that is suggested anywhere."""
    found = set[str]()
    for path in (ROOT / "turtleact").rglob("*.py"):
        for text in texts_of(path):
            found.update(QUOTED.findall(text), SHOWN.findall(text))
    return found


def in_sentences() -> set[str]:
    """The same of the pages, without their blocks."""
    pages = [
        re.sub("^```.*?^```", "", page.read_text("utf-8"), flags=re.M | re.S) for page in PAGES
    ]
    return {line for page in pages for line in INLINE.findall(page)}


ANSWERED = {"colcon build", "pkg build", "rosdep install"}
"""What these answer is an error with advice; ``test_verbs.py`` reads it."""


@together
@pytest.mark.parametrize("line", sorted((in_sentences() | suggested()) - ANSWERED))
def test_a_command_that_is_suggested_is_understood(line, capsys, monkeypatch):
    # `--show-completion` looks for a shell among the parents of this process; not all have one.
    monkeypatch.setattr("shellingham.detect_shell", lambda: ("bash", "/bin/bash"))
    # In one pass: what a path of this checkout has in it by chance is not replaced in turn.
    line = re.sub("|".join(map(re.escape, OPEN)), lambda found: OPEN[found[0]], line)
    monkeypatch.setattr(app.Verb, "invoke", lambda *_: None)  # it is only parsed
    app.run(shlex.split(f"{line} {NEEDS_MORE.get(line, '')}"))
    assert capsys.readouterr().err == ""


@together
@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=lambda page: page.name)
def test_a_program_of_the_checkout_that_is_named_is_there(page):
    for named in PYTHON.findall(page.read_text("utf-8")):
        path = named.removeprefix("-m ").replace(".", "/") + ".py" if "-m " in named else named
        assert (ROOT / path).is_file() or (ROOT / path.removesuffix(".py")).is_dir(), named
