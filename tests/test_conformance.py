"""Holds docs/conformance.md to its word: its states are the code's, its proofs are tests.

A proof is named as ``test_goal.py::test_x``, relative to this folder. It must exist, and be run on
every event loop or need none; what the loops are is said in ``conftest.py``. The files are read,
not imported.
"""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

import pytest

from turtleact.goals.state import TRANSITIONS, GoalEvent, GoalStatus

from .tables import together

TESTS = Path(__file__).parent
PAGE = (TESTS.parent / "docs" / "conformance.md").read_text("utf-8")
COLUMNS = ["what", "rclpy", "rclcpp", "turtleact", "proved by"]

PROOF = re.compile(r"`((?:\w+/)*test_\w+\.py::test_\w+)`")
EVERY_LOOP = {"asyncio", "trio", "uvloop"}
LOOPS = EVERY_LOOP | {"anyio"}
RUNNERS = "turtleact.testing"
EXCUSES = {"skip", "skipif", "xfail"}

Table = list[list[str]]
Function = ast.FunctionDef | ast.AsyncFunctionDef


def tables_of(text: str) -> list[Table]:
    """The tables of a page, each with its head first, as rows of cells."""
    found = re.findall(r"(?:^\|.*\n?)+", text, re.MULTILINE)
    return [
        [cells_of(line) for number, line in enumerate(table.splitlines()) if number != 1]
        for table in found
    ]


def cells_of(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def rows_of(text: str) -> Table:
    """The rows of all tables that compare."""
    return [row for head, *rows in tables_of(text) if head == COLUMNS for row in rows]


def fault_of(proof: str, folder: Path = TESTS, *, every_loop: bool = True) -> str:
    """Why a test does not prove what it should, on every event loop if so asked; else empty."""
    path, _, name = proof.partition("::")
    if not (folder / path).exists():
        return "there is no such file"
    module = parsed(folder / path)
    function = functions_of(module).get(name)
    if function is None:
        return "there is no such test"
    binding = [module, *conftests_of(folder / path, folder)]
    if every_loop and any(map(binds_loops, binding)):
        return "its module has event loops of its own"
    shared = assignments_of(folder / "lab.py") if (folder / "lab.py").exists() else {}
    marks = words_of(marks_of(function, module), shared | assignments_of(folder / path))
    named = not marks >= EVERY_LOOP if "loops" in marks else "anyio_backend" in marks
    if every_loop and named:
        return "it does not run on every event loop"
    is_async, room = isinstance(function, ast.AsyncFunctionDef), path.split("/")[0]
    if every_loop and is_async and room in one_loop(folder):
        return "its folder runs on one event loop"
    if marks & EXCUSES:
        return "it may be skipped, or fail"
    runners = LOOPS | set(imported_from(RUNNERS, module))
    if every_loop and not is_async and words_of(function.body, {}) & runners:
        return "it runs an event loop of its own"
    return ""


def one_loop(folder: Path) -> set[str]:
    """The folders whose async tests run on one event loop, as ``conftest.py`` says."""
    names: set[str] = ast.literal_eval(assignments_of(folder / "conftest.py")["ONE_LOOP"])
    return names


@functools.cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text("utf-8"))


def functions_of(module: ast.Module) -> dict[str, Function]:
    return {node.name: node for node in module.body if isinstance(node, Function)}


def conftests_of(path: Path, folder: Path) -> list[ast.Module]:
    """The conftest.py of each folder between the test and ``folder``, that one left out."""
    between = [parent / "conftest.py" for parent in path.parents if folder in parent.parents]
    return [parsed(found) for found in between if found.exists()]


def binds_loops(module: ast.Module) -> bool:
    """Whether a module has an ``anyio_backend`` of its own."""
    return "anyio_backend" in [*imported_from("", module), *functions_of(module)]


def imported_from(package: str, module: ast.Module) -> list[str]:
    """The names that a module has from a package, or, if that is empty, from any."""
    return [
        alias.asname or alias.name
        for node in module.body
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(package)
        for alias in node.names
    ]


def assignments_of(path: Path) -> dict[str, ast.expr]:
    """What the names of a module stand for."""
    return {
        target.id: node.value
        for node in parsed(path).body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }


def marks_of(function: Function, module: ast.Module) -> list[ast.AST]:
    """What is said about a test: its decorators, and the marks of its module."""
    of_all = [node for node in module.body if isinstance(node, ast.Assign)]
    return [
        *function.decorator_list,
        *(
            node.value
            for node in of_all
            if any(isinstance(each, ast.Name) and each.id == "pytestmark" for each in node.targets)
        ),
    ]


def words_of(nodes: list[ast.AST] | list[ast.stmt], meant: dict[str, ast.expr]) -> set[str]:
    """The names, attributes and texts in some code, and in what its names stand for."""
    words: set[str] = set()
    left: list[ast.AST] = list(nodes)
    while left:
        for node in ast.walk(left.pop()):
            word = getattr(node, "id", getattr(node, "attr", getattr(node, "value", None)))
            if isinstance(word, str) and word not in words:
                words.add(word)
                if isinstance(node, ast.Name) and word in meant:
                    left.append(meant[word])
    return words


ROWS = rows_of(PAGE)
PROOFS = sorted({proof for row in ROWS for proof in PROOF.findall(row[-1])})


def test_the_states_and_events_of_the_page_are_those_of_the_code():
    (head, *rows) = next(table for table in tables_of(PAGE) if "event" in table[0][0])
    shown = {
        (GoalStatus[status], GoalEvent[event]): GoalStatus[after]
        for states, *cells in rows
        for status in states.split(", ")
        for event, after in zip(head[1:], cells, strict=True)
        if after != "–"
    }
    assert shown == TRANSITIONS


def test_the_page_shows_every_state_and_event():
    (head, *rows) = next(table for table in tables_of(PAGE) if "event" in table[0][0])
    assert head[1:] == [event.name for event in GoalEvent]
    states = ", ".join(row[0] for row in rows).split(", ")
    assert states == [status.name for status in GoalStatus if status is not GoalStatus.UNKNOWN]


@together
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_a_row_is_full_and_names_nothing_but_proofs(row):
    assert len(row) == len(COLUMNS)
    assert all(row)
    assert all(PROOF.fullmatch(proof) for proof in row[-1].split("<br>"))


@together
@pytest.mark.parametrize("proof", PROOFS)
def test_a_proof_is_a_test_that_holds_on_every_event_loop(proof):
    assert fault_of(proof) == ""


# --- the reading itself ---------------------------------------------------------------------

TABLE = """text
| what | rclpy | rclcpp | turtleact | proved by |
|---|---|---|---|---|
| a | b | c | d | `test_goal.py::test_x`<br>`sim/test_world.py::test_y` |

| other | table |
|---|---|
| e | f |
"""

MODULE = """
import anyio
from turtleact.testing import run
NARROW = pytest.mark.parametrize("anyio_backend", [])
async def test_on_every_loop(): await anyio.sleep(0)
def test_on_none(): assert goal
@both
async def test_in_two_ways(): ...
@NARROW
async def test_on_one_loop(): ...
@pytest.mark.parametrize("anyio_backend", [])
async def test_on_another(): ...
@SHARED
async def test_on_a_shared_one(): ...
@pytest.mark.loops("trio")
async def test_on_a_named_one(): ...
@pytest.mark.loops("asyncio", "uvloop", "trio")
async def test_on_all_that_are_named(): ...
@pytest.mark.parametrize("n", [pytest.param(1, marks=pytest.mark.xfail)])
async def test_fails(): ...
def test_runs_one(): anyio.run(body)
def test_runs_one_in_virtual_time(): run(body)
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "lab.py").write_text('SHARED = mark("anyio_backend")\nboth = mark("body")', "utf-8")
    (tmp_path / "conftest.py").write_text('ONE_LOOP = {"web"}', "utf-8")
    (tmp_path / "test_it.py").write_text(MODULE, "utf-8")
    (tmp_path / "test_virtual.py").write_text(
        "from plugin import anyio_backend\nasync def test_x(): ...", "utf-8"
    )
    (tmp_path / "test_marked.py").write_text(
        "pytestmark = [pytest.mark.skip]\nasync def test_x(): ...", "utf-8"
    )
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "conftest.py").write_text("def anyio_backend(): ...", "utf-8")
    (tmp_path / "sub" / "test_it.py").write_text("async def test_x(): ...", "utf-8")
    (tmp_path / "web").mkdir()
    (tmp_path / "web" / "test_it.py").write_text(
        "async def test_x(): ...\ndef test_y(): ...", "utf-8"
    )
    return tmp_path


def test_the_rows_of_the_tables_that_compare_are_read():
    (row,) = rows_of(TABLE)
    assert row[:4] == ["a", "b", "c", "d"]
    assert PROOF.findall(row[4]) == ["test_goal.py::test_x", "sim/test_world.py::test_y"]


@pytest.mark.parametrize(
    "proof",
    [
        "test_it.py::test_on_every_loop",
        "test_it.py::test_on_none",
        "test_it.py::test_in_two_ways",
        "test_it.py::test_on_all_that_are_named",
        "web/test_it.py::test_y",
    ],
)
def test_no_fault_is_found_with_a_proof(folder, proof):
    assert fault_of(proof, folder) == ""


@pytest.mark.parametrize(
    ("proof", "fault"),
    [
        ("test_other.py::test_x", "there is no such file"),
        ("test_it.py::test_x", "there is no such test"),
        ("test_it.py::test_on_one_loop", "it does not run on every event loop"),
        ("test_it.py::test_on_another", "it does not run on every event loop"),
        ("test_it.py::test_on_a_shared_one", "it does not run on every event loop"),
        ("test_it.py::test_on_a_named_one", "it does not run on every event loop"),
        ("web/test_it.py::test_x", "its folder runs on one event loop"),
        ("test_it.py::test_fails", "it may be skipped, or fail"),
        ("test_marked.py::test_x", "it may be skipped, or fail"),
        ("test_it.py::test_runs_one", "it runs an event loop of its own"),
        ("test_it.py::test_runs_one_in_virtual_time", "it runs an event loop of its own"),
        ("test_virtual.py::test_x", "its module has event loops of its own"),
        ("sub/test_it.py::test_x", "its module has event loops of its own"),
    ],
)
def test_a_test_that_is_no_proof_is_told(folder, proof, fault):
    assert fault_of(proof, folder) == fault
