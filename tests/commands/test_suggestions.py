"""Every command that a message, a help text or a page suggests does something sensible.

Those of messages and help texts are run, on a graph of their own. The blocks of pages are run by
``tests/test_docs.py`` and ``test_page.py``; here the commands within their sentences are parsed.
"""

from __future__ import annotations

import ast
import re
import shlex
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from turtleact.commands import app

from ..tables import together
from .test_serve import PATIENCE, free_endpoint, serving, start

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
QUOTED = re.compile(r"'turtleact ([^']+)'")
SHOWN = re.compile(r"^ +turtleact (.+)$", re.MULTILINE)
INLINE = re.compile(r"`turtleact ([^`]+)`")
PYTHON = re.compile(
    r"`(?:\.venv/bin/)?python3? ((?:-m )?(?:benchmarks|scripts|tests)[./][\w./]+)[^`]*`"
)

COMPLETE = {
    "param set": "param set /turtlesim background_r 100",
}
"""What a reader puts in place of what a suggestion leaves open."""

ELSEWHERE = {
    "serve --listen tls/0.0.0.0:7447 --config serve.toml": "test_locks.py: it needs certificates",
    "bag convert": "test_playing.py: it needs a damaged bag",
    "cancel 71a9 0d4f": "test_page.py: it needs goals with these ids",
    'service call /world/set_simulation_state "state: {state: 1}"': "test_send_goal.py",
    "cancel ID": "test_page.py: likewise",
    "pause 71a9": "test_pausing.py: it needs such a goal",
    "mcp --actions /patrol,/go_to": "test_mcp.py: it serves until its client leaves",
    "mcp --all --confirm": "test_mcp.py: likewise",
    "mcp --all --read-only --http 8000": "test_mcp.py: likewise",
}
"""Who runs the others."""

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
NEEDS_MORE |= {"interface python": "std_msgs -o interfaces", "run": "turtlesim turtlesim_node"}
NEEDS_MORE |= {"serve --journal": "goals.db"}
NEEDS_MORE |= {"bag record": "-a", "bag info": "run", "bag play": "run", "bag goals": "run"}
NEEDS_MORE |= {"bag play --send-actions-as-client": "run"}
NEEDS_MORE |= {"bag convert": "-i run -o cut", "bag view": "run"}
"""What a sentence of a page leaves open, and the arguments that a command cannot do without."""

LAB = """
import turtleact
from turtleact.interfaces.standard import Fibonacci

@turtleact.action(Fibonacci, "{name}")
async def {name}(goal):
    yield Fibonacci.Result()
"""


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


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab")
    (folder / "lab.py").write_text(LAB.format(name="patrol"))
    (folder / "robot").mkdir()
    (folder / "robot" / "arm.py").write_text(LAB.format(name="arm"))
    (folder / "serve.toml").write_text("")
    return folder


@pytest.fixture(scope="module")
def served(lab):
    with serving(lab) as server:
        yield server


def runs(line: str) -> list[str]:
    return shlex.split(COMPLETE.get(line, line))


SUGGESTED = sorted(suggested() - set(ELSEWHERE))
SERVING = [line for line in SUGGESTED if runs(line)[0] == "serve" and "--help" not in line]


@pytest.mark.parametrize("line", [line for line in SUGGESTED if line not in SERVING])
def test_a_command_that_is_suggested_works_on_a_graph(served, lab, line):
    arguments = runs(line)
    is_alone = {"interface", "pkg", "--help", "--speed"} & {*arguments}
    where = [] if is_alone or "--connect" in line else ["--connect", served.at]
    arguments = [served.at if each == "tcp/127.0.0.1:7447" else each for each in arguments]
    with start(lab, *arguments, *where) as process:
        try:
            if arguments[:2] == ["topic", "echo"]:
                assert process.stdout is not None
                assert process.stdout.readline()
                process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    assert process.returncode in (0, 130), out + err


@pytest.mark.parametrize("line", SERVING)
def test_a_server_that_is_suggested_gets_ready(lab, line):
    with start(lab, *runs(line), "--listen", free_endpoint()) as server:
        try:
            assert server.stdout is not None
            ready = server.stdout.readline()
            server.send_signal(signal.SIGTERM)
            _, err = server.communicate(timeout=PATIENCE)
        finally:
            with suppress(ProcessLookupError):
                server.kill()
    assert "at " in ready, err
    assert server.returncode in (0, 143)


def test_what_is_run_elsewhere_is_still_suggested():
    assert set(ELSEWHERE) <= suggested()
    assert set(COMPLETE) <= suggested()


ANSWERED = {"colcon build", "pkg build", "rosdep install"}
"""What these answer is an error with advice; ``test_verbs.py`` reads it."""


@together
@pytest.mark.parametrize("line", sorted(in_sentences() - ANSWERED))
def test_a_command_in_a_sentence_is_understood(line, capsys, monkeypatch):
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
