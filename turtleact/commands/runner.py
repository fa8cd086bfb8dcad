"""Runs a command in an event loop of its own, and makes sure that the program can always end.

At its end, `asyncio.run` waits for every task that still runs, and the interpreter waits for every
thread. A body that ignores its cancellation or blocks a thread would therefore keep the program
alive forever. The user's code also runs in this event loop. The user's code can stop the
loop at any time with ``sys.exit``, ``raise KeyboardInterrupt`` or ``loop.stop()``, or by cancelling
every task that it finds.
"""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Coroutine
from pathlib import Path
from signal import SIGINT, SIGTERM
from time import monotonic
from typing import TYPE_CHECKING, Any, TypeVar

from turtleact.commands.output import note
from turtleact.errors import TurtleactError
from turtleact.tasks import new_event_loop

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts

__all__ = ["run"]

T = TypeVar("T")

OURS = str(Path(__file__).parents[1]) + os.sep
"""The folder of turtleact's own modules."""

GRACE = 2.0
"""How long to wait for a command's tasks after its end, and then for its threads (s, each)."""

STOPPED = (
    "a body, or other code of yours, called stop() of the event loop, which ends all that runs in "
    "it: use sys.exit to end the program"
)

CANCELLED = (
    "a body, or other code of yours, cancelled a task of turtleact: cancel only tasks that you made"
)


def run(main: Coroutine[object, object, T], interrupts: Interrupts) -> T:
    """Run a command to its end, and return its result.

    If the user's code stops the loop, the command ends as if a signal had come. This function then
    raises the exception that stopped the loop, or a `TurtleactError` if the loop was stopped
    without an exception. If other tasks or threads do not end in time, this function sets
    `Interrupts.must_leave`, because the process must end without waiting for them.

    Raises:
        SystemExit: if the user's code called `sys.exit`.
        KeyboardInterrupt: if the user's code raised it.
        TurtleactError: if the user's code stopped the loop, or cancelled the command's own task.
        BaseException: if the command raised it.
    """
    runner = asyncio.Runner(loop_factory=new_event_loop)
    loop = runner.get_loop()
    loop.set_exception_handler(_tell_of_error)
    task = loop.create_task(main)
    cause = _drive(loop, task, interrupts)
    # Without interrupts, because nothing can be asked to end any more: each wait of this task is
    # bounded. The user's code may stop the loop during it, too, so it is driven in the same way.
    ending = loop.create_task(_end_the_rest())
    _drive(loop, ending, None)
    left = ending.result()
    # Closing waits for every task, so it is safe only if none is left. Otherwise the loop stays as
    # it is: the process ends by `leave` then.
    if not left:
        runner.close()
        left = _busy_threads()
    if left:
        note(f"ending without waiting for what still runs: {', '.join(left)}")
        interrupts.must_leave = True
    if cause is not None:
        raise cause
    if task.cancelled():
        raise TurtleactError(CANCELLED)
    return task.result()


def _drive(
    loop: asyncio.AbstractEventLoop, task: asyncio.Task[Any], interrupts: Interrupts | None
) -> BaseException | None:
    """Run the loop until a task is done, even if the user's code stops the loop earlier.

    If the user's code stops the loop, ``interrupts`` tells the task to end, and the loop runs
    again. If the loop stayed stopped, running goals could not end, and their clients would get no
    answer.

    An exception such as SystemExit stops the loop in the middle of an iteration, and
    ``loop.stop()`` stops the loop at the end of an iteration. After either stop, the loop can run
    again.

    Returns:
        The exception that first stopped the loop, or a `TurtleactError` after ``loop.stop()``.
        None if the user's code did not stop the loop, or if ``interrupts`` is None.
    """
    cause: BaseException | None = None
    # `run_until_complete` would not do: it removes its callback when an exception leaves the loop,
    # and it raises if the loop is stopped before the task is done.
    task.add_done_callback(lambda _: loop.stop())
    while not task.done():
        stopped: BaseException
        try:
            loop.run_forever()
            stopped = TurtleactError(STOPPED)
        except (SystemExit, KeyboardInterrupt) as error:
            stopped = error
        if not task.done() and interrupts is not None:
            cause = cause or stopped
            interrupts.end(SIGINT if isinstance(stopped, KeyboardInterrupt) else SIGTERM)
    return cause


async def _end_the_rest() -> list[str]:
    """Cancel all other tasks, and close asynchronous generators and the loop's threads.

    Return descriptions of the tasks that have not ended in time. If no task is left, return
    descriptions of the generators and threads that have not ended. This function waits with
    `asyncio.wait`, which returns at its timeout even if a task ignores its cancellation.
    """
    loop, own = asyncio.get_running_loop(), asyncio.current_task()
    left = asyncio.all_tasks() - {own}
    for task in left:
        task.cancel()
    if left:
        await asyncio.wait(left, timeout=GRACE)
    if stuck := [_described(task) for task in left if not task.done()]:
        return stuck  # a generator that one of them runs cannot be closed
    closing = {
        loop.create_task(loop.shutdown_asyncgens(), name="an asynchronous generator"),
        loop.create_task(loop.shutdown_default_executor(), name="a thread of the loop's executor"),
    }
    await asyncio.wait(closing, timeout=GRACE)
    return [task.get_name() for task in closing if not task.done()]


def _described(task: asyncio.Task[Any]) -> str:
    """Describe a task. If the task waits in the user's own code, name the line, too."""
    stack = task.get_stack(limit=1)
    own = [frame for frame in stack if not frame.f_code.co_filename.startswith(OURS)]
    where = f" ({own[-1].f_code.co_filename}, line {own[-1].f_lineno})" if own else ""
    return f"task '{task.get_name()}'{where}"


def _busy_threads() -> list[str]:
    """Wait for other threads, and describe those that still run after `GRACE` seconds.

    Daemon threads are left out, because the interpreter does not wait for them.
    """
    due = monotonic() + GRACE
    own = threading.current_thread()
    others = [each for each in threading.enumerate() if each is not own and not each.daemon]
    for thread in others:
        thread.join(max(due - monotonic(), 0.0))
    return [f"thread '{thread.name}'" for thread in others if thread.is_alive()]


def _tell_of_error(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Log an error as asyncio does, unless the error comes from `sys.exit`.

    If a body calls `sys.exit`, the program itself reports this.
    """
    if not isinstance(context.get("exception"), SystemExit):
        loop.default_exception_handler(context)
