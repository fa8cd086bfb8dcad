from __future__ import annotations

import asyncio
import os
import signal

import pytest

from turtleact.commands.interrupts import leave

SIGINT, SIGTERM = signal.SIGINT, signal.SIGTERM


class Left(BaseException):
    pass


@pytest.fixture
def installed(interrupts, monkeypatch):
    def left(status):
        raise Left(status)

    monkeypatch.setattr(os, "_exit", left)
    interrupts.install()
    return interrupts


def test_the_first_signal_is_noted(installed):
    signal.raise_signal(SIGINT)
    assert installed.received == [SIGINT]


@pytest.mark.parametrize(("number", "status"), [(SIGINT, 130), (SIGTERM, 143)])
def test_the_status_is_that_of_the_signal(installed, number, status):
    signal.raise_signal(number)
    assert installed.status == status


def test_a_second_signal_before_the_loop_ends_the_process(installed):
    signal.raise_signal(SIGINT)
    with pytest.raises(Left, match="143"):
        signal.raise_signal(SIGTERM)


def test_reading_is_ended_by_a_signal(installed):
    with pytest.raises(KeyboardInterrupt), installed.reading():
        signal.raise_signal(SIGINT)


def test_reading_does_not_begin_after_a_signal(installed):
    signal.raise_signal(SIGINT)
    with pytest.raises(KeyboardInterrupt), installed.reading():
        pytest.fail("it began")


def test_behind_the_reading_a_signal_is_noted_again(installed):
    with installed.reading():
        pass
    signal.raise_signal(SIGINT)
    assert installed.received == [SIGINT]


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


def test_behind_the_loop_signals_mean_nothing(installed):
    in_the_loop(installed, lambda: asyncio.sleep(0))
    for _ in range(3):
        signal.raise_signal(SIGINT)


def test_a_signal_that_the_parent_ignores_stays_ignored(interrupts):
    signal.signal(SIGINT, signal.SIG_IGN)
    interrupts.install()
    assert signal.getsignal(SIGINT) is signal.SIG_IGN


def test_ignored_signals_are_dropped_by_the_system(interrupts):
    interrupts.ignore()
    assert [signal.getsignal(each) for each in (SIGINT, SIGTERM)] == [signal.SIG_IGN] * 2


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
