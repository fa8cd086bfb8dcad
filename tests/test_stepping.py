"""A coroutine that is run step by step behaves as one that is awaited; it is told if it blocks."""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress
from contextvars import ContextVar, copy_context
from functools import partial
from types import coroutine
from typing import Any

import anyio
import anyio.lowlevel
import pytest

from turtleact import GoalStatus, Outcome
from turtleact.errors import Abort, GoalAborted, GoalCanceled
from turtleact.goal import Goal
from turtleact.server.stepping import BLOCKING, Borrowed, Owned
from turtleact.tasks import current_tasks

from .lab import ON_ASYNCIO, feedback, goal, lab, result, running, settle, take_turns

LONG = BLOCKING + 1.0


class Time:
    """Time as those see it who measure steps; blocking makes it pass."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now

    def block(self, seconds: float = LONG) -> None:
        """What a long computation does."""
        self.now += seconds


@pytest.fixture
def time(monkeypatch) -> Time:
    made = Time()
    for module in ("stepping", "action_server"):
        monkeypatch.setattr(f"turtleact.server.{module}.monotonic", made)
    return made


def never(seconds: float) -> None:
    pytest.fail(f"reported {seconds} s")


@coroutine
def give(value):
    """Wait for something, as the event loop sees it; answers what it is sent."""
    return (yield value)


GOAL = Goal(goal(), 0)
NOBODY_ASKS: Any = None
"""The tasks of what is not canceled."""


class Reporter:
    """Hands on how long steps took."""

    def __init__(self, on_slow) -> None:
        self._on_slow = on_slow

    def report_blocking(self, goal: Goal, seconds: float) -> None:
        assert goal is GOAL
        self._on_slow(seconds)

    def mark_canceling(self, goal: Goal) -> None:
        raise AssertionError(f"no scope has canceled {goal}")


async def step_by_step(body, on_slow=never):
    """Run a coroutine as a goal's task does."""
    owned = Owned(GOAL, Reporter(on_slow), NOBODY_ASKS)
    owned.body = body()
    return await owned


# --- step by step -----------------------------------------------------------------------------


def drive(steps, *sent):
    """What a coroutine waits for at each step, and what it returns."""
    waits = []
    try:
        waits.append(steps.send(None))
        for value in sent:
            waits.append(steps.throw(value) if isinstance(value, Exception) else steps.send(value))
    except StopIteration as end:
        return waits, end.value
    return waits, None


def test_what_a_coroutine_waits_for_and_is_answered_passes_through():
    async def body():
        return [await give("a"), await give("b")]

    assert drive(step_by_step(body), 1, 2) == (["a", "b"], [1, 2])


def test_an_exception_that_is_thrown_in_reaches_the_coroutine():
    async def body():
        with pytest.raises(ValueError, match="mine"):
            await give("a")
        return await give("b")

    assert drive(step_by_step(body), ValueError("mine"), 2) == (["a", "b"], 2)


@pytest.mark.parametrize("waits", [False, True])
def test_an_exception_of_the_coroutine_comes_out(waits):
    async def body():
        if waits:
            await give("a")
        raise ValueError("mine")

    with pytest.raises(ValueError, match="mine"):
        drive(step_by_step(body), 1)


def test_closing_closes_the_coroutine():
    log = []

    async def body():
        try:
            await give("a")
        finally:
            log.append("closed")

    inner = body()
    steps = step_by_step(lambda: inner)
    steps.send(None)
    steps.close()
    assert log == ["closed"]


@pytest.mark.parametrize("where", ["first step", "second step", "after an exception"])
def test_a_step_that_takes_long_is_reported(time, where):
    slow: list[float] = []

    async def body():
        if where == "first step":
            time.block()
        with suppress(ValueError):
            await give("a")
        if where != "first step":
            time.block()
        await give("b")

    drive(step_by_step(body, slow.append), ValueError() if "exception" in where else 1)
    assert slow == [LONG]


@pytest.mark.parametrize("how", ["returns", "raises"])
@pytest.mark.parametrize("waits", [False, True])
def test_the_last_step_is_reported_too(time, how, waits):
    slow: list[float] = []

    async def body():
        if waits:
            await give("a")
        time.block()
        if how == "raises":
            raise ValueError

    with suppress(ValueError):
        drive(step_by_step(body, slow.append), 1)
    assert slow == [LONG]


def test_each_step_is_reported_by_itself(time):
    slow: list[float] = []

    async def body():
        for seconds in (1.0, 0.1, 2.0):
            time.block(seconds)
            await give(seconds)

    drive(step_by_step(body, slow.append), 1, 2, 3)
    assert slow == [1.0, 2.0]


@pytest.mark.parametrize(("seconds", "reports"), [(BLOCKING, 0), (BLOCKING + 0.01, 1)])
def test_only_what_takes_longer_than_half_a_second_blocks(time, seconds, reports):
    slow: list[float] = []

    async def body():
        time.now = 0.0
        await give("a")
        time.block(seconds)

    drive(step_by_step(body, slow.append), 1)
    assert (BLOCKING, len(slow)) == (0.5, reports)


def test_waiting_is_not_blocking(time):
    async def body():
        await give("a")
        await give("b")

    steps = step_by_step(body)
    steps.send(None)
    time.block(1000)
    steps.send(None)
    time.block(1000)
    with pytest.raises(StopIteration):
        steps.send(None)


def test_a_wait_that_is_closed_is_not_blocking(time):
    async def body():
        await give("a")

    steps = step_by_step(body)
    steps.send(None)
    time.block(1000)
    steps.close()


# --- in the caller's task ---------------------------------------------------------------------

WHO: ContextVar[str] = ContextVar("WHO", default="nobody")


async def lend(body, on_slow=never, made=None):
    """Run a coroutine in this very task, as a client does that awaits a goal."""
    context = copy_context()
    running = body()
    waits_for = context.run(running.send, None)
    borrowed = Borrowed(context, GOAL, Reporter(on_slow), current_tasks(), None)
    if made is not None:
        made(borrowed)
    return await borrowed.go_on(running, waits_for)


def pending_cancellations() -> int:
    task = asyncio.current_task()
    assert task is not None
    return task.cancelling()


@ON_ASYNCIO
async def test_a_borrowed_coroutine_gives_its_value():
    async def body():
        await asyncio.sleep(0)
        return 7

    assert await lend(body) == 7


@ON_ASYNCIO
async def test_an_exception_of_a_borrowed_coroutine_comes_out():
    async def body():
        await asyncio.sleep(0)
        raise ValueError("mine")

    with pytest.raises(ValueError, match="mine"):
        await lend(body)


@ON_ASYNCIO
async def test_what_a_borrowed_coroutine_sets_stays_with_it():
    seen = []

    async def body():
        WHO.set("body")
        for _ in range(3):
            await asyncio.sleep(0)
            seen.append(WHO.get())

    await lend(body)
    assert (seen, WHO.get()) == (["body"] * 3, "nobody")


@ON_ASYNCIO
async def test_a_cancel_reaches_the_borrowed_coroutine_alone():
    log = []

    async def body():
        asyncio.get_running_loop().call_soon(lambda: borrowed[0].cancel())
        try:
            await asyncio.sleep(60)
        except asyncio.CancelledError:
            log.append("canceled")
        return 7

    borrowed: list[Borrowed] = []
    assert await lend(body, made=borrowed.append) == 7
    await asyncio.sleep(0)
    assert log == ["canceled"]
    assert pending_cancellations() == 0


@ON_ASYNCIO
async def test_a_cancel_that_comes_with_the_end_is_taken_back():
    async def body():
        await asyncio.sleep(0)
        borrowed[0].cancel()
        return 7

    borrowed: list[Borrowed] = []
    assert await lend(body, made=borrowed.append) == 7
    await asyncio.sleep(0)
    assert pending_cancellations() == 0


@ON_ASYNCIO
async def test_a_cancel_after_the_end_does_nothing():
    async def body():
        await asyncio.sleep(0)

    borrowed: list[Borrowed] = []
    await lend(body, made=borrowed.append)
    borrowed[0].cancel()
    await asyncio.sleep(0)
    assert (pending_cancellations(), borrowed[0].is_caller_canceled) == (0, False)


@ON_ASYNCIO
async def test_a_cancellation_of_the_caller_is_raised_whatever_the_coroutine_makes_of_it():
    log = []

    async def body():
        try:
            await asyncio.sleep(60)
        except asyncio.CancelledError:
            log.append(borrowed[0].is_caller_canceled)
        return 7

    borrowed: list[Borrowed] = []
    task = asyncio.create_task(lend(body, made=borrowed.append))
    await take_turns()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert log == [True]


@ON_ASYNCIO
async def test_closing_the_caller_closes_the_borrowed_coroutine():
    log = []

    async def body():
        try:
            await give(None)
        finally:
            log.append(WHO.get())

    WHO.set("me")
    lending = lend(body)
    lending.send(None)
    lending.close()
    assert log == ["me"]


@ON_ASYNCIO
@pytest.mark.parametrize("how", ["goes on", "returns", "raises"])
async def test_a_step_of_a_borrowed_coroutine_that_takes_long_is_reported(time, how):
    slow: list[float] = []

    async def body():
        await asyncio.sleep(0)
        time.block()
        if how == "goes on":
            await asyncio.sleep(0)
        if how == "raises":
            raise ValueError

    with suppress(ValueError):
        await lend(body, slow.append)
    assert slow == [LONG]


@ON_ASYNCIO
async def test_a_step_of_a_borrowed_coroutine_behind_an_exception_is_reported(time):
    slow: list[float] = []
    failed = asyncio.get_running_loop().create_future()
    failed.set_exception(ValueError())

    async def body():
        await asyncio.sleep(0)
        with suppress(ValueError):
            await failed
        time.block()
        await asyncio.sleep(0)

    await lend(body, slow.append)
    assert slow == [LONG]


@ON_ASYNCIO
async def test_a_wait_of_a_borrowed_coroutine_is_not_blocking(time):
    async def body():
        for _ in range(3):
            asyncio.get_running_loop().call_soon(time.block, 1000)
            await asyncio.sleep(0)
        return 7

    assert await lend(body) == 7


@ON_ASYNCIO
async def test_a_wait_of_a_borrowed_coroutine_that_is_closed_is_not_blocking(time):
    async def body():
        await give(None)
        await give(None)

    lending = lend(body)
    lending.send(None)
    lending.send(None)
    time.block(1000)
    lending.close()


# --- bodies that block ------------------------------------------------------------------------


async def awaited(served):
    with suppress(GoalAborted, GoalCanceled):
        await served.client.send_goal(goal(), goal_id=bytes(16 * [7]))


async def entered(served):
    async with served.client.send_goal(goal(), goal_id=bytes(16 * [7])) as handle:
        await handle.outcome()


@pytest.fixture(params=[awaited, entered])
def send(request):
    return request.param


STYLES = pytest.mark.parametrize("style", ["coroutine", "generator"])


def body_of(style, act):
    """A body that acts between two waits, and ends."""

    async def coroutine(request):
        await anyio.lowlevel.checkpoint()
        await act()
        return result(1)

    async def generator(request):
        yield feedback(0)
        await anyio.lowlevel.checkpoint()
        await act()
        yield feedback(1)
        yield result(1)

    return coroutine if style == "coroutine" else generator


async def block_and_go_on(time):
    time.block()
    await anyio.lowlevel.checkpoint()


async def block_and_end(time):
    time.block()


async def block_and_raise(time):
    time.block()
    raise ValueError("mine")


async def block_and_abort(time):
    time.block()
    raise Abort("mine")


def warnings_of(caplog):
    return [
        record.getMessage()
        for record in caplog.records
        if record.levelno == logging.WARNING and record.name == "turtleact.server"
    ]


@STYLES
@pytest.mark.parametrize("act", [block_and_go_on, block_and_end, block_and_raise, block_and_abort])
async def test_a_body_that_blocks_is_warned_of(style, act, send, time, caplog):
    async with lab(body_of(style, partial(act, time))) as served:
        await send(served)
    (warning,) = warnings_of(caplog)
    assert warning == (
        f"a step of the body of /count took {LONG:.1f} s (goal {'07' * 16}): nothing else could run"
        " meanwhile; unless the process was stopped, await what waits, and move long work to"
        " anyio.to_thread.run_sync"
    )


async def block_twice(time):
    time.block(1.0)
    await anyio.lowlevel.checkpoint()
    time.block(2.0)
    await anyio.lowlevel.checkpoint()


@STYLES
async def test_each_time_that_a_body_blocks_is_warned_of(style, send, time, caplog):
    async with lab(body_of(style, partial(block_twice, time))) as served:
        await send(served)
    assert [warning.split(" took ")[1][:5] for warning in warnings_of(caplog)] == ["1.0 s", "2.0 s"]


@pytest.mark.parametrize("how", ["ends", "raises", "waits"])
async def test_a_body_that_blocks_in_its_first_step_is_warned_of(how, send, time, caplog):
    async def body(request):
        time.block()
        if how == "raises":
            raise ValueError
        if how == "waits":
            await anyio.lowlevel.checkpoint()
        return result(1)

    async with lab(body) as served:
        await send(served)
    assert len(warnings_of(caplog)) == 1


async def wait_long(time):
    async def others():
        for _ in range(3):
            time.block(1000)
            await anyio.lowlevel.checkpoint()

    async with anyio.create_task_group() as group:
        group.start_soon(others)
        await anyio.lowlevel.checkpoint()


async def work_little(time):
    for _ in range(10):
        time.block(0.1)
        await anyio.lowlevel.checkpoint()


@STYLES
@pytest.mark.parametrize("act", [wait_long, work_little])
async def test_a_body_that_waits_long_is_not_warned_of(style, act, send, time, caplog):
    async with lab(body_of(style, partial(act, time))) as served:
        await send(served)
    assert warnings_of(caplog) == []


async def test_a_body_that_is_canceled_after_a_long_wait_is_not_warned_of(send, time, caplog):
    async def body(request):
        await anyio.sleep_forever()

    async with lab(body) as served, running(lambda: send(served)):
        time.block(1000)
        await served.client.cancel_all()
    assert warnings_of(caplog) == []


async def test_a_body_that_blocks_in_its_clean_up_is_warned_of(send, time, caplog):
    async def body(request):
        try:
            await anyio.sleep_forever()
        finally:
            time.block()

    async with lab(body) as served, running(lambda: send(served)):
        time.block(1000)
        await served.client.cancel_all()
    assert len(warnings_of(caplog)) == 1


async def test_a_goal_without_an_id_is_warned_of_all_the_same(time, caplog):
    async def body(request):
        await anyio.lowlevel.checkpoint()
        time.block()
        return result(1)

    async with lab(body) as served:
        await served.client.send_goal(goal())
    assert "(goal (no id))" in warnings_of(caplog)[0]


async def test_a_body_that_blocks_ends_as_it_would_have(time):
    async def body(request):
        await anyio.lowlevel.checkpoint()
        time.block()
        return result(1)

    async with lab(body) as served, served.client.send_goal(goal()) as handle:
        await settle()
        assert await handle.outcome() == Outcome(GoalStatus.SUCCEEDED, result(1))
