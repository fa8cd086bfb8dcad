"""The part of a terminal that a live display draws on, and the terminal as it was found.

`Region` alone moves the cursor and changes how the terminal works: while it is held, the cursor is
hidden, what the user types is not shown and, if keys are to be read, comes at once. All of it is
undone however the process ends or stops, but by SIGKILL and SIGSTOP, which ask nobody.

While it is held, nothing that is written waits for the terminal (`Outlet`): one that takes nothing,
as its user has stopped it with Ctrl-S or its connection hangs, misses frames, and holds up nobody.

Two things are left to the terminal. Lines that it wraps anew when its window gets narrower may push
the first of them out of the window, where nothing can take them back. And what is typed is kept for
whoever reads next, such as the shell.

Source: ECMA-48 for the control sequences; the terminals' mode 2026 for frames without flicker; the
GNU C Library manual, "Signaling Yourself", for how to stop.
"""

from __future__ import annotations

import io
import os
import re
import select
import signal
import sys
import termios
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout, suppress
from functools import partial
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol, TextIO

import anyio

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from types import FrameType

    from turtleact import render


__all__ = [
    "Compose",
    "LogLine",
    "LogLines",
    "Region",
    "animate",
    "can_move",
    "draw",
    "keep_drawing",
]

LOCAL_MODES: Final = 3
CONTROL_CHARACTERS: Final = 6
"""Where ``tcgetattr`` keeps the modes that ECHO is one of, and where VMIN and VTIME."""

GIVE_BACK: Final = "\r\x1b[K\x1b7\x1b[B\x1b[J\x1b8\x1b[?25h"
"""Takes the lines away and shows the cursor. Erasing the screen from its very top would make some
terminals keep what stood there in their history, so the first line is erased by itself."""


def can_move(stream: TextIO | None) -> bool:
    """Whether a stream is a terminal that can move its cursor and show braille."""
    return (
        stream is not None
        and stream.isatty()
        and os.environ.get("TERM", "") not in ("", "dumb", "unknown")
        and stream.encoding.lower().replace("-", "") == "utf8"
    )


class Outlet:
    """The way to a terminal, on which nothing waits: what it does not take is kept.

    The terminal is opened a second time: not to wait is a property of an opened file, and the one
    that the process was given is the shell's, too. Where it cannot be opened, a frame is written
    only if the terminal takes something, and may then wait.

    Args:
        stream: The terminal.

    Attributes:
        is_writing: Whether this very moment something is written: what a signal handler writes
            then comes in its middle.
        due: What is to be done as soon as nothing is.
    """

    def __init__(self, stream: TextIO) -> None:
        self.is_writing = False
        self.due: Callable[[], object] | None = None
        self._stream = stream
        self._kept = b""
        self._descriptor = _opened_again(stream)

    def write(self, text: str) -> None:
        """Write what the terminal takes now, behind all that was kept."""
        if self._descriptor is None:
            self._stream.write(text)
            self._stream.flush()
        else:
            self._kept += text.encode(errors="backslashreplace")
            self.push()

    def push(self) -> bool:
        """Write what is kept; whether the terminal has taken all of it."""
        if self._descriptor is None:
            return not self._stream.isatty() or bool(select.select([], [self._stream], [], 0)[1])
        self.is_writing = True
        try:
            while self._kept:
                written = os.write(self._descriptor, self._kept)
                self._kept = self._kept[written:]
        except BlockingIOError:
            return False
        finally:
            self.is_writing = False
            due, self.due = self.due, None
            if due is not None:
                due()
        return not self._kept

    def interject(self, text: str) -> None:
        """Write at once and before all that was kept, if the terminal takes it."""
        if self._descriptor is not None:
            with suppress(BlockingIOError):
                os.write(self._descriptor, text.encode())

    async def drained(self) -> None:
        """Wait until all of it is taken. Cancelling: safe."""
        while self._descriptor is not None and not self.push():
            await anyio.wait_writable(self._descriptor)

    def close(self) -> None:
        """Write nothing more; what is still kept is lost."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is not None:
            os.close(descriptor)


class Region:
    """Some lines at the end of the screen that are drawn again and again.

    Between two frames the hidden cursor stands at the beginning of the first line. A terminal
    that is resized, and wraps the lines anew, keeps the cursor with its line: so the next frame
    begins where the last one did. Each line is erased before it is drawn, or a terminal would take
    lines that it has wrapped for one, and wrap them together the next time.

    Args:
        stream: The terminal.
        keyboard: Where keys are read from, if they are: each comes at once then.
    """

    def __init__(self, stream: TextIO, keyboard: TextIO | None = None) -> None:
        self._stream = stream
        self._keyboard = keyboard
        self._outlet: Outlet | None = None  # while it is held
        self._is_drawn = False
        self._is_held = False
        self._modes: list[Any] | None = None  # as they were found, while there is no echo

    def size(self) -> tuple[int, int]:
        """Columns and lines of the window, as they are now."""
        try:
            columns, rows = os.get_terminal_size(self._stream.fileno())
        except OSError:
            columns, rows = 0, 0
        return columns or 80, rows or 24

    def is_ready(self) -> bool:
        """Whether a frame would be drawn now.

        None is while the process runs in the background, as the terminal is another's then, nor
        while the terminal has yet to take what was written before.
        """
        return self.is_in_foreground() and (self._outlet is None or self._outlet.push())

    def draw(self, lines: Sequence[str]) -> None:
        """Put these lines where the last ones were, if it is ready; the window has a line more."""
        if not self.is_ready():
            return
        if self._is_held and self._modes is None:
            self._silence()
        text = "\n".join(f"\x1b[2K{line}" for line in lines)
        back = f"\x1b[{len(lines) - 1}A" if len(lines) > 1 else ""
        self._is_drawn = True  # a signal may stop the writing
        self._write(f"\x1b[?2026h\x1b[?25l\r{text}\x1b[J{back}\r\x1b[?2026l")

    def say(self, text: str) -> None:
        """Print text that stays; the next frame is drawn below it."""
        self.clear()
        self._write(text)

    def clear(self) -> None:
        """Take the lines away, and show the cursor."""
        if self._is_drawn:
            self._write(GIVE_BACK)
            self._is_drawn = False

    async def drained(self) -> None:
        """Wait until the terminal has taken all that was written. Cancelling: safe."""
        if self._outlet is not None:
            await self._outlet.drained()

    def is_in_foreground(self) -> bool:
        """Whether the terminal is ours to draw on; one that controls no process is."""
        try:
            return os.tcgetpgrp(self._stream.fileno()) == os.getpgrp()
        except OSError:
            return True

    @contextmanager
    def held(self) -> Iterator[None]:
        """A block in which frames are drawn; behind it the terminal is as it was.

        SIGTSTP (Ctrl-Z) and SIGQUIT do what they do by default, but give the terminal
        back first; after SIGCONT the next frame is drawn where the cursor stands then.
        """
        handlers: dict[signal.Signals, Callable[[int, FrameType | None], None]] = {
            signal.SIGTSTP: self._follow,
            signal.SIGQUIT: self._follow,
            signal.SIGCONT: self._forget,
        }
        taken = [each for each in handlers if signal.getsignal(each) is signal.SIG_DFL]
        self._is_held = True
        self._outlet = outlet = Outlet(self._stream)
        try:
            for number in taken:
                signal.signal(number, handlers[number])
            if self._keyboard is not None and self.is_in_foreground():
                self._silence()
            yield
        finally:
            self._is_held = False
            self.restore()
            self._outlet = None
            outlet.close()
            for number in taken:
                signal.signal(number, signal.SIG_DFL)

    def restore(self) -> None:
        """Give the terminal back as it was found; never blocks, and may be called at any moment."""
        is_drawn, self._is_drawn = self._is_drawn, False
        modes, self._modes = self._modes, None
        with suppress(OSError, termios.error):  # where it has gone, there is nothing to give back
            if is_drawn and self._outlet is not None:
                if self._outlet.is_writing:  # and the process is about to end
                    self._outlet.interject(GIVE_BACK)
                else:
                    self._outlet.write(GIVE_BACK)
            elif is_drawn and select.select([], [self._stream], [], 0)[1]:
                os.write(self._stream.fileno(), GIVE_BACK.encode())
            if modes is not None and self.is_in_foreground():
                termios.tcsetattr(self._typed_at(), termios.TCSANOW, modes)

    def _follow(self, number: int, _: FrameType | None) -> None:
        """Do what a signal does by default; the process may be continued."""
        if self._outlet is not None and self._outlet.is_writing:
            self._outlet.due = partial(self._follow, number, None)
            return
        self.restore()
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)
        signal.signal(number, self._follow)

    def _forget(self, _: int, __: FrameType | None) -> None:
        """The screen has been somebody else's."""
        self._is_drawn = False
        if self._keyboard is not None and self._modes is None and self.is_in_foreground():
            self._silence()

    def _silence(self) -> None:
        """Let the terminal not show what is typed: it would tear the frame apart."""
        typed_at = self._typed_at()
        try:
            modes = termios.tcgetattr(typed_at)
        except (OSError, termios.error):
            return  # not a terminal
        self._modes = [*modes]
        modes[LOCAL_MODES] &= ~termios.ECHO
        if self._keyboard is not None:
            modes[LOCAL_MODES] &= ~termios.ICANON
            modes[CONTROL_CHARACTERS] = [*modes[CONTROL_CHARACTERS]]  # those of before are kept
            modes[CONTROL_CHARACTERS][termios.VMIN] = 1
            modes[CONTROL_CHARACTERS][termios.VTIME] = 0
        termios.tcsetattr(typed_at, termios.TCSANOW, modes)

    def _typed_at(self) -> TextIO:
        return self._keyboard or self._stream

    def _write(self, text: str) -> None:
        if self._outlet is not None:
            self._outlet.write(text)
            return
        self._stream.write(text)
        self._stream.flush()


def _opened_again(stream: TextIO) -> int | None:
    """The terminal behind a stream, opened anew, so that writing to it never waits."""
    try:
        name = os.ttyname(stream.fileno())
        descriptor = os.open(name, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError:  # no terminal, or one that was handed on by another user
        return None
    if os.fstat(descriptor).st_rdev != os.fstat(stream.fileno()).st_rdev:  # of another namespace
        os.close(descriptor)
        return None
    return descriptor


PERIOD: Final = 1 / 15
"""Wall seconds from frame to frame, at least."""

SHARE: Final = 0.2
"""The part of the processor's time that drawing may take; what others take meanwhile is not its."""

FULL: Final = 2
"""Lines of a frame that fill the window, beside one that may: they become two if it shrinks."""


class Compose(Protocol):
    """Makes the picture as it is now."""

    def __call__(self, *, width: int, height: int) -> render.Picture:
        """For so many columns and lines."""


def draw(region: Region, compose: Compose) -> None:
    """Draw a frame, unless the terminal has yet to take the one before."""
    if not region.is_ready():
        return
    from turtleact import render  # rich takes long to import

    columns, rows = region.size()
    width, height = columns - 1, max(rows - 1 - FULL, 1)
    content = compose(width=width, height=height)
    region.draw(render.lines(content, width=width, height=height))


async def animate(region: Region, compose: Compose) -> None:
    """Draw a frame now and then, until it is canceled; the terminal is held meanwhile."""
    with region.held():
        await keep_drawing(region, compose)


async def keep_drawing(region: Region, compose: Compose) -> None:
    """The same of a terminal that is held."""
    draw(region, compose)
    await anyio.sleep(PERIOD)
    while True:
        began = time.thread_time()
        draw(region, compose)
        spent = time.thread_time() - began
        await anyio.sleep(max(PERIOD, spent / SHARE) - spent)


MOST: Final = 200
"""So many lines are kept."""


class LogLine(NamedTuple):
    """A line as it is shown, and as it is left standing."""

    short: str
    full: str


class LogLines(io.TextIOBase):
    """The newest lines, as a stream that can be printed to; from any thread."""

    def __init__(self) -> None:
        super().__init__()
        self._lines: deque[LogLine] = deque(maxlen=MOST)
        self._begun = ""

    def add(self, line: str, short: str | None = None) -> None:
        """Add a line."""
        self._lines.append(LogLine(line if short is None else short, line))

    def lines(self) -> list[LogLine]:
        """The lines, the newest last."""
        return list(self._lines)

    def write(self, text: str) -> int:
        """Take the lines that are whole; one that differs from the last in numbers replaces it.

        A turtle at the wall is warned of 62 times a second.
        """
        *whole, self._begun = (self._begun + text).split("\n")
        for line in whole:
            if self._lines and _words(self._lines[-1].full) == _words(line):
                self._lines.pop()
            self.add(line)
        return len(text)

    @contextmanager
    def listening(self) -> Iterator[None]:
        """A block in which what this process prints comes here, unless stderr goes elsewhere."""
        is_shown = sys.stderr is None or sys.stderr.isatty()
        with redirect_stdout(self), redirect_stderr(self) if is_shown else nullcontext():
            yield


def _words(line: str) -> str:
    return re.sub(r"[-\d.]+", "", line)
