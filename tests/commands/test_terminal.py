"""The region that is drawn on, and the terminal as it is found when the process stops or ends."""

from __future__ import annotations

import contextlib
import io
import os
import re
import signal
import termios
import time
from typing import Any

import anyio
import pytest

from turtleact.commands.terminal import GIVE_BACK, Region

from .ttys import Screen, filled, open_terminal

FRAME = "\x1b[?2026h\x1b[?25l\r\x1b[2Kone\x1b[J\r\x1b[?2026l"
HIDE, SHOW = b"\x1b[?25l", b"\x1b[?25h"

# --- the region -----------------------------------------------------------------------------


@pytest.fixture
def stream():
    return io.StringIO()


@pytest.fixture
def region(stream):
    return Region(stream)


def test_a_frame_leaves_the_cursor_at_its_beginning(region, stream):
    region.draw(["one", "two", "three"])
    assert stream.getvalue() == (
        "\x1b[?2026h\x1b[?25l\r\x1b[2Kone\n\x1b[2Ktwo\n\x1b[2Kthree\x1b[J\x1b[2A\r\x1b[?2026l"
    )


def test_a_frame_of_one_line_moves_no_line_up(region, stream):
    region.draw(["one"])
    assert not re.search(r"\x1b\[\d*A", stream.getvalue())


def test_text_that_stays_takes_the_place_of_the_frame(region, stream):
    region.draw(["one"])
    stream.truncate(0)
    stream.seek(0)
    region.say("stays\n")
    assert stream.getvalue() == f"{GIVE_BACK}stays\n"


def test_clearing_twice_does_nothing_more(region, stream):
    region.draw(["one"])
    region.clear()
    before = stream.getvalue()
    region.clear()
    assert stream.getvalue() == before


def test_a_stream_that_is_no_terminal_has_the_usual_size():
    reading, writing = os.pipe()
    with os.fdopen(reading), os.fdopen(writing, "w") as pipe:
        assert Region(pipe).size() == (80, 24)


@pytest.fixture
def tty():
    """Both ends of a terminal: a descriptor to read from, a stream to draw on."""
    main, other = open_terminal(31, 17)
    with os.fdopen(other, "w") as stream:
        yield main, stream
    os.close(main)


def unread(main):
    """All that can be read now."""
    text = b""
    os.set_blocking(main, False)
    with contextlib.suppress(BlockingIOError):
        while chunk := os.read(main, 65536):
            text += chunk
    os.set_blocking(main, True)
    return text


def test_a_terminal_has_the_size_it_has(tty):
    assert Region(tty[1]).size() == (31, 17)


# --- the terminal as it was -----------------------------------------------------------------


def echoes(descriptor):
    return bool(termios.tcgetattr(descriptor)[3] & termios.ECHO)


def test_what_is_typed_is_not_shown_while_frames_are_drawn(tty):
    main, stream = tty
    region = Region(stream)
    with region.held():
        region.draw(["one"])
        assert not echoes(main)
    assert echoes(main)


def test_a_terminal_without_echo_is_left_without(tty):
    main, stream = tty
    modes = termios.tcgetattr(main)
    modes[3] &= ~termios.ECHO
    termios.tcsetattr(main, termios.TCSANOW, modes)
    with (region := Region(stream)).held():
        region.draw(["one"])
    assert not echoes(main)


def test_the_cursor_comes_back_at_the_end_of_the_block(tty):
    main, stream = tty
    with (region := Region(stream)).held():
        region.draw(["one"])
    assert unread(main).endswith(GIVE_BACK.encode())


def test_giving_back_a_terminal_that_takes_nothing_does_not_block(tty):
    _, stream = tty
    region = Region(stream)
    region.draw(["one"])
    os.set_blocking(stream.fileno(), False)
    with contextlib.suppress(BlockingIOError):
        while os.write(stream.fileno(), b"x" * 1000):
            pass
    os.set_blocking(stream.fileno(), True)
    region.restore()


def test_signal_handlers_are_those_of_before(tty):
    watched = (signal.SIGTSTP, signal.SIGCONT, signal.SIGQUIT)
    with Region(tty[1]).held():
        assert signal.SIG_DFL not in map(signal.getsignal, watched)
    assert [signal.getsignal(each) for each in watched] == [signal.SIG_DFL] * 3


def test_a_signal_that_is_ignored_stays_ignored(tty):
    before = signal.signal(signal.SIGTSTP, signal.SIG_IGN)
    try:
        with Region(tty[1]).held():
            assert signal.getsignal(signal.SIGTSTP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGTSTP, before)


def test_in_the_background_the_terminal_is_left_alone(tty, monkeypatch):
    main, stream = tty
    group = os.getpgrp()
    monkeypatch.setattr(os, "tcgetpgrp", lambda _: group + 1)
    with (region := Region(stream)).held():
        region.draw(["one"])
        assert echoes(main)
        monkeypatch.setattr(os, "tcgetpgrp", lambda _: group)
        region.draw(["two"])
        assert not echoes(main)
    assert b"one" not in unread(main)


def test_keys_come_at_once_and_are_not_shown_while_they_are_read(tty):
    main, stream = tty
    before = termios.tcgetattr(main)
    with os.fdopen(os.dup(stream.fileno()), "r") as keyboard, Region(stream, keyboard).held():
        modes = termios.tcgetattr(main)
        assert not modes[3] & (termios.ECHO | termios.ICANON)
        assert modes[3] & termios.ISIG
        os.write(main, b"q")
        assert os.read(stream.fileno(), 10) == b"q"
    assert termios.tcgetattr(main) == before


# --- nothing waits for a terminal -----------------------------------------------------------


def test_what_the_terminal_does_not_take_is_kept_for_later(tty):
    main, stream = tty
    region = Region(stream)
    with region.held():
        filled(region)
        region.say("the end")
        assert not region.is_ready()
        while not region.is_ready():
            unread(main)
        assert unread(main).endswith(b"the end")


async def test_it_can_be_waited_for_without_blocking(tty):
    main, stream = tty
    region = Region(stream)
    with region.held():
        filled(region)
        async with anyio.create_task_group() as beside:
            beside.start_soon(region.drained)
            await anyio.wait_all_tasks_blocked()
            assert not region.is_ready()
            while not region.is_ready():
                unread(main)


def test_a_terminal_that_takes_nothing_is_given_back_without_waiting(tty):
    main, stream = tty
    region = Region(stream)
    with region.held():
        region.draw(["one"])
        filled(region)
    assert echoes(main)


@pytest.mark.parametrize("number", [signal.SIGTSTP, signal.SIGQUIT])
def test_a_signal_in_the_middle_of_a_frame_is_followed_behind_it(tty, monkeypatch, number):
    main, stream = tty
    raised: list[object] = []
    write = os.write

    def interrupted(descriptor, data):
        written = write(descriptor, data[:3])
        if not raised:
            raised.append("arrived")
            handler: Any = signal.getsignal(number)
            handler(number, None)
        return written

    monkeypatch.setattr(signal, "raise_signal", raised.append)
    with (region := Region(stream)).held():
        monkeypatch.setattr(os, "write", interrupted)
        region.draw(["one"])
        assert raised == ["arrived", number]
    assert unread(main).startswith(f"{FRAME}{GIVE_BACK}".encode())


def test_an_end_in_the_middle_of_a_frame_shows_the_cursor(tty, monkeypatch):
    main, stream = tty
    region, write = Region(stream), os.write

    def ended(descriptor, data):
        monkeypatch.setattr(os, "write", write)
        written = write(descriptor, data[:3])
        region.restore()
        raise SystemExit(written)

    with contextlib.suppress(SystemExit), region.held():
        monkeypatch.setattr(os, "write", ended)
        region.draw(["one"])
    assert unread(main) == f"{FRAME[:3]}{GIVE_BACK}".encode()


def test_a_terminal_that_has_gone_needs_nothing_back():
    main, other = open_terminal()
    with os.fdopen(other, "w") as stream, (region := Region(stream)).held():
        region.draw(["one"])
        os.close(main)


def test_the_terminal_of_the_shell_goes_on_to_wait(tty):
    _, stream = tty
    with Region(stream).held():
        assert os.get_blocking(stream.fileno())


def test_a_full_terminal_that_cannot_be_opened_again_is_not_written_to(tty, monkeypatch):
    main, stream = tty
    filling = Region(stream)
    with filling.held():
        for _ in range(5):  # the system makes a little room when it moves what was written
            filled(filling)
            time.sleep(0.01)

    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(os, "open", refuse)
    with (region := Region(stream)).held():
        assert not region.is_ready()
        region.draw(["one"])
        while not region.is_ready():
            unread(main)
        region.draw(["two"])
    assert b"two" in unread(main)


# --- a program that stops or ends -----------------------------------------------------------


@pytest.fixture
def screen():
    """A goal that runs on a terminal that is its own."""
    with Screen("hold") as screen:
        screen.wait_for(b"EXECUTING")
        yield screen


def test_a_program_that_is_stopped_gives_the_terminal_back(screen):
    assert not echoes(screen.main)
    screen.process.send_signal(signal.SIGTSTP)
    screen.wait_until_stopped()
    assert screen.rest().endswith(SHOW)
    assert echoes(screen.main)


def test_a_program_that_lets_go_of_its_goal_gives_the_terminal_back():
    with Screen("stubborn") as screen:
        screen.wait_for(b"EXECUTING")
        screen.process.send_signal(signal.SIGINT)
        screen.wait_for(b"Canceling goal")
        screen.wait_for(HIDE)
        screen.process.send_signal(signal.SIGINT)
        assert screen.process.wait(30) == 130
        text = screen.rest()
        assert text.rindex(SHOW) > text.rindex(HIDE)
        assert echoes(screen.main)


def test_a_program_that_is_continued_draws_again(screen):
    screen.process.send_signal(signal.SIGTSTP)
    screen.wait_until_stopped()
    screen.rest()
    screen.written = b""
    screen.process.send_signal(signal.SIGCONT)
    screen.wait_for(b"EXECUTING")
    assert not echoes(screen.main)


def test_a_program_that_is_stopped_twice_gives_the_terminal_back_twice(screen):
    for _ in range(2):
        screen.rest()
        screen.written = b""
        screen.process.send_signal(signal.SIGCONT)
        screen.wait_for(b"EXECUTING")
        screen.process.send_signal(signal.SIGTSTP)
        screen.wait_until_stopped()
        assert screen.rest().endswith(SHOW)


@pytest.mark.parametrize(
    ("number", "status"),
    [
        (signal.SIGINT, 130),
        (signal.SIGTERM, 143),
        (signal.SIGHUP, 129),
        (signal.SIGQUIT, -signal.SIGQUIT),
    ],
)
def test_a_program_that_is_ended_gives_the_terminal_back(screen, number, status):
    screen.process.send_signal(number)
    assert screen.process.wait(30) == status
    text = screen.rest()
    assert text.rindex(SHOW) > text.rindex(HIDE)
    assert echoes(screen.main)
