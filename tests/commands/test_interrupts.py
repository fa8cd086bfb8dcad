"""Signals, from the first moment of the program to its last."""

from __future__ import annotations

import asyncio
import os
import select
import signal
import time
from threading import Lock, Thread, get_ident

import pytest

from turtleact.commands.interrupts import SIGNALS, leave
from turtleact.errors import TurtleactError

SIGINT, SIGTERM = signal.SIGINT, signal.SIGTERM


class Left(BaseException):
    pass


@pytest.fixture
def installed(interrupts, monkeypatch):
    def left(status):
        signal.setitimer(signal.ITIMER_REAL, 0)  # a process that has ended hears no alarm
        raise Left(status)

    monkeypatch.setattr(os, "_exit", left)
    interrupts.install()
    return interrupts


def test_the_first_signal_is_noted(installed):
    signal.raise_signal(SIGINT)
    assert installed.received == [SIGINT]


@pytest.mark.parametrize(
    ("number", "status"), [(SIGINT, 130), (SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_the_status_is_that_of_the_signal(installed, number, status):
    signal.raise_signal(number)
    assert installed.status == status


def test_a_second_signal_before_the_loop_ends_the_process(installed):
    signal.raise_signal(SIGINT)
    with pytest.raises(Left, match="143"):
        signal.raise_signal(SIGTERM)


def test_a_signal_ends_a_process_that_leaves_nothing_behind_at_once(installed):
    with installed.ending_at_once(), pytest.raises(Left, match="143"):
        signal.raise_signal(SIGTERM)


def test_an_earlier_signal_ends_such_a_process_too(installed):
    signal.raise_signal(SIGINT)
    with pytest.raises(Left, match="130"), installed.ending_at_once():
        pytest.fail("it went on")


def test_behind_such_a_block_a_signal_is_noted_again(installed):
    with installed.ending_at_once():
        pass
    signal.raise_signal(SIGINT)
    assert installed.received == [SIGINT]


@pytest.fixture
def pipe():
    file, other = os.pipe()
    with os.fdopen(file, "rb") as reader, os.fdopen(other, "wb", buffering=0) as writer:
        yield reader, writer


@pytest.fixture
def at_the_wait(monkeypatch):
    """Something happens when the system is asked to wait."""

    def put(happens):
        real = select.select

        def wait(*files):
            happens()
            return real(*files)

        monkeypatch.setattr(select, "select", wait)

    return put


def test_reading_is_ended_by_a_signal(installed, pipe, at_the_wait):
    at_the_wait(lambda: signal.raise_signal(SIGINT))
    with pytest.raises(KeyboardInterrupt):
        installed.read(pipe[0].fileno(), 10)


def test_a_signal_wakes_the_reading_before_python_knows(interrupts, pipe, at_the_wait):
    """As one does that comes after Python last looked, and before the system waits."""
    then = iter([lambda: signal.raise_signal(SIGINT), pipe[1].close])
    before = signal.signal(SIGINT, lambda *_: None)
    at_the_wait(lambda: next(then)())
    try:
        assert interrupts.read(pipe[0].fileno(), 10) == b""
    finally:
        signal.signal(SIGINT, before)
    assert not list(then)


def test_reading_does_not_begin_after_a_signal(installed, pipe, at_the_wait):
    at_the_wait(lambda: pytest.fail("it began"))
    signal.raise_signal(SIGINT)
    with pytest.raises(KeyboardInterrupt):
        installed.read(pipe[0].fileno(), 10)


def test_behind_the_reading_a_signal_is_noted_again(installed, pipe):
    pipe[1].write(b"x")
    assert installed.read(pipe[0].fileno(), 1) == b"x"
    signal.raise_signal(SIGINT)
    assert installed.received == [SIGINT]


def test_what_comes_in_parts_is_read_to_the_end(interrupts, pipe, at_the_wait):
    parts = iter([b"a", b"b\n", b"c"])
    at_the_wait(lambda: pipe[1].write(part) if (part := next(parts, b"")) else pipe[1].close())
    assert interrupts.read(pipe[0].fileno(), 10) == b"ab\nc"


def spin() -> None:
    """Let no time pass unseen: a signal that comes before `signal.pause` would not end that."""
    while True:
        pass


def heard_alarms(monkeypatch) -> list[float]:
    """When the alarm clock rings, which goes on to do what it does; for handlers set from now."""
    rung, set_handler = [], signal.signal

    def set_heard(number, handler):
        if number != signal.SIGALRM or isinstance(handler, signal.Handlers):
            return set_handler(number, handler)

        def hear(*arguments):
            rung.append(time.monotonic())
            handler(*arguments)

        return set_handler(number, hear)

    monkeypatch.setattr(signal, "signal", set_heard)
    return rung


def in_the_loop(interrupts, steps):
    async def main():
        with interrupts.listening(asyncio.get_running_loop()):
            await steps()

    asyncio.run(main())


def test_the_loop_hears_of_a_signal(installed):
    async def steps():
        asyncio.get_running_loop().call_later(0, signal.raise_signal, SIGINT)
        await installed.wait(1)

    in_the_loop(installed, steps)


def test_a_signal_that_does_not_break_into_the_sleep_of_the_loop_ends_it(installed):
    """Another thread takes it, as nobody can hit the moment just before the sleep."""
    asleep = Lock()

    def take():
        with asleep:  # held by Python's own lock, too, until the loop lets go of that to sleep
            signal.pthread_kill(get_ident(), SIGINT)

    async def steps():
        asleep.acquire()
        thread = Thread(target=take)
        thread.start()
        asyncio.get_running_loop().call_soon(asleep.release)
        async with asyncio.timeout(10):
            await installed.wait(1)
        thread.join()

    in_the_loop(installed, steps)


def test_a_signal_that_came_before_the_loop_is_heard_of(installed):
    signal.raise_signal(SIGINT)
    in_the_loop(installed, lambda: installed.wait(1))


def test_the_loop_hears_of_the_second_signal_too(installed):
    async def steps():
        asyncio.get_running_loop().call_later(0, signal.raise_signal, SIGINT)
        await installed.wait(1)
        asyncio.get_running_loop().call_later(0, signal.raise_signal, SIGTERM)
        await installed.wait(2)

    in_the_loop(installed, steps)


def test_a_third_signal_ends_the_process_whatever_the_loop_does(installed):
    async def steps():
        signal.raise_signal(SIGINT)
        signal.raise_signal(SIGINT)
        with pytest.raises(Left, match="130"):
            signal.raise_signal(SIGINT)

    in_the_loop(installed, steps)


def test_a_loop_that_does_not_come_to_the_second_signal_is_ended(installed, monkeypatch):
    def interrupted():
        signal.raise_signal(SIGINT)
        signal.raise_signal(SIGTERM)
        spin()

    async def steps():
        with pytest.raises(Left, match="143"):
            interrupted()

    monkeypatch.setattr("turtleact.commands.interrupts.GRACE", 0.01)
    in_the_loop(installed, steps)


def test_of_several_deadlines_the_first_counts(installed, monkeypatch):
    monkeypatch.setattr("turtleact.commands.interrupts.GRACE", 0.01)

    def late():
        for seconds in (60.0, 0.0, 30.0):
            installed.end_within(seconds, round(seconds))
        spin()

    async def steps():
        with pytest.raises(Left, match=r"^0$"):
            late()

    in_the_loop(installed, steps)


def test_a_signal_of_another_kind_may_count_as_the_same(installed):
    installed.together = 60.0
    for number in (signal.SIGHUP, SIGTERM):
        signal.raise_signal(number)
    assert (installed.received, installed.status) == ([signal.SIGHUP], 129)
    with pytest.raises(Left, match="129"):
        signal.raise_signal(signal.SIGHUP)


def test_a_deadline_can_be_put_off_until_a_second_signal(installed, monkeypatch):
    now = 0.0
    monkeypatch.setattr("turtleact.commands.interrupts.GRACE", 0.01)
    monkeypatch.setattr("turtleact.commands.interrupts.monotonic", lambda: now)
    installed.patience = 0.0
    rung = heard_alarms(monkeypatch)

    def interrupted():
        nonlocal now
        signal.raise_signal(SIGINT)
        for _ in range(5):
            now += 0.009
            installed.extend()
        before = len(rung)
        while len(rung) < before + 2:  # the alarm clock looks at the deadline
            pass

    def late():
        interrupted()
        assert len(installed.received) == 1
        interrupted()

    async def steps():
        with pytest.raises(Left, match="130"):
            late()
        assert len(installed.received) == 2

    in_the_loop(installed, steps)


def test_the_last_words_are_written_before_the_process_ends(installed, capfd):
    installed.last_words = lambda: "lost\n"
    signal.raise_signal(SIGINT)
    with pytest.raises(Left):
        signal.raise_signal(SIGINT)
    assert capfd.readouterr().err == "lost\n"


def test_an_alarm_that_is_lost_comes_again(installed, monkeypatch):
    leaves, alarms = os._exit, []

    def lost_at_first(status):
        alarms.append(status)
        if len(alarms) > 1:
            leaves(status)

    monkeypatch.setattr(os, "_exit", lost_at_first)
    monkeypatch.setattr("turtleact.commands.interrupts.GRACE", 0.01)

    def late():
        installed.end_within(0.0, 7)
        assert signal.getitimer(signal.ITIMER_REAL)[1] > 0.0
        spin()

    async def steps():
        with pytest.raises(Left, match="7"):
            late()

    in_the_loop(installed, steps)


def test_a_spent_alarm_still_is_the_first_deadline(installed, monkeypatch):
    monkeypatch.setattr("turtleact.commands.interrupts.GRACE", 0.01)
    ended: list[int] = []
    monkeypatch.setattr(os, "_exit", ended.append)

    async def steps():
        installed.end_within(0.0, 7)
        while not ended:
            pass
        installed.end_within(30.0, 8)
        assert signal.getitimer(signal.ITIMER_REAL)[0] < 1.0

    in_the_loop(installed, steps)
    assert set(ended) == {7}


def test_a_beginning_that_goes_on_behind_a_signal_ends_with_the_process(installed, monkeypatch):
    monkeypatch.setattr("turtleact.commands.interrupts.GRACE", 0.001)

    def late():
        with installed.beginning(7):
            signal.raise_signal(SIGINT)
            spin()

    async def steps():
        with pytest.raises(Left, match="7"):
            late()

    in_the_loop(installed, steps)


def test_a_beginning_without_a_status_ends_with_that_of_the_signal(installed, monkeypatch):
    monkeypatch.setattr("turtleact.commands.interrupts.GRACE", 0.001)

    def late():
        with installed.beginning():
            signal.raise_signal(SIGTERM)
            spin()

    async def steps():
        with pytest.raises(Left, match="143"):
            late()

    in_the_loop(installed, steps)


def test_a_beginning_behind_a_signal_is_a_short_one(installed, monkeypatch):
    monkeypatch.setattr("turtleact.commands.interrupts.GRACE", 0.001)
    signal.raise_signal(SIGINT)

    async def steps():
        with pytest.raises(Left, match="7"), installed.beginning(7):
            spin()

    in_the_loop(installed, steps)


def test_behind_the_first_signal_nothing_waits_for_long_without_an_alarm(installed, monkeypatch):
    """A second one that comes in the moment before a write begins is told then."""
    monkeypatch.setattr("turtleact.commands.interrupts.GRACE", 0.001)
    rung = heard_alarms(monkeypatch)

    async def steps():
        signal.raise_signal(SIGINT)
        while len(rung) < 3:  # none of them ends the process
            pass

    in_the_loop(installed, steps)


def test_a_beginning_that_is_soon_over_leaves_the_end_to_the_loop(installed, monkeypatch):
    left: list[int] = []
    monkeypatch.setattr("turtleact.commands.interrupts.leave", left.append)

    async def steps():
        with installed.beginning(7):
            installed.end_within(0.02, 8)
            signal.raise_signal(SIGINT)
        await installed.wait(1)
        time.sleep(0.05)  # the alarm clock would end a loop that is stuck
        assert not left

    in_the_loop(installed, steps)


def test_after_a_signal_the_error_of_a_beginning_does_not_count(installed):
    async def steps():
        with pytest.raises(TurtleactError, match="before"), installed.beginning():
            raise TurtleactError("before the signal")
        with installed.beginning():
            signal.raise_signal(SIGINT)
            raise TurtleactError("after it")
        assert installed.status == 130

    in_the_loop(installed, steps)


def test_a_second_signal_in_a_beginning_is_a_deadline_behind_it_too(installed):
    async def steps():
        with installed.beginning(7):
            signal.raise_signal(SIGINT)
            signal.raise_signal(SIGINT)
        assert signal.getitimer(signal.ITIMER_REAL)[0] > 0

    in_the_loop(installed, steps)


def test_a_deadline_beyond_all_measure_is_none(installed):
    async def steps():
        installed.end_within(1e300, 1)
        assert signal.getitimer(signal.ITIMER_REAL)[0] > 1e8

    in_the_loop(installed, steps)


def test_behind_the_loop_a_deadline_means_nothing(installed):
    before = signal.getsignal(signal.SIGALRM)

    async def steps():
        installed.end_within(60.0, 1)

    in_the_loop(installed, steps)
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    assert signal.getsignal(signal.SIGALRM) == before


def test_the_terminal_is_given_back_before_the_process_ends(installed):
    given_back = []
    installed.restore = lambda: given_back.append(True)
    signal.raise_signal(SIGINT)
    with pytest.raises(Left):
        signal.raise_signal(SIGINT)
    assert given_back


def test_the_process_ends_even_if_the_terminal_cannot_be_given_back(installed):
    def fails():
        raise OSError

    installed.restore = fails
    signal.raise_signal(SIGINT)
    with pytest.raises(Left):
        signal.raise_signal(SIGINT)


def test_behind_the_loop_signals_mean_nothing(installed):
    in_the_loop(installed, lambda: asyncio.sleep(0))
    for _ in range(3):
        signal.raise_signal(SIGINT)


@pytest.fixture(autouse=True)
def default_handlers(interrupts):
    """As a program finds them that was started on a terminal."""
    for number in SIGNALS:
        signal.signal(number, signal.default_int_handler)


def test_a_signal_that_the_parent_ignores_stays_ignored(interrupts):
    signal.signal(SIGINT, signal.SIG_IGN)
    interrupts.install()
    assert signal.getsignal(SIGINT) is signal.SIG_IGN


def test_ignored_signals_are_dropped_by_the_system(interrupts):
    interrupts.ignore()
    assert [signal.getsignal(each) for each in SIGNALS] == [signal.SIG_IGN] * 3


def test_no_alarm_rings_while_python_ends(installed):
    signal.raise_signal(SIGTERM)
    with installed.beginning():
        assert signal.getitimer(signal.ITIMER_REAL)[0] > 0
    installed.ignore()
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_signals_are_given_back_to_python(installed):
    installed.release()
    assert signal.getsignal(SIGINT) is signal.default_int_handler
    assert signal.getsignal(SIGTERM) is signal.SIG_DFL


def test_what_was_printed_is_flushed_before_the_process_ends(monkeypatch, installed):
    flushed = []

    class Stream:
        def flush(self):
            flushed.append(self)

    monkeypatch.setattr("sys.stdout", Stream())
    monkeypatch.setattr("sys.stderr", None)
    with pytest.raises(Left, match="7"):
        leave(7)
    assert len(flushed) == 1
