"""What is kept of a goal's feedback, whom a body waits for, and for how long."""

from __future__ import annotations

import gc
from collections.abc import AsyncIterator, Callable

import anyio
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact import GoalStatus
from turtleact.goals.running import BURST
from turtleact.goals.state import FeedbackLog

from ..lab import Count, Gate, feedback, goal, lab, result, running, settle

KEPT = FeedbackLog.KEPT
BUDGET = FeedbackLog.BUDGET
MANY = 5 * KEPT

LARGE = feedback(*[1 << 30] * 20_000)
LARGE_SIZE = 100_000
"""What `LARGE` takes in a compact encoding, to the nearest thousand (bytes)."""


def log_of(count: int) -> FeedbackLog:
    log = FeedbackLog(is_kept=True)
    for number in range(count):
        log.append(number)
    return log


# --- what is kept -----------------------------------------------------------------------------


@given(st.lists(st.sampled_from(["append", "trim"]), max_size=50), st.integers(0, 4 * KEPT))
def test_what_is_kept_is_a_run_that_ends_with_the_newest(steps: list[str], before: int):
    log = log_of(before)
    for step in steps:
        if step == "append":
            log.append(log.count)
        else:
            log.trim()
    assert log.items == list(range(log.dropped, log.count))


def test_a_reader_far_behind_does_not_make_each_message_dear():
    log = FeedbackLog(is_kept=True)
    log.read = 0
    log.items += range(50 * KEPT)
    moves = 0
    for _ in range(10 * KEPT):
        before = log.dropped
        log.append(None)
        log.read += 1
        moves += log.dropped != before
    assert moves < 20


# --- who is waited for ------------------------------------------------------------------------


@pytest.mark.parametrize("period", [1, 2, 3, 5, 8, 16])
@pytest.mark.parametrize("phase", [0, 1])
def test_large_messages_among_small_ones_are_found(period: int, phase: int):
    log = FeedbackLog(is_kept=True)
    log.read = 0
    for number in range(2 * BURST * BURST):
        log.append(LARGE if number % period == phase % period else feedback(1))
        if log.count % BURST == 0:
            log.weigh()
    assert log.is_full


def test_one_large_message_is_forgotten_in_time():
    log = FeedbackLog(is_kept=True)
    log.append(LARGE)
    log.read = 0
    log.weigh()
    for number in range(20 * BURST):
        log.append(feedback(number))
        if number % 2:
            log.weigh()
    log.read = 0
    assert not log.is_full


# --- a body and its readers -------------------------------------------------------------------


class Source:
    """A generator body that yields one message as fast as it is let, and counts."""

    def __init__(self, make: Callable[[int], object] = feedback, upto: int = MANY) -> None:
        self.published = 0
        self._make = make
        self._upto = upto

    async def stream(self, goal: Count.Goal) -> AsyncIterator[object]:
        for number in range(self._upto):
            self.published += 1
            yield self._make(number)
        yield result(self._upto)

    async def settle(self) -> int:
        """Let it run until it is held up, or has ended; answer how far it has come."""
        while True:
            before = self.published
            await settle()
            if self.published == before:
                return before


def large(number: int) -> object:
    return LARGE


@pytest.mark.parametrize(
    ("make", "upto", "size", "budget", "head_start"),
    [(feedback, MANY, 1, KEPT, BURST), (large, 200, LARGE_SIZE, BUDGET, 2 * BURST * LARGE_SIZE)],
    ids=["small", "large"],
)
async def test_unread_messages_hold_the_body_up_by_their_number_or_bytes(
    make, upto, size, budget, head_start
):
    source = Source(make, upto)
    async with lab(source.stream) as served, served.client.send_goal(goal()) as handle:
        reading = aiter(handle)
        assert budget <= await source.settle() * size < budget + head_start
        del reading


@pytest.mark.parametrize("make", [feedback, large])
async def test_who_waits_for_the_result_besides_reading_is_not_held_up(make):
    upto = 2 * KEPT if make is feedback else 50
    source = Source(make, upto)
    async with lab(source.stream) as served, served.client.send_goal(goal()) as handle:
        reading = aiter(handle)
        assert await source.settle() < upto
        assert await handle.result() == result(upto)
        assert len([message async for message in reading]) == upto
        assert handle.missed == 0


async def test_a_body_is_held_up_again_once_nobody_waits_for_the_result_any_more():
    gate, source = Gate(), Source()

    async def body(request):
        yield feedback(0)
        await gate.opened.wait()
        for number in range(MANY):
            source.published += 1
            yield feedback(number)

    async with lab(body) as served, served.client.send_goal(goal()) as handle:
        reading = aiter(handle)
        async with running(handle.result) as waiter:
            waiter.scope.cancel()
        gate.opened.set()
        assert await source.settle() < KEPT + BURST
        del reading


async def test_a_body_that_is_held_up_is_canceled_when_the_block_is_left():
    source = Source()
    async with lab(source.stream) as served:
        async with served.client.send_goal(goal()) as handle:
            reading = aiter(handle)
            await source.settle()
        assert handle.status is GoalStatus.CANCELED
        del reading


# --- readers that are left --------------------------------------------------------------------


def feedback_of(handle):
    return aiter(handle)


def events_of(handle):
    return handle.events()


READERS = pytest.mark.parametrize("read", [feedback_of, events_of])


async def broken_off(reading, source):
    async for _ in reading:
        if await source.settle():
            break


async def failed(reading, source):
    async def fail():
        async for _ in reading:
            await source.settle()
            raise ValueError("mine")

    with pytest.raises(ValueError, match="mine"):
        await fail()


async def canceled(reading, source):
    with anyio.CancelScope() as scope:
        async for _ in reading:
            await source.settle()
            scope.cancel()
            await anyio.sleep_forever()


async def wrapped(reading, source):
    async def inner():
        async for item in reading:
            yield item

    outer = inner()
    await anext(outer)
    await source.settle()
    await outer.aclose()


async def closed_over(reading, source):
    holder: list[object] = [reading]
    holder.append(holder)
    await anext(reading)
    await source.settle()


WAYS = pytest.mark.parametrize("leave", [broken_off, failed, canceled, wrapped, closed_over])


@READERS
@WAYS
async def test_a_body_goes_on_however_its_reader_is_left(read, leave):
    source = Source()
    async with lab(source.stream) as served, served.client.send_goal(goal()) as handle:
        await leave(read(handle), source)
        assert leave is not closed_over or gc.collect()
        await source.settle()
        assert handle.done


@READERS
async def test_a_body_goes_on_after_the_block_of_a_detached_goal_although_it_may_be_read(read):
    source = Source()
    async with lab(source.stream) as served:
        async with served.client.send_goal(goal()) as handle:
            handle.detach()
            reading = read(handle)
            assert await source.settle() < MANY
        await source.settle()
        assert handle.done
        del reading


@READERS
async def test_a_reader_that_is_left_late_does_not_disturb_one_begun_since(read):
    source = Source()
    async with lab(source.stream) as served, served.client.send_goal(goal()) as handle:
        first = read(handle)
        await anext(first)
        second = aiter(handle)
        del first
        assert await source.settle() < KEPT + 2 * BURST
        rest = [message.so_far[0] async for message in second]
        assert (rest[-1], handle.missed) == (MANY - 1, 0)
        assert rest == list(range(MANY - len(rest), MANY))


@READERS
async def test_of_two_readers_the_last_one_to_be_left_lets_the_body_go_on(read):
    source = Source()
    async with lab(source.stream) as served, served.client.send_goal(goal()) as handle:
        first, second = read(handle), read(handle)
        await source.settle()
        del first
        assert await source.settle() < MANY
        del second
        await source.settle()
        assert handle.done


@READERS
async def test_a_body_goes_on_although_its_reader_is_collected_in_another_thread(read):
    source = Source()
    gc.disable()
    try:
        async with lab(source.stream) as served, served.client.send_goal(goal()) as handle:
            holder: list[object] = [read(handle)]
            holder.append(holder)
            assert await source.settle() < MANY
            del holder
            await anyio.to_thread.run_sync(gc.collect)
            await source.settle()
            assert handle.done
    finally:
        gc.enable()
