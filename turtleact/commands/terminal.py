"""Draws a live display on a terminal: its region, frames, log lines and keys.

Only `Region` moves the cursor and changes the terminal's modes. During `Region.held`, the cursor is
hidden and typed characters are not echoed. If keys are read, each key arrives as soon as it is
pressed, without Enter. When the process ends or stops, the cursor and the modes are restored. Only
SIGKILL and SIGSTOP prevent that, because a process cannot handle them.

During `Region.held`, an `Outlet` writes to the terminal without waiting. Frames are skipped while
the terminal accepts no text, for example because the user pressed Ctrl-S or the connection hangs.

Two problems remain:

- When the window gets narrower, the terminal wraps the lines of the frame. That may push the first
  lines into the history, where they cannot be erased.
- Keys that are pressed but not read stay in the terminal's input. The next program that reads from
  the terminal, such as the shell, receives the unread keys.

Source: ECMA-48 for the control sequences; xterm for the control sequences of the arrow keys; the
terminals' mode 2026 for frames without flicker; the GNU C Library manual, "Signaling Yourself", for
how to stop the process.
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

STOPPING: Final = [
    getattr(signal, each) for each in ("SIGTSTP", "SIGQUIT") if hasattr(signal, each)
]
"""The signals that stop or end the process."""

CONTINUING: Final = [signal.SIGCONT] if hasattr(signal, "SIGCONT") else []
"""The signal that continues a stopped process.

While the process is stopped, another process may use the terminal.
"""

GIVE_BACK: Final = "\r\x1b[K\x1b7\x1b[B\x1b[J\x1b8\x1b[?25h"
"""Removes the frame and shows the cursor.

The first line is erased separately. Some terminals copy the screen to their history when a single
control sequence erases the whole screen.
"""

BACKGROUND: Final = 0.2
"""The interval at which a background process checks whether it is in the foreground again (s)."""

ARROWS: Final = {b"A": "up", b"B": "down", b"C": "right", b"D": "left"}

TOKEN: Final = re.compile(
    rb"\x1b\[[0-?]*[ -/]*(?P<csi>[@-~])|\x1bO(?P<ss3>[@-~])"
    rb"|(?P<begun>\x1b(?:\[[0-?]*[ -/]*|O)?\Z)|(?P<key>[^\x1b])|\x1b"
)
"""Matches a control sequence, an incomplete one at the end of the input, a key, or a lone ESC."""


def can_move(stream: TextIO | None) -> bool:
    """Whether a stream is a UTF-8 terminal that can move its cursor."""
    return (
        stream is not None
        and stream.isatty()
        and console().can_move()
        and stream.encoding.lower().replace("-", "") == "utf8"
    )


class Outlet:
    """Writes to a terminal without waiting. Buffers the text that the terminal does not accept yet.

    The outlet opens the terminal a second time for non-blocking mode. Otherwise the mode would also
    apply to the shell, because the shell and this process share the open file of the terminal. If
    the terminal cannot be opened a second time, writing may block. In that case, frames are drawn
    only while the terminal accepts text.

    Attributes:
        is_writing: Whether `push` is writing at the moment. A signal handler must not write to the
            terminal during a `push`, because its text would end up in the middle of other text.
        due: A function that `push` calls once, as soon as it has stopped writing; None if there is
            nothing to call.
    """

    def __init__(self, stream: TextIO) -> None:
        self.is_writing = False
        self.due: Callable[[], object] | None = None
        self._stream = stream
        self._kept = b""
        self._descriptor = console().reopen(stream)

    def write(self, text: str) -> None:
        """Append text to the buffer, and write as much of the buffer as the terminal accepts."""
        if self._descriptor is None:
            self._stream.write(text)
            self._stream.flush()
        else:
            self._kept += text.encode(errors="backslashreplace")
            self.push()

    def push(self) -> bool:
        """Write the buffered text, and return whether the terminal has accepted all of it."""
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
        """Write text ahead of the buffered text.

        If the terminal does not accept the text now, drop the text.
        """
        if self._descriptor is not None:
            with suppress(BlockingIOError):
                os.write(self._descriptor, text.encode())

    async def drained(self) -> None:
        """Wait until the terminal has accepted all buffered text. Cancelling: safe."""
        while self._descriptor is not None and not self.push():
            await anyio.wait_writable(self._descriptor)

    def close(self) -> None:
        """Close the outlet's own file descriptor of the terminal. Buffered text is lost."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is not None:
            os.close(descriptor)


class Region:
    """Lines at the end of the screen that are redrawn with each frame.

    Between two frames, the hidden cursor stands at the beginning of the region's first line. When
    the window is resized, the terminal wraps its lines again. The cursor moves with the line that
    it is on, so the next frame starts where the last one did.

    Each line is erased before it is drawn. Otherwise the terminal could still regard several rows
    as one wrapped line, and would join the new text of these rows at the next resize.

    Args:
        stream: The terminal to draw on.
        keyboard: The stream from which keys are read one by one, without Enter; None if no keys are
            read.
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
        """The size of the window, in columns and lines."""
        try:
            columns, rows = os.get_terminal_size(self._stream.fileno())
        except OSError:
            columns, rows = 0, 0
        return columns or 80, rows or 24

    def is_ready(self) -> bool:
        """Whether `draw` would draw a frame now.

        No frame is drawn after `say_last`, or while the terminal has not accepted all earlier text.
        While this process is in the background, no frame is drawn either, because another process
        has the terminal.
        """
        if self._is_over or not self.is_in_foreground():
            return False
        return self._outlet is None or self._outlet.push()

    def draw(self, lines: Sequence[str]) -> None:
        """Draw a frame in place of the last one, if `is_ready`.

        The window must be at least one line higher than the frame.
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
        """Remove the frame, and print text. The next frame is drawn below the text."""
        self.clear()
        self._write(text)

    def say_last(self, lines: Sequence[str]) -> None:
        """Print the last frame, which stays on the screen. All later text is printed below it."""
        self._is_over = True
        if self.is_in_foreground():
            self.say("".join(f"{line}\n" for line in lines))

    def clear(self) -> None:
        """Remove the frame from the screen, and show the cursor."""
        if self._is_drawn:
            self._write(GIVE_BACK)
            self._is_drawn = False

    async def drained(self) -> None:
        """Wait until the terminal has accepted all text. Cancelling: safe."""
        if self._outlet is not None:
            await self._outlet.drained()

    def is_in_foreground(self) -> bool:
        """Whether the process is in the foreground.

        Also true if the stream is not the controlling terminal of this process.
        """
        return console().is_in_foreground(self._stream)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Prepare the terminal for frames during a block, and restore the terminal afterwards.

        On SIGTSTP (Ctrl-Z) or SIGQUIT during the block, the terminal is restored before the signal
        stops or ends the process. When SIGCONT has continued the process, the next frame is drawn
        at the cursor's position.
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
        """Remove the frame, show the cursor, and restore the terminal's modes.

        This may be called at any time, even by a signal handler.
        """
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
        """Restore the terminal, then let the signal stop or end the process.

        If the `Outlet` is writing, the signal is handled as soon as the outlet has stopped writing.
        """
        if self._outlet is not None and self._outlet.is_writing:
            self._outlet.due = partial(self._follow, number, None)
            return
        # For SIGTSTP the process stops inside `raise_signal`, and the next line runs after SIGCONT.
        self.restore()
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)
        signal.signal(number, self._follow)

    def _forget(self, _: int, __: FrameType | None) -> None:
        """Forget the last frame, because another process may have written over it."""
        self._is_drawn = False
        if self._keyboard is not None and self._modes is None and self.is_in_foreground():
            self._silence()

    def _silence(self) -> None:
        """Turn echo off, because echoed characters would damage the frame."""
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
"""The minimum height of the frame that stays on the screen at the end, enough for a small map.

This last frame may shrink to this height to make room for the text below the frame.
"""

FULL: Final = 2
"""This many lines of a frame fill the whole width of the window.

When the window gets narrower, each of these lines wraps onto two lines.
"""


class Compose(Protocol):
    """A function that composes the picture to draw."""

    def __call__(self, *, width: int, height: int) -> render.Picture:
        """Compose the picture for a display of ``width`` columns and ``height`` lines."""


def draw(region: Region, compose: Compose) -> None:
    """Compose and draw a frame, if the region is ready; see `Region.is_ready`."""
    if not region.is_ready():
        return
    from turtleact import render  # rich takes long to import

    columns, rows = region.size()
    width, height = columns - 1, max(rows - 1 - FULL, 1)
    content = compose(width=width, height=height)
    region.draw(render.lines(content, width=width, height=height))


def print_last(region: Region, compose: Compose, *, below: int) -> None:
    """Print the last frame, which stays on the screen.

    Args:
        region: The region that the earlier frames were drawn on.
        compose: Composes the frame.
        below: How many lines will be printed below the frame. The frame leaves room for these
            lines, unless it would become smaller than `SMALLEST`.
    """
    from turtleact import render  # as above

    columns, rows = region.size()
    width, height = columns - 1, max(rows - below, min(rows - 1, SMALLEST), 1)
    region.say_last(render.lines(compose(width=width, height=height), width=width, height=height))


async def animate(region: Region, compose: Compose) -> None:
    """Enter `Region.held`, and draw frames until the task is cancelled."""
    with region.held():
        await keep_drawing(region, compose)


async def keep_drawing(region: Region, compose: Compose) -> None:
    """Draw frames until the task is cancelled. The caller must have entered `Region.held`.

    This function draws at most 15 frames a second, and uses at most a fifth of the processor's
    time. The first frame may take longer, because modules are imported to draw it.
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
    """A line of the log: a text for the live display, and a text to print when the display ends.

    Attributes:
        short: The line as the display shows it.
        full: The line as it is printed when the display ends.
        subject: What the line is about, if it comes from `LogLines.retell`; otherwise empty.
    """

    short: str
    full: str
    subject: str = ""


class LogLines(io.TextIOBase):
    """The newest lines of a log, as a text stream that any thread can print to."""

    def __init__(self) -> None:
        super().__init__()
        self._lines: deque[LogLine] = deque(maxlen=MOST)
        self._begun = ""

    def add(self, line: str, short: str | None = None) -> None:
        """Add a line. If ``short`` is given, the display shows that text instead of the line."""
        self._lines.append(LogLine(line if short is None else short, line))

    def retell(self, subject: str, text: str) -> None:
        """Remove all lines about a subject, and add the lines of a text about this subject."""
        for line in self.lines():
            if line.subject == subject:
                with suppress(ValueError):  # another thread has pushed it out by now
                    self._lines.remove(line)
        self._lines.extend(LogLine(line, line, subject) for line in text.split("\n"))

    def lines(self) -> list[LogLine]:
        """All kept lines, the newest last."""
        return list(self._lines)

    def write(self, text: str) -> int:
        """Add the complete lines of a text. Keep the rest until its line is complete.

        If a line differs from the previous line only in numbers, it replaces the previous line.
        Otherwise a turtle at the wall, which causes 62 warnings a second, would fill the log.
        """
        *whole, self._begun = (self._begun + text).split("\n")
        for line in whole:
            if self._lines and _words(self._lines[-1].full) == _words(line):
                self._lines.pop()
            self.add(line)
        return len(text)

    def close(self) -> None:
        """Do nothing, because the log must stay open even if a body closes its stdout."""

    @contextmanager
    def listening(self) -> Iterator[None]:
        """During a block, add all text printed to stdout to this log.

        Text printed to stderr is added too, unless stderr is redirected to a file or pipe.
        """
        is_shown = sys.stderr is None or sys.stderr.isatty()
        with redirect_stdout(self), redirect_stderr(self) if is_shown else nullcontext():
            yield


class Keys:
    """Decodes pressed keys from the bytes of a terminal.

    The bytes of one control sequence may be split between two calls of `read`.
    """

    def __init__(self) -> None:
        self._begun = b""

    def read(self, data: bytes) -> list[str]:
        r"""Return the pressed keys: ``up``, ``down``, ``left``, ``right``, or a lower-case letter.

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
    """Yield keys as they are pressed, until the terminal is closed; see `Keys.read`.

    While this process is in the background, no keys are read, because they are for another process.

    Args:
        region: The region of the display. The caller must have entered `Region.held`.
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
