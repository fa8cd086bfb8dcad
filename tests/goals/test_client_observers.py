"""What the observers of a client hear: of its own goals, wherever the server is."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from contextvars import ContextVar, Token
from typing import Any

import anyio
import pytest

from turtleact import Abort, GoalAborted, GoalStatus, TurtleactError
from turtleact.goals.observers import GoalObserver
from turtleact.goals.state import Goal, GoalRequest

from ..lab import Apart, Count, Gate, count, far_and_near, feedback, goal, result, settle
from .test_remote_server import Cut

ID, OTHER = bytes(range(16)), bytes(range(1, 17))


class Notes(GoalObserver):
    """Writes down what it hears.

    Attributes:
        heard: The names of the states, and the numbers of the feedback.
    """

    def __init__(self) -> None:
        self.heard: list[object] = []

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
        self.heard.append((before.name, after.name))

    def feedback_published(self, goal: Goal, feedback: object) -> None:
        self.heard.append(feedback)

    def pause_changed(self, goal: Goal, is_paused: bool) -> None:
        self.heard.append("paused" if is_paused else "resumed")


SUCCEEDS = [
    ("UNKNOWN", "ACCEPTED"),
    ("ACCEPTED", "EXECUTING"),
    feedback(0),
    ("EXECUTING", "SUCCEEDED"),
]
CANCELED = [
    ("UNKNOWN", "ACCEPTED"),
    ("ACCEPTED", "EXECUTING"),
    ("EXECUTING", "CANCELING"),
    ("CANCELING", "CANCELED"),
]


@asynccontextmanager
async def clients(where: str, execute: Any) -> AsyncIterator[tuple[Any, Any]]:
    """Two clients of one action."""
    async with far_and_near(near=Apart if where == "elsewhere" else lambda here: here) as (
        far,
        node,
    ):
        far.action_server(Count, "count", execute)
        yield node.action_client(Count, "count"), node.action_client(Count, "count")


WHERE = pytest.mark.parametrize("where", ["here", "elsewhere"])


@WHERE
async def test_an_observer_hears_of_the_goals_of_its_client_alone_from_its_coming_to_its_going(
    where,
):
    async with clients(where, count) as (client, other):
        await client.send_goal(goal(1))
        client.observers.add(notes := Notes())
        assert await other.send_goal(goal(1)) == result(0)
        assert notes.heard == []
        assert await client.send_goal(goal(1)) == result(0)
        assert await other.send_goal(goal(1)) == result(0)
        client.observers.remove(notes)
        await client.send_goal(goal(1))
        assert notes.heard == SUCCEEDS


@WHERE
async def test_an_observer_hears_of_a_goal_that_is_canceled(where):
    gate = Gate()
    async with clients(where, gate.wait) as (client, _):
        client.observers.add(notes := Notes())
        async with client.send_goal(goal(1)):
            await gate.started.wait()
            await settle()
        assert notes.heard == CANCELED


@WHERE
async def test_an_observer_hears_of_pauses(where):
    async def step(request: Count.Goal) -> AsyncIterator[Count.Feedback]:
        while True:
            yield feedback()
            await anyio.sleep(0)

    async with clients(where, step) as (client, _):
        client.observers.add(notes := Notes())
        async with client.send_goal(goal(1)) as handle:
            await handle.pause()
            await handle.pause()
            await handle.resume()
        assert [each for each in notes.heard if isinstance(each, str)] == ["paused", "resumed"]


@WHERE
async def test_an_observer_does_not_hear_of_a_goal_that_its_client_is_attached_to(where):
    gate = Gate()
    async with clients(where, gate.wait) as (client, other):
        client.observers.add(notes := Notes())
        async with other.send_goal(goal(1), goal_id=ID):
            await gate.started.wait()
            async with client.attach(ID) as handle:
                gate.opened.set()
                assert await handle.result() == result(1)
        assert notes.heard == []


SENDING: ContextVar[str] = ContextVar("SENDING", default="nothing")


class Calls(GoalObserver):
    """Names each goal, and writes down how its call ended.

    Attributes:
        ended: The ids of the goals, each with what its call raised.
    """

    def __init__(self) -> None:
        self.ended: list[tuple[bytes | None, type[BaseException] | None]] = []
        self._tokens: dict[GoalRequest, Token[str]] = {}

    def enter_call(self, order: GoalRequest) -> None:
        order.goal_id = order.goal_id or ID
        self._tokens[order] = SENDING.set("a goal")

    def leave_call(self, order: GoalRequest, error: BaseException | None) -> None:
        assert SENDING.get() == "a goal"
        SENDING.reset(self._tokens.pop(order))
        self.ended.append((order.goal_id, None if error is None else type(error)))


async def show_sending(request: Count.Goal) -> Count.Result:
    return result(int(SENDING.get() == "a goal"))


@pytest.mark.parametrize("where", ["here", "elsewhere"])
async def test_an_observer_prepares_the_context_in_which_a_goal_is_sent(where):
    async with clients(where, show_sending) as (client, other):
        client.observers.add(calls := Calls())
        assert await client.send_goal(goal()) == result(1)
        async with client.send_goal(goal(), goal_id=OTHER) as handle:
            assert calls.ended == [(ID, None), (OTHER, None)]
            assert SENDING.get() == "nothing"
            assert handle.goal_id == OTHER
            await handle.result()
        assert await other.send_goal(goal()) == result(0)


async def test_an_observer_hears_how_a_call_failed():
    async def refuse(request: Count.Goal) -> Count.Result:
        raise Abort

    async with clients("here", refuse) as (client, _):
        client.observers.add(calls := Calls())
        with pytest.raises(GoalAborted):
            await client.send_goal(goal())
        await client.aclose()
        with pytest.raises(TurtleactError):
            async with client.send_goal(goal()):
                pytest.fail("it was sent")
    assert calls.ended == [(ID, GoalAborted), (ID, TurtleactError)]


async def test_a_call_that_an_observer_prepares_can_be_cancelled():
    gate = Gate()
    async with clients("here", gate.wait) as (client, _):
        client.observers.add(calls := Calls())
        async with anyio.create_task_group() as group:
            group.start_soon(client.send_goal, goal())
            await gate.started.wait()
            group.cancel_scope.cancel()
    assert [error for _, error in calls.ended] == [anyio.get_cancelled_exc_class()]


async def test_an_observer_that_fails_does_no_harm(caplog):
    class Broken(GoalObserver):
        def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
            raise ValueError("mine")

    async with clients("elsewhere", count) as (client, _):
        client.observers.add(Broken())
        assert await client.send_goal(goal(1)) == result(0)
    assert "an observer of the goals of /count failed" in caplog.text


async def test_an_observer_hears_of_a_goal_that_is_lost(monkeypatch):
    monkeypatch.setattr("turtleact.goals.remote.BACK_WITHIN", 0.0)
    gate = Gate()
    async with far_and_near(near=Cut) as (far, near):
        graph: Any = near.transport
        far.action_server(Count, "count", gate.wait)
        client = near.action_client(Count, "count")
        client.observers.add(notes := Notes())
        async with client.send_goal(goal()) as handle:
            handle.detach()
            await gate.started.wait()
            await settle()
            graph.cut()
            await settle()
        assert notes.heard[-1] == ("EXECUTING", "UNKNOWN")
        gate.opened.set()
