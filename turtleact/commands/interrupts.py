"""SIGINT and SIGTERM, from the first moment of the program to its last.

A signal is noted, never raised into the middle of an import or of somebody's body. Who is told of
it depends on where the program stands:

- before the event loop runs: nobody; the program looks at `Interrupts.received` before it begins.
  A second signal ends the process at once.
- while it reads what the user types (`Interrupts.reading`): the signal ends the reading.
- in the event loop (`Interrupts.listening`): whoever waits in `Interrupts.wait`. A third signal
  ends the process at once, should the loop itself not come to it.
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

SIGNALS = (signal.SIGINT, signal.SIGTERM)


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
    """

    def __init__(self) -> None:
        self.received: list[signal.Signals] = []
        self._endured = 1
        self._is_reading = False
        self._tell: Callable[[], object] | None = None

    @property
    def status(self) -> int:
        """The exit status that says which signal ended the program: 130 or 143."""
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
        try:
            yield
        finally:
            self._tell = None
            self._endured = sys.maxsize

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
            leave(self.status)
        if self._tell is not None:
            self._tell()
