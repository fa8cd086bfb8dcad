"""What a client can see of an action, beside rclpy's own server: the transcripts of scenarios.

turtleact's server is asked through the same endpoints; its clock is set by hand.
"""

from __future__ import annotations

from collections import deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

import anyio
import pytest
from anyio.abc import TaskGroup

import turtleact
from turtleact import CancelResponse, GoalResponse, QoS
from turtleact.interfaces import Action, Message, implied, int32
from turtleact.interfaces.standard import UUID, CancelGoal, GoalInfo, GoalStatusArray, Time
from turtleact.transports import MemoryTransport

from ..lab import HandClock, Running, settle
from .conftest import Ros
from .scenarios import (
    REJECTED,
    RESULT_TIMEOUT,
    SCENARIOS,
    STUBBORN,
    cancel_line,
    goal_id,
    label_of,
    result_line,
    shows,
    status_line,
)

PATIENCE = 5.0
"""How long a scenario may take (real s)."""

MEANT = {
    "a_body_returns_none": (["result of a: no answer"], ["result of a: ABORTED []"]),
    "a_second_cancel": (["cancel a: 3", "cancel all: 0"], ["cancel a: 0 a", "cancel all: 0 a"]),
    "a_goal_that_is_not_let_go": (["cancel a: 0"], ["cancel a: 1"]),
    "some_goals_are_not_let_go": (["cancel all: 0 b c"], ["cancel all: 0 c"]),
}
"""What rclpy's transcript says where turtleact's says something else: rows of conformance.md."""


class Fibonacci(Action, type_name="test_msgs/action/Fibonacci"):
    """The action that rclpy's wheels have."""

    class Goal(Message):
        order: int32 = 0

    class Result(Message):
        sequence: list[int32] = []

    class Feedback(Message):
        sequence: list[int32] = []


IMPLIED = implied(Fibonacci)


class Orders:
    """What a body is to do, in order."""

    def __init__(self) -> None:
        self._given: deque[tuple[str, list[int]]] = deque()
        self._new = anyio.Event()

    def put(self, word: str, numbers: list[int]) -> None:
        self._given.append((word, numbers))
        self._new.set()

    async def get(self) -> tuple[str, list[int]]:
        while not self._given:
            self._new = anyio.Event()
            await self._new.wait()
        return self._given.popleft()


class TurtleactPeer:
    """turtleact's server, and a client of its endpoints that knows no action."""

    def __init__(self, node: turtleact.Node, clock: HandClock, tasks: TaskGroup) -> None:
        self.transcript: list[str] = []
        self._orders: dict[str, Orders] = {}
        self._stamps: dict[str, Time] = {}
        self._asked: list[tuple[str, Running[Any]]] = []
        self._tasks = tasks
        self._newest: list[tuple[str, int]] = []
        self._clock = clock
        node.action_server(
            Fibonacci,
            "told",
            self._execute,
            goal_callback=lambda goal: (
                GoalResponse.REJECT if goal.order == REJECTED else GoalResponse.ACCEPT
            ),
            cancel_callback=lambda handle: (
                CancelResponse.REJECT if handle.request.order == STUBBORN else CancelResponse.ACCEPT
            ),
            result_timeout=RESULT_TIMEOUT,
        )
        base, latched = "told/_action", QoS(depth=100, durability="transient_local")
        self._send = node.service_client(IMPLIED.send_goal, f"{base}/send_goal")
        self._get = node.service_client(IMPLIED.get_result, f"{base}/get_result")
        self._cancel = node.service_client(CancelGoal, f"{base}/cancel_goal")
        self._statuses = node.subscription(GoalStatusArray, f"{base}/status", latched)
        self._heard = node.subscription(IMPLIED.feedback_message, f"{base}/feedback")

    async def _execute(
        self, goal: Fibonacci.Goal, handle: turtleact.ServerGoalHandle[Any, Any, Any]
    ) -> Any:
        orders, word = self._orders[label_of(handle.goal_id)], "feedback"
        while word == "feedback":
            with anyio.CancelScope(shield=True):  # as rclpy's body: it goes by its orders alone
                word, numbers = await orders.get()
            if word == "feedback":
                handle.publish_feedback(Fibonacci.Feedback(sequence=numbers))
        result = Fibonacci.Result(sequence=numbers)
        if word == "raise":
            raise RuntimeError("as it was told")
        if word == "abort":
            raise turtleact.Abort("as it was told", result=result)
        if word == "canceled":
            raise turtleact.Cancel(result)
        return result if word == "succeed" else None

    async def send(self, label: str, order: int = 3) -> None:
        request = IMPLIED.send_goal.Request(UUID(goal_id(label)), Fibonacci.Goal(order))
        self._orders.setdefault(label, Orders())
        answer = await self._send.call(request)
        self.transcript.append(f"send {label}: {'accepted' if answer.accepted else 'rejected'}")
        if answer.accepted:
            self._stamps[label] = answer.stamp

    async def tell(self, label: str, word: str, *numbers: int) -> None:
        self._orders[label].put(word, list(numbers))

    async def cancel(self, label: str | None = None, before: str | None = None) -> None:
        info = GoalInfo()
        if label is not None:
            info.goal_id = UUID(goal_id(label))
        if before is not None:
            stamp = self._stamps[before]
            nanoseconds = stamp.sec * 10**9 + stamp.nanosec - 1
            info.stamp = Time(*divmod(nanoseconds, 10**9))
        answer = await self._cancel.call(CancelGoal.Request(info))
        goals = [label_of(each.goal_id.uuid) for each in answer.goals_canceling]
        self.transcript.append(cancel_line(label, before, answer.return_code, goals))

    async def status(self, **goals: str) -> None:
        while not shows(self._newest, goals):
            array = await anext(self._statuses)
            self._newest = [
                (label_of(each.goal_info.goal_id.uuid), each.status) for each in array.status_list
            ]
        self.transcript.append(status_line(self._newest))

    async def result(self, label: str) -> None:
        await self.ask(label)
        await self.answers()

    async def ask(self, label: str) -> None:
        request = IMPLIED.get_result.Request(UUID(goal_id(label)))
        asked: Running[Any] = Running(partial(self._get.call, request))
        self._tasks.start_soon(asked.run)
        self._asked.append((label, asked))
        await settle()

    async def answers(self) -> None:
        for label, asked in self._asked:
            await asked.done.wait()
            answer = asked.value
            self.transcript.append(result_line(label, answer.status, answer.result.sequence))
        self._asked.clear()

    async def feedback(self, count: int) -> None:
        for _ in range(count):
            heard: Any = await anext(self._heard)
            label = label_of(heard.goal_id.uuid)
            self.transcript.append(f"feedback of {label}: {heard.feedback.sequence}")

    async def pause(self, seconds: float) -> None:
        self._clock.advance(seconds)
        await settle()


@asynccontextmanager
async def peer() -> AsyncIterator[TurtleactPeer]:
    clock = HandClock()
    async with (
        turtleact.open_node("interop", transport=MemoryTransport(clock)) as node,
        anyio.create_task_group() as tasks,
    ):
        with anyio.fail_after(PATIENCE):
            yield TurtleactPeer(node, clock, tasks)


@pytest.fixture(scope="session")
def transcripts(ros: Ros) -> dict[str, list[str]]:
    """What a client of rclpy's server sees, by scenario."""
    seen: dict[str, list[str]] = ros.run("ros_actions.py")
    return seen


@pytest.mark.parametrize("name", SCENARIOS)
async def test_a_client_sees_what_it_sees_of_rclpy_but_for_what_is_meant(name, transcripts):
    theirs, ours = MEANT.get(name, ([], []))
    expected = transcripts[name]
    for one, other in zip(theirs, ours, strict=True):
        assert one in expected, "rclpy does not do it any more: change conformance.md"
        expected = [other if line == one else line for line in expected]
    async with peer() as asked:
        await SCENARIOS[name](asked)
    assert asked.transcript == expected
