"""What an action promises and no other file here proves; docs/conformance.md names all of it."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from typing import Any

import anyio
import pytest

from turtleact import CancelResponse, GoalResponse, GoalStatus, QoS, open_world
from turtleact.errors import (
    GoalAborted,
    GoalRejected,
    InvalidName,
    InvalidOption,
    InvalidTransition,
)
from turtleact.goals.state import CancelCode
from turtleact.interfaces.standard import GoalStatusArray

from ..lab import (
    ON_ASYNCIO,
    Count,
    Gate,
    count,
    feedback,
    goal,
    hand_lab,
    lab,
    other_tasks,
    result,
    running,
    settle,
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
                served.local.request_cancel(served.active[0])

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
            served.local.request_cancel(served.active[0])

    async with (
        lab(generator if style == "generator" else coroutine) as served,
        served.client.send_goal(goal(), feedback_callback=cancel) as handle,
    ):
        assert (await handle.outcome()).status is GoalStatus.CANCELED
        assert handle.last_feedback == feedback(3)


async def test_zeros_are_no_id_of_a_goal():
    async with lab(count) as served:
        with pytest.raises(InvalidName, match="must not be all zeros"):
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
        assert not await client.wait_for_server(timeout=60)
        assert node.clock.now() - before >= 60 * 10**9


async def test_the_newest_feedback_is_known_when_its_callback_is_called():
    seen = []

    has_handle = anyio.Event()

    async def body(request, handle):
        await has_handle.wait()
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
            has_handle.set()
            await handle.outcome()
    assert seen == [feedback(1)]


# --- what a body or callback does to others -----------------------------------------------------


async def test_what_a_body_does_behind_its_result_does_not_change_it():
    async def body(request):
        counted = [0, 1]
        try:
            yield Count.Result(counted=counted)
        finally:
            counted.clear()

    async with lab(body) as served:
        assert await served.client.send_goal(goal()) == result(0, 1)


async def test_feedback_and_a_partial_result_after_the_end_raise():
    handles: list[Any] = []

    async def body(request, handle):
        handles.append(handle)
        return result(1)

    async with lab(body) as served:
        assert await served.client.send_goal(goal()) == result(1)
        with pytest.raises(InvalidTransition, match="a partial result is not allowed"):
            handles[0].set_partial_result(result(9))
        with pytest.raises(InvalidTransition, match="SUCCEEDED: feedback is not allowed"):
            handles[0].publish_feedback(feedback(1))


def canceled_future() -> asyncio.Future[Any]:
    future = asyncio.get_running_loop().create_future()
    future.cancel()
    return future


@ON_ASYNCIO
async def test_a_hook_that_reads_a_canceled_future_silences_no_hook(caplog):
    heard = []
    async with lab(count) as served:
        served.node.on_transition(lambda *_: canceled_future().result())
        served.node.on_transition(lambda goal, old, new: heard.append(new.name))
        assert await served.client.send_goal(goal(1)) == result(0)
    assert heard == ["ACCEPTED", "EXECUTING", "SUCCEEDED"]
    assert "an observer of the goals of /count failed" in caplog.messages


@ON_ASYNCIO
async def test_a_feedback_callback_that_reads_a_canceled_future_does_not_cancel_the_body():
    async with lab(count) as served:
        sending = served.client.send_goal(
            goal(), feedback_callback=lambda _: canceled_future().result()
        )
        assert await sending == result(0, 1, 2)


@ON_ASYNCIO
async def test_a_callback_that_awaits_what_was_canceled_does_not_agree():
    gate = Gate()

    async def wait(_):
        await canceled_future()

    async with lab(gate.wait, goal_callback=wait) as served:
        with pytest.raises(GoalRejected, match="it waited for something that was canceled"):
            await served.client.send_goal(goal())
    async with (
        lab(gate.wait, cancel_callback=wait) as served,
        served.client.send_goal(goal()) as handle,
    ):
        assert (await handle.cancel()).return_code == CancelCode.REJECTED
        gate.opened.set()
        assert await handle.result() == result(3)


async def test_who_asks_a_server_that_is_closing_is_answered():
    async def never(_):
        await anyio.sleep_forever()

    gate = Gate()
    async with (
        lab(gate.tidy, cancel_callback=never) as served,
        served.client.send_goal(goal()) as handle,
        running(served.server.aclose),
    ):
        answer = await handle.cancel()
        assert answer.goals_canceling == []
        gate.opened.set()


class Stubborn:
    """A body that swallows every cancellation, until it is told not to."""

    def __init__(self) -> None:
        self.may_end = False

    async def __call__(self, request: Count.Goal) -> Count.Result:
        while not self.may_end:
            try:
                await anyio.sleep_forever()
            except anyio.get_cancelled_exc_class():
                if self.may_end:
                    raise
        return result()


@ON_ASYNCIO
@pytest.mark.parametrize("how", ["the server is closed", "the caller is canceled"])
async def test_a_stubborn_body_does_not_keep_the_one_who_awaits_it(how):
    body = Stubborn()
    async with lab(body, grace=0.01) as served:
        client = served.node.action_client(Count, "count", cancel_timeout=0.01)
        calling = asyncio.create_task(client.send_goal(goal()))
        await settle()
        if how == "the server is closed":
            await served.server.aclose()
            with pytest.raises(GoalAborted, match="shutdown"):
                await calling
        else:
            calling.cancel()
            with pytest.raises(asyncio.CancelledError):
                await calling
        body.may_end = True
        for task in other_tasks():
            if task.get_name() == "/count":
                task.cancel()
        await settle()


@ON_ASYNCIO
async def test_a_callers_scope_is_not_lost_to_a_cancel_of_the_goal():
    inner = anyio.Event()

    async def body(request):
        async def tidy() -> None:
            try:
                await anyio.sleep_forever()
            finally:
                with anyio.CancelScope(shield=True):
                    await inner.wait()

        async with anyio.create_task_group() as group:
            group.start_soon(tidy)
            await anyio.sleep_forever()

    async with lab(body) as served:
        scopes: list[anyio.CancelScope] = []

        async def call() -> str:
            with anyio.CancelScope() as scope:
                scopes.append(scope)
                await served.client.send_goal(goal())
            return "behind the scope"

        calling = asyncio.create_task(call())
        await settle()
        scopes[0].cancel()
        await settle()
        await served.client.cancel_all()
        await settle()
        inner.set()
        assert await calling == "behind the scope"
