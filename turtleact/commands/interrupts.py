"""The signals that ask the program to end, from its first moment to its last.

A signal is noted, never raised into the middle of an import or of somebody's body. Who is told of
it depends on where the program stands:

- before the event loop runs: nobody; the program looks at `Interrupts.received` before it begins.
  A second signal ends the process at once.
- while it reads what the user types (`Interrupts.read`): the signal ends the reading.
- in a beginning that may take long (`Interrupts.beginning`): the system's alarm clock, which ends
  the process unless that is over within `GRACE`.
- in the event loop (`Interrupts.listening`): whoever waits in `Interrupts.wait`. Should the loop
  not come to the second signal within `GRACE`, or to a deadline (`Interrupts.end_within`), because
  it is stuck in a body or in writing to somebody who does not read, the system's alarm clock ends
  the process. A third signal ends it at once. From the first signal on the clock also rings every
  `GRACE`: one that comes in the moment before a write begins would be told after it only.
- after the loop: nobody. What has ended has ended; at last they are ignored.

One handler for all of this, set once: the loop's own signal handling would leave Python's default
behind, and with it a traceback, in the moments before and after the loop. The loop is told by
``call_soon_threadsafe``, as `asyncio.Runner` does for Ctrl-C. What waits for the system meanwhile,
the loop or a reading, waits for a pipe too, into which the system writes each signal: one that came
in the moment before that wait began would be told after it only.
"""

from __future__ import annotations

import os
import select
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from time import monotonic
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    import asyncio
    from types import FrameType

__all__ = ["Interrupts", "leave"]

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

GRACE = 0.5
"""Wall seconds that the loop has for what it is late with."""

LONGEST = 1e9
"""Seconds that the system's alarm clock can be set to without harm: 31 years."""

CHUNK = 2**16
"""Bytes that are read at once: what a pipe holds on Linux."""


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
        patience: How long the loop may go on after the first signal, before the alarm clock ends
            the process (s, wall clock).
        must_leave: Whether the process has to end by `leave`, as tasks or threads are left that do
            not end.
    """

    def __init__(self) -> None:
        self.received: list[signal.Signals] = []
        self.restore: Callable[[], object] = bool
        self.patience = inf
        self.must_leave = False
        self._endured = 1
        self._is_reading = False
        self._is_beginning = False
        self._early: int | None = None  # the exit status of a beginning, if it has one of its own
        self._due = inf  # when the process is to end, by the monotonic clock (s)
        self._late = 0  # the exit status then
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

    def read(self, file: int, most: int, *, line: bool = False) -> bytes:
        """What a file holds, waited for; a signal ends the waiting.

        Args:
            file: Its descriptor.
            most: So many bytes at most; the end of the file comes before.
            line: Whether the end of the first line is enough. More may have been read.

        Raises:
            KeyboardInterrupt: if a signal comes, or came before.
            OSError: if it cannot be read.
        """
        data = bytearray()
        self._is_reading = True
        try:
            with _signals_in_a_pipe() as signals:
                if self.received:
                    raise KeyboardInterrupt
                while len(data) < most and not (line and b"\n" in data):
                    ready, _, _ = select.select([file, signals], (), ())
                    if signals in ready:  # one that ends nothing
                        os.read(signals, CHUNK)
                    if file not in ready:
                        continue
                    part = os.read(file, min(most - len(data), CHUNK))
                    if not part:
                        break
                    data += part
        finally:
            self._is_reading = False
        return bytes(data)

    @contextmanager
    def listening(self, loop: asyncio.AbstractEventLoop) -> Iterator[None]:
        """A block in which `wait` hears of signals; behind it they mean nothing any more."""
        import asyncio

        self._changed = asyncio.Event()
        self._tell = lambda: loop.call_soon_threadsafe(self._changed.set)
        self._endured = 2
        before = signal.getsignal(signal.SIGALRM)
        with _signals_in_a_pipe() as signals:
            loop.add_reader(signals, os.read, signals, CHUNK)
            try:
                yield
            finally:
                loop.remove_reader(signals)
                signal.setitimer(signal.ITIMER_REAL, 0)
                signal.signal(signal.SIGALRM, before)
                self._tell = None
                self._due = inf
                self._endured = sys.maxsize

    @contextmanager
    def beginning(self, status: int | None = None) -> Iterator[None]:
        """A block that has nothing to end yet; behind it a signal means what it does elsewhere.

        If a signal comes in it, or came before, it has `GRACE` to leave the block, however busy
        the loop is, or the process ends.

        Args:
            status: With this exit status; None means that of the signal.
        """
        self._is_beginning, self._early = True, status
        if self.received:
            self._end_beginning()
        try:
            yield
        finally:
            self._is_beginning = False
            if len(self.received) < self._endured:
                self._due = inf

    def end(self, number: signal.Signals = signal.SIGTERM) -> None:
        """End the program as if this signal had come, unless one has come before."""
        if not self.received:
            self._arrive(number, None)

    def end_within(self, seconds: float, status: int) -> None:
        """Give the loop some wall seconds and `GRACE` to leave `listening`, or end the process.

        Of several deadlines the first counts. What has been printed stays; nothing is flushed.
        """
        due = monotonic() + seconds + GRACE
        if due < self._due:
            self._due, self._late = due, status
            self._set_alarm()

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
        if self._is_beginning:
            self._end_beginning()
        if self._tell is not None:
            is_last = len(self.received) == self._endured
            self.end_within(0.0 if is_last else self.patience, self.status)
            self._set_alarm()
            self._tell()

    def _end_beginning(self) -> None:
        self.end_within(0.0, self.status if self._early is None else self._early)

    def _set_alarm(self) -> None:
        """Have the system's alarm clock ring when the process is to end, or in `GRACE`.

        It rings every `GRACE` from then on, so that no alarm is the only one: Python 3.11 may note
        a signal and yet not tell a main thread that is in a loop of its own.
        """
        seconds = self._due - monotonic()
        if self.received:
            seconds = min(seconds, GRACE)
        signal.signal(signal.SIGALRM, self._ring)
        signal.setitimer(signal.ITIMER_REAL, min(max(seconds, 1e-6), LONGEST), GRACE)

    def _ring(self, *_: object) -> None:
        if monotonic() >= self._due:
            self._end(self._late)
        else:
            self._set_alarm()

    def _end(self, status: int) -> NoReturn:
        try:
            self.restore()
        finally:
            os._exit(status)


@contextmanager
def _signals_in_a_pipe() -> Iterator[int]:
    """The end of a pipe that can be read as soon as a signal has come."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    before = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    try:
        yield reader
    finally:
        signal.set_wakeup_fd(before)
        os.close(reader)
        os.close(writer)
