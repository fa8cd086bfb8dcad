"""What docs/embedding.md and its examples promise: a web app, a behaviour tree, a notebook."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import re
import uuid
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import anyio
import httpx
import pytest
from py_trees.common import Status

from turtleact import testing

from .lab import Count, Gate, goal, lab, settle

EXAMPLES = Path(__file__).parents[1] / "examples"
BACKENDS = pytest.mark.parametrize("backend", ["asyncio", "trio"])
PLACES = {"targets": [{"x": 9.0, "y": 7.0}, {"x": 9.0, "y": 10.0}]}


def load(name: str) -> ModuleType:
    """An example as a module; what it does when it is run as a program is left out."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# --- the web app ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def app():
    return load("20_fastapi").app


@asynccontextmanager
async def browser(app):
    transport = httpx.ASGITransport(app)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=transport, base_url="http://turtle") as http,
    ):
        yield http


async def start_patrol(http: httpx.AsyncClient) -> str:
    answer = await http.post("/patrol", json=PLACES)
    return f"/goals/{answer.json()['goal_id']}"


async def status_of(http: httpx.AsyncClient, goal: str):
    return (await http.get(goal)).json()["status"]


class Listener:
    """A request whose answer is read bit by bit, as `httpx.ASGITransport` does not."""

    def __init__(self, app: Any, path: str) -> None:
        self._app = app
        self._scope = {
            "type": "http",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "method": "GET",
            "path": path,
            "raw_path": path.encode(),
            "query_string": b"",
            "root_path": "",
            "headers": [],
            "scheme": "http",
        }
        self._left = anyio.Event()
        self.heard = anyio.Event()
        self.text = ""

    async def listen(self) -> None:
        await self._app(self._scope, self._receive, self._send)

    def leave(self) -> None:
        self._left.set()

    async def _receive(self) -> dict[str, Any]:
        await self._left.wait()
        return {"type": "http.disconnect"}

    async def _send(self, message: Any) -> None:
        self.text += message.get("body", b"").decode()
        if self.text:
            self.heard.set()


@BACKENDS
def test_a_listener_hears_feedback_while_the_goal_runs(app, backend):
    async def visit():
        async with browser(app) as http, anyio.create_task_group() as group:
            goal = await start_patrol(http)
            listener = Listener(app, f"{goal}/feedback")
            group.start_soon(listener.listen)
            await listener.heard.wait()
            assert listener.text.startswith('data: {"reached": 0, ')
            assert await status_of(http, goal) == "EXECUTING"

    testing.run(visit, backend=backend)


@BACKENDS
def test_a_goal_outlives_a_listener_that_leaves(app, backend):
    async def visit():
        async with browser(app) as http:
            goal = await start_patrol(http)
            listener = Listener(app, f"{goal}/feedback")
            async with anyio.create_task_group() as group:
                group.start_soon(listener.listen)
                await listener.heard.wait()
                listener.leave()
            assert "result" not in listener.text
            await anyio.sleep(5)
            assert await status_of(http, goal) == "SUCCEEDED"

    testing.run(visit, backend=backend)


@BACKENDS
def test_a_listener_that_comes_late_hears_what_has_been_said(app, backend):
    async def visit():
        async with browser(app) as http:
            goal = await start_patrol(http)
            await anyio.sleep(5)
            return (await http.get(f"{goal}/feedback")).text

    text = testing.run(visit, backend=backend)
    assert re.findall(r'"reached": (\d)', text) == ["0", "1", "1", "2"]
    assert text.endswith('event: result\ndata: "SUCCEEDED"\n\n')


@BACKENDS
def test_a_mistake_in_a_goal_is_answered_with_its_path(app, backend):
    async def visit():
        async with browser(app) as http:
            return await http.post("/patrol", json={"targets": [{"x": 9.0, "yy": 7.0}]})

    answer = testing.run(visit, backend=backend)
    assert answer.status_code == 422
    (problem,) = answer.json()["detail"]
    assert problem["loc"] == ["body", "targets", 0]
    assert problem["msg"] == "unknown field 'yy', did you mean 'y'?"


@pytest.mark.parametrize(
    ("goal_id", "code"), [("abc", 422), ("abcd", 422), (str(uuid.UUID(int=1)), 404)]
)
def test_a_wrong_goal_id_is_the_callers_mistake(app, goal_id, code):
    async def visit():
        async with browser(app) as http:
            return (await http.get(f"/goals/{goal_id}")).status_code

    assert testing.run(visit) == code


@BACKENDS
def test_a_goal_that_has_ended_cannot_be_canceled(app, backend):
    async def visit():
        async with browser(app) as http:
            goal = await start_patrol(http)
            await anyio.sleep(5)
            return await http.delete(goal)

    answer = testing.run(visit, backend=backend)
    assert (answer.status_code, answer.json()) == (409, {"detail": "the goal is SUCCEEDED"})


# --- the behaviour tree ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def goal_leaf():
    return load("21_py_trees").GoalLeaf


@asynccontextmanager
async def leaf_of(goal_leaf, client):
    """A leaf that sends a goal of `Count`, and is let go of at the end."""
    async with anyio.create_task_group() as group:
        leaf = goal_leaf(client, goal(), name="leaf", group=group, turtle=anyio.Lock())
        yield leaf
        leaf.stop(Status.INVALID)


def tick(leaf):
    leaf.tick_once()
    return leaf.status


async def tick_twice(leaf):
    """What a leaf says once all has happened that its first tick brings about."""
    leaf.tick_once()
    await settle()
    return tick(leaf)


async def test_a_leaf_is_running_as_long_as_its_goal(goal_leaf):
    gate = Gate()
    async with lab(gate.wait) as node, leaf_of(goal_leaf, node.client) as leaf:
        assert await tick_twice(leaf) is Status.RUNNING
        gate.opened.set()
        await settle()
        assert tick(leaf) is Status.SUCCESS


async def test_a_leaf_whose_goal_is_aborted_fails(goal_leaf):
    async def give_up(goal: Count.Goal) -> None:
        """Returns no result."""

    async with lab(give_up) as node, leaf_of(goal_leaf, node.client) as leaf:
        assert await tick_twice(leaf) is Status.FAILURE
        assert leaf.feedback_message == "ABORTED"


async def test_a_leaf_whose_goal_is_rejected_fails_and_says_why(goal_leaf):
    gate = Gate()
    async with (
        lab(gate.wait, policy="reject") as node,
        node.client.send_goal(goal()),
        leaf_of(goal_leaf, node.client) as leaf,
    ):
        assert await tick_twice(leaf) is Status.FAILURE
        assert "the goal was rejected: " in leaf.feedback_message


async def test_a_leaf_that_is_left_cancels_its_goal(goal_leaf):
    gate = Gate()
    async with lab(gate.wait) as node, leaf_of(goal_leaf, node.client) as leaf:
        assert await tick_twice(leaf) is Status.RUNNING
        leaf.stop(Status.INVALID)
        await settle()
        assert gate.log == ["begun", "canceled", "over"]
        assert leaf.handle.status.name == "CANCELED"


# --- the notebook ---------------------------------------------------------------------------


def cells_for_a_notebook(text: str) -> list[str]:
    """The cells of the example, changed as its docstring says."""
    cells = re.split(r"^# %% (.*)\n", text, flags=re.MULTILINE)
    return [
        re.sub(r"\brun\(", "await (", cell)
        for title, cell in zip(cells[1::2], cells[2::2], strict=True)
        if not title.startswith("Not in a notebook")
    ]


async def run_cell(cell: str, names: dict[str, Any]) -> None:
    """What a notebook does with a cell: it may await, and it runs in the loop that is there."""
    code = compile(cell, "a cell", "exec", flags=ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
    running = eval(code, names)
    if inspect.iscoroutine(running):
        await running


@pytest.mark.loops("asyncio", "uvloop")  # on trio, a node is closed by the task that opened it
async def test_the_cells_of_the_example_run_in_a_notebook_each_in_a_task_of_its_own(capsys):
    text = (EXAMPLES / "22_notebook.py").read_text("utf-8")
    docstring = ast.get_docstring(ast.parse(text)) or ""
    names: dict[str, Any] = {}
    for cell in cells_for_a_notebook(text):
        async with anyio.create_task_group() as group:
            group.start_soon(partial(run_cell, cell, names))
    assert capsys.readouterr().out == inspect.cleandoc(docstring.partition("Prints:")[2]) + "\n"
