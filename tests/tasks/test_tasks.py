"""Tasks begun at once, signals, and coroutines that run in somebody else's task."""

from __future__ import annotations

import asyncio
import logging
import sys
import threading

import anyio
import pytest

from turtleact.tasks import Background, current_tasks, run_in_daemon, wait_while

from ..lab import ON_ASYNCIO, settle


async def note(log: list[object], entry: object) -> None:
    log.append(entry)


async def wait_forever(log: list[object]) -> None:
    try:
        await anyio.sleep_forever()
    except anyio.get_cancelled_exc_class():
        log.append("canceled")
        raise


# --- spawn ----------------------------------------------------------------------------------


async def test_a_task_canceled_at_once_is_canceled_at_its_first_wait():
    log: list[object] = []
    current_tasks().spawn(wait_forever(log), "lab").cancel()
    await settle()
    assert log == ["canceled"]


async def test_a_task_that_was_just_spawned_has_run_after_a_checkpoint():
    tasks = current_tasks()
    for _ in range(20):  # trio chooses the order of its tasks at random
        log: list[object] = []
        tasks.spawn(note(log, "ran"), "lab")
        await tasks.checkpoint()
        assert log == ["ran"]


def test_a_task_in_no_shielded_scope_is_not_shielded():
    async def main():
        task = asyncio.current_task()
        with anyio.CancelScope(), anyio.move_on_after(1):
            assert not current_tasks().is_shielded(task)
        with anyio.CancelScope(shield=True), anyio.CancelScope():
            assert current_tasks().is_shielded(task)
        assert not current_tasks().is_shielded(task)

    anyio.run(main)


@pytest.mark.parametrize("name", ["_task_states", "anyio._backends._asyncio"])
def test_without_anyios_private_table_no_task_is_shielded(name, monkeypatch):
    async def main():
        backend = sys.modules["anyio._backends._asyncio"]
        with anyio.CancelScope(shield=True):
            if name == "_task_states":
                monkeypatch.delattr(backend, name)
            else:
                monkeypatch.delitem(sys.modules, name)
            answer = current_tasks().is_shielded(asyncio.current_task())
            monkeypatch.undo()
        return answer

    assert not anyio.run(main)


# --- signals --------------------------------------------------------------------------------


async def test_a_fire_wakes_all_that_wait_then_once_and_is_not_remembered():
    signal, log = current_tasks().signal(), []

    async def wait(number: int) -> None:
        while True:
            await signal.wait()
            log.append(number)

    signal.fire()
    async with anyio.create_task_group() as group:
        for number in range(3):
            group.start_soon(wait, number)
        await settle()
        assert log == []
        signal.fire()
        await settle()
        assert sorted(log) == [0, 1, 2]
        group.cancel_scope.cancel()


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


# --- what runs in the background ------------------------------------------------------------


@pytest.mark.parametrize("is_canceled", [False, True])
async def test_closing_what_runs_in_the_background_waits_for_its_clean_up(is_canceled):
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
    assert log == []
    with anyio.CancelScope() as scope:
        if is_canceled:
            scope.cancel()
        await background.aclose()
    assert log == ["cleaned up"]


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


async def test_a_function_in_a_daemon_returns_or_raises():
    def fail() -> None:
        raise ValueError("mine")

    assert await run_in_daemon(lambda: 3, "three") == 3
    with pytest.raises(ValueError, match="mine"):
        await run_in_daemon(fail, "failing")


async def test_a_function_in_a_daemon_can_be_left_behind():
    gone = threading.Event()
    with anyio.move_on_after(0.01) as scope:
        await run_in_daemon(gone.wait, "hanging")
    assert scope.cancelled_caught
    gone.set()
