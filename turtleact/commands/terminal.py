"""Draws a live display on a terminal: its region, frames, log lines and keys.

Only `Region` moves the cursor and changes the terminal's modes. While a region is held, the cursor
is hidden and typed characters are not echoed. If keys are read, each key comes at once, without
Enter. All of this is undone whenever the process ends or stops. Only SIGKILL and SIGSTOP cannot be
handled.

While a region is held, writing never waits for the terminal (`Outlet`). Frames are left out while
the terminal takes no text, for example because the user pressed Ctrl-S or the connection hangs.

Two limits remain. When the window gets narrower, the terminal wraps lines again, which may push the
first lines out of the window for good. Besides, keys that nobody reads are kept for the next
reader, such as the shell.

Source: ECMA-48 for the control sequences, and xterm's for the arrows; the terminals' mode 2026 for
frames without flicker; the GNU C Library manual, "Signaling Yourself", for how to stop.
"""

from __future__ import annotations

import io
import os
import re
import signal
import sys
import time
from collections import deque
from collections.abc import AsyncGenerator, Iterator
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout, suppress
from functools import partial
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol, TextIO

import anyio

from turtleact.commands.console import console
from turtleact.commands.interrupts import signals

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import FrameType

    from turtleact import render

__all__ = [
    "Compose",
    "Keys",
    "LogLine",
    "LogLines",
    "Region",
    "animate",
    "can_move",
    "draw",
    "keep_drawing",
    "print_last",
    "typed_keys",
]

STOPPING: Final = signals("SIGTSTP", "SIGQUIT")

CONTINUING: Final = signals("SIGCONT")
"""The signals that stop and continue the process.

In between, another process may have the terminal.
"""

GIVE_BACK: Final = "\r\x1b[K\x1b7\x1b[B\x1b[J\x1b8\x1b[?25h"
"""Removes the lines and shows the cursor. The first line is erased separately: some terminals copy
a screen that is erased from its very top into their history."""

BACKGROUND: Final = 0.2
"""The interval at which a background process checks whether it is in the foreground again (s)."""

ARROWS: Final = {b"A": "up", b"B": "down", b"C": "right", b"D": "left"}

TOKEN: Final = re.compile(
    rb"\x1b\[[0-?]*[ -/]*(?P<csi>[@-~])|\x1bO(?P<ss3>[@-~])"
    rb"|(?P<begun>\x1b(?:\[[0-?]*[ -/]*|O)?\Z)|(?P<key>[^\x1b])|\x1b"
)
"""The pattern of a control sequence, of its beginning at the very end, of a key, or of an ESC."""


def can_move(stream: TextIO | None) -> bool:
    """Whether a stream is a terminal that can move its cursor and show braille."""
    return (
        stream is not None
        and stream.isatty()
        and console().can_move()
        and stream.encoding.lower().replace("-", "") == "utf8"
    )


class Outlet:
    """Writes to a terminal without waiting. Text that the terminal does not take yet is kept.

    The terminal is opened a second time, because non-blocking mode belongs to the open file, and
    the process shares its open file with the shell. If the terminal cannot be opened again, a frame
    is written only while the terminal accepts text, and writing it may block.

    Attributes:
        is_writing: Whether text is being written right now. Text from a signal handler would end up
            in the middle of it.
        due: Called as soon as nothing is being written.
    """

    def __init__(self, stream: TextIO) -> None:
        self.is_writing = False
        self.due: Callable[[], object] | None = None
        self._stream = stream
        self._kept = b""
        self._descriptor = console().reopen(stream)

    def write(self, text: str) -> None:
        """Write after the kept text. Text that the terminal does not take now is kept too."""
        if self._descriptor is None:
            self._stream.write(text)
            self._stream.flush()
        else:
            self._kept += text.encode(errors="backslashreplace")
            self.push()

    def push(self) -> bool:
        """Write the text that is kept, and return whether the terminal has taken all of it."""
        if self._descriptor is None:
            return not self._stream.isatty() or console().takes_text(self._stream)
        self.is_writing = True
        try:
            while self._kept:
                written = os.write(self._descriptor, self._kept)
                self._kept = self._kept[written:]
        except BlockingIOError:
            return False
        finally:
            # A signal that came while text was being written takes effect now, between two texts.
            self.is_writing = False
            due, self.due = self.due, None
            if due is not None:
                due()
        return not self._kept

    def interject(self, text: str) -> None:
        """Write at once, before the text that is kept, if the terminal takes it."""
        if self._descriptor is not None:
            with suppress(BlockingIOError):
                os.write(self._descriptor, text.encode())

    async def drained(self) -> None:
        """Wait until the terminal has taken everything. Cancelling: safe."""
        while self._descriptor is not None and not self.push():
            await anyio.wait_writable(self._descriptor)

    def close(self) -> None:
        """Write nothing more. Kept text is lost."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is not None:
            os.close(descriptor)


class Region:
    """Lines at the end of the screen that are redrawn again and again.

    Between two frames the hidden cursor stands at the beginning of the first line. When a terminal
    is resized and wraps lines anew, the cursor stays with its line, so the next frame starts where
    the last one did. Each line is erased before it is drawn: otherwise the terminal would remember
    rows as parts of a wrapped line, and would wrap their new text together at the next resize.

    Args:
        stream: The terminal.
        keyboard: The stream from which keys are read, each at once; None if no keys are read.
    """

    def __init__(self, stream: TextIO, keyboard: TextIO | None = None) -> None:
        self._stream = stream
        self._keyboard = keyboard
        self._outlet: Outlet | None = None  # while it is held
        self._is_drawn = False
        self._is_over = False
        self._is_held = False
        self._modes: object | None = None  # as they were found, while there is no echo

    def size(self) -> tuple[int, int]:
        """The current columns and lines of the window."""
        try:
            columns, rows = os.get_terminal_size(self._stream.fileno())
        except OSError:
            columns, rows = 0, 0
        return columns or 80, rows or 24

    def is_ready(self) -> bool:
        """Whether a frame would be drawn now.

        No frame is drawn after the last one, or while the terminal has not taken all of the
        previous text. In the background, no frame is drawn either, because the terminal belongs to
        another process.
        """
        if self._is_over or not self.is_in_foreground():
            return False
        return self._outlet is None or self._outlet.push()

    def draw(self, lines: Sequence[str]) -> None:
        """If `is_ready`, draw lines in place of the last ones.

        The window must have at least one line more than these.
        """
        if not self.is_ready():
            return
        if self._is_held and self._modes is None:
            self._silence()
        text = "\n".join(f"\x1b[2K{line}" for line in lines)
        back = f"\x1b[{len(lines) - 1}A" if len(lines) > 1 else ""
        self._is_drawn = True  # a signal may stop the writing
        self._write(f"\x1b[?2026h\x1b[?25l\r{text}\x1b[J{back}\r\x1b[?2026l")

    def say(self, text: str) -> None:
        """Print text that stays above the next frame."""
        self.clear()
        self._write(text)

    def say_last(self, lines: Sequence[str]) -> None:
        """Print the last frame, which stays. Text that is printed later comes below it."""
        self._is_over = True
        if self.is_in_foreground():
            self.say("".join(f"{line}\n" for line in lines))

    def clear(self) -> None:
        """Remove the lines, and show the cursor."""
        if self._is_drawn:
            self._write(GIVE_BACK)
            self._is_drawn = False

    async def drained(self) -> None:
        """Wait until the terminal has taken all text. Cancelling: safe."""
        if self._outlet is not None:
            await self._outlet.drained()

    def is_in_foreground(self) -> bool:
        """Whether the process is in the foreground, or the terminal controls no process."""
        return console().is_in_foreground(self._stream)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Let frames be drawn during a block. After it, the terminal is as it was before.

        On SIGTSTP (Ctrl-Z) or SIGQUIT during the block, the terminal is given back first. Then the
        signal has its default effect. After SIGCONT the next frame is drawn where the cursor
        stands.
        """
        handlers: dict[signal.Signals, Callable[[int, FrameType | None], None]] = {
            **dict.fromkeys(STOPPING, self._follow),
            **dict.fromkeys(CONTINUING, self._forget),
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
            # The handlers are the last to go: until then a signal still gives the terminal back
            # first. `restore` writes through the outlet, so that is closed after it.
            self._is_held = False
            self.restore()
            self._outlet = None
            outlet.close()
            for number in taken:
                signal.signal(number, signal.SIG_DFL)

    def restore(self) -> None:
        """Give the terminal back as it was; never blocks, and may be called at any moment."""
        # Noted as done before it is done: a signal handler may call this in the middle of it, and
        # must not do it a second time.
        is_drawn, self._is_drawn = self._is_drawn, False
        modes, self._modes = self._modes, None
        with suppress(OSError):  # if it is gone, there is nothing to give back
            if is_drawn and self._outlet is not None:
                if self._outlet.is_writing:  # and the process is about to end
                    self._outlet.interject(GIVE_BACK)
                else:
                    self._outlet.write(GIVE_BACK)
            elif is_drawn and console().takes_text(self._stream):
                os.write(self._stream.fileno(), GIVE_BACK.encode())
            if modes is not None and self.is_in_foreground():
                console().give_back(self._typed_at(), modes)

    def _follow(self, number: int, _: FrameType | None) -> None:
        """Let a signal have its default effect. The process may be continued afterwards."""
        if self._outlet is not None and self._outlet.is_writing:
            self._outlet.due = partial(self._follow, number, None)
            return
        # For SIGTSTP the process stops inside `raise_signal`, and the next line runs after SIGCONT.
        self.restore()
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)
        signal.signal(number, self._follow)

    def _forget(self, _: int, __: FrameType | None) -> None:
        """Forget the last frame, because another process has used the screen."""
        self._is_drawn = False
        if self._keyboard is not None and self._modes is None and self.is_in_foreground():
            self._silence()

    def _silence(self) -> None:
        """Turn echo off, because typed characters would tear the frame apart."""
        by_key = self._keyboard is not None
        self._modes = console().silence(self._typed_at(), by_key=by_key)

    def _typed_at(self) -> TextIO:
        return self._keyboard or self._stream

    def _write(self, text: str) -> None:
        if self._outlet is not None:
            self._outlet.write(text)
            return
        self._stream.write(text)
        self._stream.flush()


PERIOD: Final = 1 / 15
"""The shortest time between two frames (s, wall clock)."""

SHARE: Final = 0.2
"""The share of processor time that drawing may take."""

SMALLEST: Final = 14
"""The minimum height of a last frame, enough for a small map.

A last frame shrinks to make room for the text below it.
"""

FULL: Final = 2
"""How many lines of a frame fill the width of the window.

In a narrower window, each becomes two.
"""


class Compose(Protocol):
    """A function that composes the current picture."""

    def __call__(self, *, width: int, height: int) -> render.Picture:
        """Compose the picture for a number of columns and lines."""


def draw(region: Region, compose: Compose) -> None:
    """Draw a frame, unless the terminal has not taken the previous one yet."""
    if not region.is_ready():
        return
    from turtleact import render  # rich takes long to import

    columns, rows = region.size()
    width, height = columns - 1, max(rows - 1 - FULL, 1)
    content = compose(width=width, height=height)
    region.draw(render.lines(content, width=width, height=height))


def print_last(region: Region, compose: Compose, *, below: int) -> None:
    """Print a last frame that stays.

    Args:
        region: The region that the earlier frames were drawn on.
        compose: Composes the frame.
        below: How many lines will be printed below the frame. The frame leaves room for them,
            unless it would become smaller than `SMALLEST`.
    """
    from turtleact import render  # as above

    columns, rows = region.size()
    width, height = columns - 1, max(rows - below, min(rows - 1, SMALLEST), 1)
    region.say_last(render.lines(compose(width=width, height=height), width=width, height=height))


async def animate(region: Region, compose: Compose) -> None:
    """Hold the terminal and draw frames until this is cancelled."""
    with region.held():
        await keep_drawing(region, compose)


async def keep_drawing(region: Region, compose: Compose) -> None:
    """Draw frames on a held terminal until this is cancelled.

    This function draws at most 15 frames a second, and takes at most a fifth of the processor's
    time. The first frame, which imports modules, does not count.
    """
    draw(region, compose)
    await anyio.sleep(PERIOD)
    while True:
        began = time.thread_time()
        draw(region, compose)
        spent = time.thread_time() - began
        await anyio.sleep(max(PERIOD, spent / SHARE) - spent)


MOST: Final = 200
"""How many log lines are kept."""


class LogLine(NamedTuple):
    """A line of the log in two forms: one for the display, and one for the end of the display.

    Attributes:
        short: The line as the display shows it.
        full: The line as it is printed when the display ends.
        subject: The subject of the line, if later lines about the same subject replace it.
    """

    short: str
    full: str
    subject: str = ""


class LogLines(io.TextIOBase):
    """The newest lines of a log. It is a stream, and any thread can print to it."""

    def __init__(self) -> None:
        super().__init__()
        self._lines: deque[LogLine] = deque(maxlen=MOST)
        self._begun = ""

    def add(self, line: str, short: str | None = None) -> None:
        """Add a line."""
        self._lines.append(LogLine(line if short is None else short, line))

    def retell(self, subject: str, text: str) -> None:
        """Add the lines of a text in place of all earlier lines about the same subject."""
        for line in self.lines():
            if line.subject == subject:
                with suppress(ValueError):  # another thread has pushed it out by now
                    self._lines.remove(line)
        self._lines.extend(LogLine(line, line, subject) for line in text.split("\n"))

    def lines(self) -> list[LogLine]:
        """The lines, the newest last."""
        return list(self._lines)

    def write(self, text: str) -> int:
        """Add complete lines. A line that differs from the last only in numbers replaces it.

        For example, a turtle at the wall causes 62 warnings a second.
        """
        *whole, self._begun = (self._begun + text).split("\n")
        for line in whole:
            if self._lines and _words(self._lines[-1].full) == _words(line):
                self._lines.pop()
            self.add(line)
        return len(text)

    def close(self) -> None:
        """Do nothing: a body that closes this as its stdout must not end the log."""

    @contextmanager
    def listening(self) -> Iterator[None]:
        """During a block, add prints to stdout to this log.

        Prints to stderr are added too, unless stderr is redirected.
        """
        is_shown = sys.stderr is None or sys.stderr.isatty()
        with redirect_stdout(self), redirect_stderr(self) if is_shown else nullcontext():
            yield


class Keys:
    """Reads keys from bytes. A control sequence may come in parts."""

    def __init__(self) -> None:
        self._begun = b""

    def read(self, data: bytes) -> list[str]:
        r"""Return the keys: ``up``, ``down``, ``left``, ``right``, or a small letter.

        Other keys are ignored.

        >>> Keys().read(b"G\x1b[Aq")
        ['g', 'up', 'q']
        """
        data, self._begun = self._begun + data, b""
        keys = []
        for token in TOKEN.finditer(data):
            self._begun = token["begun"] or b""
            arrow = ARROWS.get(token["csi"] or token["ss3"] or b"")
            if arrow is not None:
                keys.append(arrow)
            elif token["key"] is not None and token["key"].isalpha():
                keys.append(token["key"].decode().lower())
        return keys


async def typed_keys(region: Region) -> AsyncGenerator[str, None]:
    """Yield keys as they are pressed, until the terminal is gone; see `Keys.read`.

    While this process is in the background, no keys are read, because they are for another process.

    Args:
        region: The region of the display, which must be held.
    """
    keys = Keys()
    while True:
        await console().wait_for_key(sys.stdin)
        if not region.is_in_foreground():
            await anyio.sleep(BACKGROUND)
            continue
        data = console().typed(sys.stdin)
        for key in keys.read(data):
            yield key
        if not data:
            return


def _words(line: str) -> str:
    return re.sub(r"[-\d.]+", "", line)
