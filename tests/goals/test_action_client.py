"""What a client may ask of a goal, and that a cancellation at any point leaves nothing behind."""

from __future__ import annotations

import asyncio
import contextlib
import inspect
from collections.abc import Callable
from typing import Any

import anyio
import anyio.lowlevel
import anyio.to_thread
import pytest

import turtleact
from turtleact import CancelResponse, GoalResponse, GoalStatus, Outcome
from turtleact.errors import (
    Abort,
    Cancel,
    GoalAborted,
    GoalCanceled,
    GoalRejected,
    ServerUnavailable,
    TurtleactError,
)
from turtleact.tasks import current_tasks

from ..lab import (
    ON_ASYNCIO,
    TURNS,
    Count,
    Gate,
    Other,
    count,
    feedback,
    goal,
    hand_lab,
    lab,
    once_canceled,
    other_tasks,
    result,
    running,
    settle,
)


async def abort(request, handle):
    handle.set_partial_result(result(1))
    raise Abort("no pen")


async def wait_with_partial_result(request, handle):
    handle.set_partial_result(result(1))
    await anyio.sleep_forever()


# --- awaiting a goal ------------------------------------------------------------------------


async def test_awaiting_an_aborted_goal_raises_its_reason_and_result():
    async with lab(abort) as served:
        with pytest.raises(GoalAborted, match=r"^the goal was aborted: no pen$") as caught:
            await served.client.send_goal(goal())
        assert (caught.value.reason, caught.value.result) == ("no pen", result(1))


async def test_awaiting_a_canceled_goal_raises_its_result(where):
    async with (
        where(wait_with_partial_result) as served,
        running(lambda: served.client.send_goal(goal())) as sent,
    ):
        await served.client.cancel_all()
    assert isinstance(sent.error, GoalCanceled)
    assert (str(sent.error), sent.error.result) == ("the goal was canceled", result(1))


async def test_a_goal_that_was_neither_awaited_nor_entered_is_not_sent():
    gate = Gate()
    async with lab(gate.wait) as served:
        with pytest.warns(RuntimeWarning, match="the goal for '/count' was never sent") as told:
            served.client.send_goal(goal())
        line = inspect.currentframe().f_lineno - 1  # type: ignore[union-attr]  # CPython has one
        assert (told[0].filename, told[0].lineno) == (__file__, line)
        await settle()
        assert (gate.log, served.active) == ([], [])


async def enter(sending: Any) -> Any:
    async with sending as handle:
        return await handle.result()


async def await_(sending: Any) -> Any:
    return await sending


@pytest.mark.parametrize("first", [await_, enter])
@pytest.mark.parametrize("second", [await_, enter])
async def test_a_goal_is_sent_once(first, second):
    async with lab(count) as served:
        sending = served.client.send_goal(goal(1))
        assert await first(sending) == result(0)
        with pytest.raises(TurtleactError, match="this goal for '/count' was already sent: call"):
            await second(sending)


@pytest.mark.parametrize(
    ("end", "status"),
    [(Cancel(result(5)), GoalStatus.CANCELED), (result(5), GoalStatus.SUCCEEDED)],
)
async def test_who_awaits_a_goal_stays_canceled_however_its_body_ends(end, status):
    async with lab(once_canceled(end)) as served:
        async with running(lambda: served.client.send_goal(goal())) as sent:
            (held,) = served.active
            sent.scope.cancel()
        assert (sent.scope.cancelled_caught, sent.value) == (True, None)
        assert (held.status, held.result) == (status, result(5))


# --- entering a goal ------------------------------------------------------------------------


async def test_a_handle_shows_its_goal():
    gate = Gate()
    async with lab(gate.wait) as served, served.client.send_goal(goal()) as handle:
        assert (handle.accepted, handle.done, handle.status) == (True, False, GoalStatus.EXECUTING)
        gate.opened.set()
        await handle.result()
        assert (handle.done, handle.status) == (True, GoalStatus.SUCCEEDED)


async def test_canceling_who_waits_for_the_result_lets_the_goal_go_on():
    gate = Gate()
    async with lab(gate.wait) as served, served.client.send_goal(goal(7)) as handle:
        async with running(handle.result) as waiter:
            waiter.scope.cancel()
        assert handle.status is GoalStatus.EXECUTING
        gate.opened.set()
        assert await handle.result() == result(7)


async def test_the_outcome_of_a_goal_never_raises():
    async with lab(abort) as served, served.client.send_goal(goal()) as handle:
        expected = Outcome(GoalStatus.ABORTED, result(1), "no pen")
        assert [await handle.outcome(), await handle.outcome()] == [expected, expected]


async def test_a_handle_can_be_read_message_by_message():
    async with lab(count) as served, served.client.send_goal(goal(2)) as handle:
        assert [await anext(handle), await anext(handle)] == [feedback(0), feedback(0, 1)]
        with pytest.raises(StopAsyncIteration):
            await anext(handle)


@pytest.mark.parametrize("error", [None, ValueError("mine")])
async def test_leaving_the_block_cancels_the_goal_and_waits_for_its_end(where, error):
    gate, caught = Gate(), None
    async with where(gate.wait) as served:
        try:
            async with served.client.send_goal(goal()) as handle:
                await gate.started.wait()
                if error is not None:
                    raise error
        except ValueError as mine:
            caught = mine
        assert caught is error
        assert (handle.status, gate.log) == (GoalStatus.CANCELED, ["begun", "canceled", "over"])


async def test_a_detached_goal_goes_on(where):
    gate = Gate()
    async with where(gate.wait) as served:
        async with served.client.send_goal(goal(7)) as handle:
            handle.detach()
        assert handle.status is GoalStatus.EXECUTING
        gate.opened.set()
        assert await handle.result() == result(7)


async def test_a_goal_whose_result_has_expired_still_answers_its_handle():
    clock, laboratory = hand_lab(count)
    async with laboratory as served, served.client.send_goal(goal(1)) as handle:
        await handle.result()
        clock.advance(100)
        assert await handle.result() == result(0)


# --- finding a server -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "ask",
    [
        lambda client: client.send_goal(goal()),
        lambda client: client.send_goal(goal()).__aenter__(),
        lambda client: client.attach(bytes(range(16))),
        lambda client: client.cancel_all(),
        lambda client: client.cancel_before(turtleact.interfaces.standard.Time()),
    ],
)
async def test_without_a_server_nothing_can_be_asked(ask):
    async with turtleact.open_node("lab") as node:
        client = node.action_client(Count, "count")
        with pytest.raises(ServerUnavailable, match=r"^action '/count': no server answers; this"):
            await ask(client)
        assert await client.wait_for_server(0) is False


async def test_a_similar_action_is_suggested():
    async with turtleact.open_node("lab") as node:
        node.action_server(Count, "count", count)
        with pytest.raises(ServerUnavailable, match=r"answers; did you mean '/count'\?$"):
            await node.action_client(Count, "counts").send_goal(goal())


async def test_a_server_that_comes_later_is_waited_for_which_is_said_once(caplog, monkeypatch):
    monkeypatch.setattr("turtleact.goals.client.SILENCE", 0.0)
    async with turtleact.open_node("lab") as node:
        client = node.action_client(Count, "count")
        async with running(client.wait_for_server) as waiter:
            node.action_server(Count, "other", count)
            await settle()
            assert not waiter.done.is_set()
            assert "still waiting for a server of action '/count'" in caplog.text
            node.action_server(Count, "count", count)
            await waiter.done.wait()
        assert waiter.value is True
        assert await client.send_goal(goal(1)) == result(0)
    assert caplog.text.count("still waiting") == 1


async def test_waiting_for_a_server_can_be_canceled():
    async with turtleact.open_node("lab") as node:
        client = node.action_client(Count, "count")
        async with running(client.wait_for_server) as waiter:
            waiter.scope.cancel()
        node.action_server(Count, "count", count)
        assert await client.wait_for_server() is True


async def test_a_server_of_another_type_is_no_server():
    async with lab(count) as served:
        client = served.node.action_client(Other, "count")
        assert await client.wait_for_server(0) is False


async def test_a_client_finds_the_next_server_once_the_first_is_closed():
    async def other(request):
        return result(7)

    async with lab(count) as served:
        await served.client.send_goal(goal(1))
        await served.server.aclose()
        served.node.action_server(Count, "count", other)
        assert await served.client.send_goal(goal(1)) == result(7)


async def test_a_client_that_is_closed_lets_its_goals_go_on():
    gate = Gate()
    async with lab(gate.wait) as served, served.client.send_goal(goal(7)) as handle:
        await served.client.aclose()
        await served.client.aclose()
        gate.opened.set()
        assert await handle.result() == result(7)


# --- canceled at every point ----------------------------------------------------------------


class Busy:
    """A body and callbacks that wait as often as can be, in their clean-up too."""

    def __init__(self) -> None:
        self.active = 0

    async def body(self, request, handle):
        self.active += 1
        try:
            await take(2)
            handle.publish_feedback(feedback(1))
            await take(2)
            return result(1)
        finally:
            await self.clean_up()

    async def stream(self, request):
        self.active += 1
        try:
            for number in range(20):
                yield feedback(number)
            await take(2)
            yield result(1)
        finally:
            await self.clean_up()

    async def clean_up(self):
        try:
            with anyio.CancelScope(shield=True):
                await take(2)
        finally:
            self.active -= 1

    async def accept(self, request):
        await take(2)
        return GoalResponse.ACCEPT

    async def let_go(self, handle):
        await take(2)
        return CancelResponse.ACCEPT


async def take(turns: int) -> None:
    for _ in range(turns):
        await anyio.lowlevel.checkpoint()


async def await_it(client):
    await client.send_goal(goal())


async def read_it(client):
    async with client.send_goal(goal()) as handle:
        async for _ in handle:
            await take(1)
        await handle.result()


async def leave_it(client):
    async with client.send_goal(goal()):
        await take(3)


async def cancel_it(client):
    async with client.send_goal(goal()) as handle:
        await take(3)
        await handle.cancel()
        await handle.outcome()


async def cancel_them_all(client):
    async with client.send_goal(goal()):
        await take(3)
        await client.cancel_all()


async def find_it(client):
    await client.wait_for_server()
    await client.send_goal(goal())


async def cancel_after(turns: int, call, native: bool) -> bool:
    """Run a call in a task of its own and cancel it after some turns; whether it was still on."""
    if native:
        task = asyncio.create_task(call())
        await take_native(turns)
        task.cancel()
        await asyncio.wait([task])
        return task.cancelled()
    scope, ended = anyio.CancelScope(), False

    async def run():
        nonlocal ended
        with scope:
            await call()
            ended = True

    async with anyio.create_task_group() as group:
        group.start_soon(run)
        tasks = current_tasks()
        for _ in range(turns):
            await tasks.checkpoint()
        scope.cancel()
    return not ended


async def take_native(turns: int) -> None:
    for _ in range(turns):
        await asyncio.sleep(0)


CALLS = pytest.mark.parametrize(
    "call", [await_it, read_it, leave_it, cancel_it, cancel_them_all, find_it]
)
ASKING = pytest.mark.parametrize("asks", [False, True], ids=["plain", "asking"])
BUSY = pytest.mark.parametrize("style", ["body", "stream"])


async def cancel_at_each_point(call, client, is_over: Callable[[], bool], *, native: bool) -> None:
    """Cancel a call at each point from its beginning on: all is over then, and as before."""
    before = other_tasks() if on_asyncio() else set()
    for turns in range(100 * TURNS):
        was_on = await cancel_after(turns, call, native)
        if native:  # a second scope may be left at once: what was shielded goes on
            await settle()
        assert is_over(), f"after {turns} turns"
        await settle()
        assert not on_asyncio() or other_tasks() == before, f"after {turns} turns"
        assert await client.send_goal(goal()) == result(1), f"after {turns} turns"
        if not was_on:
            assert turns > 3
            return
    pytest.fail("the call never came to its end")


async def cancel_everywhere(call, style, *, asks, native) -> None:
    busy = Busy()
    callbacks: dict[str, Any] = {"goal_callback": busy.accept, "cancel_callback": busy.let_go}
    async with lab(getattr(busy, style), **callbacks if asks else {}) as served:
        await cancel_at_each_point(
            lambda: call(served.client),
            served.client,
            lambda: (served.active, busy.active) == ([], 0),
            native=native,
        )


def on_asyncio() -> bool:
    return anyio.get_cancelled_exc_class() is asyncio.CancelledError


@CALLS
@ASKING
@BUSY
async def test_a_call_canceled_by_a_scope_at_any_point_leaves_nothing_behind(call, style, asks):
    await cancel_everywhere(call, style, asks=asks, native=False)


@ON_ASYNCIO
@CALLS
@ASKING
@BUSY
async def test_a_call_canceled_as_a_task_at_any_point_leaves_nothing_behind(call, style, asks):
    await cancel_everywhere(call, style, asks=asks, native=True)


@CALLS
@BUSY
async def test_a_server_closed_at_any_point_of_a_call_answers_it(call, style):
    async def run(client):
        with contextlib.suppress(GoalAborted, GoalCanceled, GoalRejected, ServerUnavailable):
            await call(client)

    for turns in range(40):
        busy = Busy()
        async with lab(getattr(busy, style)) as served, anyio.create_task_group() as group:
            group.start_soon(run, served.client)
            await take(turns)
            await served.server.aclose()
            assert (served.active, busy.active) == ([], 0), f"after {turns} turns"
            if call is find_it:
                group.cancel_scope.cancel()  # it may wait for the next server


# --- given to what wants a coroutine ------------------------------------------------------------


@ON_ASYNCIO
async def test_a_task_group_takes_it():
    async with lab(count) as served, asyncio.TaskGroup() as group:
        tasks = [group.create_task(served.client.send_goal(goal(upto))) for upto in range(3)]
    assert [task.result() for task in tasks] == [result(), result(0), result(0, 1)]


@ON_ASYNCIO
async def test_canceling_the_task_before_its_first_step_sends_nothing():
    async with lab(count) as served:
        task = asyncio.create_task(served.client.send_goal(goal()))
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert served.active == []


async def test_what_was_never_begun_can_be_closed():
    async with lab(count) as served:
        served.client.send_goal(goal()).close()
        assert served.active == []


# --- used elsewhere than in its event loop ------------------------------------------------------


USES: dict[str, Callable[[Any, Any], Any]] = {
    "send_goal": lambda client, _: awaited(client.send_goal(goal())),
    "async with": lambda client, _: entered(client.send_goal(goal())),
    "attach": lambda client, _: awaited(client.attach(bytes(range(16)))),
    "wait_for_server": lambda client, _: client.wait_for_server(),
    "cancel_all": lambda client, _: client.cancel_all(),
    "aclose": lambda client, _: client.aclose(),
    "result": lambda _, handle: handle.result(),
    "outcome": lambda _, handle: handle.outcome(),
    "cancel": lambda _, handle: handle.cancel(),
    "cancel_nowait": lambda _, handle: called(handle.cancel_nowait),
    "aiter": lambda _, handle: called(lambda: aiter(handle)),
    "anext": lambda _, handle: anext(handle),
    "events": lambda _, handle: called(handle.events),
}


async def awaited(sending: Any) -> Any:
    return await sending


async def entered(sending: Any) -> None:
    async with sending:
        pass


async def called(call: Callable[[], object]) -> None:
    call()


@pytest.mark.parametrize("use", USES)
@pytest.mark.parametrize("backend", ["asyncio", "trio"])
async def test_what_is_used_in_another_event_loop_says_so(use, backend):
    gate = Gate()
    async with lab(gate.wait) as served, served.client.send_goal(goal()) as handle:
        said = "the client of action '/count' belongs to another event loop: .* anyio.from_thread"
        with pytest.raises(TurtleactError, match=said):
            await anyio.to_thread.run_sync(
                lambda: anyio.run(USES[use], served.client, handle, backend=backend)
            )
        gate.opened.set()
        assert await handle.result() == result(3)


async def test_a_loop_over_a_goal_that_was_not_sent_says_what_to_write():
    async with lab(count) as served:
        with pytest.raises(TypeError, match="write 'async with"):
            async for _ in served.client.send_goal(goal(3)):
                pass


async def test_a_goal_to_be_sent_is_shown_by_its_action():
    async with lab(count) as served:
        sending = served.client.send_goal(goal(3))
        assert repr(sending) == "<goal for '/count', not yet sent>"
        await sending
        assert repr(sending) == "<goal for '/count', already sent>"


async def test_a_loop_that_sends_rejected_goals_again_lets_other_tasks_run():
    gate = Gate()

    async def let_go() -> None:
        gate.opened.set()

    async with (
        lab(gate.wait, policy="reject") as served,
        anyio.create_task_group() as group,
        served.client.send_goal(goal()) as holder,
    ):
        group.start_soon(let_go)  # runs only if the loop below lets it
        while True:
            try:
                await served.client.send_goal(goal())
                break
            except GoalRejected:
                continue
        assert (await holder.outcome()).status is GoalStatus.SUCCEEDED
