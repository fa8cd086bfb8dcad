"""What README.md, docs/ and the docstrings show is run as it stands.

- ``>>>`` blocks of a page are one session: a later block sees the names of an earlier one.
- A ``python`` block below ``<!-- run -->`` is a whole program: it must end well, without a warning.
- Every ``$ turtleact …`` line of README.md in a ``console`` or ``sh`` block is run. Lines below it
  are its output, in which ``...`` stands for anything; without them it must just succeed.
  ``<!-- exit status N -->`` above the block says how its commands end, if not with 0;
  ``<!-- not run: why -->`` leaves the block out.
"""

from __future__ import annotations

import ast
import doctest
import importlib
import os
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

import msgspec
import pytest

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").rglob("*.md"))]
MODULES = [
    path for path in sorted((ROOT / "turtleact").rglob("*.py")) if ">>> " in path.read_text("utf-8")
]

INSTALL = "python3 -m venv .venv && .venv/bin/pip install . && .venv/bin/turtleact send-goal patrol"
TEST = 'python3 -m venv .venv && .venv/bin/pip install -e ".[test]" && .venv/bin/pytest'

FENCE = re.compile(
    r"(?:^<!-- (?P<mark>[^\n]*?) -->\n+)?^```(?P<language>\w*)[^\n]*\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
DOCTEST_OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
SECONDS = 50


class Block(msgspec.Struct, frozen=True):
    """A fenced block of a page, with what the comment above it says."""

    page: Path
    line: int
    language: str
    mark: str
    text: str

    @property
    def name(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


class Command(msgspec.Struct, frozen=True):
    """A command line that a page shows, and what it should print and return."""

    name: str
    line: str
    output: str
    status: int


def blocks_of(page: Path, text: str | None = None) -> list[Block]:
    text = page.read_text("utf-8") if text is None else text
    return [
        Block(
            page,
            text.count("\n", 0, found.start("text")) + 1,
            found["language"],
            found["mark"] or "",
            found["text"],
        )
        for found in FENCE.finditer(text)
    ]


def commands_of(block: Block) -> list[Command]:
    """The ``$ turtleact …`` lines of a block; a line that ends in a backslash goes on."""
    if block.language not in {"console", "sh"} or block.mark.startswith("not run: "):
        return []
    found = re.fullmatch(r"exit status (\d+)", block.mark)
    status = int(found[1]) if found else 0
    _, *parts = re.split(r"^\$ ", block.text, flags=re.MULTILINE)
    commands = []
    for part in parts:
        shown, _, output = re.sub(r"\\\n\s*", "", part).partition("\n")
        if shown.startswith("turtleact"):
            commands.append(Command(f"{block.name}: {shown}", shown, output.rstrip(), status))
    return commands


def session_of(page: Path) -> doctest.DocTest:
    """All ``>>>`` blocks of a page as one doctest, each at its own line."""
    lines = [""] * page.read_text("utf-8").count("\n")
    for block in blocks_of(page):
        if ">>> " in block.text:
            shown = block.text.splitlines()
            lines[block.line - 1 : block.line - 1 + len(shown)] = shown
    return doctest.DocTestParser().get_doctest("\n".join(lines), {}, page.name, str(page), 0)


def run_session(session: doctest.DocTest) -> str:
    """Runs a doctest; what is not as shown, as text."""
    report: list[str] = []
    doctest.DocTestRunner(verbose=False, optionflags=DOCTEST_OPTIONS).run(
        session, out=report.append
    )
    return "".join(report)


def run(arguments: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Runs a program as a reader would who is in ``folder``; stderr goes with stdout."""
    return subprocess.run(
        arguments,
        cwd=folder,
        env=os.environ | {"PATH": f"{sysconfig.get_path('scripts')}:{os.environ['PATH']}"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        timeout=SECONDS,
    )


def is_as_shown(output: str, shown: str) -> bool:
    checker = doctest.OutputChecker()
    return checker.check_output(f"{shown}\n", f"{output.rstrip()}\n", doctest.ELLIPSIS)


BLOCKS = [block for page in PAGES for block in blocks_of(page)]
SESSIONS = [page for page in PAGES if ">>> " in page.read_text("utf-8")]
PROGRAMS = [block for block in BLOCKS if (block.language, block.mark) == ("python", "run")]
COMMANDS = [command for block in BLOCKS if block.page == README for command in commands_of(block)]


@pytest.mark.parametrize("page", SESSIONS, ids=lambda page: page.name)
def test_a_session_goes_as_the_page_shows(page):
    assert run_session(session_of(page)) == ""


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_session_goes_as_the_docstring_shows(path):
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    module = importlib.import_module(name)
    sessions = doctest.DocTestFinder().find(module, name)
    assert "".join(map(run_session, sessions)) == ""


@pytest.mark.parametrize("block", PROGRAMS, ids=lambda block: block.name)
def test_a_program_of_a_page_runs(block, tmp_path):
    (tmp_path / "program.py").write_text(block.text, "utf-8")
    outcome = run([sys.executable, "-W", "error", "program.py"], tmp_path)
    assert outcome.returncode == 0, outcome.stdout


@pytest.mark.parametrize(
    "block", [block for block in BLOCKS if block.language == "python"], ids=lambda block: block.name
)
def test_a_python_block_is_python(block):
    if ">>> " not in block.text:
        ast.parse(block.text, block.name)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_a_command_of_the_readme_does_what_it_shows(command, tmp_path):
    outcome = run(["bash", "-c", command.line], tmp_path)
    assert outcome.returncode == command.status, outcome.stdout
    assert not command.output or is_as_shown(outcome.stdout, command.output), outcome.stdout


@pytest.mark.parametrize(
    ("mark", "line"),
    [("install command", INSTALL), ("test command", TEST)],
    ids=["install", "test"],
)
def test_the_readme_has_the_line_that_takes_a_newcomer_there(mark, line):
    (text,) = [block.text for block in blocks_of(README) if block.mark == mark]
    assert text.startswith(line)


# --- the reading itself ---------------------------------------------------------------------


def commands_in(text: str) -> list[tuple[str, str, int]]:
    found = [command for block in blocks_of(README, text) for command in commands_of(block)]
    return [(command.line, command.output, command.status) for command in found]


def test_a_command_is_read_with_the_output_below_it():
    text = "```console\n$ turtleact goals\nid  state\n$ ls\n$ turtleact --version\n```\n"
    assert commands_in(text) == [
        ("turtleact goals", "id  state", 0),
        ("turtleact --version", "", 0),
    ]


def test_a_command_that_goes_on_is_one_command():
    text = "```sh\n$ turtleact send-goal \\\n    patrol\n```\n"
    assert commands_in(text) == [("turtleact send-goal patrol", "", 0)]


def test_a_mark_says_how_a_command_ends():
    text = "<!-- exit status 2 -->\n```console\n$ turtleact wat\n```\n"
    assert commands_in(text) == [("turtleact wat", "", 2)]


def test_a_block_with_a_reason_is_not_run():
    text = "<!-- not run: serves until Ctrl-C -->\n```console\n$ turtleact serve\n```\n"
    assert commands_in(text) == []


def test_dots_in_the_output_stand_for_anything():
    assert is_as_shown("Goal accepted with ID: 0d4f\n\n", "Goal accepted with ID: ...")
    assert not is_as_shown("Goal rejected\n", "Goal accepted with ID: ...")


def test_the_blocks_of_a_page_are_one_session(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```python\n>>> a = 20\n```\ntext\n```python\n>>> a + 1\n20\n```\n", "utf-8")
    report = run_session(session_of(page))
    assert re.search(r"line 6,.*Expected:\s+20\s+Got:\s+21", report, re.DOTALL)
