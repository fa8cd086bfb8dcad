"""The services and topics that make up an action, used by hand as any node may."""

from __future__ import annotations

from typing import Any

import anyio
import pytest

import turtleact
from turtleact import GoalResponse, GoalStatus, QoS
from turtleact.errors import InvalidMessage, ServerUnavailable
from turtleact.interfaces import implied, type_hash
from turtleact.interfaces.standard import (
    UUID,
    CancelGoal,
    GoalInfo,
    GoalStatusArray,
    Time,
)
from turtleact.node.topics import Subscription
from turtleact.tasks.clock import VirtualClock
from turtleact.transports import MemoryTransport
from turtleact.transports.base import Format

from ..lab import Count, Gate, count, feedback, goal, lab, result, running, settle

IMPLIED = implied(Count)
LATCHED = QoS(depth=10, durability="transient_local")
TOPICS = tuple(f"/count/_action/{each}" for each in ("feedback", "status", "paused", "reason"))
ID = UUID(bytes(range(16)))
OTHER = UUID(bytes(range(16, 32)))


class Wire:
    """What a node that knows no action client does."""

    def __init__(self, node: turtleact.Node) -> None:
        self._send = node.service_client(IMPLIED.send_goal, "count/_action/send_goal")
        self._get = node.service_client(IMPLIED.get_result, "count/_action/get_result")
        self._cancel = node.service_client(CancelGoal, "count/_action/cancel_goal")
        self._node = node

    async def send(self, goal_id: UUID = ID, upto: int = 3) -> Any:
        return await self._send.call(IMPLIED.send_goal.Request(goal_id=goal_id, goal=goal(upto)))

    async def get(self, goal_id: UUID = ID) -> Any:
        return await self._get.call(IMPLIED.get_result.Request(goal_id=goal_id))

    async def cancel(self, goal_id: UUID = ID, stamp: Time | None = None) -> Any:
        info = GoalInfo(goal_id, stamp or Time())
        return await self._cancel.call(CancelGoal.Request(info))

    def listen(self) -> Subscription[Any]:
        return self._node.subscription(IMPLIED.feedback_message, "count/_action/feedback")

    def watch(self, qos: QoS = LATCHED) -> Subscription[Any]:
        return self._node.subscription(GoalStatusArray, "count/_action/status", qos)


def statuses(array: Any) -> dict[bytes, GoalStatus]:
    """What a status message says."""
    return {each.goal_info.goal_id.uuid: GoalStatus(each.status) for each in array.status_list}


def story(subscription: Any, goal_id: UUID = ID) -> list[str]:
    """How the state of a goal went, as all status messages so far say."""
    told = [statuses(array).get(goal_id.uuid) for array in subscription.drain()]
    return [status.name if status else "-" for status in told]


async def test_a_goal_is_sent_and_its_result_asked_for():
    async with lab(count) as served:
        wire = Wire(served.node)
        accepted = await wire.send()
        assert accepted.accepted
        assert accepted.stamp != Time()
        answer = await wire.get()
        assert (answer.status, answer.result) == (GoalStatus.SUCCEEDED, result(0, 1, 2))


async def test_a_result_that_is_asked_for_early_comes_at_the_end():
    gate = Gate()
    async with lab(gate.wait) as served:
        wire = Wire(served.node)
        await wire.send()
        async with running(wire.get) as one, running(wire.get) as other:
            assert (one.value, other.value) == (None, None)
            gate.opened.set()
        assert one.value.status == other.value.status == GoalStatus.SUCCEEDED
        assert (await wire.get()).result == result(3)


async def test_the_result_of_an_unknown_goal_is_unknown():
    async with lab(count) as served:
        answer = await Wire(served.node).get()
        assert (answer.status, answer.result) == (GoalStatus.UNKNOWN, result())


@pytest.mark.parametrize("asks", ["reject", "held"])
async def test_a_goal_that_is_not_taken_is_not_accepted(asks):
    options: Any = {"goal_callback": lambda _: GoalResponse.REJECT} if asks == "reject" else {}
    async with lab(count, **options) as served:
        wire = Wire(served.node)
        if asks == "held":
            await wire.send()
        refused = await wire.send()
        assert (refused.accepted, refused.stamp) == (False, Time())


async def test_a_goal_that_does_not_fit_is_told_to_its_sender():
    async with lab(count) as served:
        sender = served.node.service_client(IMPLIED.send_goal, "count/_action/send_goal")
        request = IMPLIED.send_goal.Request(goal_id=ID, goal=goal())
        request.goal.upto = "many"  # type: ignore[attr-defined]  # no number, on purpose
        with pytest.raises(InvalidMessage, match=r"request\.goal\.upto"):
            await sender.call(request)


@pytest.mark.parametrize("by", ["id", "stamp", "all"])
async def test_goals_are_canceled_by_id_and_stamp(by):
    gate = Gate()
    async with lab(gate.wait) as served:
        wire = Wire(served.node)
        stamp = (await wire.send()).stamp
        response = await {
            "id": lambda: wire.cancel(),
            "stamp": lambda: wire.cancel(UUID(), stamp),
            "all": lambda: wire.cancel(UUID()),
        }[by]()
        assert response == CancelGoal.Response(0, [GoalInfo(ID, stamp)])
        assert (await wire.get()).status == GoalStatus.CANCELED


async def test_a_cancel_of_nothing_says_why():
    async with lab(count) as served:
        wire = Wire(served.node)
        unknown = await wire.cancel()
        await wire.send()
        await wire.get()
        codes = (unknown.return_code, (await wire.cancel()).return_code)
        assert codes == (2, 3)


async def test_feedback_goes_to_all_who_listen_and_to_the_sender():
    async with lab(count) as served:
        wire = Wire(served.node)
        one, other = wire.listen(), wire.listen()
        await wire.send()
        await settle()
        async with served.client.send_goal(goal(1), goal_id=OTHER.uuid) as handle:
            assert [each async for each in handle] == [feedback(0)]
        heard = [(each.goal_id, each.feedback) for each in one.drain()]
        numbers = [feedback(0), feedback(0, 1), feedback(0, 1, 2)]
        assert heard == [*((ID, each) for each in numbers), (OTHER, feedback(0))]
        assert [(each.goal_id, each.feedback) for each in other.drain()] == heard


async def test_each_change_of_a_state_is_told():
    gate = Gate()
    async with lab(gate.wait) as served:
        wire = Wire(served.node)
        watched = wire.watch()
        await wire.send()
        await wire.cancel()
        await wire.get()
        assert story(watched) == ["-", "ACCEPTED", "EXECUTING", "CANCELING", "CANCELED"]


@pytest.mark.loops("asyncio", "trio")
async def test_a_goal_that_has_expired_leaves_the_status():
    clock = VirtualClock()
    async with anyio.create_task_group() as group:
        group.start_soon(clock.run)
        async with lab(count, transport=MemoryTransport(clock)) as served:
            watched = Wire(served.node).watch()
            await served.client.send_goal(goal())
            await clock.sleep(12.0)
            assert [len(each.status_list) for each in watched.drain()[-2:]] == [1, 0]
        group.cancel_scope.cancel()


async def test_who_waits_for_a_result_gets_it_when_the_server_closes():
    gate = Gate()
    async with lab(gate.wait) as served:
        wire = Wire(served.node)
        await wire.send()
        async with running(wire.get) as waiting:
            await served.server.aclose()
        assert waiting.value.status == GoalStatus.ABORTED
        with pytest.raises(ServerUnavailable):
            await wire.get()
        assert served.node.graph().actions == {}


async def test_what_goes_over_a_wire_has_the_hashes_of_its_types():
    transport = Notebook()
    async with lab(count, transport=transport):
        own = ("/set_paused", "/paused", "/pause", "/resume", "/reason")
        names = [name for name in transport.formats if not name.endswith(own)]
        hashed = [transport.formats[name].type_hash for name in names]
        known = (CancelGoal, IMPLIED.get_result, IMPLIED.send_goal)
        topics = (IMPLIED.feedback_message, GoalStatusArray)
        assert hashed == [type_hash(each) for each in (*known, *topics)]


async def test_who_finds_the_service_that_takes_goals_finds_the_others_too():
    transport = Notebook()
    async with lab(count, transport=transport):
        served = [name for name in transport.formats if name not in TOPICS]
        assert served[-1] == "/count/_action/send_goal"
        assert len(served) == 6  # three of ROS 2, and three for pausing


class Notebook(MemoryTransport):
    """Notes the formats that endpoints come with."""

    def __init__(self) -> None:
        super().__init__()
        self.formats: dict[str, Format] = {}

    def advertise(self, endpoint, format, source=None):
        self.formats.setdefault(endpoint.name, format)
        return super().advertise(endpoint, format, source)

    def serve(self, endpoint, format, handler):
        self.formats.setdefault(endpoint.name, format)
        return super().serve(endpoint, format, handler)
