"""How commands end, whatever runs in their event loop."""

from __future__ import annotations

import asyncio
import signal
import sys
import threading
import time
from contextlib import suppress

import pytest

from turtleact.commands import runner
from turtleact.commands.runner import run
from turtleact.errors import TurtleactError


@pytest.fixture(autouse=True)
def _short_grace(monkeypatch):
    monkeypatch.setattr(runner, "GRACE", 0.05)


@pytest.fixture
def until_ended(interrupts):
    """A command that waits for a signal, with something beside it."""

    async def command(beside):
        with interrupts.listening(asyncio.get_running_loop()):
            task = asyncio.create_task(beside())
            await interrupts.wait(1)
        return task

    return lambda beside: run(command(beside), interrupts)


async def returning():
    return 7


async def failing():
    raise OSError("by hand")


def test_what_a_command_returns_is_returned(interrupts):
    assert run(returning(), interrupts) == 7
    assert not interrupts.must_leave


def test_what_a_command_raises_is_raised(interrupts):
    with pytest.raises(OSError, match="by hand"):
        run(failing(), interrupts)


async def exits():
    sys.exit(3)


async def interrupted():
    raise KeyboardInterrupt


async def stops():
    asyncio.get_running_loop().stop()


@pytest.mark.parametrize(
    ("beside", "error", "number"),
    [
        (exits, SystemExit, signal.SIGTERM),
        (interrupted, KeyboardInterrupt, signal.SIGINT),
        (stops, TurtleactError, signal.SIGTERM),
    ],
)
def test_code_that_stops_the_loop_ends_the_command_as_a_signal_does(
    until_ended, interrupts, beside, error, number
):
    with pytest.raises(error):
        until_ended(beside)
    assert interrupts.received == [number]


def test_a_command_whose_own_task_is_cancelled_says_so(until_ended, interrupts):
    async def cancels():
        for task in asyncio.all_tasks():
            task.cancel()

    with pytest.raises(TurtleactError, match="cancelled a task of turtleact"):
        until_ended(cancels)


def test_tasks_that_are_left_are_cancelled_and_waited_for(interrupts):
    cleaned = []

    async def left():
        try:
            await asyncio.sleep(60)
        finally:
            await asyncio.sleep(0)
            cleaned.append(True)

    async def command():
        asyncio.create_task(left())  # noqa: RUF006  # as of a user who does not know better
        await asyncio.sleep(0)

    run(command(), interrupts)
    assert (cleaned, interrupts.must_leave) == ([True], False)


@pytest.mark.filterwarnings("ignore")  # a loop is left with its tasks, which only os._exit ends
def test_a_task_that_ignores_its_cancellation_is_named_with_its_line(interrupts, capsys):
    is_over = False

    async def endless():
        while not is_over:
            with suppress(asyncio.CancelledError):
                await asyncio.sleep(60)

    async def command():
        task = asyncio.create_task(endless(), name="endless")
        await asyncio.sleep(0)
        return task

    task = run(command(), interrupts)
    assert interrupts.must_leave
    assert capsys.readouterr().err.startswith(
        f"turtleact: ending without waiting for what still runs: task 'endless' ({__file__}, line "
    )
    is_over = True
    task.get_loop().call_soon(task.cancel)
    task.get_loop().run_until_complete(asyncio.wait([task]))
    task.get_loop().close()


@pytest.mark.parametrize("in_executor", [True, False])
@pytest.mark.filterwarnings("ignore")
def test_a_thread_that_does_not_end_is_left(interrupts, capsys, in_executor):
    over = threading.Event()
    before = set(threading.enumerate())

    async def command():
        loop = asyncio.get_running_loop()
        if in_executor:
            loop.run_in_executor(None, over.wait)
        else:
            threading.Thread(target=over.wait, name="endless").start()
        return loop

    try:
        loop = run(command(), interrupts)
        name = "a thread of the loop's executor" if in_executor else "thread 'endless'"
        assert interrupts.must_leave
        assert (
            f"turtleact: ending without waiting for what still runs: {name}"
            in capsys.readouterr().err
        )
    finally:
        over.set()
    while set(threading.enumerate()) - before and not loop.is_closed():
        time.sleep(0.001)
        loop.run_until_complete(asyncio.sleep(0))
    loop.close()
