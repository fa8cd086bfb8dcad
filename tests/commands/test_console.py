"""Terminals and signals where POSIX is missing: every module, the keys, the display, the end."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import anyio
import pytest

from turtleact.commands import console as consoles
from turtleact.commands import terminal
from turtleact.commands.console import PosixConsole, WindowsConsole, console
from turtleact.commands.terminal import GIVE_BACK, Region
from turtleact.errors import UsageError

from .test_teleop import Robot
from .ttys import open_terminal, read

ON_WINDOWS = Path(__file__).with_name("on_windows.py")
PACKAGE = Path(consoles.__file__).parents[1]
PATIENCE = 30


# --- without POSIX ------------------------------------------------------------------------------


def test_every_module_is_imported_without_posix():
    said = subprocess.check_output([sys.executable, ON_WINDOWS], text=True, timeout=PATIENCE)
    files = [path for path in PACKAGE.rglob("*.py") if path.name != "__main__.py"]
    assert len(said.splitlines()) == len(files) - 1  # all but turtleact itself


@pytest.fixture
def start():
    """Starts a command line that lacks POSIX, on the stage."""
    programs = []

    def begin(*arguments, **options):
        programs.append(
            subprocess.Popen(
                [sys.executable, ON_WINDOWS, *arguments],
                **{"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, **options},
                stderr=subprocess.PIPE,
                text=True,
            )
        )
        return programs[-1]

    yield begin
    for program in programs:
        program.kill()
        program.communicate()


def test_a_goal_is_read_from_stdin(start):
    out, err = start("send-goal", "now", "--stdin", "--plain").communicate("order: 1", PATIENCE)
    assert "Goal finished with status: SUCCEEDED" in out, err


def test_a_signal_ends_the_reading_of_stdin(start):
    program = start("send-goal", "now", "--stdin", "--plain")
    deadline = time.monotonic() + PATIENCE
    while program.poll() is None and time.monotonic() < deadline:
        time.sleep(0.2)  # before its handlers stand, a signal would end it anyhow
        program.send_signal(signal.SIGINT)
        time.sleep(0.2)
    assert program.returncode in (130, -signal.SIGINT)


def test_a_signal_wakes_the_loop_and_cancels_the_goal(start):
    program = start("send-goal", "hold", "--plain", "--feedback")
    while "Feedback" not in program.stdout.readline():
        pass
    program.send_signal(signal.SIGINT)
    out, _ = program.communicate(timeout=PATIENCE)
    assert program.returncode == 130
    assert "Goal finished with status: CANCELED" in out


def test_a_second_signal_ends_a_program_that_is_stuck_in_its_output(start):
    reading, writing = os.pipe()
    program = start("send-goal", "flood", "--feedback", "--plain", stdout=writing)
    while select.select([], [writing], [], 0)[1]:
        assert program.poll() is None
        time.sleep(0.01)
    program.send_signal(signal.SIGINT)
    program.send_signal(signal.SIGTERM)
    assert program.wait(PATIENCE) == 143
    os.close(reading)
    os.close(writing)


# --- a console of Windows ---------------------------------------------------------------------


class Keyboard:
    """A stand-in for ``msvcrt``."""

    def __init__(self, typed):
        self.typed = list(typed)

    def kbhit(self):
        return bool(self.typed)

    def getwch(self):
        return self.typed.pop(0)


@pytest.fixture
def windows(monkeypatch):
    """Makes this system's console one of Windows, on which something is typed."""

    def make(typed=""):
        made = WindowsConsole()
        monkeypatch.setitem(sys.modules, "msvcrt", Keyboard(typed))
        monkeypatch.setattr(terminal, "console", lambda: made)
        return made

    return make


def test_this_system_has_a_posix_console():
    assert isinstance(console(), PosixConsole)


@pytest.mark.parametrize(
    ("typed", "read"),
    [
        ("g", b"g"),
        ("\xe0H\xe0P\xe0M\xe0K", b"\x1b[A\x1b[B\x1b[C\x1b[D"),
        ("\x00Hq", b"\x1b[Aq"),
        ("\xe0Sq", b"q"),  # the key Del
        ("é", "é".encode()),
    ],
)
def test_a_key_reads_as_on_other_terminals(windows, typed, read):
    assert windows(typed).typed(sys.stdin) == read


def test_a_key_that_means_nothing_is_not_the_end_of_the_terminal(windows):
    assert windows("\xe0S").typed(sys.stdin) == b"\x00"


def test_ctrl_c_that_comes_as_a_key_is_the_signal(windows):
    with pytest.raises(KeyboardInterrupt):
        windows("\x03").typed(sys.stdin)


async def test_a_key_is_waited_for(windows):
    console = windows()
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(console.wait_for_key, sys.stdin)
        await anyio.sleep(3 * consoles.KEY_PERIOD)
        sys.modules["msvcrt"].typed.append("q")


async def test_a_system_without_keys_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "msvcrt", None)
    with pytest.raises(UsageError, match="no way to read single keys"):
        await WindowsConsole().wait_for_key(sys.stdin)


class Kernel:
    """A stand-in for ``ctypes.windll.kernel32``."""

    def __init__(self, *, is_console):
        self.is_console = is_console
        self.mode = None

    def GetStdHandle(self, number):  # Microsoft's name
        return number

    def GetConsoleMode(self, handle, mode):
        return self.is_console

    def SetConsoleMode(self, handle, mode):
        self.mode = mode
        return 1


@pytest.mark.parametrize("is_console", [False, True])
def test_control_sequences_are_switched_on(monkeypatch, is_console):
    kernel = Kernel(is_console=is_console)
    monkeypatch.setattr("ctypes.windll", SimpleNamespace(kernel32=kernel), raising=False)
    assert WindowsConsole().can_move() is is_console
    assert kernel.mode == (consoles.VIRTUAL_TERMINAL if is_console else None)


def test_teleop_drives_on_windows(windows, on_graph, monkeypatch):
    main, other = open_terminal()
    with os.fdopen(other, "r") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        windows("\xe0H\xe0Kq")
        robot = Robot()
        ran = on_graph(robot, "teleop", "--plain")
    os.close(main)
    assert (ran.status, ran.err) == (0, "")
    assert robot.twists == [(2.0, 0.0), (0.0, 2.0)]


def test_a_display_is_drawn_and_given_back_on_windows(windows):
    windows()
    main, other = open_terminal()
    with os.fdopen(other, "w") as stream:
        region = Region(stream)
        with region.held():
            region.draw(["one"])
    written = b""
    while chunk := read(main):  # the system may hand it over in parts
        written += chunk
    os.close(main)
    assert written.decode().endswith(f"\x1b[?2026l{GIVE_BACK}")
