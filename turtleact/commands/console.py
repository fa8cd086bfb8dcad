"""Handles terminals on POSIX systems and on Windows.

`termios` and job control exist only on POSIX, and `msvcrt` exists only on Windows. These modules
are imported only when a terminal is used, so every module of turtleact can be imported everywhere.
The rest of turtleact uses a `Console`, which hides the differences between the systems.

Source: the documentation of Python's ``termios`` and ``msvcrt``; Microsoft's "Console Virtual
Terminal Sequences". The part for Windows has been tested only with a stand-in for ``msvcrt``.
"""

from __future__ import annotations

import os
import select
import signal
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final, Protocol, TextIO

import anyio

from turtleact.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Console", "PosixConsole", "WindowsConsole", "console"]

LOCAL_MODES: Final = 3
"""The index of the local modes, such as ECHO, in the list that ``tcgetattr`` returns."""

CONTROL_CHARACTERS: Final = 6
"""The index of the control characters, such as VMIN, in the list that ``tcgetattr`` returns."""

KEY_PERIOD: Final = 0.02
"""How often to poll for pressed keys on Windows (s), where keys cannot wake an event loop."""

SPECIAL: Final = "\x00\xe0"
"""The characters that Windows sends before the code of a special key, such as an arrow key."""

ARROWS: Final = {"H": b"\x1b[A", "P": b"\x1b[B", "M": b"\x1b[C", "K": b"\x1b[D"}
"""Maps the Windows codes of arrow keys to the control sequences that other terminals send."""

CTRL_C: Final = "\x03"

STDOUT: Final = -11
"""The number of the standard output in the Windows API."""

VIRTUAL_TERMINAL: Final = 0x0004
"""The flag in the Windows API that makes a console interpret control sequences."""


class Console(Protocol):
    """The operations on a terminal that differ between systems.

    A parameter called ``stream`` must be a terminal, unless the method says otherwise.
    """

    def can_move(self) -> bool:
        """Return whether the terminal obeys control sequences, such as cursor movements."""

    def is_in_foreground(self, stream: TextIO) -> bool:
        """Return whether the process is in the foreground of its terminal.

        The result is also True if the stream is not the controlling terminal of this process.
        """

    def reopen(self, stream: TextIO) -> int | None:
        """Open the terminal a second time, so that writes never wait.

        Return the file descriptor, or None if the terminal cannot be opened.
        """

    def takes_text(self, stream: TextIO) -> bool:
        """Return whether a write to the terminal would return at once."""

    def silence(self, stream: TextIO, *, by_key: bool) -> object | None:
        """Turn off the echo of typed characters, because they would damage the picture.

        Args:
            stream: Where the user types.
            by_key: Whether input is read key by key instead of line by line.

        Returns:
            The terminal's earlier modes, which `give_back` restores; None if there is nothing
            to restore.
        """

    def give_back(self, stream: TextIO, modes: object) -> None:
        """Restore the modes that `silence` returned. If the terminal is gone, do nothing."""

    async def wait_for_key(self, stream: TextIO) -> None:
        """Wait until something was typed. Cancelling: safe."""

    def typed(self, stream: TextIO) -> bytes:
        """Read what was typed. Arrow keys are read as control sequences.

        The result is empty if the terminal is gone.
        """


class PosixConsole:
    """A terminal on POSIX, which has modes and job control."""

    def can_move(self) -> bool:
        """Return whether the terminal obeys control sequences, according to ``TERM``."""
        return os.environ.get("TERM", "") not in ("", "dumb", "unknown")

    def is_in_foreground(self, stream: TextIO) -> bool:
        """Return whether the process is in the terminal's foreground process group."""
        try:
            return os.tcgetpgrp(stream.fileno()) == os.getpgrp()
        except OSError:
            return True

    def reopen(self, stream: TextIO) -> int | None:
        """Open the terminal a second time, by its name. Return None if that fails."""
        try:
            name = os.ttyname(stream.fileno())
            descriptor = os.open(name, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError:  # no terminal, or one that was handed on by another user
            return None
        if os.fstat(descriptor).st_rdev != os.fstat(stream.fileno()).st_rdev:
            os.close(descriptor)  # a terminal of another namespace has the same name
            return None
        return descriptor

    def takes_text(self, stream: TextIO) -> bool:
        """Return whether a write to the terminal would return at once, according to `select`."""
        return bool(select.select([], [stream], [], 0)[1])

    def silence(self, stream: TextIO, *, by_key: bool) -> object | None:
        """Turn off the terminal's echo. With ``by_key``, also make each key readable at once."""
        import termios

        try:
            modes = termios.tcgetattr(stream)
        except (OSError, termios.error):
            return None  # not a terminal
        before = [*modes]
        modes[LOCAL_MODES] &= ~termios.ECHO
        if by_key:
            modes[LOCAL_MODES] &= ~termios.ICANON
            modes[CONTROL_CHARACTERS] = [*modes[CONTROL_CHARACTERS]]  # the earlier modes are kept
            modes[CONTROL_CHARACTERS][termios.VMIN] = 1
            modes[CONTROL_CHARACTERS][termios.VTIME] = 0
        termios.tcsetattr(stream, termios.TCSANOW, modes)
        return before

    def give_back(self, stream: TextIO, modes: Any) -> None:  # noqa: ANN401  # from `silence`
        """Restore the modes that `silence` found."""
        import termios

        with suppress(OSError, termios.error):
            termios.tcsetattr(stream, termios.TCSANOW, modes)

    async def wait_for_key(self, stream: TextIO) -> None:
        """Wait until the event loop reports that something was typed."""
        await anyio.wait_readable(stream.fileno())

    def typed(self, stream: TextIO) -> bytes:
        """Read what was typed."""
        try:
            return os.read(stream.fileno(), 1024)
        except OSError:
            return b""


class WindowsConsole:
    """A console on Windows, which has no job control.

    It echoes only input that is read line by line.
    """

    def __init__(self) -> None:
        self._keyboard: Any = None

    def can_move(self) -> bool:
        """Switch on control sequences, and return whether that worked.

        In old console windows, control sequences are off at first.
        """
        import ctypes

        kernel = getattr(getattr(ctypes, "windll", None), "kernel32", None)
        if kernel is None:
            return False
        output, mode = kernel.GetStdHandle(STDOUT), ctypes.c_ulong()
        if not kernel.GetConsoleMode(output, ctypes.byref(mode)):
            return False
        return bool(kernel.SetConsoleMode(output, mode.value | VIRTUAL_TERMINAL))

    def is_in_foreground(self, _: TextIO) -> bool:
        """Return True, because every process that has a console may use the console."""
        return True

    def reopen(self, _: TextIO) -> int | None:
        """Return None, because a console has no non-blocking mode."""
        return None

    def takes_text(self, _: TextIO) -> bool:
        """Return True, because Windows does not say whether a write would wait.

        A write waits only while the user selects text in the console window.
        """
        return True

    def silence(self, stream: TextIO, *, by_key: bool) -> object | None:
        """Do nothing: a key is echoed only when it is read, and `typed` reads keys without echo."""

    def give_back(self, stream: TextIO, modes: object) -> None:
        """Do nothing, because `silence` has changed nothing."""

    async def wait_for_key(self, _: TextIO) -> None:
        """Check for keys at short intervals, because a selector cannot wait for a console."""
        pressed: Callable[[], bool] = self._msvcrt().kbhit
        while not pressed():
            await anyio.sleep(KEY_PERIOD)

    def typed(self, _: TextIO) -> bytes:
        """Read the keys that were pressed, without echo."""
        keyboard, data = self._msvcrt(), b""
        while keyboard.kbhit():
            character = keyboard.getwch()
            if character == CTRL_C:  # a signal, unless the console's modes were changed
                signal.raise_signal(signal.SIGINT)
            elif character in SPECIAL:
                data += ARROWS.get(keyboard.getwch(), b"")
            else:
                data += character.encode(errors="ignore")
        return data or b"\x00"  # nothing would mean that the terminal is gone

    def _msvcrt(self) -> Any:  # noqa: ANN401  # a module that only Windows has
        if self._keyboard is None:
            try:
                import msvcrt
            except ModuleNotFoundError:
                raise UsageError("this system has no way to read single keys") from None
            self._keyboard = msvcrt
        return self._keyboard


@cache
def console() -> Console:
    """Return the `Console` for the operating system."""
    return PosixConsole() if find_spec("termios") is not None else WindowsConsole()
