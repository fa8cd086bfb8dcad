"""The status of the goals that a server holds, as messages and as bytes."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, cast

import anyio
import pytest

import turtleact
from turtleact import Abort, GoalStatus
from turtleact.goals.observers import FeedbackLost, GoalObserver, News
from turtleact.goals.server import LocalActionServer
from turtleact.goals.server_endpoints import FeedbackTopic, StatusTopic
from turtleact.goals.state import Goal
from turtleact.goals.wire import GoalReason, reason_topic
from turtleact.interfaces import WireFormat, decode
from turtleact.interfaces.standard import GoalStatusArray
from turtleact.tasks.clock import VirtualClock
from turtleact.transports import MemoryTransport
from turtleact.transports.base import Endpoint

from ..lab import Count, Lab, bare_goal, goal, lab, result, settle


class Topic:
    """Counts how often the state has changed."""

    changes = 0
    has_object_readers = False

    def __init__(self) -> None:
        self.clock = VirtualClock()  # it stands still

    def refresh(self) -> None:
        self.changes += 1

    def advertise(self, endpoint: Any, format: Any, source: Any) -> Any:
        """What a transport does."""
        return self


def source_of(local: LocalActionServer, topic: Any = None) -> StatusTopic:
    source = StatusTopic(local, topic or cast("Any", Topic()), cast("Any", None))
    source.readers_changed(has_readers=True)
    return source


class FullLane(MemoryTransport):
    """A transport whose publication drops every second message."""

    sent = 0
    has_object_readers = False

    def send(self, data: bytes) -> None:
        self.sent += 1
        if self.sent % 2 == 0:
            self._source.message_lost()

    def advertise(self, endpoint: Any, format: Any, source: Any = None) -> Any:
        """What a transport does."""
        if source is None:
            return super().advertise(endpoint, format)
        self._source = source
        return self


class Losses(GoalObserver):
    def __init__(self) -> None:
        self.heard: list[News] = []

    def noted(self, goal: Goal, news: News) -> None:
        self.heard.append(news)


async def test_observers_hear_of_feedback_that_cannot_be_sent():
    async with lab(act) as served:
        local = served.local
        local.observers.add(losses := Losses())
        described = Endpoint("publisher", "/count/_action/feedback", "", "/lab")
        topic = FeedbackTopic(local, FullLane(), described)
        sent = bare_goal()
        for number in range(4):
            topic.send(sent, Count.Feedback(so_far=[number]))
        assert losses.heard == [FeedbackLost(1), FeedbackLost(1)]


def check(source: StatusTopic, *expected: GoalStatus) -> None:
    """Both forms say the same, and this."""
    encode = WireFormat(GoalStatusArray).encode
    (message,), (data,) = source.current(), source.written(encode)
    assert data == encode(message)
    said = decode(GoalStatusArray, data)
    assert [GoalStatus(each.status) for each in said.status_list] == list(expected)


async def act(request: Count.Goal) -> Count.Result:
    if request.upto == 1:
        raise Abort("no")
    if request.upto == 2:
        await anyio.sleep_forever()
    return Count.Result()


async def send(served: Lab, upto: int) -> None:
    """Send a goal for others to wait for."""
    async with served.client.send_goal(goal(upto)) as sent:
        sent.detach()
    await settle()


async def test_both_forms_say_the_same_of_goals_in_any_state():
    async with lab(act) as served:
        source = source_of(served.local)
        for upto in (0, 1, 2):
            await send(served, upto)
        check(source, GoalStatus.SUCCEEDED, GoalStatus.ABORTED, GoalStatus.EXECUTING)
        await served.client.cancel_all()
        await settle()
        check(source, GoalStatus.SUCCEEDED, GoalStatus.ABORTED, GoalStatus.CANCELED)


# --- reasons


async def act_or_give_up(request: Count.Goal) -> Any:
    if request.upto == 1:
        raise Abort("too low")
    return result(*range(request.upto))


def choose(request: Count.Goal) -> turtleact.GoalResponse:
    if request.upto < 0:
        raise turtleact.Reject("negative")
    return turtleact.GoalResponse.ACCEPT


@pytest.mark.parametrize(
    ("upto", "told"),
    [(2, []), (1, [(GoalStatus.ABORTED, "too low")]), (-1, [(GoalStatus.UNKNOWN, "negative")])],
)
async def test_ends_without_success_and_rejections_have_reasons(upto, told):
    async with turtleact.open_node("lab") as node:
        node.action_server(
            Count, "count", act_or_give_up, goal_callback=choose, introspection="metadata"
        )
        reader = node.subscription(GoalReason, reason_topic("/count"))
        with suppress(turtleact.GoalAborted, turtleact.GoalRejected):
            await node.action_client(Count, "count").send_goal(goal(upto))
        found: list[Any] = reader.drain()
        assert [(each.status, each.reason) for each in found] == told
        assert all(any(each.goal_id.uuid) for each in found)


async def test_lists_of_all_endpoints_leave_reasons_out():
    async with turtleact.open_node("lab") as node:
        node.action_server(Count, "count", act_or_give_up)
        name = reason_topic("/count")
        assert node.transport.endpoints(name)
        assert name not in {each.name for each in node.transport.endpoints()}
