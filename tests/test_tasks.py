"""Tasks begun at once, signals, and coroutines that run in somebody else's task."""

from __future__ import annotations

import asyncio
import gc
import logging
import sys
from collections.abc import Callable, Coroutine
from contextlib import nullcontext
from contextvars import ContextVar, copy_context
from typing import Any

import anyio
import pytest
from turtleact.server.stepping import Borrowed

from turtleact.goal import Goal
from turtleact.tasks import Background, current_tasks, wait_while
from turtleact.tasks.on_asyncio import AsyncioTasks
from turtleact.tasks.on_trio import TrioTasks

from .lab import ON_ASYNCIO, ON_TRIO, other_tasks, settle

COLOUR: ContextVar[str] = ContextVar("COLOUR", default="none")


async def note(log: list[object], entry: object) -> None:
    log.append(entry)


async def wait_forever(log: list[object]) -> None:
    try:
        await anyio.sleep_forever()
    except anyio.get_cancelled_exc_class():
        log.append("canceled")
        raise


def me() -> asyncio.Task[Any]:
    """The task that runs."""
    task = asyncio.current_task()
    assert task is not None
    return task


# --- spawn ----------------------------------------------------------------------------------


@ON_ASYNCIO
async def test_the_tasks_of_asyncio_are_asyncios():
    assert isinstance(current_tasks(), AsyncioTasks)


@ON_TRIO
async def test_the_tasks_of_trio_are_trios():
    assert isinstance(current_tasks(), TrioTasks)


async def test_a_spawned_coroutine_runs():
    log: list[object] = []
    current_tasks().spawn(note(log, "ran"), "lab")
    await settle()
    assert log == ["ran"]


@ON_ASYNCIO
async def test_the_first_step_has_run_when_spawn_returns():
    log: list[object] = []
    current_tasks().spawn(note(log, "ran"), "lab")
    assert log == ["ran"]


@ON_TRIO
async def test_on_trio_the_first_step_runs_soon_but_not_at_once():
    log: list[object] = []
    current_tasks().spawn(note(log, "ran"), "lab")
    assert log == []
    await settle()


@ON_ASYNCIO
async def test_the_first_step_runs_as_its_own_task():
    seen: list[object] = []

    async def body():
        seen.append(asyncio.current_task())

    task = current_tasks().spawn(body(), "lab")
    assert seen == [task]


@ON_ASYNCIO
async def test_the_caller_is_the_current_task_again_after_a_spawn():
    me = asyncio.current_task()
    current_tasks().spawn(note([], ""), "lab")
    assert asyncio.current_task() is me


@ON_ASYNCIO
async def test_a_task_that_waits_goes_on_as_the_same_task():
    seen: list[object] = []

    async def body():
        seen.append(asyncio.current_task())
        await asyncio.sleep(0)
        seen.append(asyncio.current_task())

    task = current_tasks().spawn(body(), "lab")
    await settle()
    assert seen == [task, task]


@ON_ASYNCIO
async def test_a_spawned_task_is_among_the_tasks_of_the_loop():
    task = current_tasks().spawn(wait_forever([]), "lab")
    assert task in asyncio.all_tasks()
    task.cancel()
    await settle()


@ON_ASYNCIO
async def test_a_spawned_task_has_the_name_it_was_given():
    task: Any = current_tasks().spawn(note([], ""), "the body of /count")
    assert task.get_name() == "the body of /count"


@ON_ASYNCIO
async def test_a_spawn_outside_of_any_task_runs_at_once_too():
    log: list[object] = []
    tasks = current_tasks()

    def spawn() -> None:
        tasks.spawn(note(log, asyncio.current_task()), "lab")
        log.append("spawned")

    asyncio.get_running_loop().call_soon(spawn)
    await settle()
    assert log == [None, "spawned"]


async def test_a_spawned_coroutine_sees_the_context_of_its_caller():
    log: list[object] = []

    async def body():
        log.append(COLOUR.get())

    token = COLOUR.set("red")
    current_tasks().spawn(body(), "lab")
    COLOUR.reset(token)
    await settle()
    assert log == ["red"]


async def test_what_a_spawned_coroutine_sets_in_its_context_stays_there():
    async def body():
        COLOUR.set("blue")
        await settle()
        COLOUR.set("green")

    current_tasks().spawn(body(), "lab")
    await settle()
    assert COLOUR.get() == "none"


async def test_a_spawned_coroutine_keeps_its_context_over_a_wait():
    log: list[object] = []

    async def body():
        COLOUR.set("blue")
        await anyio.lowlevel.checkpoint()
        log.append(COLOUR.get())

    current_tasks().spawn(body(), "lab")
    await settle()
    assert log == ["blue"]


async def test_a_spawned_coroutine_can_spawn():
    log: list[object] = []

    async def outer():
        current_tasks().spawn(note(log, "inner"), "inner")
        await settle()
        log.append("outer")

    current_tasks().spawn(outer(), "outer")
    await settle()
    await settle()
    assert log == ["inner", "outer"]


@ON_ASYNCIO
async def test_eager_starts_nest():
    seen: list[object] = []
    me = asyncio.current_task()

    async def body(depth: int) -> None:
        before = asyncio.current_task()
        if depth:
            current_tasks().spawn(body(depth - 1), f"depth {depth}")
        seen.append(asyncio.current_task() is before)

    current_tasks().spawn(body(5), "lab")
    assert (seen, asyncio.current_task()) == ([True] * 6, me)


@ON_ASYNCIO
async def test_what_the_first_step_raises_does_not_reach_the_caller():
    async def body():
        raise ValueError("first step")

    task: Any = current_tasks().spawn(body(), "lab")
    assert str(task.exception()) == "first step"


@ON_ASYNCIO
async def test_what_stops_the_program_in_the_first_step_leaves_the_caller_current():
    async def body():
        raise KeyboardInterrupt

    me = asyncio.current_task()
    with pytest.raises(KeyboardInterrupt):
        current_tasks().spawn(body(), "lab")
    assert asyncio.current_task() is me
    retrieve_exceptions()


def retrieve_exceptions() -> None:
    """Look at the exceptions of all tasks that have ended, or the loop complains of them."""
    for thing in gc.get_objects():
        if isinstance(thing, asyncio.Task) and thing.done() and not thing.cancelled():
            thing.exception()


@ON_ASYNCIO
@pytest.mark.parametrize("failing", [False, True], ids=["made", "not made"])
async def test_the_loop_is_as_it_was_after_a_task_was(failing):
    loop = asyncio.get_running_loop()
    if failing:
        with pytest.raises(TypeError):
            current_tasks().spawn("no coroutine", "lab")  # type: ignore[arg-type]  # on purpose
    else:
        current_tasks().spawn(note([], ""), "lab")
    assert "call_soon" not in vars(loop)


@ON_ASYNCIO
async def test_a_task_that_could_not_be_made_leaves_the_next_one_alone():
    log: list[object] = []
    tasks = current_tasks()
    with pytest.raises(TypeError):
        tasks.spawn("no coroutine", "lab")  # type: ignore[arg-type]  # on purpose
    tasks.spawn(note(log, "ran"), "lab")
    assert log == ["ran"]


async def test_a_task_that_waits_is_canceled_there():
    log: list[object] = []
    task = current_tasks().spawn(wait_forever(log), "lab")
    await settle()
    task.cancel()
    await settle()
    assert log == ["canceled"]


async def test_a_task_canceled_at_once_is_canceled_at_its_first_wait():
    log: list[object] = []
    current_tasks().spawn(wait_forever(log), "lab").cancel()
    await settle()
    assert log == ["canceled"]


async def test_canceling_a_task_that_has_ended_does_nothing():
    task = current_tasks().spawn(note([], ""), "lab")
    await settle()
    task.cancel()


async def test_a_checkpoint_lets_others_run():
    log: list[object] = []
    tasks = current_tasks()

    async def body():
        await tasks.checkpoint()
        log.append("other")

    tasks.spawn(body(), "lab")
    while not log:
        await tasks.checkpoint()
    assert log == ["other"]


@ON_ASYNCIO
async def test_the_first_step_does_not_take_a_turn_of_the_loop():
    turns: list[int] = []
    asyncio.get_running_loop().call_soon(turns.append, 1)
    current_tasks().spawn(note([], ""), "lab")
    assert turns == []
    await settle()


# --- signals --------------------------------------------------------------------------------


def waiting(signal: object) -> int:
    """How many wait for a signal."""
    lot = getattr(signal, "_lot", None)
    return len(signal._waiting) if lot is None else lot.statistics().tasks_waiting  # type: ignore[attr-defined]  # of asyncio


async def test_a_signal_wakes_all_that_wait():
    signal, log = current_tasks().signal(), []

    async def wait(number: int) -> None:
        await signal.wait()
        log.append(number)

    async with anyio.create_task_group() as group:
        for number in range(3):
            group.start_soon(wait, number)
        await settle()
        signal.fire()
    assert sorted(log) == [0, 1, 2]


async def test_a_signal_does_not_remember_that_it_fired():
    signal, log = current_tasks().signal(), []

    async def wait() -> None:
        await signal.wait()
        log.append("woken")

    signal.fire()
    async with anyio.create_task_group() as group:
        group.start_soon(wait)
        await settle()
        assert log == []
        signal.fire()


async def test_one_fire_wakes_a_waiter_once():
    signal, log = current_tasks().signal(), []

    async def wait() -> None:
        while True:
            await signal.wait()
            log.append("woken")

    async with anyio.create_task_group() as group:
        group.start_soon(wait)
        await settle()
        signal.fire()
        await settle()
        assert log == ["woken"]
        group.cancel_scope.cancel()


async def test_a_canceled_waiter_leaves_nothing_behind():
    signal = current_tasks().signal()
    async with anyio.create_task_group() as group:
        group.start_soon(signal.wait)
        await settle()
        assert waiting(signal) == 1
        group.cancel_scope.cancel()
    assert waiting(signal) == 0


async def test_a_canceled_waiter_leaves_the_others_waiting():
    signal, log = current_tasks().signal(), []

    async def wait() -> None:
        await signal.wait()
        log.append("woken")

    async with anyio.create_task_group() as group:
        group.start_soon(wait)
        with anyio.CancelScope() as scope:
            scope.cancel()
            await signal.wait()
        await settle()
        signal.fire()
    assert log == ["woken"]


@ON_ASYNCIO
async def test_a_waiter_canceled_after_the_fire_leaves_nothing_behind():
    signal = current_tasks().signal()
    task = asyncio.create_task(signal.wait())
    await asyncio.sleep(0)
    signal.fire()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert waiting(signal) == 0


@ON_ASYNCIO
async def test_a_fire_right_after_a_cancellation_passes_over_the_canceled_waiter():
    signal = current_tasks().signal()
    task = asyncio.create_task(signal.wait())
    await asyncio.sleep(0)
    task.cancel()
    signal.fire()
    with pytest.raises(asyncio.CancelledError):
        await task


# --- what is being ended --------------------------------------------------------------------


async def test_what_is_over_is_not_waited_for():
    waiting = wait_while(lambda: False, current_tasks().signal(), 1.0)
    with pytest.raises(StopIteration):
        waiting.send(None)


async def test_what_is_not_over_is_waited_for_though_the_waiter_is_canceled():
    signal, busy = current_tasks().signal(), [1, 2]
    log: list[object] = []

    async def wait() -> None:
        await wait_while(lambda: busy, signal, 60.0)
        log.append("over")

    async with anyio.create_task_group() as group:
        group.start_soon(wait)
        await settle()
        group.cancel_scope.cancel()
        while busy:
            busy.pop()
            signal.fire()
            with anyio.CancelScope(shield=True):
                await settle()
            log.append(len(busy))
    assert log == [1, "over", 0]


async def test_what_is_not_over_in_time_is_left():
    await wait_while(lambda: True, current_tasks().signal(), 0.0)


# --- a coroutine in the caller's own task ---------------------------------------------------


class Loan:
    """A coroutine that the test runs in its own task, and what happened.

    Attributes:
        log: What happened to the coroutine, in its own words.
        slow: How long each step took that blocked the loop (s).
        borrowed: The one that runs it; None before it has waited.
        was_canceled: Whether, at the end of the coroutine, the caller counted as canceled.
    """

    def __init__(self) -> None:
        self.log: list[object] = []
        self.slow: list[float] = []
        self.borrowed: Any = None
        self.was_canceled = False

    async def run(self, body: Callable[[], Coroutine[object, object, object]]) -> object:
        async def watched() -> object:
            try:
                return await body()
            finally:
                self.was_canceled = bool(self.borrowed and self.borrowed.is_caller_canceled)

        coroutine, context = watched(), copy_context()
        try:
            waits_for = context.run(coroutine.send, None)
        except StopIteration as end:
            return end.value
        self.borrowed = Borrowed(context, Goal(None, 0), self, current_tasks(), None)
        return await self.borrowed.go_on(coroutine, waits_for)

    def report_blocking(self, goal: Goal, seconds: float) -> None:
        self.slow.append(seconds)

    def mark_canceling(self, goal: Goal) -> None:
        """There is no goal here."""

    async def wait(self) -> str:
        """Let the cancellation out."""
        try:
            await asyncio.sleep(3600)
        except asyncio.CancelledError:
            self.log.append("canceled")
            raise
        return "slept"

    async def swallow(self) -> str:
        """End as if nothing had happened."""
        try:
            await asyncio.sleep(3600)
        except asyncio.CancelledError:
            self.log.append("canceled")
        return "swallowed"

    async def clean_up(self) -> str:
        """Wait in the clean-up too."""
        try:
            await asyncio.sleep(3600)
        except asyncio.CancelledError:
            self.log.append("canceled")
            await asyncio.sleep(0)
            self.log.append("cleaned up")
        return "clean"

    def cancel_soon(self) -> None:
        """Cancel the coroutine alone, in the next turn of the loop."""
        asyncio.get_running_loop().call_soon(lambda: self.borrowed.cancel())


def cancel_me_soon() -> None:
    asyncio.get_running_loop().call_soon(me().cancel)


@pytest.fixture
def loan() -> Loan:
    return Loan()


async def apart(call: Callable[[], Coroutine[object, object, object]]) -> asyncio.Task[object]:
    """Run something in a task of its own, to its end; a cancellation of it is its own affair."""
    task = asyncio.create_task(call())
    await asyncio.wait([task])
    return task


@ON_ASYNCIO
async def test_a_borrowed_coroutine_runs_in_the_task_of_its_caller(loan):
    async def body():
        await asyncio.sleep(0)
        return asyncio.current_task()

    assert await loan.run(body) is asyncio.current_task()


@ON_ASYNCIO
async def test_a_borrowed_coroutine_gives_its_value(loan):
    async def body():
        for _ in range(5):
            await asyncio.sleep(0)
        return "value"

    assert await loan.run(body) == "value"


@ON_ASYNCIO
async def test_what_a_borrowed_coroutine_raises_reaches_the_caller(loan):
    async def body():
        await asyncio.sleep(0)
        raise ValueError("mine")

    with pytest.raises(ValueError, match="mine"):
        await loan.run(body)


@ON_ASYNCIO
async def test_a_failed_future_is_raised_where_a_borrowed_coroutine_awaits_it(loan):
    future = asyncio.get_running_loop().create_future()
    asyncio.get_running_loop().call_soon(future.set_exception, ValueError("no answer"))

    async def body():
        with pytest.raises(ValueError, match="no answer"):
            await future
        return "went on"

    assert (await loan.run(body), loan.was_canceled) == ("went on", False)


@ON_ASYNCIO
async def test_a_canceled_future_does_not_cancel_the_caller(loan):
    future = asyncio.get_running_loop().create_future()
    asyncio.get_running_loop().call_soon(future.cancel)

    async def body():
        with pytest.raises(asyncio.CancelledError):
            await future
        return "went on"

    assert (await loan.run(body), loan.was_canceled) == ("went on", False)


# Canceling the coroutine alone.


@ON_ASYNCIO
@pytest.mark.parametrize("body", ["swallow", "clean_up"])
async def test_canceling_the_coroutine_alone_lets_the_caller_go_on(loan, body):
    loan.cancel_soon()
    value = await loan.run(getattr(loan, body))
    await asyncio.sleep(0)
    assert (value, loan.log[0]) == ({"swallow": "swallowed", "clean_up": "clean"}[body], "canceled")


@ON_ASYNCIO
async def test_canceling_the_coroutine_alone_leaves_no_trace_in_the_task(loan):
    before = me().cancelling()
    loan.cancel_soon()
    await loan.run(loan.swallow)
    assert me().cancelling() == before


@ON_ASYNCIO
async def test_canceling_the_coroutine_alone_is_no_cancellation_of_the_caller(loan):
    loan.cancel_soon()
    await loan.run(loan.swallow)
    assert not loan.was_canceled


@ON_ASYNCIO
async def test_a_cancellation_that_the_coroutine_lets_out_reaches_the_caller_as_it_is(loan):
    loan.cancel_soon()
    with pytest.raises(asyncio.CancelledError):
        await loan.run(loan.wait)
    await asyncio.sleep(0)
    assert me().cancelling() == 0


@ON_ASYNCIO
async def test_a_coroutine_may_be_canceled_twice(loan):
    loan.cancel_soon()

    async def body():
        await loan.swallow()
        loan.cancel_soon()
        return await loan.swallow()

    assert await loan.run(body) == "swallowed"
    assert (loan.log, me().cancelling()) == (["canceled", "canceled"], 0)


@ON_ASYNCIO
async def test_two_cancels_in_one_turn_arrive_as_one(loan):
    loan.cancel_soon()
    loan.cancel_soon()
    assert await loan.run(loan.clean_up) == "clean"
    await asyncio.sleep(0)
    assert me().cancelling() == 0


@ON_ASYNCIO
async def test_a_cancel_in_the_coroutines_own_last_step_does_not_reach_the_caller(loan):
    async def body():
        await asyncio.sleep(0)
        loan.borrowed.cancel()
        return "ended first"

    assert await loan.run(body) == "ended first"
    await asyncio.sleep(0)
    assert me().cancelling() == 0


@ON_ASYNCIO
async def test_canceling_a_coroutine_that_has_ended_does_nothing(loan):
    async def body():
        await asyncio.sleep(0)

    await loan.run(body)
    loan.borrowed.cancel()
    await asyncio.sleep(0)
    assert (me().cancelling(), loan.borrowed.is_caller_canceled) == (0, False)


@ON_ASYNCIO
async def test_a_caller_in_its_own_clean_up_goes_on_after_the_coroutine_was_canceled(loan):
    async def call():
        try:
            await asyncio.sleep(3600)
        finally:
            loan.cancel_soon()
            loan.log.append(await loan.run(loan.swallow))

    task = asyncio.create_task(call())
    await asyncio.sleep(0)
    task.cancel()
    await asyncio.wait([task])
    assert loan.log == ["canceled", "swallowed"]


# Canceling the caller.


@ON_ASYNCIO
@pytest.mark.parametrize("body", ["wait", "swallow", "clean_up"])
async def test_a_canceled_caller_stays_canceled_whatever_the_coroutine_makes_of_it(loan, body):
    async def call():
        cancel_me_soon()
        return await loan.run(getattr(loan, body))

    task = await apart(call)
    assert (task.cancelled(), loan.log[0]) == (True, "canceled")


@ON_ASYNCIO
@pytest.mark.parametrize("body", ["wait", "swallow", "clean_up"])
async def test_at_its_end_a_coroutine_knows_that_its_caller_was_canceled(loan, body):
    async def call():
        cancel_me_soon()
        return await loan.run(getattr(loan, body))

    await apart(call)
    assert loan.was_canceled


@ON_ASYNCIO
async def test_the_clean_up_of_a_coroutine_is_run_to_its_end(loan):
    async def call():
        cancel_me_soon()
        await loan.run(loan.clean_up)

    await apart(call)
    assert loan.log == ["canceled", "cleaned up"]


@ON_ASYNCIO
async def test_a_second_cancellation_of_the_caller_reaches_the_clean_up(loan):
    async def body():
        try:
            await loan.wait()
        finally:
            await loan.wait()

    async def call():
        cancel_me_soon()
        await loan.run(body)

    task = asyncio.create_task(call())
    while not loan.log:
        await asyncio.sleep(0)
    task.cancel()
    await asyncio.wait([task])
    assert (task.cancelled(), loan.log) == (True, ["canceled", "canceled"])


@ON_ASYNCIO
async def test_a_canceled_caller_is_told_even_when_the_coroutine_fails(loan):
    async def body():
        try:
            await asyncio.sleep(3600)
        except asyncio.CancelledError:
            raise ValueError("in the clean-up") from None

    async def call():
        cancel_me_soon()
        await loan.run(body)

    task = await apart(call)
    assert (str(task.exception()), loan.was_canceled) == ("in the clean-up", True)


@ON_ASYNCIO
@pytest.mark.parametrize("order", ["coroutine first", "caller first"])
@pytest.mark.parametrize("body", ["wait", "swallow", "clean_up"])
async def test_both_canceled_at_once_cancels_the_caller(loan, body, order):
    async def call():
        if order == "coroutine first":
            loan.cancel_soon()
        cancel_me_soon()
        if order == "caller first":
            loan.cancel_soon()
        return await loan.run(getattr(loan, body))

    task = await apart(call)
    assert (task.cancelled(), task.cancelling(), loan.was_canceled) == (True, 1, True)


@ON_ASYNCIO
@pytest.mark.parametrize("order", ["coroutine first", "caller first"])
async def test_both_canceled_one_after_the_other_cancels_the_caller(loan, order):
    async def call():
        loan.log.append("begun")
        return await loan.run(loan.clean_up)

    task = asyncio.create_task(call())
    await asyncio.sleep(0)
    cancels = [loan.borrowed.cancel, task.cancel]
    for cancel in cancels if order == "coroutine first" else reversed(cancels):
        cancel()
        await asyncio.sleep(0)
    await asyncio.wait([task])
    assert (task.cancelled(), task.cancelling()) == (True, 1)


@ON_ASYNCIO
async def test_a_cancellation_of_the_caller_in_the_coroutines_last_step_comes_later(loan):
    async def body():
        await asyncio.sleep(0)
        me().cancel()
        return "ended first"

    async def call():
        loan.log.append(await loan.run(body))
        await asyncio.sleep(0)

    task = await apart(call)
    assert (task.cancelled(), loan.log) == (True, ["ended first"])


@ON_ASYNCIO
async def test_both_canceled_in_the_coroutines_last_step_cancels_the_caller(loan):
    async def body():
        await asyncio.sleep(0)
        loan.borrowed.cancel()
        me().cancel()
        return "ended first"

    async def call():
        await loan.run(body)

    task = await apart(call)
    assert (task.cancelled(), task.cancelling()) == (True, 1)


# Timeouts and scopes, around and within.


@ON_ASYNCIO
@pytest.mark.parametrize("body", ["wait", "swallow", "clean_up"])
async def test_a_timeout_around_the_coroutine_times_out(loan, body):
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0):
            await loan.run(getattr(loan, body))
    await asyncio.sleep(0)
    assert me().cancelling() == 0


@ON_ASYNCIO
@pytest.mark.parametrize("body", ["wait", "swallow", "clean_up"])
async def test_a_scope_around_the_coroutine_catches_its_own_cancellation(loan, body):
    with anyio.move_on_after(0) as scope:
        await loan.run(getattr(loan, body))
    await asyncio.sleep(0)
    assert (scope.cancelled_caught, me().cancelling()) == (True, 0)


@ON_ASYNCIO
async def test_canceling_the_coroutine_leaves_a_scope_around_it_alone(loan):
    loan.cancel_soon()
    with anyio.CancelScope() as scope:
        await loan.run(loan.swallow)
        await anyio.lowlevel.checkpoint()
    assert not scope.cancelled_caught


@ON_ASYNCIO
async def test_canceling_the_coroutine_leaves_a_timeout_around_it_alone(loan):
    loan.cancel_soon()
    async with asyncio.timeout(3600):
        await loan.run(loan.swallow)
        await asyncio.sleep(0)


@ON_ASYNCIO
async def test_a_scope_within_the_coroutine_is_its_own_affair(loan):
    async def body():
        with anyio.move_on_after(0) as scope:
            await asyncio.sleep(3600)
        return scope.cancelled_caught

    assert (await loan.run(body), loan.was_canceled) == (True, False)


@ON_ASYNCIO
async def test_a_timeout_within_the_coroutine_is_its_own_affair(loan):
    async def body():
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0):
                await asyncio.sleep(3600)
        return "went on"

    assert (await loan.run(body), loan.was_canceled) == ("went on", False)


@ON_ASYNCIO
@pytest.mark.parametrize("kind", ["anyio", "asyncio"])
async def test_a_task_group_within_the_coroutine_is_its_own_affair(loan, kind):
    async def fail():
        raise ValueError("child")

    async def wait_in_a_group():
        if kind == "anyio":
            async with anyio.create_task_group() as group:
                group.start_soon(fail)
                await asyncio.sleep(3600)
        else:
            async with asyncio.TaskGroup() as native:
                native.create_task(fail())
                await asyncio.sleep(3600)

    async def body():
        with pytest.raises(ExceptionGroup, match="unhandled errors"):
            await wait_in_a_group()
        return "went on"

    assert (await loan.run(body), loan.was_canceled) == ("went on", False)


@ON_ASYNCIO
async def test_a_canceled_caller_is_not_taken_for_a_timeout_within(loan):
    async def body():
        async with asyncio.timeout(3600):
            await loan.wait()

    async def call():
        cancel_me_soon()
        await loan.run(body)

    task = await apart(call)
    assert (task.cancelled(), loan.was_canceled) == (True, True)


@ON_ASYNCIO
async def test_a_canceled_coroutine_is_not_taken_for_a_scope_within(loan):
    async def body():
        with anyio.move_on_after(3600) as scope:
            await loan.swallow()
        return scope.cancelled_caught

    loan.cancel_soon()
    assert await loan.run(body) is False


@ON_ASYNCIO
async def test_a_timeout_within_and_then_a_canceled_caller_cancels_the_caller(loan):
    async def body():
        with anyio.move_on_after(0):
            await asyncio.sleep(3600)
        cancel_me_soon()
        return await loan.swallow()

    task = await apart(lambda: loan.run(body))
    assert (task.cancelled(), loan.was_canceled) == (True, True)


@ON_ASYNCIO
async def test_a_scope_around_catches_its_own_after_a_timeout_within(loan):
    async def body():
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0):
                await asyncio.sleep(3600)
        scope.cancel()
        return await loan.swallow()

    with anyio.CancelScope() as scope:
        await loan.run(body)
    await asyncio.sleep(0)
    assert (scope.cancelled_caught, me().cancelling()) == (True, 0)


# One within another.


@ON_ASYNCIO
async def test_canceling_an_inner_coroutine_leaves_the_outer_one_alone(loan):
    inner = Loan()

    async def body():
        inner.cancel_soon()
        await inner.run(inner.swallow)
        await asyncio.sleep(0)
        return "went on"

    assert await loan.run(body) == "went on"
    assert (loan.was_canceled, inner.was_canceled, inner.log) == (False, False, ["canceled"])


@ON_ASYNCIO
async def test_canceling_an_outer_coroutine_cancels_the_inner_ones_caller(loan):
    inner = Loan()

    async def body():
        await asyncio.sleep(0)
        loan.cancel_soon()
        with pytest.raises(asyncio.CancelledError):
            await inner.run(inner.swallow)
        return "outer went on"

    assert await loan.run(body) == "outer went on"
    assert (inner.was_canceled, loan.was_canceled) == (True, False)


@ON_ASYNCIO
@pytest.mark.parametrize("order", ["inner first", "outer first"])
async def test_canceling_both_of_two_coroutines_leaves_the_caller_alone(loan, order):
    inner = Loan()

    async def body():
        await asyncio.sleep(0)
        for each in (inner, loan) if order == "inner first" else (loan, inner):
            each.cancel_soon()
        with pytest.raises(asyncio.CancelledError):
            await inner.run(inner.swallow)
        return "outer went on"

    assert await loan.run(body) == "outer went on"
    await asyncio.sleep(0)
    assert (inner.was_canceled, loan.was_canceled, me().cancelling()) == (
        True,
        False,
        0,
    )


@ON_ASYNCIO
async def test_canceling_the_caller_of_two_coroutines_cancels_both(loan):
    inner = Loan()

    async def body():
        await asyncio.sleep(0)
        cancel_me_soon()
        await inner.run(inner.swallow)

    task = await apart(lambda: loan.run(body))
    assert (task.cancelled(), inner.was_canceled, loan.was_canceled) == (True, True, True)


# What ends the program.


@ON_ASYNCIO
async def test_closing_the_caller_closes_the_coroutine(loan):
    async def body():
        try:
            await asyncio.sleep(3600)
        finally:
            loan.log.append("closed")

    call = loan.run(body)
    call.send(None)
    call.close()
    assert loan.log == ["closed"]


@ON_ASYNCIO
async def test_closing_the_caller_of_a_canceled_coroutine_takes_the_cancel_back(loan):
    call = loan.run(loan.wait)
    call.send(None)
    loan.borrowed.cancel()
    call.close()
    on_its_way = sys.version_info < (3, 13)  # from then on `Task.uncancel` stops it
    with pytest.raises(asyncio.CancelledError) if on_its_way else nullcontext():
        await asyncio.sleep(0)
    assert me().cancelling() == 0


@ON_ASYNCIO
async def test_an_interrupt_in_a_borrowed_coroutine_passes_through(loan):
    async def body():
        await asyncio.sleep(0)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        await loan.run(body)


@ON_ASYNCIO
async def test_an_interrupt_thrown_in_reaches_the_coroutine(loan):
    async def body():
        try:
            await asyncio.sleep(3600)
        except KeyboardInterrupt:
            loan.log.append("interrupted")
            raise

    call = loan.run(body)
    call.send(None)
    with pytest.raises(KeyboardInterrupt):
        call.throw(KeyboardInterrupt)
    assert loan.log == ["interrupted"]


@ON_ASYNCIO
async def test_a_canceled_caller_leaves_no_cycle_of_references(loan):
    async def call():
        cancel_me_soon()
        await loan.run(loan.swallow)

    await apart(call)
    assert loan.borrowed._thrown is None


# --- what runs in the background ------------------------------------------------------------


async def test_a_background_coroutine_runs_until_it_is_closed():
    log: list[object] = []
    background = Background(wait_forever(log), "the clock")
    await settle()
    assert log == []
    await background.aclose()
    assert log == ["canceled"]


async def test_closing_waits_for_the_end_of_the_clean_up():
    log: list[object] = []

    async def body():
        try:
            await anyio.sleep_forever()
        finally:
            with anyio.CancelScope(shield=True):
                await anyio.lowlevel.checkpoint()
            log.append("cleaned up")

    background = Background(body(), "the clock")
    await settle()
    await background.aclose()
    assert log == ["cleaned up"]


async def test_closing_waits_even_where_the_closer_is_canceled():
    log: list[object] = []
    background = Background(wait_forever(log), "the clock")
    await settle()
    with anyio.CancelScope() as scope:
        scope.cancel()
        await background.aclose()
    assert log == ["canceled"]


async def test_closing_twice_is_closing_once():
    background = Background(wait_forever([]), "the clock")
    await background.aclose()
    await background.aclose()


async def test_closing_what_has_ended_returns_at_once():
    background = Background(note([], ""), "the clock")
    await settle()
    await background.aclose()


async def test_a_background_coroutine_that_fails_is_logged(caplog):
    async def body():
        raise ValueError("the battery is flat")

    background = Background(body(), "the clock")
    await settle()
    await background.aclose()
    record = caplog.records[0]
    assert (record.name, record.levelno, record.getMessage()) == (
        "turtleact",
        logging.ERROR,
        "the clock has failed",
    )
    assert "the battery is flat" in str(record.exc_info)


async def test_a_background_coroutine_that_is_closed_is_not_logged(caplog):
    background = Background(wait_forever([]), "the clock")
    await background.aclose()
    assert not caplog.records


@ON_ASYNCIO
async def test_nothing_is_left_running_after_a_close():
    before = other_tasks()
    background = Background(wait_forever([]), "the clock")
    await background.aclose()
    await settle()
    assert other_tasks() == before
