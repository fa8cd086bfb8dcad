"""Shows a live display at the end of a terminal, with rich, and reads keys.

Printed lines scroll above the display. When the display ends, its last frame stays on the screen.
"""

from __future__ import annotations

import io
import os
import re
import select
import sys
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from importlib.util import find_spec
from time import perf_counter
from typing import TYPE_CHECKING, Any, Final, Protocol, TextIO

import anyio

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.live import Live

__all__ = ["Compose", "Screen", "can_move", "can_read_keys", "cbreak", "typed_keys"]

PERIOD: Final = 1 / 15
"""The shortest time between two frames (s, wall clock)."""

REST: Final = 4.0
"""After each frame, the display rests at least this many times as long as the frame took."""

ABOVE: Final = 4
"""How many lines of the window a frame leaves to the lines above it, if the window is high."""

MOST_LINES: Final = 1000
"""At most this many lines wait to be printed above a frame."""

LOW: Final = 20
"""In a window lower than this (lines), a frame leaves only one line free."""

STDOUT: Final = 1

LOCAL_MODES: Final = 3
CONTROL_CHARACTERS: Final = 6
"""Indices in the list that ``termios.tcgetattr`` returns."""

KEYS: Final = re.compile(r"\x1b[\[O]([A-D])|\x1b\[[0-9;]*.|([A-Za-z])")
"""Matches an arrow key, another control sequence, or a letter."""

ARROWS: Final = {"A": "up", "B": "down", "C": "right", "D": "left"}


class Compose(Protocol):
    """A function that composes the picture to draw."""

    def __call__(self, *, width: int, height: int) -> RenderableType:
        """Compose the picture for a display of ``width`` columns and at most ``height`` lines."""


def can_move(stream: TextIO | None) -> bool:
    """Whether a stream is a terminal that can show a display, with this process in front."""
    return (
        stream is not None
        and stream.isatty()
        and stream.encoding.lower().replace("-", "") == "utf8"
        and os.environ.get("TERM", "") not in ("dumb", "unknown")
        and _is_in_foreground(stream)
    )


def _is_in_foreground(stream: TextIO) -> bool:
    """Whether this process may change the modes of its terminal. Windows has no job control."""
    try:
        return os.tcgetpgrp(stream.fileno()) == os.getpgrp()
    except (OSError, AttributeError):
        return True


def can_read_keys() -> bool:
    """Whether stdin is a terminal from which single keys can be read. Not on Windows."""
    return sys.stdin is not None and sys.stdin.isatty() and find_spec("termios") is not None


class Screen:
    """A live display on stdout.

    Args:
        compose: Composes the frames.
    """

    def __init__(self, compose: Compose) -> None:
        self._compose = compose
        self._live: Live | None = None  # once it is shown
        self._lines: deque[str] = deque(maxlen=MOST_LINES)
        self._drawn = io.StringIO()
        self._stream = sys.stdout
        self._restore: Callable[[], object] = bool

    async def run(self) -> None:
        """Show frames until the task is cancelled. Whatever is printed scrolls above them.

        The first frame may take long, because modules are imported to draw it. A thread writes the
        frames, so that a terminal that takes no text, for example after Ctrl-S, holds up nothing.
        """
        with self._shown():
            while True:
                began = perf_counter()
                self._draw()
                rest = max(PERIOD, REST * (perf_counter() - began))
                await anyio.to_thread.run_sync(self._write, self._taken(), abandon_on_cancel=True)
                await anyio.sleep(rest)

    def _draw(self) -> None:
        """Print the lines that have come since the last frame, and draw a frame."""
        from rich.text import Text

        if self._live is None:
            return
        while self._lines:
            self._live.console.print(Text.from_ansi(self._lines.popleft()))
        self._live.refresh()

    def _taken(self) -> str:
        """Return what rich has drawn since the last call."""
        text = self._drawn.getvalue()
        self._drawn.seek(0)
        self._drawn.truncate()
        return text

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()

    @contextmanager
    def _shown(self) -> Iterator[None]:
        from rich.console import Console
        from rich.live import Live

        console = Console(
            file=self._drawn, force_terminal=True, highlight=False, markup=False, emoji=False
        )

        def compose() -> RenderableType:
            width, lines = console.size
            height = lines - (ABOVE if lines >= LOW else 1)
            return self._compose(width=width - 1, height=max(height, 1))

        live = Live(
            console=console,
            get_renderable=compose,
            auto_refresh=False,
            redirect_stdout=False,
            redirect_stderr=False,
            vertical_overflow="crop",
        )
        # At the end, this is undone in reverse: lines go to stdout again, the last lines and the
        # last frame are drawn, rich shows the cursor, all is written, and the terminal echoes.
        with ExitStack() as stack:
            if can_read_keys():
                self._restore = stack.enter_context(cbreak(sys.stdin))
            stack.enter_context(suppress(OSError))  # the terminal may go away
            stack.callback(lambda: self._write(self._taken()))
            self._live = stack.enter_context(live)
            stack.callback(self._draw)
            stack.enter_context(redirect_stdout(_Above(self._lines)))
            if sys.stderr is None or sys.stderr.isatty():
                stack.enter_context(redirect_stderr(_Above(self._lines, thins=True)))
            yield

    def close(self) -> None:
        """Restore the terminal. A signal handler may call this."""
        if self._live is not None and self._live.is_started and _takes_text():
            with suppress(OSError):
                os.write(STDOUT, b"\n\x1b[?25h")
        self._restore()


class _Above(io.TextIOBase):
    """A text stream for lines above a display. Any thread may print to it.

    Args:
        lines: Where the lines go.
        thins: Whether to leave out a line that differs from the line before it only in its numbers.
            A turtle at the wall, for example, causes 62 warnings a second.
    """

    def __init__(self, lines: deque[str], *, thins: bool = False) -> None:
        super().__init__()
        self._lines = lines
        self._thins = thins
        self._begun = ""
        self._last = ""

    def write(self, text: str) -> int:
        """Add the complete lines of a text. Keep the rest until its line is complete."""
        *lines, self._begun = (self._begun + text).split("\n")
        for line in lines:
            words = re.sub(r"[-\d.]+", "", line)
            if not self._thins or words != self._last or not words:
                self._lines.append(line)
            self._last = words
        return len(text)

    def close(self) -> None:
        """Do nothing, because a body may close its stdout."""


def _takes_text() -> bool:
    """Whether stdout would accept text at once. Windows does not tell."""
    return os.name != "posix" or bool(select.select((), (STDOUT,), (), 0)[1])


@contextmanager
def cbreak(stream: TextIO) -> Iterator[Callable[[], object]]:
    """During a block, read each key at once, without echo. Yield a function that ends this.

    Ctrl-Z has no effect then, because the process could not restore the terminal before it stops.
    """
    import termios

    before = termios.tcgetattr(stream)
    modes: list[Any] = termios.tcgetattr(stream)
    modes[LOCAL_MODES] &= ~(termios.ECHO | termios.ICANON)
    modes[CONTROL_CHARACTERS][termios.VSUSP] = b"\0"

    def restore() -> None:
        with suppress(OSError, termios.error):  # the terminal may be gone
            termios.tcsetattr(stream, termios.TCSANOW, before)

    termios.tcsetattr(stream, termios.TCSANOW, modes)
    try:
        yield restore
    finally:
        restore()


async def typed_keys() -> AsyncIterator[str]:
    """Yield the keys that are pressed: ``up``, ``down``, ``left``, ``right``, or a letter.

    The iteration ends when the terminal is closed. Use this within `cbreak`.
    """
    while True:
        await anyio.wait_readable(sys.stdin)
        data = os.read(sys.stdin.fileno(), 1024)
        if not data:
            return
        for arrow, letter in KEYS.findall(data.decode(errors="ignore")):
            if arrow or letter:
                yield ARROWS.get(arrow) or letter.lower()
