"""The signals that ask the program to end, from its first moment to its last.

A signal is noted, never raised into the middle of an import or of somebody's body. Who is told of
it depends on where the program stands:

- before the event loop runs: nobody; the program looks at `Interrupts.received` before it begins.
  A second signal ends the process at once.
- while it reads what the user types (`Interrupts.reading`): the signal ends the reading.
- in the event loop (`Interrupts.listening`): whoever waits in `Interrupts.wait`. Should the loop
  not come to the second signal within `GRACE`, or to a deadline (`Interrupts.end_within`), because
  it is stuck in a body or in writing to somebody who does not read, the system's alarm clock ends
  the process. A third signal ends it at once.
- after the loop: nobody. What has ended has ended; at last they are ignored.

One handler for all of this, set once: the loop's own signal handling would leave Python's default
behind, and with it a traceback, in the moments before and after the loop. The loop is told by
``call_soon_threadsafe``, as `asyncio.Runner` does for Ctrl-C.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    import asyncio
    from types import FrameType

__all__ = ["Interrupts", "leave"]

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

GRACE = 0.5
"""Wall seconds that the loop has for what it is late with."""

LONGEST = 1e9
"""Wall seconds that the system's alarm clock can be set to without harm: 31 years."""


def leave(status: int) -> NoReturn:
    """End the process now, with nothing more than what has been printed."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    os._exit(status)


class Interrupts:
    """The signals that asked this process to end.

    Attributes:
        received: Which came, in order.
        restore: Gives the terminal back; called by a signal handler, before it ends the process.
    """

    def __init__(self) -> None:
        self.received: list[signal.Signals] = []
        self.restore: Callable[[], object] = bool
        self._endured = 1
        self._is_reading = False
        self._tell: Callable[[], object] | None = None

    @property
    def status(self) -> int:
        """The exit status that says which signal ended the program: 130, 143 or 129."""
        return 128 + self.received[-1]

    def install(self) -> None:
        """Take the signals from now on; one that the parent had ignored stays ignored."""
        for number in SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._arrive)

    def ignore(self) -> None:
        """Let the system drop the signals: Python, when it ends, would let them kill it."""
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)

    @contextmanager
    def reading(self) -> Iterator[None]:
        """A block that a signal leaves with KeyboardInterrupt."""
        self._is_reading = True
        try:
            if self.received:
                raise KeyboardInterrupt
            yield
        finally:
            self._is_reading = False

    @contextmanager
    def listening(self, loop: asyncio.AbstractEventLoop) -> Iterator[None]:
        """A block in which `wait` hears of signals; behind it they mean nothing any more."""
        import asyncio

        self._changed = asyncio.Event()
        self._tell = lambda: loop.call_soon_threadsafe(self._changed.set)
        self._endured = 2
        before = signal.getsignal(signal.SIGALRM)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)
            self._tell = None
            self._endured = sys.maxsize

    def end_within(self, seconds: float, status: int) -> None:
        """Give the loop some wall seconds and `GRACE` to leave `listening`, or end the process.

        Of several deadlines the first counts. What has been printed stays; nothing is flushed.
        """
        seconds += GRACE
        left, _ = signal.getitimer(signal.ITIMER_REAL)
        if not 0 < left <= seconds:
            signal.signal(signal.SIGALRM, lambda *_: self._end(status))
            signal.setitimer(signal.ITIMER_REAL, min(seconds, LONGEST))

    async def wait(self, count: int) -> None:
        """Wait until ``count`` signals have come. Cancelling: safe."""
        while len(self.received) < count:
            self._changed.clear()
            await self._changed.wait()

    def _arrive(self, number: int, _: FrameType | None) -> None:
        self.received.append(signal.Signals(number))
        if self._is_reading:
            raise KeyboardInterrupt
        if len(self.received) > self._endured:
            self._end(self.status)
        if self._tell is not None:
            if len(self.received) == self._endured:
                self.end_within(0.0, self.status)
            self._tell()

    def _end(self, status: int) -> NoReturn:
        try:
            self.restore()
        finally:
            os._exit(status)
