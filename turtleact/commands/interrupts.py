"""Runs a command in an event loop, and ends it at a signal.

The first signal asks the command to end: the command is cancelled, or cancels its goal and waits
for the end. The second signal ends the process at once, even if the user's code blocks the event
loop. Before and after `Interrupts.run`, Python's own signal handlers are in place.

Source: `asyncio.Runner`, which handles Ctrl-C in the same way. The loop's ``add_signal_handler``
would not do, because its handlers wait for a blocked loop.
"""

from __future__ import annotations

import asyncio
import os
import select
import signal
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

__all__ = ["Interrupts"]

SIGNALS = tuple(
    signal.Signals(getattr(signal, name))
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
    if hasattr(signal, name)
)
"""The signals that end the program. Windows has no SIGHUP, and only Windows has SIGBREAK."""

STDERR = 2


class Interrupts:
    """The signals that asked this process to end.

    Attributes:
        received: The signals that came, in order.
        cancels: Whether the first signal cancels the command that `run` runs. If not, the command
            waits for the signal itself, with `wait`.
        forced: The exit status of the process after a second signal; None for that of the signal.
        restore: Restores the terminal at the end of `run`, and before a second signal ends the
            process. It may be called twice.
        last_words: Returns a text for stderr before a second signal ends the process.
    """

    def __init__(self) -> None:
        self.received: list[signal.Signals] = []
        self.cancels = True
        self.forced: int | None = None
        self.restore: Callable[[], object] = bool
        self.last_words: Callable[[], str] = str
        self._first = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._task: asyncio.Task[int] | None = None

    @property
    def status(self) -> int:
        """The exit status for the last signal: 128 plus its number, such as 130 for Ctrl-C."""
        return 128 + self.received[-1]

    def run(self, main: Coroutine[object, object, int]) -> int:
        """Run a command in an event loop of its own, and return its exit status.

        Raises:
            BaseException: if the command raised it.
        """
        # The handlers also cover the opening of the loop, which a signal would leave half done, and
        # its closing, which waits for tasks and threads.
        with self._handled(), asyncio.Runner(loop_factory=asyncio.new_event_loop) as runner:
            self._loop = runner.get_loop()
            self._task = self._loop.create_task(main)
            if self.received:  # before there was a loop to call
                self._ask_to_end()
            try:
                return self._loop.run_until_complete(self._task)
            except asyncio.CancelledError:
                if not self.received:
                    raise
                return self.status
            finally:
                self.restore()

    def end(self) -> None:
        """Let `wait` return, as if a signal had come."""
        self._first.set()

    async def wait(self) -> None:
        """Wait for the first signal. Cancelling: safe."""
        await self._first.wait()

    def _ask_to_end(self) -> None:
        self._first.set()
        if self.cancels and self._task is not None:
            self._task.cancel()

    @contextmanager
    def _handled(self) -> Iterator[None]:
        """Handle `SIGNALS` during a block, except those that this process inherited as ignored."""

        def arrive(number: int, _: FrameType | None) -> None:
            # A terminal that closes sends SIGHUP twice, and some service managers send it together
            # with another signal. So it never counts as a second signal.
            if self.received and signal.Signals(number).name == "SIGHUP":
                return
            self.received.append(signal.Signals(number))
            if len(self.received) > 1:
                self._end()
            if self._loop is not None and not self._loop.is_closed():
                self._loop.call_soon_threadsafe(self._ask_to_end)

        taken = [each for each in SIGNALS if signal.getsignal(each) is not signal.SIG_IGN]
        before = {each: signal.signal(each, arrive) for each in taken}
        try:
            yield
        finally:
            for each, handler in before.items():
                signal.signal(each, handler)

    def _end(self) -> NoReturn:
        self.restore()
        text = self.last_words()
        # A terminal that the user has stopped with Ctrl-S must not stop this process.
        if text and (os.name != "posix" or select.select((), (STDERR,), (), 0)[1]):
            os.write(STDERR, text.encode(errors="backslashreplace"))
        os._exit(self.status if self.forced is None else self.forced)
