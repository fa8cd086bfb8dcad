"""Handles the signals that ask the program to end, from its first moment to its last.

The signal handler records each signal. It raises no exception in the middle of an import or of a
body. The effect of a signal depends on what the program is doing:

- Before the event loop runs, a first signal is only recorded. The program checks
  `Interrupts.received` before it starts the loop. A second signal ends the process at once.
- While the program reads input (`Interrupts.read`), a signal ends the reading.
- While the program needs no clean-up (`Interrupts.ending_at_once`), a signal ends the process at
  once.
- During a start that may take long (`Interrupts.beginning`), a signal sets the system's alarm timer
  (SIGALRM). The timer ends the process unless the start is over within `GRACE`.
- In the event loop (`Interrupts.listening`), a signal wakes the task that waits in
  `Interrupts.wait`. But the loop may be stuck in the code of an action, or in writing to a pipe
  that nobody reads.
  Therefore, if the loop has not ended within `GRACE` after a second signal, the alarm timer ends
  the process. The timer also ends the process when another deadline passes
  (`Interrupts.end_within`, `Interrupts.patience`). A third signal ends the process at once. After
  the first signal, the timer also expires every `GRACE` and interrupts blocking writes. Without
  these interruptions, Python would notice a signal that came just before a blocking write only
  after the write.
- Some desktops and service managers send two signals of different kinds at once. A command that
  needs time to end can treat two signals of different kinds as one (`Interrupts.together`).
- After the loop has ended, a signal has no effect. While Python shuts down, signals are ignored.

One signal handler, set once, does all of this. With the loop's own signal handling, Python's
default handler would be active just before and after the loop, and print a traceback. The handler
wakes the loop through ``call_soon_threadsafe``, as `asyncio.Runner` does for Ctrl-C.

The event loop and `Interrupts.read` wait in a system call that also watches a socket. Python writes
to the socket as soon as a signal comes. Without the socket, if a signal came just before the wait,
Python would notice the signal only after the wait.

Windows has no alarm timer, and its `select.select` cannot wait for a file. On Windows, one thread
replaces the alarm timer, and another thread reads the file.
"""

from __future__ import annotations

import os
import select
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from math import inf
from time import monotonic, sleep
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    import asyncio
    import socket
    from types import FrameType

    import anyio

__all__ = ["Interrupts", "leave", "signals"]


def signals(*names: str) -> tuple[signal.Signals, ...]:
    """Return the signals with these names. Leave out signals that this system does not have."""
    return tuple(signal.Signals(getattr(signal, each)) for each in names if hasattr(signal, each))


SIGNALS = signals("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")

HAS_ALARM = hasattr(signal, "SIGALRM")
"""Whether the system has an alarm timer, which sends SIGALRM when it expires."""

WAITS_FOR_FILES = os.name == "posix"
"""Whether the system can wait for a file and a signal at the same time."""

TICK = 0.1
"""How often the deadline and the input are polled on some systems, such as Windows (s).

These systems have no alarm timer, or cannot wait for a file.
"""

GRACE = 0.5
"""The event loop has this much time after a deadline to end by itself (s, wall clock)."""

LONGEST = 1e9
"""The longest time for which the alarm timer can safely be set (s): 31 years."""

STDERR = 2

CHUNK = 2**16
"""How many bytes are read at a time: as many as a pipe holds on Linux."""


def leave(status: int) -> NoReturn:
    """Flush stdout and stderr, and end the process at once, without any other clean-up."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    os._exit(status)


class Interrupts:
    """The signals that asked this process to end.

    Attributes:
        received: The signals that came, in order.
        restore: A function that restores the terminal. A signal handler calls this function just
            before the handler ends the process.
        last_words: A function that returns a text for stderr. A signal handler calls this function
            just before the handler ends the process. The function must therefore not wait for the
            main thread.
        together: The time after the first signal in which a second signal of another kind is
            ignored (s, wall clock).
        patience: How long the loop may go on after the first signal, before the alarm timer ends
            the process (s, wall clock).
        must_leave: Whether the process must end with `leave`, because some tasks or threads do not
            end.
    """

    def __init__(self) -> None:
        self.received: list[signal.Signals] = []
        self.restore: Callable[[], object] = bool
        self.last_words: Callable[[], str] = str
        self.together = 0.0
        self.patience = inf
        self._first_at = -inf  # when the first signal came (s, monotonic clock)
        self.must_leave = False
        self._endured = 1
        self._is_reading = False
        self._is_beginning = False
        self._is_released = False
        self._early: int | None = None  # the exit status of `beginning`, if it was given one
        self._due = inf  # when the process must end (s, monotonic clock)
        self._late = 0  # the exit status then
        self._tell: Callable[[], object] | None = None

    @property
    def status(self) -> int:
        """The exit status for the last signal: 128 plus its number, such as 130 for Ctrl-C."""
        return 128 + self.received[-1]

    def install(self) -> None:
        """Handle `SIGNALS` from now on, except those that this process inherited as ignored."""
        for number in SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._arrive)
        if not HAS_ALARM:
            from threading import Thread

            Thread(target=self._watch, name="alarm clock", daemon=True).start()

    def ignore(self) -> None:
        """Ignore all `SIGNALS` from now on, because they would kill Python while it shuts down."""
        if self._is_released:  # the user's threads may still run until a signal ends them
            return
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        if HAS_ALARM:  # at its end Python takes all handlers away, and then an alarm would kill it
            signal.setitimer(signal.ITIMER_REAL, 0)

    def release(self) -> None:
        """Restore Python's own signal handlers, for a user's program that handles signals itself.

        Raises:
            KeyboardInterrupt: if a signal has come before.
        """
        self._is_released = True
        for number in SIGNALS:
            if signal.getsignal(number) == self._arrive:
                is_interrupt = number == signal.SIGINT
                handler = signal.default_int_handler if is_interrupt else signal.SIG_DFL
                signal.signal(number, handler)
        if self.received:
            raise KeyboardInterrupt

    def read(self, file: int, most: int, *, line: bool = False) -> bytes:
        """Read a file to its end or up to a limit, and wait for data if necessary.

        Args:
            file: The file descriptor.
            most: How many bytes to read at most.
            line: Whether to stop once a whole line has been read. The result may also contain bytes
                after that line.

        Raises:
            KeyboardInterrupt: if a signal comes, or has come before.
            OSError: if the file cannot be read.
        """
        data = bytearray()
        self._is_reading = True
        try:
            with _woken_by_signals() as woken:
                # A signal that comes before this line is in `received`, and one that comes after it
                # raises, because `_is_reading` is set already. So none is missed in between.
                if self.received:
                    raise KeyboardInterrupt
                read = partial(_read, file, woken) if WAITS_FOR_FILES else _reading_thread(file)
                while len(data) < most and not (line and b"\n" in data):
                    part = read(min(most - len(data), CHUNK))
                    if not part:
                        break
                    data += part
        finally:
            self._is_reading = False
        return bytes(data)

    @contextmanager
    def listening(self, loop: asyncio.AbstractEventLoop) -> Iterator[None]:
        """Let `wait` notice signals during a block. After the block, signals have no effect."""
        import asyncio

        self._changed = asyncio.Event()
        self._tell = lambda: loop.call_soon_threadsafe(self._changed.set)
        self._endured = 2
        before = signal.getsignal(signal.SIGALRM) if HAS_ALARM else None
        with _woken_by_signals() as woken:
            loop.add_reader(woken, woken.recv, CHUNK)
            try:
                yield
            finally:
                loop.remove_reader(woken)
                if HAS_ALARM:
                    signal.setitimer(signal.ITIMER_REAL, 0)
                    signal.signal(signal.SIGALRM, before)
                # The loop has ended in time, so nothing is left for a signal to end.
                self._tell = None
                self._due = inf
                self._endured = sys.maxsize

    @contextmanager
    def ending_at_once(self) -> Iterator[None]:
        """Let a signal end the process at once during a block that needs no clean-up.

        If a signal has come before the block, the process ends as soon as the block begins.
        """
        endured, self._endured = self._endured, 0
        try:
            # A signal that comes before the line above is in `received`. A later one ends the
            # process in its handler.
            if self.received:
                self._end(self.status)
            yield
        finally:
            self._endured = endured

    @contextmanager
    def beginning(self, status: int | None = None) -> Iterator[None]:
        """Let a signal end the process during a block that starts something, such as a node.

        If a signal comes before or during the block, the program must leave the block within
        `GRACE` seconds. After that time, the process ends, even if the loop is busy. If a
        `TurtleactError` ends the block after a signal, the error is suppressed. Therefore check
        `received` before you use the results of the block.

        Args:
            status: The exit status of the process if it ends in the block. None stands for the exit
                status of the signal.
        """
        from turtleact.errors import TurtleactError

        self._is_beginning, self._early = True, status
        if self.received:
            self._end_beginning()
        try:
            yield
        except TurtleactError:
            if not self.received:
                raise
        finally:
            self._is_beginning = False
            # What has begun may now be wound down in its own time. But a deadline of the last
            # signal stays, because the process must end in any case.
            if len(self.received) < self._endured:
                self._due = inf

    def end(self, number: signal.Signals = signal.SIGTERM) -> None:
        """Act as if a signal had arrived, unless another signal has arrived before."""
        if not self.received:
            self._arrive(number, None)

    def end_within(self, seconds: float, status: int) -> None:
        """End the process unless the loop leaves `listening` within ``seconds`` plus `GRACE`.

        If there are several deadlines, the earliest counts. The process ends without flushing its
        output.
        """
        due = monotonic() + seconds + GRACE
        if due < self._due:
            self._due, self._late = due, status
            self._set_alarm()

    def extend(self) -> None:
        """Restart the countdown of `patience`, unless a second signal has come."""
        if len(self.received) < self._endured:
            self._due = monotonic() + self.patience + GRACE

    async def wait(self, count: int) -> None:
        """Wait until ``count`` signals have come. Cancelling: safe."""
        # No signal is lost between the check and the wait: the handler only schedules `set`, which
        # the loop runs once this task waits.
        while len(self.received) < count:
            self._changed.clear()
            await self._changed.wait()

    async def cancel_at_signal(self, scope: anyio.CancelScope) -> None:
        """Wait for the first signal, and then cancel a scope. Cancelling: safe."""
        await self.wait(1)
        scope.cancel()

    def _arrive(self, number: int, _: FrameType | None) -> None:
        if self._is_repeated(number):
            return
        self.received.append(signal.Signals(number))
        # As a signal handler, this may run between any two bytecodes of the main thread. So it
        # takes no lock, and raises only where `read` expects it.
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

    def _is_repeated(self, number: int) -> bool:
        """Whether to ignore a signal shortly after a signal of another kind; see `together`."""
        if not self.received:
            self._first_at = monotonic()
            return False
        is_soon = monotonic() - self._first_at < self.together
        return is_soon and len(self.received) == 1 and number != self.received[0]

    def _end_beginning(self) -> None:
        self.end_within(0.0, self.status if self._early is None else self._early)

    def _set_alarm(self) -> None:
        """Set the alarm timer for the deadline or, after a signal, for at most `GRACE` from now.

        After the timer has expired once, it expires again every `GRACE`, because a single alarm
        could get lost. While the main thread is in a busy loop, Python 3.11 may record a signal
        without running the signal's handler.
        """
        if not HAS_ALARM:  # `_watch` looks at the deadline by itself
            return
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

    def _watch(self) -> None:
        """End the process when the deadline has passed. Runs in a thread, without an alarm timer.

        The thread only reads the deadline that the signal handlers write. The signal handlers
        cannot start a `threading.Timer` instead, because a timer takes a lock. Signal handlers must
        take no lock, because they may interrupt the main thread anywhere.
        """
        while monotonic() < self._due:
            sleep(TICK)
        self._end(self._late)

    def _end(self, status: int) -> NoReturn:
        try:
            self.restore()
            _write_at_once(self.last_words())
        finally:
            os._exit(status)


def _write_at_once(text: str) -> None:
    """Write to stderr, unless the write would block."""
    if text and (not WAITS_FOR_FILES or select.select((), (STDERR,), (), 0)[1]):
        os.write(STDERR, text.encode(errors="backslashreplace"))


def _read(file: int, woken: socket.socket, most: int) -> bytes:
    """Wait until a file has data or has ended, and read a part of it."""
    while True:
        ready, _, _ = select.select([file, woken.fileno()], (), ())
        if woken.fileno() in ready:  # a signal that does not end the program
            woken.recv(CHUNK)
        if file in ready:
            return os.read(file, most)


def _reading_thread(file: int) -> Callable[[int], bytes]:
    """Return a function that reads like `_read`, for systems where `select` supports no files.

    Each part is read in another thread. The main thread checks at short intervals whether that
    thread has read something, so that signal handlers can run between two checks. After a signal,
    the other thread may keep waiting for data, but it does not keep the program alive.
    """
    import queue
    from threading import Thread

    parts: queue.SimpleQueue[bytes | OSError] = queue.SimpleQueue()

    def read(most: int) -> None:
        try:
            parts.put(os.read(file, most))
        except OSError as error:
            parts.put(error)

    def wait(most: int) -> bytes:
        Thread(target=read, args=(most,), name="reading", daemon=True).start()
        while True:
            try:
                part = parts.get(timeout=TICK)
            except queue.Empty:
                continue
            if isinstance(part, OSError):
                raise part
            return part

    return wait


@contextmanager
def _woken_by_signals() -> Iterator[socket.socket]:
    """Yield a socket that becomes readable when a signal comes, on Windows too."""
    import socket

    reader, writer = socket.socketpair()
    with reader, writer:
        writer.setblocking(False)
        before = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
        try:
            yield reader
        finally:
            signal.set_wakeup_fd(before)
