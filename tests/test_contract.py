"""What an action promises and no other file here proves; docs/conformance.md names all of it."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from typing import Any

import anyio
import pytest

from turtleact import CancelResponse, GoalResponse, GoalStatus, QoS
from turtleact.app import open_world
from turtleact.errors import InvalidName, InvalidOption, InvalidTransition
from turtleact.interfaces.standard import GoalStatusArray

from .lab import (
    ON_ASYNCIO,
    Count,
    Gate,
    count,
    feedback,
    goal,
    hand_lab,
    lab,
    result,
    running,
    take_turns,
)

ID = bytes(range(16))
COUNTED = [feedback(0), feedback(0, 1), feedback(0, 1, 2)]


async def test_no_feedback_is_lost_to_a_slow_acceptance():
    async def accept(request):
        await take_turns()
        return GoalResponse.ACCEPT

    async with (
        lab(count, goal_callback=accept) as served,
        served.client.send_goal(goal()) as handle,
    ):
        await take_turns()
        assert [message async for message in handle] == COUNTED


@pytest.mark.parametrize("style", ["wait", "stream"])
async def test_a_body_canceled_before_its_first_step_never_begins(style):
    gate = Gate()
    async with lab(getattr(gate, style)) as served:

        def cancel(handle, old, new):
            if new is GoalStatus.EXECUTING:
                served.server.cancel_nowait(served.active[0])

        served.node.on_transition(cancel)
        async with served.client.send_goal(goal()) as handle:
            assert (await handle.outcome()).status is GoalStatus.CANCELED
    assert gate.log == []


async def test_a_late_observer_hears_of_a_goal_as_long_as_its_result_is_kept():
    clock, laboratory = hand_lab(count)
    async with laboratory as served:
        await served.client.send_goal(goal(), goal_id=ID)
        assert seen_late(served) == [(ID, GoalStatus.SUCCEEDED)]
        clock.advance(11)
        assert seen_late(served) == []


def seen_late(served):
    """The goals that who subscribes to the status now is told of."""
    qos = QoS(durability="transient_local")
    (array,) = served.node.subscription(GoalStatusArray, "count/_action/status", qos).drain()
    return [(each.goal_info.goal_id.uuid, each.status) for each in array.status_list]


async def test_the_feedback_of_a_child_is_not_that_of_its_parent():
    async def parent(request, handle):
        async with handle.node.action_client(Count, "child").send_goal(request) as sent:
            async for message in sent:
                if len(message.so_far) == 2:
                    yield message
            yield await sent.result()

    async def child(request):
        await take_turns()
        async for message in count(request):
            yield message

    async with lab(parent, policy="queue") as served:
        served.node.action_server(Count, "child", child)
        async with served.client.send_goal(goal()) as handle:
            assert [message async for message in handle] == [feedback(0, 1)]
            assert await handle.result() == result(0, 1, 2)


async def test_feedback_of_a_goal_that_waits_raises():
    gate, raised = Gate(), []

    def publish(handle):
        try:
            handle.publish_feedback(feedback(1))
        except InvalidTransition:
            raised.append(handle.goal_id)
        return CancelResponse.REJECT

    async with (
        lab(gate.wait, policy="queue", cancel_callback=publish) as served,
        served.client.send_goal(goal()),
        served.client.send_goal(goal()) as waiting,
    ):
        await waiting.cancel()
        gate.opened.set()
        await waiting.outcome()
        assert (raised, waiting.last_feedback) == ([waiting.goal_id], None)


# --- whoever asks is answered, and whoever waits has his turn -------------------------------------


@ON_ASYNCIO
@pytest.mark.parametrize("when", ["before", "in its feedback_callback", "in its first step"])
async def test_a_caller_that_is_canceled_is_not_taken_for_a_body_that_is(when):
    async def call() -> None:
        me = asyncio.current_task()
        assert me is not None

        async def body(request, handle):
            handle.publish_feedback(feedback(0))
            if when == "in its first step":
                me.cancel()
            await anyio.sleep_forever()

        async with lab(body) as served:
            if when == "before":
                me.cancel()
            listen = (lambda _: me.cancel()) if "feedback" in when else None
            await served.client.send_goal(goal(), feedback_callback=listen)

    calling = asyncio.create_task(call())
    await asyncio.wait([calling])
    assert calling.cancelled()


@pytest.mark.parametrize("kind", ["goal_callback", "cancel_callback"])
async def test_a_server_that_closes_waits_for_no_callback(kind):
    gate = Gate()

    async def never(_):
        await anyio.sleep_forever()

    options: dict[str, Any] = {kind: never}
    async with lab(gate.wait, **options) as served:
        async with AsyncExitStack() as stack:
            if kind == "goal_callback":
                asked = await stack.enter_async_context(running(lambda: entered(served)))
            else:
                handle = await stack.enter_async_context(served.client.send_goal(goal()))
                asked = await stack.enter_async_context(running(handle.cancel))
            await served.server.aclose()
        if kind == "goal_callback":
            assert str(asked.error).endswith("the server of '/count' is shutting down")
        else:
            assert (asked.error, asked.value.goals_canceling) == (None, [])


async def entered(served):
    async with served.client.send_goal(goal()) as handle:
        return await handle.outcome()


@ON_ASYNCIO
async def test_a_loops_own_callback_can_cancel_a_goal():
    gate = Gate()

    async def agree(_):
        await take_turns()
        return CancelResponse.ACCEPT

    async with (
        lab(gate.wait, cancel_callback=agree) as served,
        served.client.send_goal(goal()) as handle,
    ):
        asyncio.get_running_loop().call_soon(handle.cancel_nowait)
        assert (await handle.outcome()).status is GoalStatus.CANCELED


@pytest.mark.parametrize("way", ["awaited", "entered"])
async def test_goals_that_never_wait_let_others_run(way):
    async def body(request, handle):
        return result()

    async def send_for_ever():
        while True:
            if way == "entered":
                await entered(served)
            else:
                await served.client.send_goal(goal())

    async with lab(body) as served, running(send_for_ever) as sending:
        sending.scope.cancel()


async def test_who_watches_the_status_is_told_of_the_shutdown():
    gate = Gate()
    async with lab(gate.wait) as served:
        qos = QoS(depth=100)
        watched = served.node.subscription(GoalStatusArray, "count/_action/status", qos)
        async with served.client.send_goal(goal()):
            await served.server.aclose()
            last = watched.drain()[-1]
        assert [each.status for each in last.status_list] == [GoalStatus.ABORTED]


@pytest.mark.parametrize("style", ["generator", "coroutine"])
async def test_who_is_told_of_a_message_may_cancel_at_it(style):
    async def coroutine(request, handle):
        for number in range(10):
            handle.publish_feedback(feedback(number))
            await anyio.lowlevel.checkpoint()
        return result()

    async def generator(request):
        await anyio.lowlevel.checkpoint()
        for number in range(10):
            yield feedback(number)
        yield result()

    def cancel(message):
        if message == feedback(3):
            served.server.cancel_nowait(served.active[0])

    async with (
        lab(generator if style == "generator" else coroutine) as served,
        served.client.send_goal(goal(), feedback_callback=cancel) as handle,
    ):
        assert (await handle.outcome()).status is GoalStatus.CANCELED
        assert handle.last_feedback == feedback(3)


async def test_zeros_are_no_id_of_a_goal():
    async with lab(count) as served:
        with pytest.raises(InvalidName, match="zeros name no goal"):
            served.client.send_goal(goal(), goal_id=bytes(16))


async def test_the_message_that_the_goal_callback_has_seen_is_the_one_that_is_carried_out():
    sent = goal(1)

    async def change(request):
        await take_turns()
        sent.upto = 3
        return GoalResponse.ACCEPT

    async with lab(count, goal_callback=change) as served:
        assert await served.client.send_goal(sent) == result(0)


@pytest.mark.parametrize("seconds", [-1, True, "10", float("nan"), float("inf")])
async def test_a_time_that_is_none_is_no_result_timeout(seconds):
    with pytest.raises(InvalidOption, match="result_timeout"):
        async with lab(count, result_timeout=seconds):
            pass


async def test_a_client_waits_for_its_server_by_the_clock_of_the_graph():
    async with open_world(speed="max") as node:
        before = node.clock.now()
        client = node.action_client(Count, "nobody")
        assert not await client.wait_for_server(timeout=3600)
        assert node.clock.now() - before >= 3600 * 10**9


async def test_the_newest_feedback_is_known_when_its_callback_is_called():
    seen = []

    async def body(request, handle):
        await anyio.lowlevel.checkpoint()
        handle.publish_feedback(feedback(1))
        await anyio.lowlevel.checkpoint()
        return result()

    async with lab(body) as served:
        handles: list[Any] = []
        sending = served.client.send_goal(
            goal(), feedback_callback=lambda _: seen.append(handles[0].last_feedback)
        )
        async with sending as handle:
            handles.append(handle)
            await handle.outcome()
    assert seen == [feedback(1)]
