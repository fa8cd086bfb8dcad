"""``serve --reload``: what changes count, what is replaced, and what stays."""

from __future__ import annotations

import linecache
import os
import sys
from pathlib import Path
from typing import NamedTuple

import anyio
import anyio.lowlevel
import pytest

from turtleact import GoalStatus, Node, open_node
from turtleact.commands.reloading import Reloader, Watch
from turtleact.commands.targets import Modules
from turtleact.errors import InvalidParameter
from turtleact.interfaces import get_action, load_interfaces
from turtleact.interfaces.standard import Fibonacci
from turtleact.interfaces.types import REGISTRY
from turtleact.transports import MemoryTransport

LAB = """
import anyio
import turtleact
from turtleact.interfaces.standard import Fibonacci
import reloadhelper

{more}

@turtleact.action(Fibonacci, "mine")
async def mine(goal, handle):
    yield Fibonacci.Feedback(partial_sequence=[0])
    if goal.order:
        await anyio.sleep_forever()
    yield Fibonacci.Result(sequence=[{number}, reloadhelper.NUMBER])
"""


class Desk(NamedTuple):
    """What a test works with.

    Attributes:
        folder: Where the user's files are.
        node: The node that serves them.
        reloader: What is tested.
        said: What the user was told.
        transport: The graph.
    """

    folder: Path
    node: Node
    reloader: Reloader
    said: list[str]
    transport: MemoryTransport

    def write(self, number=1, *, more="", file="reloadlab.py", text=""):
        """Save a file; its time changes even if the clock is coarse."""
        path = self.folder / file
        before = path.stat().st_mtime_ns if path.exists() else 0
        path.write_text(text or LAB.format(number=number, more=more))
        stamp = max(before + 1_000_000, path.stat().st_mtime_ns)
        os.utime(path, ns=(stamp, stamp))

    async def rest(self):
        """Let the files be at rest: the change counts at the second look."""
        await self.reloader.look()
        await self.reloader.look()

    async def answer(self):
        client = self.node.action_client(Fibonacci, "mine")
        return list((await client.send_goal(Fibonacci.Goal(order=0))).sequence)


@pytest.fixture
async def desk(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(sys, "modules", dict(sys.modules))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    (tmp_path / "reloadlab.py").write_text(LAB.format(number=1, more=""))
    (tmp_path / "reloadhelper.py").write_text("NUMBER = 10\n")
    transport = MemoryTransport()
    modules = Modules(["reloadlab.py"])
    watch = Watch(modules)
    found = modules.find()
    watch.follow()
    said: list[str] = []
    async with open_node("turtleact", transport=transport) as node:
        reloader = Reloader(node, modules, watch, said.append)
        reloader.adopt(found, [node.serve(each) for each in found.actions])
        yield Desk(tmp_path, node, reloader, said, transport)


# --- what counts as a change ----------------------------------------------------------------


async def test_a_changed_file_is_served_anew(desk):
    assert await desk.answer() == [1, 10]
    desk.write(2)
    await desk.rest()
    assert await desk.answer() == [2, 10]
    assert desk.said == ["reloading: reloadlab.py changed", "reloaded: /mine"]


BEATING = """
import anyio

@turtleact.background
async def beat(node):
    node.beats.append("begun")
    try:
        await anyio.sleep_forever()
    finally:
        node.beats.append("ended")
"""


async def test_a_background_task_runs_until_the_next_reload(desk):
    desk.node.beats = []
    desk.write(2, more=BEATING)
    await desk.rest()
    await anyio.wait_all_tasks_blocked()
    assert desk.node.beats == ["begun"]
    desk.write(3, more=BEATING)
    await desk.rest()
    await anyio.wait_all_tasks_blocked()
    assert desk.node.beats == ["begun", "ended", "begun"]
    await desk.reloader.aclose()
    assert desk.node.beats[2:] == ["begun", "ended"]


PAIR = """
import anyio
import turtleact

begun = [anyio.Event(), anyio.Event()]

async def end_together(own, other):
    try:
        await anyio.sleep_forever()
    finally:
        with anyio.move_on_after(1, shield=True) as waiting:
            own.set()
            await other.wait()
        print("too late" if waiting.cancelled_caught else "in time")

@turtleact.background
async def one(node):
    await end_together(*begun)

@turtleact.background
async def two(node):
    await end_together(*reversed(begun))
"""


async def test_background_tasks_end_together(desk, capsys):
    desk.write(text=PAIR)
    await desk.rest()
    await anyio.lowlevel.checkpoint()
    await desk.reloader.aclose()
    assert capsys.readouterr().out == "in time\n" * 2


LINGERING = """
import anyio
import turtleact
from turtleact.interfaces.standard import Fibonacci

@turtleact.background
async def linger(node):
    client = node.action_client(Fibonacci, "mine")
    async with client.send_goal(Fibonacci.Goal(order=1)) as handle:
        try:
            await anyio.sleep_forever()
        finally:
            with anyio.move_on_after(1, shield=True):
                node.seen.append((await handle.outcome()).reason)
                try:
                    await client.send_goal(Fibonacci.Goal())
                except turtleact.TurtleactError as error:
                    node.seen.append(type(error).__name__)
"""


@pytest.mark.parametrize("reason", ["reloading", "shutdown"])
async def test_goals_end_and_none_is_accepted_while_a_background_task_cleans_up(desk, reason):
    desk.node.seen = []
    desk.write(2, more=LINGERING)
    await desk.rest()
    await anyio.wait_all_tasks_blocked()
    if reason == "reloading":
        desk.write(3)
        await desk.rest()
    else:
        await desk.reloader.aclose()
    assert desk.node.seen == [reason, "ServerUnavailable"]


async def test_a_module_may_have_background_tasks_alone(desk, caplog):
    text = "import turtleact\n\n@turtleact.background\nasync def fail(node):\n    node.missing\n"
    desk.write(text=text)
    await desk.rest()
    await anyio.wait_all_tasks_blocked()
    assert desk.said[-1] == "reloaded: background tasks"
    assert "the background task fail has failed" in caplog.messages


async def test_a_local_module_that_it_imports_counts_too(desk):
    desk.write(file="reloadhelper.py", text="NUMBER = 20\n")
    await desk.rest()
    assert await desk.answer() == [1, 20]


async def test_a_warning_quotes_the_line_as_it_is_now(desk):
    file = str(desk.folder / "reloadlab.py")
    assert linecache.getlines(file)[-1].strip().endswith("[1, reloadhelper.NUMBER])")
    desk.write(2)
    await desk.rest()
    assert linecache.getlines(file)[-1].strip().endswith("[2, reloadhelper.NUMBER])")


async def test_nothing_happens_without_a_change(desk):
    server = next(iter(desk.transport.endpoints("mine/_action/send_goal")), None)
    await desk.rest()
    assert desk.said == []
    assert next(iter(desk.transport.endpoints("mine/_action/send_goal")), None) is server


async def test_a_file_that_is_still_being_written_is_waited_for(desk):
    desk.write(2)
    await desk.reloader.look()
    desk.write(3)
    await desk.reloader.look()
    assert desk.said == []
    await desk.reloader.look()
    assert await desk.answer() == [3, 10]


async def test_two_files_that_change_together_are_one_reload(desk):
    desk.write(2)
    desk.write(file="reloadhelper.py", text="NUMBER = 20\n")
    await desk.rest()
    assert await desk.answer() == [2, 20]
    assert desk.said == ["reloading: reloadhelper.py, reloadlab.py changed", "reloaded: /mine"]


async def test_an_editor_may_replace_the_file(desk):
    (desk.folder / "reloadlab.py").unlink()
    await desk.reloader.look()
    desk.write(2, file="reloadlab.py~")
    (desk.folder / "reloadlab.py~").rename(desk.folder / "reloadlab.py")
    await desk.rest()
    assert await desk.answer() == [2, 10]


async def test_a_change_during_a_reload_is_seen_afterwards(desk):
    stamp = "import os; os.utime('reloadhelper.py', ns=(1, 1))"
    desk.write(2, more=stamp)
    await desk.rest()
    await desk.rest()
    assert desk.said[-2:] == ["reloading: reloadhelper.py changed", "reloaded: /mine"]


async def test_a_module_that_is_imported_from_now_on_is_watched(desk):
    desk.write(file="reloadnew.py", text="X = 1\n")
    desk.write(2, more="import reloadnew")
    await desk.rest()
    desk.write(file="reloadnew.py", text="X = 2\n")
    await desk.rest()
    assert desk.said[-2:] == ["reloading: reloadnew.py changed", "reloaded: /mine"]


async def test_an_interface_file_is_read_anew(desk):
    with REGISTRY.isolated():
        desk.folder.joinpath("reload_msgs", "action").mkdir(parents=True)
        desk.write(file="reload_msgs/action/Count.action", text="int32 to\n---\n---\n")
        load_interfaces(desk.folder)
        desk.reloader.watch.follow()
        assert get_action("reload_msgs/action/Count").Goal(to=1).to == 1
        desk.write(file="reload_msgs/action/Count.action", text="int32 until\n---\n---\n")
        await desk.rest()
        assert get_action("reload_msgs/action/Count").Goal(until=1).until == 1


async def test_an_interface_stays_while_the_code_fails_and_is_read_with_the_next_success(desk):
    with REGISTRY.isolated():
        desk.folder.joinpath("reload_msgs", "action").mkdir(parents=True)
        desk.write(file="reload_msgs/action/Count.action", text="int32 to\n---\n---\n")
        load_interfaces(desk.folder)
        desk.reloader.watch.follow()
        assert get_action("reload_msgs/action/Count").Goal(to=1).to == 1
        desk.write(file="reload_msgs/action/Count.action", text="int32 until\n---\n---\n")
        desk.write(2, more="1 / 0")
        await desk.rest()
        assert get_action("reload_msgs/action/Count").Goal(to=1).to == 1
        desk.write(2)
        await desk.rest()
        assert get_action("reload_msgs/action/Count").Goal(until=1).until == 1


# --- what is replaced, and what stays ---------------------------------------------------------


async def test_running_goals_end_aborted_with_the_reason(desk):
    client = desk.node.action_client(Fibonacci, "mine")
    async with client.send_goal(Fibonacci.Goal(order=1)) as goal:
        await anext(aiter(goal))
        desk.write(2)
        await desk.rest()
        outcome = await goal.outcome()
    assert (outcome.status, outcome.reason) == (GoalStatus.ABORTED, "reloading")


async def test_an_action_that_is_gone_leaves_the_graph_and_a_new_one_joins(desk):
    desk.write(text=LAB.format(number=2, more="").replace('"mine"', '"yours"'))
    await desk.rest()
    assert list(desk.node.graph().actions) == ["/yours"]


async def test_parameters_begin_anew_with_the_module(desk):
    desk.write(more="speed = turtleact.parameter('speed', 1.0)")
    await desk.rest()
    desk.node.parameter("speed").value = 3.0
    desk.write(more="speed = turtleact.parameter('speed', 2.0)\nn = turtleact.parameter('n', 1)")
    await desk.rest()
    assert (desk.node.parameter("speed").value, desk.node.parameter("n").value) == (2.0, 1)
    desk.write()
    await desk.rest()
    with pytest.raises(InvalidParameter, match="not declared"):
        desk.node.parameter("speed")


async def test_a_name_that_another_node_serves_by_now_is_waited_for(desk):
    async with open_node("other", transport=desk.transport) as other:
        other.serve(Modules(["reloadlab.py"]).find().actions[0], name="yours")
        desk.write(text=LAB.format(number=2, more="").replace('"mine"', '"yours"'))
        await desk.rest()
        assert desk.said[-1] == "reloaded: /yours"
    await anyio.wait_all_tasks_blocked()
    client = desk.node.action_client(Fibonacci, "yours")
    assert list((await client.send_goal(Fibonacci.Goal(order=0))).sequence) == [2, 10]


# --- what fails -----------------------------------------------------------------------------

FAILURES = [
    ("def f(:", "reloadlab.py:7: module 'reloadlab' cannot be imported: SyntaxError: "),
    ("1 / 0", "ZeroDivisionError: division by zero"),
    ("raise SystemExit(3)", "SystemExit: 3"),
    ("raise KeyboardInterrupt", "KeyboardInterrupt"),
    ("import reload_nowhere", "No module named 'reload_nowhere'"),
    ("del turtleact", "NameError: name 'turtleact' is not defined"),
]


@pytest.mark.parametrize(("more", "problem"), FAILURES)
async def test_a_module_that_fails_leaves_the_old_actions_until_the_next_change(
    desk, caplog, more, problem
):
    desk.write(2, more=more)
    await desk.rest()
    (record,) = caplog.records
    assert problem in record.message
    assert record.message.endswith("; the actions stay as they are until the next change")
    assert await desk.answer() == [1, 10]
    await desk.rest()
    assert len(caplog.records) == 1
    desk.write(3)
    await desk.rest()
    assert await desk.answer() == [3, 10]


async def test_a_deleted_file_leaves_the_old_actions_until_it_is_back(desk, caplog):
    (desk.folder / "reloadlab.py").unlink()
    await desk.rest()
    assert "there is no file 'reloadlab.py' any more" in caplog.text
    assert await desk.answer() == [1, 10]
    desk.write(2)
    await desk.rest()
    assert await desk.answer() == [2, 10]


async def test_a_missing_module_that_appears_is_a_change(desk, caplog):
    desk.write(2, more="import reload_later")
    await desk.rest()
    desk.write(file="reload_later.py", text="X = 1\n")
    await desk.rest()
    assert await desk.answer() == [2, 10]


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        ("a = turtleact.parameter('a', 1); b = turtleact.parameter('a', 2)", "declared already"),
        (
            "@turtleact.action(Fibonacci, 'other', policy='none')\nasync def o(goal): ...",
            "option 'policy'",
        ),
    ],
)
async def test_what_cannot_be_served_brings_the_old_actions_back(desk, caplog, more, problem):
    desk.write(2, more=more)
    await desk.rest()
    assert problem in caplog.text
    assert caplog.records[-1].message.endswith("; the actions are served as they were before")
    assert await desk.answer() == [1, 10]
    desk.write(3)
    await desk.rest()
    assert await desk.answer() == [3, 10]
