"""Wall time, a factor of it, and virtual time."""

from __future__ import annotations

import math
import time

import anyio
import anyio.lowlevel
import pytest

from turtleact.errors import SimError
from turtleact.tasks import Background, wait_until_idle
from turtleact.tasks.clock import (
    EPOCH,
    FASTEST,
    LEEWAY,
    ScaledClock,
    VirtualClock,
    WallClock,
    make_clock,
)

from ..lab import ON_A_LOOP_THAT_TELLS, running, settle

SECOND = 1_000_000_000


class HandTime:
    """The two clocks of the ``time`` module, set by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.seconds = 100.0
        self.set_by = 0
        monkeypatch.setattr(time, "monotonic", lambda: self.seconds)
        monkeypatch.setattr(time, "time_ns", self.time_ns)

    def time_ns(self) -> int:
        return round((5_000 + self.set_by + self.seconds) * SECOND)


@pytest.fixture
def wall(monkeypatch):
    return HandTime(monkeypatch)


# --- wall time and its factors --------------------------------------------------------------


@pytest.mark.parametrize("factor", [0.5, 1.0, 20.0])
def test_a_scaled_clock_begins_at_the_time_of_the_wall_and_runs_so_many_times_as_fast(wall, factor):
    clock = ScaledClock(factor)
    assert clock.now() == time.time_ns()
    wall.seconds += 3
    assert (clock.time(), clock.now()) == (3 * factor, (5_100 + 3 * factor) * SECOND)


def test_a_wall_clock_tells_the_time_of_the_wall_also_when_that_is_set(wall, monkeypatch):
    clock = WallClock()
    wall.seconds += 2
    assert (clock.time(), clock.now()) == (2.0, 5_102 * SECOND)
    monkeypatch.setattr(wall, "set_by", 3600)
    assert (clock.time(), clock.now()) == (2.0, 8_702 * SECOND)


def test_a_scaled_clock_is_not_misled_when_the_wall_is_set(wall, monkeypatch):
    clock = ScaledClock(2)
    monkeypatch.setattr(wall, "set_by", 3600)
    assert clock.now() == 5_100 * SECOND


def test_a_scaled_clock_has_a_highest_speed():
    assert ScaledClock(FASTEST).factor == FASTEST
    with pytest.raises(SimError, match=r"speed is 100 at most, not 100\.1; 'max' has no limit"):
        ScaledClock(FASTEST + 0.1)


@pytest.mark.parametrize(
    ("factor", "seconds", "slept"), [(1, 2, 2), (4, 2, 0.5), (4, 0, 0), (4, -1, 0)]
)
async def test_a_scaled_clock_sleeps_its_own_seconds(monkeypatch, factor, seconds, slept):
    asked: list[float] = []

    async def sleep(wall_seconds: float) -> None:
        asked.append(wall_seconds)

    clock = ScaledClock(factor)
    monkeypatch.setattr(anyio, "sleep", sleep)
    await clock.sleep(seconds)
    assert asked == [slept]


async def test_a_scaled_clock_sleeps_until_a_moment(monkeypatch):
    asked: list[float] = []

    async def sleep(wall_seconds: float) -> None:
        asked.append(wall_seconds)

    wall = HandTime(monkeypatch)
    clock = ScaledClock(4)
    monkeypatch.setattr(anyio, "sleep", sleep)
    await clock.sleep_until(8)
    wall.seconds += 3
    await clock.sleep_until(8)
    assert asked == [2, 0]


class HandSleep:
    """What a clock sleeps, ended by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked: list[float] = []
        self.ends: list[anyio.Event] = []
        monkeypatch.setattr(anyio, "sleep", self.sleep)

    async def sleep(self, seconds: float) -> None:
        self.asked.append(seconds)
        self.ends.append(anyio.Event())
        await self.ends[-1].wait()


async def test_a_scaled_clock_waits_for_a_sleeper_that_is_late(wall, monkeypatch):
    clock, sleeps = ScaledClock(10), HandSleep(monkeypatch)
    async with running(lambda: clock.sleep(1)):
        for _ in range(2):
            wall.seconds += 5
            assert clock.time() == pytest.approx(1 + LEEWAY)
        sleeps.ends[0].set()
    await settle()
    wall.seconds += 2
    assert clock.time() == pytest.approx(1 + LEEWAY + 20)


async def test_a_scaled_clock_waits_for_a_sleeper_that_catches_up(wall, monkeypatch):
    clock, sleeps = ScaledClock(10), HandSleep(monkeypatch)
    wall.seconds += 1
    async with running(lambda: clock.sleep_until(9.99)), running(lambda: clock.sleep_until(1)):
        for _ in range(2):
            wall.seconds += 5
            assert clock.time() == pytest.approx(10)
        sleeps.ends[1].set()
        await settle()
        wall.seconds += 5
        assert clock.time() == pytest.approx(9.99 + LEEWAY)
        sleeps.ends[0].set()


async def test_what_a_late_sleeper_took_nobody_else_has_slept(wall, monkeypatch):
    clock, sleeps = ScaledClock(10), HandSleep(monkeypatch)
    async with running(lambda: clock.sleep(1)), running(lambda: clock.sleep(3)):
        wall.seconds += 5
        sleeps.ends[0].set()
        await settle()
        sleeps.ends[1].set()
        await settle()
        assert sleeps.asked == pytest.approx([0.1, 0.3, 0.2 - LEEWAY / 10])
        wall.seconds += 0.2
        sleeps.ends[2].set()


async def test_a_sleeper_that_was_canceled_holds_no_clock_up(wall, monkeypatch):
    clock, _ = ScaledClock(10), HandSleep(monkeypatch)
    async with running(lambda: clock.sleep(1)) as sleeping:
        sleeping.scope.cancel()
    wall.seconds += 5
    assert clock.time() == 50


async def test_a_wall_clock_waits_for_nobody(wall, monkeypatch):
    clock, sleeps = WallClock(), HandSleep(monkeypatch)
    async with running(lambda: clock.sleep(1)):
        wall.seconds += 5
        assert clock.time() == 5
        sleeps.ends[0].set()


@pytest.mark.parametrize("make", [WallClock, VirtualClock])
@pytest.mark.parametrize("seconds", [0, -1])
async def test_sleeping_no_time_lets_others_run(make, seconds):
    clock, turns = make(), []

    async def take() -> None:
        turns.append("other")

    async with anyio.create_task_group() as group:
        group.start_soon(take)
        for _ in range(3):
            await clock.sleep(seconds)
        assert turns == ["other"]


@pytest.mark.parametrize("make", [WallClock, VirtualClock])
async def test_sleeping_no_time_can_be_canceled(make):
    clock = make()
    with anyio.CancelScope() as scope:
        scope.cancel()
        await clock.sleep(0)
    assert scope.cancelled_caught


# --- a clock that stands ---------------------------------------------------------------------


@pytest.mark.parametrize("factor", [0.5, 1.0, 20.0])
def test_a_clock_that_was_stopped_stands(wall, factor):
    clock = ScaledClock(factor)
    wall.seconds += 3
    clock.stop_at(clock.time())
    wall.seconds += 7
    assert (clock.time(), clock.now()) == (3 * factor, 5_100 * SECOND + 3 * factor * SECOND)


def test_a_clock_comes_as_far_as_it_may_and_goes_on_from_there(wall):
    clock = ScaledClock(2)
    clock.stop_at(3)
    wall.seconds += 1
    assert clock.time() == 2
    wall.seconds += 10
    clock.stop_at(math.inf)
    assert clock.time() == 3
    wall.seconds += 1
    assert clock.time() == 5


def test_a_wall_clock_that_has_stood_is_behind_the_wall_by_as_much(wall):
    clock = WallClock()
    wall.seconds += 2
    clock.stop_at(clock.time())
    wall.seconds += 5
    assert clock.now() == 5_102 * SECOND
    clock.stop_at(math.inf)
    wall.seconds += 1
    assert clock.now() == 5_103 * SECOND


@pytest.mark.parametrize("make", [WallClock, ScaledClock])
async def test_whoever_sleeps_has_not_slept_while_the_clock_stood(wall, monkeypatch, make):
    clock, sleeps = make(), HandSleep(monkeypatch)
    async with running(lambda: clock.sleep(3)) as sleeper:
        wall.seconds += 1
        clock.stop_at(clock.time())
        wall.seconds += 2
        sleeps.ends[0].set()
        await settle()
        wall.seconds += 5
        assert sleeps.asked == [3.0]
        clock.stop_at(math.inf)
        await settle()
        assert sleeps.asked == [3.0, 2.0]
        wall.seconds += 2
        sleeps.ends[1].set()
        await sleeper.done.wait()
        assert clock.time() == 3


@pytest.mark.parametrize("make", [WallClock, ScaledClock])
async def test_whoever_lies_down_while_the_clock_stands_sleeps_once_it_goes_on(
    wall, monkeypatch, make
):
    clock, sleeps = make(), HandSleep(monkeypatch)
    clock.stop_at(clock.time())
    async with running(lambda: clock.sleep_until(2)) as sleeper:
        wall.seconds += 5
        assert sleeps.asked == []
        clock.stop_at(1)  # not yet
        await settle()
        assert sleeps.asked == []
        clock.stop_at(math.inf)
        await settle()
        assert sleeps.asked == [2.0]
        wall.seconds += 2
        sleeps.ends[0].set()
        await sleeper.done.wait()


@pytest.mark.parametrize("make", [WallClock, ScaledClock])
async def test_whoever_sleeps_until_the_clock_stops_wakes_then(wall, monkeypatch, make):
    clock, sleeps = make(), HandSleep(monkeypatch)
    clock.stop_at(0.1)
    async with running(lambda: clock.sleep_until(0.1)) as sleeper:
        wall.seconds += 5
        sleeps.ends[0].set()
        await sleeper.done.wait()
        assert (clock.time(), sleeps.asked) == (0.1, [0.1])


# --- choosing a clock -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("speed", "kind", "factor"),
    [
        (1, WallClock, 1.0),
        (1.0, WallClock, 1.0),
        ("1", WallClock, 1.0),
        (2, ScaledClock, 2.0),
        ("0.5", ScaledClock, 0.5),
        ("max", VirtualClock, None),
    ],
)
def test_a_speed_chooses_a_clock(speed, kind, factor):
    clock = make_clock(speed)
    assert (type(clock), getattr(clock, "factor", None)) == (kind, factor)


NO_NUMBER = "a speed is a number above zero or 'max'"


@pytest.mark.parametrize(
    ("speed", "said"),
    [
        *((each, "must be a number above zero, not") for each in (0, -1, math.nan, math.inf)),
        *((each, "must be a number above zero, not") for each in ("0", "-2", "nan", "inf")),
        *((each, f"{NO_NUMBER}, not '{each}'") for each in ("fast", "", "MAX", "1x")),
        *((each, NO_NUMBER) for each in (None, [], object(), 10**400)),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_is_no_speed_is_refused(speed, said):
    with pytest.raises(SimError, match=said):
        make_clock(speed)


# --- virtual time ---------------------------------------------------------------------------


@pytest.fixture
async def clock(anyio_backend):
    """A virtual clock that is driven."""
    clock = VirtualClock()
    driver = Background(clock.run(), "the clock")
    yield clock
    await driver.aclose()


async def test_virtual_time_leaps_to_the_next_deadline(clock):
    await clock.sleep(3600)
    assert (clock.time(), clock.now()) == (3600.0, EPOCH + 3600 * SECOND)


async def test_virtual_time_stands_still_until_somebody_drives_it():
    clock = VirtualClock()
    async with running(lambda: clock.sleep(1)) as sleeper:
        assert (sleeper.done.is_set(), clock.time()) == (False, 0)
        async with running(clock.run) as driver:
            await sleeper.done.wait()
            driver.scope.cancel()
        assert clock.time() == 1


async def test_virtual_time_leaps_to_no_deadline_behind_the_moment_of_its_stop(clock):
    clock.stop_at(1)
    async with running(lambda: clock.sleep(1)) as one, running(lambda: clock.sleep(1.1)) as other:
        await one.done.wait()
        await wait_until_idle()
        assert (other.done.is_set(), clock.time()) == (False, 1)
        clock.stop_at(math.inf)
        await other.done.wait()
        assert clock.time() == 1.1


async def test_virtual_time_stands_still_while_anything_can_run(clock):
    async with running(lambda: clock.sleep(1)) as sleeper:
        for _ in range(100):
            await anyio.lowlevel.checkpoint()
            assert clock.time() == 0
        await sleeper.done.wait()
        assert clock.time() == 1


async def lie_down(group: anyio.abc.TaskGroup, clock: VirtualClock, seconds: float, wake) -> None:
    """Start a task that sleeps and then calls ``wake``; it lies before this returns."""

    lying = anyio.Event()

    async def sleep() -> None:
        lying.set()  # whoever waits for that runs only once this task waits itself
        await clock.sleep(seconds)
        await wake()

    group.start_soon(sleep)
    await lying.wait()


async def test_sleepers_of_one_deadline_go_on_in_the_order_in_which_they_lay_down(clock):
    log: list[int] = []

    def noting(number: int):
        async def note() -> None:
            log.append(number)

        return note

    async with anyio.create_task_group() as group:
        for number in range(20):
            await lie_down(group, clock, 1, noting(number))
    assert log == list(range(20))


async def test_a_sleeper_goes_on_once_all_that_the_one_before_it_brought_about_is_done(clock):
    log: list[str] = []
    rung = anyio.Event()

    async def ring() -> None:
        rung.set()

    async def answer() -> None:
        await rung.wait()
        for _ in range(10):
            await anyio.lowlevel.checkpoint()
        log.append("answered")

    async def note() -> None:
        log.append("second")

    async with anyio.create_task_group() as group:
        group.start_soon(answer)
        await lie_down(group, clock, 1, ring)
        await lie_down(group, clock, 1, note)
    assert log == ["answered", "second"]


async def test_time_does_not_leap_to_the_end_of_a_canceled_sleep():
    clock = VirtualClock()
    async with running(lambda: clock.sleep(1)) as sleeper:
        sleeper.scope.cancel()
    async with running(clock.run) as driver:
        await wait_until_idle()
        driver.scope.cancel()
    assert clock.time() == 0


async def test_a_canceled_sleep_leaves_the_others_in_order():
    clock, log = VirtualClock(), []

    async def sleep(seconds: float) -> None:
        await clock.sleep(seconds)
        log.append(seconds)

    async with anyio.create_task_group() as group:
        for seconds in (5, 4, 3, 9, 8, 7):
            group.start_soon(sleep, seconds)
        async with running(lambda: clock.sleep(2)) as sleeper:
            sleeper.scope.cancel()
        async with running(clock.run) as driver:
            while len(log) < 6:
                await wait_until_idle()
            driver.scope.cancel()
    assert log == [3, 4, 5, 7, 8, 9]


async def test_time_waits_for_a_child_to_be_joined(clock):
    """The parent goes on some turns after the child's end, with nothing else to run between."""
    moments: list[float] = []

    async def parent() -> None:
        async with anyio.create_task_group() as group:
            group.start_soon(clock.sleep, 1)
        moments.append(clock.time())

    async with anyio.create_task_group() as group:
        group.start_soon(clock.sleep, 2)
        group.start_soon(parent)
    assert moments == [1]


async def test_time_does_not_leap_for_ever(clock):
    """One who sleeps without end does not take the clock along."""
    async with running(lambda: clock.sleep(math.inf)) as sleeper:
        for _ in range(3):
            await wait_until_idle()
        assert clock.time() == 0
        await clock.sleep(1)
        assert clock.time() == 1
        sleeper.scope.cancel()


@ON_A_LOOP_THAT_TELLS
@pytest.mark.parametrize("ticks", [(50, math.inf), (math.inf, 50)])
async def test_two_clocks_of_one_loop_hold_each_other_up_no_more_than_anyone(ticks):
    one, other = VirtualClock(), VirtualClock()

    async def tick(clock: VirtualClock, times: float) -> None:
        while clock.time() < times:
            await clock.sleep(1)
        group.cancel_scope.cancel()

    async with running(one.run) as driver, running(other.run) as second:
        async with anyio.create_task_group() as group:
            group.start_soon(tick, one, ticks[0])
            group.start_soon(tick, other, ticks[1])
        assert one.time() == pytest.approx(other.time(), abs=1)
        driver.scope.cancel()
        second.scope.cancel()
