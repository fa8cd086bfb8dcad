"""What README.md, docs/ and the docstrings show is run as it stands.

- ``>>>`` blocks of a page are one session: a later block sees the names of an earlier one.
- A ``python`` block below ``<!-- run -->`` is a whole program: it must end well, without a warning.
  One below ``<!-- run on -->`` goes on where the last one stopped: the two are one program. The
  block below ``<!-- output -->`` is what the program prints; ``...`` stands for anything.
- Every ``$ turtleact …`` line of a ``console`` or ``sh`` block is run. Lines below it
  are its output, in which ``...`` stands for anything; without them it must just succeed.
  ``<!-- exit status N -->`` above the block says how its commands end, if not with 0;
  ``<!-- not run: why -->`` leaves the block out.
- Blocks below ``<!-- recipe FILE -->`` are the files of one folder, the one below ``<!-- recipe
  output of COMMAND -->`` is what the command prints there; ``<!-- recipe instead FILE -->`` is
  another version of the file.
- A block below ``<!-- file PATH -->`` is that file, one below ``<!-- made by PATH -->`` what that
  script prints. ``<!-- layers -->`` stands above the rows of the import contract.
- Blocks below ``<!-- save FILE -->`` and ``<!-- terminal N -->`` are left to
  ``commands/test_tutorial.py``.
- No block is left over.
"""

from __future__ import annotations

import ast
import configparser
import doctest
import importlib
import importlib.util
import os
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

import msgspec
import pytest

from . import warm
from .tables import together

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
RECORD_PATROL = ROOT / "scripts" / "record_patrol.py"
PAGES = [README, *sorted((ROOT / "docs").rglob("*.md"))]
MODULES = [
    path for path in sorted((ROOT / "turtleact").rglob("*.py")) if ">>> " in path.read_text("utf-8")
]

INSTALL = "python3 -m venv .venv && .venv/bin/pip install . && .venv/bin/turtleact send-goal patrol"
TEST = (
    'python3 -m venv .venv && .venv/bin/pip install -e ".[test]" && '
    ".venv/bin/pytest -n auto --dist worksteal"
)

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


class Program(msgspec.Struct):
    """A program that a page shows in one block or several, and what it should print."""

    name: str
    text: str
    output: str | None = None


class Command(msgspec.Struct, frozen=True):
    """A command line that a page shows, and what it should print and return."""

    name: str
    line: str
    output: str
    status: int


def blocks_of(page: Path) -> list[Block]:
    text = page.read_text("utf-8")
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


def programs_of(blocks: list[Block]) -> list[Program]:
    """The programs of a page, each put together from its blocks."""
    programs: list[Program] = []
    for block in blocks:
        if block.mark == "run":
            programs.append(Program(block.name, block.text))
        elif block.mark == "run on":
            programs[-1].text += f"\n{block.text}"
        elif block.mark == "output":
            programs[-1].output = block.text.rstrip()
    return programs


def commands_of(block: Block) -> list[Command]:
    """The ``$ turtleact …`` lines of a block; a line that ends in a backslash goes on."""
    if block.language not in {"console", "sh"} or block.mark.startswith(("not run: ", "terminal ")):
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
    return warm.run(
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


def is_checked(block: Block) -> bool:
    """Whether one of the tests here looks at a block, or its mark says why none does."""
    return (
        ">>> " in block.text
        or block.mark in {"run", "run on", "output", "layers", "install command", "test command"}
        or block.mark.startswith(
            ("file ", "made by ", "not run: ", "recipe ", "save ", "terminal ")
        )
        or bool(commands_of(block))
    )


def marked(word: str) -> list[Block]:
    return [block for block in BLOCKS if block.mark.startswith(word)]


BLOCKS = [block for page in PAGES for block in blocks_of(page)]
SESSIONS = [page for page in PAGES if ">>> " in page.read_text("utf-8")]
PROGRAMS = [program for page in PAGES for program in programs_of(blocks_of(page))]
COMMANDS = [command for block in BLOCKS for command in commands_of(block)]
LINKS = [
    (page, link)
    for page in PAGES
    for link in re.findall(r"\]\(([^)\s]+)\)", FENCE.sub("", page.read_text("utf-8")))
    if not link.startswith(("https://", "#"))
]


@pytest.mark.parametrize("page", SESSIONS, ids=lambda page: page.name)
def test_a_session_goes_as_the_page_shows(page):
    assert run_session(session_of(page)) == ""


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_session_goes_as_the_docstring_shows(path):
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    module = importlib.import_module(name)
    sessions = doctest.DocTestFinder().find(module, name)
    assert "".join(map(run_session, sessions)) == ""


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.name)
def test_a_program_of_a_page_does_what_it_shows(program, tmp_path):
    (tmp_path / "program.py").write_text(program.text, "utf-8")
    outcome = run([sys.executable, "-W", "error", "program.py"], tmp_path)
    assert outcome.returncode == 0, outcome.stdout
    assert program.output is None or is_as_shown(outcome.stdout, program.output), outcome.stdout


@together
@pytest.mark.parametrize(
    "block", [block for block in BLOCKS if block.language == "python"], ids=lambda block: block.name
)
def test_a_python_block_is_python(block):
    if ">>> " not in block.text:
        ast.parse(block.text, block.name)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_a_command_of_a_page_does_what_it_shows(command, tmp_path):
    words = warm.words_of(command.line)
    assert words is None or words[0] == "turtleact"
    program = ["bash", "-c", command.line]
    if words is not None:
        program = [sys.executable, "-m", *words]
    outcome = run(program, tmp_path)
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


def test_the_line_that_installs_leads_to_a_goal_that_succeeds(tmp_path):
    (block,) = marked("install command")
    command = block.text.strip().rpartition("&& .venv/bin/")[2]
    outcome = run(["bash", "-c", f"{command} --speed max"], tmp_path)
    assert outcome.returncode == 0, outcome.stdout
    assert outcome.stdout.endswith("Goal finished with status: SUCCEEDED\n")


def files_of_the_recipe() -> dict[str, str]:
    blocks = [block for block in marked("recipe ") if block.page.name == "testing.md"]
    return {block.mark.removeprefix("recipe "): block.text for block in blocks}


@pytest.mark.parametrize("version", ["", "instead "])
def test_the_recipe_for_tests_works_in_an_empty_folder(tmp_path, version):
    blocks = files_of_the_recipe()
    for name in ("pytest.ini", "conftest.py", "test_fibonacci.py"):
        text = blocks.get(f"{version}{name}", blocks[name])
        (tmp_path / name).write_text(text, "utf-8")
    outcome = run(["pytest", "-q", "-p", "no:cacheprovider"], tmp_path)
    shown = blocks["output of pytest -q"] if not version else ". [100%]\n1 passed in ...s"
    printed = re.sub(" +", " ", outcome.stdout)
    assert is_as_shown(printed, shown.rstrip()), outcome.stdout


@pytest.mark.parametrize("block", marked("file "), ids=lambda block: block.name)
def test_a_file_stands_as_the_page_shows(block):
    path = ROOT / block.mark.removeprefix("file ")
    assert path.read_text("utf-8").rstrip() == block.text.rstrip()


@pytest.mark.parametrize("block", marked("made by "), ids=lambda block: block.name)
def test_a_block_that_is_made_is_what_its_script_prints(block):
    outcome = run([sys.executable, block.mark.removeprefix("made by ")], ROOT)
    assert outcome.stdout == block.text


def test_the_layers_are_those_of_the_import_contract():
    (block,) = marked("layers")
    contract = configparser.ConfigParser()
    contract.read(ROOT / ".importlinter", "utf-8")
    rows = contract["importlinter:contract:layers"]["layers"].strip()
    shown = [re.split(r"  +", line)[0] for line in block.text.splitlines()]
    assert shown == re.sub(r"[()]", "", rows).splitlines()


def test_every_module_of_the_way_to_other_processes_is_described():
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    section = page.partition("## To other processes\n")[2].partition("\n## ")[0]
    rows = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
    modules = (ROOT / "turtleact" / "transports" / "rmw_zenoh").glob("[!_]*.py")
    assert sorted(re.findall(r"\w+", "".join(rows))) == sorted(path.stem for path in modules)


def test_the_picture_of_the_patrol_is_what_its_script_draws():
    outcome = run([sys.executable, "scripts/record_patrol.py"], ROOT)
    assert outcome.stdout == (ROOT / "docs" / "patrol.svg").read_text("utf-8")


def test_the_picture_of_the_patrol_shows_the_goal_of_the_readme():
    script = importlib.util.spec_from_file_location("record_patrol", RECORD_PATROL)
    assert script is not None
    assert script.loader is not None
    module = importlib.util.module_from_spec(script)
    script.loader.exec_module(module)
    (block,) = marked("install command")
    shown = re.findall(r"\{x: ([\d.]+), y: ([\d.]+)\}", block.text)
    assert [(float(x), float(y)) for x, y in shown] == list(module.TARGETS)


@together
@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.name)
def test_every_block_is_checked(block):
    assert is_checked(block)


@together
@pytest.mark.parametrize(("page", "link"), LINKS, ids=lambda value: getattr(value, "name", value))
def test_a_link_leads_to_a_file(page, link):
    assert (page.parent / link.partition("#")[0]).exists()
