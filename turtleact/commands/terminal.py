"""The part of a terminal that a live display draws on, and the terminal as it was found.

`Region` alone moves the cursor and changes how the terminal works: while it is held, the cursor is
hidden and what the user types is not shown. Both are undone however the process ends or stops, but
by SIGKILL and SIGSTOP, which ask nobody.

Two things are left to the terminal. Lines that it wraps anew when its window gets narrower may push
the first of them out of the window, where nothing can take them back. And what is typed is kept for
whoever reads next, such as the shell.

Source: ECMA-48 for the control sequences; the terminals' mode 2026 for frames without flicker; the
GNU C Library manual, "Signaling Yourself", for how to stop.
"""

from __future__ import annotations

import os
import select
import signal
import termios
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, TextIO

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from types import FrameType

__all__ = ["Region"]

LOCAL_MODES: Final = 3
"""Where ``tcgetattr`` keeps the modes that ECHO is one of."""

GIVE_BACK: Final = "\r\x1b[K\x1b7\x1b[B\x1b[J\x1b8\x1b[?25h"
"""Takes the lines away and shows the cursor. Erasing the screen from its very top would make some
terminals keep what stood there in their history, so the first line is erased by itself."""


class Region:
    """Some lines at the end of the screen that are drawn again and again.

    Between two frames the hidden cursor stands at the beginning of the first line. A terminal
    that is resized, and wraps the lines anew, keeps the cursor with its line: so the next frame
    begins where the last one did. Each line is erased before it is drawn, or a terminal would take
    lines that it has wrapped for one, and wrap them together the next time.

    Args:
        stream: The terminal.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
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

    def draw(self, lines: Sequence[str]) -> None:
        """Put these lines where the last ones were; the window must have a line more.

        Nothing is drawn while the process runs in the background: the terminal is another's then.
        """
        if not self._is_in_foreground():
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
        try:
            for number in taken:
                signal.signal(number, handlers[number])
            yield
        finally:
            self._is_held = False
            self.restore()
            for number in taken:
                signal.signal(number, signal.SIG_DFL)

    def restore(self) -> None:
        """Give the terminal back as it was found; never blocks, and may be called at any moment."""
        if self._is_drawn and select.select([], [self._stream], [], 0)[1]:
            os.write(self._stream.fileno(), GIVE_BACK.encode())
        self._is_drawn = False
        modes, self._modes = self._modes, None
        if modes is not None and self._is_in_foreground():
            termios.tcsetattr(self._stream, termios.TCSANOW, modes)

    def _follow(self, number: int, _: FrameType | None) -> None:
        """Do what a signal does by default; the process may be continued."""
        self.restore()
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)
        signal.signal(number, self._follow)

    def _forget(self, _: int, __: FrameType | None) -> None:
        """The screen has been somebody else's."""
        self._is_drawn = False

    def _silence(self) -> None:
        """Let the terminal not show what is typed: it would tear the frame apart."""
        try:
            modes = termios.tcgetattr(self._stream)
        except (OSError, termios.error):
            return  # not a terminal
        self._modes = [*modes]
        modes[LOCAL_MODES] &= ~termios.ECHO
        termios.tcsetattr(self._stream, termios.TCSANOW, modes)

    def _is_in_foreground(self) -> bool:
        """Whether the terminal is ours to draw on; one that controls no process is."""
        try:
            return os.tcgetpgrp(self._stream.fileno()) == os.getpgrp()
        except OSError:
            return True

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()
