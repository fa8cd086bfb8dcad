"""Clients and subscriptions that are opened with a name alone."""

from __future__ import annotations

from typing import Any

import anyio
import pytest

import turtleact
from turtleact import InvalidGoal, InvalidName, ServerUnavailable, TurtleactError
from turtleact.interfaces.standard import Point
from turtleact.interfaces.standard.example_interfaces.srv import AddTwoInts
from turtleact.interfaces.standard.std_msgs.msg import Int32
from turtleact.transports import MemoryTransport

from ..lab import Count, take_turns


async def count(goal):
    for number in range(goal.upto):
        yield Count.Feedback(so_far=[number])
    yield Count.Result(counted=[goal.upto])


def add(request):
    return AddTwoInts.Response(sum=request.a + request.b)


async def test_a_goal_is_sent_as_a_mapping_or_as_a_message_of_the_learned_type():
    async with turtleact.open_node("lab") as node:
        node.action_server(Count, "count", count)
        client = node.action_client("count")
        assert (await client.send_goal({"upto": 2})).counted == [2]
        assert client.action_type is Count
        assert (await client.send_goal(Count.Goal(upto=3))).counted == [3]


async def test_a_handle_gives_feedback_and_another_client_attaches():
    async with turtleact.open_node("lab") as node:
        node.action_server(Count, "count", count)
        client = node.action_client("/count")
        async with client.send_goal({"upto": 2}) as goal:
            assert [each.so_far async for each in goal] == [[0], [1]]
        other: Any = await node.action_client("count").attach(goal.goal_id)
        assert (await other.result()).counted == [2]


async def test_the_fields_of_a_goal_are_checked():
    async with turtleact.open_node("lab") as node:
        node.action_server(Count, "count", count)
        with pytest.raises(InvalidGoal, match="did you mean 'upto'"):
            await node.action_client("count").send_goal({"up_to": 2})


async def test_the_type_of_a_client_is_unknown_before_the_first_await():
    async with turtleact.open_node("lab") as node:
        client = node.action_client("count")
        with pytest.raises(TurtleactError, match="not known before the first await"):
            _ = client.action_type
        assert not await client.wait_for_server(0)
        node.action_server(Count, "count", count)
        assert await client.wait_for_server(0)
        assert client.action_type is Count
        assert (await client.cancel_all()).goals_canceling == []


async def test_a_name_that_nobody_serves_is_told_when_it_is_used():
    async with turtleact.open_node("lab") as node:
        with pytest.raises(ServerUnavailable, match="action '/count': no server answers"):
            await node.action_client("count").send_goal({})
        with pytest.raises(ServerUnavailable, match="service '/add': no server answers"):
            await node.service_client("add").call({})


async def test_a_service_is_called_with_a_mapping():
    async with turtleact.open_node("lab") as node:
        client = node.service_client("add")
        node.service(AddTwoInts, "add", add)
        assert await client.wait_for_service(0)
        assert (await client.call({"a": 2, "b": 3})).sum == 5


async def test_a_subscription_waits_for_a_publisher_and_then_reads():
    transport = MemoryTransport()
    async with (
        turtleact.open_node("lab", transport=transport) as node,
        turtleact.open_node("other", transport=transport) as other,
        anyio.create_task_group() as group,
    ):
        read = []

        async def reading():
            async for message in node.subscription("numbers"):
                read.append(message.data)
                if message.data == 2:
                    break

        group.start_soon(reading)
        await take_turns()
        publisher = other.publisher(Int32, "numbers")
        await take_turns()
        for number in (1, 2):
            publisher.publish(Int32(data=number))
        await take_turns()
        assert read == [1, 2]


async def test_the_node_closes_what_has_no_type_yet():
    async with turtleact.open_node("lab") as node:
        client = node.action_client("count")
    with pytest.raises(TurtleactError, match="closed"):
        await client.send_goal({})


@pytest.mark.loops("asyncio")
async def test_a_wrong_name_and_a_missing_name_are_told_at_once():
    async with turtleact.open_node("lab") as node:
        with pytest.raises(InvalidName):
            node.action_client("co unt")
        with pytest.raises(InvalidName, match="expected text such as 'patrol'"):
            node.subscription(Point)  # type: ignore[call-overload]
