"""Recording and playing between processes: what travels as bytes stays the same bytes."""

from __future__ import annotations

import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import anyio
import pytest

import turtleact
from turtleact import QoS, open_node, open_zenoh, recording
from turtleact.interfaces import encode, load_message
from turtleact.interfaces.standard import ExampleFibonacci as Fibonacci
from turtleact.interfaces.standard.std_msgs.msg import String
from turtleact.interfaces.types import REGISTRY
from turtleact.transports.base import STATUS_QOS

from ..registry import isolated_registry

pytestmark = pytest.mark.loops("asyncio")


def free_endpoint() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{free.getsockname()[1]}"


@asynccontextmanager
async def two_nodes() -> AsyncIterator[tuple[turtleact.Node, turtleact.Node]]:
    """Nodes that see each other only through the network."""
    at = free_endpoint()
    async with (
        open_zenoh([], listen=[at], mode="router", config={}) as here,
        open_zenoh([at], mode="client", config={}) as there,
        open_node("talker", transport=here) as talker,
        open_node("recorder", transport=there) as recorder,
    ):
        yield talker, recorder


async def appeared(node, name, kind="publisher"):
    while not any(each.kind == kind for each in node.transport.endpoints(name)):
        await node.transport.wait_for_change()


async def test_bytes_are_recorded_and_played_as_they_are(tmp_path):
    @turtleact.action(Fibonacci, "fibonacci", introspection="contents")
    async def count(goal):
        yield Fibonacci.Feedback([7])
        yield Fibonacci.Result([goal.order])

    async with two_nodes() as (talker, recorder):
        talker.publisher(String, "/map", STATUS_QOS).publish(String(data="old"))
        said = talker.publisher(String, "/said")
        talker.serve(count)
        for topic in ("/map", "/said", "/fibonacci/_action/send_goal/_service_event"):
            await appeared(recorder, topic)
        client = recorder.action_client(Fibonacci, "fibonacci")
        all_but_status = recording.Selection(
            all_topics=True, all_actions=True, exclude=frozenset({"/fibonacci/_action/status"})
        )
        async with recording.record(recorder, tmp_path / "run", selection=all_but_status) as run:
            while not said.has_subscriptions:
                await talker.transport.wait_for_change()
            for number in range(100):
                said.publish(String(data=str(number)))
            while run.count < 100 + 1:
                await anyio.sleep(0.01)
            is_complete = False
            while not is_complete:  # until the server knows the readers of its events
                before = run.count
                await client.send_goal(Fibonacci.Goal(order=3))
                with anyio.move_on_after(1):
                    while run.count < before + 1 + 2 + 2:
                        await anyio.sleep(0.01)
                    is_complete = True
        found = [each async for each in recording.read(tmp_path / "run")]
        texts = [each.value.data for each in found if each.topic == "/said"]
        assert texts == [str(number) for number in range(100)]
        assert [each.data for each in found if each.topic == "/map"] == [encode(String(data="old"))]
        *_, goal = await recording.goals(tmp_path / "run")
        assert (goal.goal.order, goal.result.sequence, goal.feedback_count) == (3, [3], 1)
        assert run.lost == 0

        heard = talker.subscription(String, "/again", QoS(depth=1000))
        await appeared(recorder, "/again", "subscription")
        played = await recording.play(
            recorder,
            tmp_path / "run",
            rate="max",
            remap={"/said": "/again"},
            selection=recording.Selection(topics=frozenset({"/said"}), all_actions=True),
            send_goals=True,
        )
        assert set(played.goals) == {("/fibonacci", "SUCCEEDED")}
        assert played.messages == 100
        with anyio.fail_after(5):
            assert [(await anext(heard)).data for _ in range(100)] == texts


async def test_the_reasons_of_goals_in_another_process_are_recorded(tmp_path):
    async def give_up(goal):
        yield Fibonacci.Feedback([7])
        raise turtleact.Abort("no way")

    async with two_nodes() as (talker, recorder):
        talker.action_server(Fibonacci, "fibonacci", give_up)
        await appeared(recorder, "/fibonacci/_action/send_goal", "service")
        client = recorder.action_client(Fibonacci, "fibonacci")
        async with recording.record(recorder, tmp_path / "run", actions=["/fibonacci"]):
            await appeared(recorder, "/fibonacci/_action/reason")  # now that somebody reads it
            for _ in range(3):  # at first the server may not know its reader yet
                with pytest.raises(turtleact.GoalAborted):
                    await client.send_goal(Fibonacci.Goal())
                await anyio.sleep(0.02)
    *_, goal = await recording.goals(tmp_path / "run")
    assert (goal.status.name, goal.reason) == ("ABORTED", "no way")


async def test_a_type_that_the_recorder_does_not_know_is_recorded_as_bytes(tmp_path):
    with isolated_registry():
        odd = load_message("int32 number", type_name="lab_msgs/msg/Odd")
        async with two_nodes() as (talker, recorder):
            said = talker.publisher(odd, "/odd")
            await appeared(recorder, "/odd")
            REGISTRY.forget("lab_msgs/msg/Odd")
            async with recording.record(recorder, tmp_path / "run", topics=["/odd"]) as run:
                while not said.has_subscriptions:
                    await talker.transport.wait_for_change()
                said.publish(odd(number=7))
                while not run.count:
                    await anyio.sleep(0.01)
    [found] = [each async for each in recording.read(tmp_path / "run")]
    assert (found.type_name, found.value) == ("lab_msgs/msg/Odd", None)
    assert found.data == encode(odd(number=7))
    bag = recording.Bag(tmp_path / "run")
    [channel] = bag.channels()
    assert channel.schema.text == ""
    assert channel.type_hash.startswith("RIHS01_")
