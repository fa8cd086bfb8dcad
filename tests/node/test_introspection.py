"""The events of services: who published what, and that nothing is published without readers."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, cast

import pytest

import turtleact
from turtleact import (
    GoalRejected,
    GoalResponse,
    GoalStatus,
    open_world,
)
from turtleact.errors import InvalidOption, ServiceError
from turtleact.goals.service_server import EVENT_QOS
from turtleact.interfaces import implied
from turtleact.interfaces.classes import event_message
from turtleact.interfaces.standard import CancelGoal, ServiceEventInfo, Time
from turtleact.interfaces.standard.std_srvs.srv import SetBool
from turtleact.names import event_topic
from turtleact.node import Node
from turtleact.node.topics import Subscription
from turtleact.transports import MemoryTransport, open_zenoh

from ..lab import Count, HandClock, count, goal, result

IMPLIED = implied(Count)
SERVICES: dict[str, Any] = {
    "send_goal": IMPLIED.send_goal,
    "get_result": IMPLIED.get_result,
    "cancel_goal": CancelGoal,
}
SECOND_SEVEN = Time(sec=1_700_000_007)
"""The time on the virtual clock of `lab_shown`."""
CALLED = ["REQUEST_SENT", "REQUEST_RECEIVED", "RESPONSE_SENT", "RESPONSE_RECEIVED"]
"""The events of one call that both ends publish, in order."""


@pytest.fixture
def address(tmp_path) -> str:
    return f"unixsock-stream/{tmp_path}/socket"


class Log:
    """Subscribes to the events of the action ``/count``."""

    def __init__(self, node: Node) -> None:
        self.topics: dict[str, Subscription[Any]] = {
            name: node.subscription(
                event_message(service), event_topic(f"/count/_action/{name}"), EVENT_QOS
            )
            for name, service in SERVICES.items()
        }
        self._kept: dict[str, list[Any]] = {name: [] for name in SERVICES}

    def events(self, name: str) -> list[Any]:
        self._kept[name] += self.topics[name].drain()
        return self._kept[name]

    def kinds(self, name: str) -> list[str]:
        return [kind_of(each) for each in self.events(name)]


def kind_of(event: Any) -> str:
    return next(each for each in CALLED if getattr(ServiceEventInfo, each) == event.info.event_type)


def call_ids(events: list[Any]) -> set[tuple[bytes, int]]:
    """Which calls the events belong to."""
    return {(bytes(each.info.client_gid), each.info.sequence_number) for each in events}


async def flip(request: SetBool.Request) -> SetBool.Response:
    return SetBool.Response(success=not request.data)


@asynccontextmanager
async def apart(address: str) -> AsyncIterator[tuple[Node, Node]]:
    """Two nodes on a Zenoh session each."""
    async with (
        open_zenoh([], listen=[address]) as there,
        open_zenoh([address], listen=[]) as here,
        turtleact.open_node("server", transport=there) as far,
        turtleact.open_node("client", transport=here) as near,
    ):
        yield far, near


# --- actions


async def test_both_ends_of_an_action_publish_its_requests_and_responses():
    async with lab_shown("contents") as (log, client):
        assert await client.send_goal(goal(2)) == result(0, 1)
        sent, asked = log.events("send_goal"), log.events("get_result")
        assert [kind_of(each) for each in sent] == CALLED
        assert sorted(map(kind_of, asked)) == sorted(CALLED)
        assert [each.request[0].goal for each in sent[:2]] == [goal(2), goal(2)]
        assert [each.response[0].accepted for each in sent[2:]] == [True, True]
        assert asked[-1].response[0].status == GoalStatus.SUCCEEDED
        assert asked[-1].response[0].result == result(0, 1)
        assert not log.events("cancel_goal")


async def test_metadata_leave_out_what_requests_and_responses_contain():
    async with lab_shown("metadata") as (log, client):
        await client.send_goal(goal(1))
        assert log.kinds("send_goal") == CALLED
        assert all(not (each.request or each.response) for each in log.events("send_goal"))


async def test_an_event_names_its_call_and_the_graphs_time():
    async with lab_shown("contents") as (log, client):
        for _ in range(2):
            await client.send_goal(goal(1))
        events = log.events("send_goal")
        (gid, first), (other, second) = sorted(call_ids(events))
        assert (gid, first, second) == (other, 1, 2)
        assert all(each.info.stamp == SECOND_SEVEN for each in events)


async def test_a_rejected_goal_and_a_refused_cancel_are_published():
    def reject(_: object) -> GoalResponse:
        return GoalResponse.REJECT

    async with lab_shown("contents", goal_callback=reject) as (log, client):
        with pytest.raises(GoalRejected):
            await client.send_goal(goal(1))
        assert not log.events("send_goal")[-1].response[0].accepted
        assert not (await client.cancel_all()).goals_canceling
        assert log.kinds("cancel_goal") == CALLED


@pytest.mark.parametrize(
    ("server", "client", "kinds"),
    [
        ("contents", "off", ["REQUEST_RECEIVED", "RESPONSE_SENT"]),
        ("off", "contents", ["REQUEST_SENT", "RESPONSE_RECEIVED"]),
        ("off", "off", []),
    ],
)
async def test_each_end_publishes_for_itself(server, client, kinds):
    async with lab_shown(server, client=client) as (log, sender):
        assert await sender.send_goal(goal(1)) == result(0)
        assert log.kinds("send_goal") == kinds


async def test_what_is_opened_on_a_node_does_as_the_node_unless_it_says_otherwise():
    async with turtleact.open_node("lab") as node:
        node.introspection = "contents"
        node.action_server(Count, "count", count)
        node.service(SetBool, "flip", flip, introspection="off")
        topics = {each.name for each in node.transport.endpoints() if each.kind == "publisher"}
        shown = {each for each in topics if each.endswith("/_service_event")}
        assert shown == {event_topic(f"/count/_action/{name}") for name in SERVICES}


@asynccontextmanager
async def lab_shown(
    mode: Any, *, client: Any = None, execute: Any = count, **options: Any
) -> AsyncIterator[tuple[Log, turtleact.ActionClient[Any, Any, Any]]]:
    """A server and a client in one process at second 7, and a log of their events."""
    clock = HandClock()
    clock.advance(7.0)
    transport = MemoryTransport(clock)
    async with turtleact.open_node("lab", transport=transport) as node:
        node.action_server(Count, "count", execute, introspection=mode, **options)
        sender = node.action_client(Count, "count", introspection=client or mode)
        yield Log(node), sender


# --- services


async def test_a_service_publishes_its_calls():
    async with turtleact.open_node("lab") as node:
        node.service(SetBool, "flip", flip, introspection="contents")
        client = node.service_client(SetBool, "flip", introspection="contents")
        reader = node.subscription(event_message(SetBool), event_topic("/flip"))
        assert not (await client.call(SetBool.Request(data=True))).success
        events: list[Any] = reader.drain()
        assert [kind_of(each) for each in events] == CALLED
        assert events[0].request == [SetBool.Request(data=True)]
        assert events[3].response == [SetBool.Response(success=False)]
        assert len(call_ids(events)) == 1


async def test_a_failure_is_no_response():
    def fail(_: SetBool.Request) -> SetBool.Response:
        raise RuntimeError("no power")

    async with turtleact.open_node("lab") as node:
        node.service(SetBool, "flip", fail, introspection="contents")
        reader = node.subscription(event_message(SetBool), event_topic("/flip"))
        with pytest.raises(ServiceError, match="no power"):
            await node.service_client(SetBool, "flip").call(SetBool.Request())
        assert [kind_of(each) for each in reader.drain()] == ["REQUEST_RECEIVED"]


@pytest.mark.parametrize(
    "open_it",
    [
        lambda node, mode: node.action_server(Count, "count", count, introspection=mode),
        lambda node, mode: node.action_client(Count, "count", introspection=mode),
        lambda node, mode: node.service(SetBool, "flip", flip, introspection=mode),
        lambda node, mode: node.service_client(SetBool, "flip", introspection=mode),
    ],
    ids=["action server", "action client", "service", "service client"],
)
async def test_an_unknown_mode_is_refused_and_nothing_is_opened(open_it):
    async with turtleact.open_node("lab") as node:
        with pytest.raises(InvalidOption, match="'everything'"):
            open_it(node, "everything")
        node.introspection = cast("Any", "all of it")
        with pytest.raises(InvalidOption, match="'all of it'"):
            open_it(node, None)
        assert not node.transport.endpoints()


# --- over Zenoh


async def test_the_events_of_a_goal_in_another_process_name_its_wire_calls(address):
    async with apart(address) as (far, near):
        far.action_server(Count, "count", count, introspection="contents")
        client = near.action_client(Count, "count", introspection="contents")
        log = Log(near)
        await client.wait_for_server()
        for name in ("send_goal", "get_result"):
            while not (calls := complete(log.events(name))):  # until both ends know the readers
                assert await client.send_goal(goal(1)) == result(0)
            ends = far.transport.endpoints(f"/count/_action/{name}")
            (caller,) = [each for each in ends if each.kind == "client"]
            assert {gid for gid, _ in calls} == {caller.gid}
        requests = [each.request[0] for each in log.events("send_goal") if each.request]
        assert {each.goal.upto for each in requests} == {1}


def complete(events: list[Any]) -> set[tuple[bytes, int]]:
    """The calls that both ends have published in full."""
    calls = call_ids(events)
    return {each for each in calls if sum(call_ids([one]) == {each} for one in events) == 4}


async def test_a_world_publishes_the_events_of_all_its_actions_and_services():
    async with open_world(introspection="contents") as world:
        shown = {
            each.name.removesuffix("/_service_event")
            for each in world.transport.endpoints()
            if each.kind == "publisher" and each.name.endswith("/_service_event")
        }
        services = {each.name for each in world.transport.endpoints() if each.kind == "service"}
        assert services == shown
