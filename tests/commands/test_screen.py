"""Live displays, on terminals of their own: what is drawn, what scrolls above, what is left."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import termios
from pathlib import Path

import pytest

from .. import warm
from .ttys import Screen, open_terminal, read

ESCAPE = re.compile(r"\x1b(\[[0-9;?]*[A-Za-z]|[78])")
SHOW, HIDE = b"\x1b[?25h", b"\x1b[?25l"
PATROL = "targets: [{x: 9, y: 7}, {x: 5, y: 1}]"
ON_WINDOWS = Path(__file__).with_name("on_windows.py")


def on_terminal(*arguments, columns=80, rows=24, **environment):
    """What ``send-goal`` writes to a terminal, and its exit status."""
    main, other = open_terminal(columns, rows)
    settings = {"TERM": "xterm-256color", "PYTHONUTF8": "1"} | environment
    hidden = ("NO_COLOR", "COLUMNS", "LINES")
    base = {name: each for name, each in os.environ.items() if name not in hidden}
    process = warm.start(
        [sys.executable, "-m", "turtleact", "send-goal", *arguments],
        stdin=other,
        stdout=other,
        stderr=subprocess.PIPE,
        env=base | settings,
    )
    os.close(other)
    written = b""
    while chunk := read(main):
        written += chunk
    os.close(main)
    assert process.stderr is not None
    process.stderr.close()
    return written.decode().replace("\r\n", "\n"), process.wait(30)


def standing(text):
    """What stays on the screen from the last frame on."""
    shown = ESCAPE.sub("", text).replace("\r", "")
    return shown[shown.rindex("● /") :]


def test_the_last_frame_and_the_result_stand_when_the_goal_has_ended():
    text, status = on_terminal("patrol", PATROL, "--speed", "max")
    frame, _, result = standing(text).partition("Result:\n")
    assert status == 0
    assert re.match(r"● /patrol +SUCCEEDED \d+\.\d s +[0-9a-f]{8}\n", frame)
    assert re.search(r"│.*[⠁-⣿].*│", frame)
    assert frame.count("✓") == 2
    assert "%" not in frame
    assert result.startswith("    reached: 2\n")
    assert result.endswith("\nGoal finished with status: SUCCEEDED\n")


@pytest.mark.parametrize(
    ("columns", "rows", "side"), [(60, 30, 14), (80, 30, 20), (100, 40, 24), (140, 40, 24)]
)
def test_the_last_map_is_as_large_as_the_window_allows(columns, rows, side):
    text, _ = on_terminal("patrol", PATROL, "--speed", "max", columns=columns, rows=rows)
    frame = standing(text).partition("Result:")[0]
    assert len([line for line in frame.splitlines() if line.startswith("│")]) == side
    assert max(map(len, frame.splitlines())) <= columns


def test_a_window_of_30_by_10_shows_no_map():
    text, _ = on_terminal("patrol", PATROL, "--speed", "max", columns=30, rows=10)
    lines = standing(text).partition("Result:")[0].splitlines()
    assert len(lines) < 10
    assert max(map(len, lines)) <= 30
    assert "┌" not in text


def test_a_value_that_does_not_remain_is_progress():
    text, _ = on_terminal("go_to", "{x: 9, y: 7}")
    assert re.search(r" \d+%  distance_remaining \d\.\d\d", ESCAPE.sub("", text))


def test_feedback_that_was_asked_for_is_a_line_each_above():
    text, _ = on_terminal("fibonacci", "order: 3", "-f", "--speed", "10")
    lines = [line.strip() for line in ESCAPE.sub("", text).replace("\r", "\n").splitlines()]
    told = [line for line in lines if line.startswith("Feedback: ")]
    assert told == [
        "Feedback: partial_sequence [0, 1, 1]",
        "Feedback: partial_sequence [0, 1, 1, 2]",
    ]


def test_no_color_is_respected():
    text, _ = on_terminal("patrol", PATROL, "--speed", "max", NO_COLOR="1")
    assert not re.search(r"\x1b\[[0-9;]*3[0-7]", text)


@pytest.mark.parametrize(
    ("arguments", "environment"),
    [
        ([], {"TERM": "dumb"}),
        ([], {"PYTHONUTF8": "0", "PYTHONIOENCODING": "latin-1"}),
        (["--plain"], {}),
        (["--json"], {}),
    ],
)
def test_where_nothing_can_or_shall_move_no_escape_sequence_is_written(arguments, environment):
    text, status = on_terminal("fibonacci", "--speed", "max", *arguments, **environment)
    assert status == 0
    assert "\x1b" not in text


def test_a_goal_of_many_lines_does_not_flood_the_terminal():
    targets = ", ".join(["{x: 5, y: 5}"] * 50)
    text, _ = on_terminal("patrol", f"targets: [{targets}]", "--speed", "max")
    assert re.search(r"     … \d+ more lines …\n", text)


# --- the terminal comes back ----------------------------------------------------------------


def echoes(main):
    return bool(termios.tcgetattr(main)[3] & termios.ECHO)


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_a_program_that_is_ended_gives_the_terminal_back(number, status):
    with Screen("hold") as screen:
        screen.wait_for(b"EXECUTING")
        assert not echoes(screen.main)
        screen.process.send_signal(number)
        assert screen.process.wait(30) == status
        text = screen.rest()
        assert text.rindex(SHOW) > text.rindex(HIDE)
        assert text.rstrip().endswith(b"Goal finished with status: CANCELED")
        assert echoes(screen.main)


def test_a_program_that_lets_go_of_its_goal_gives_the_terminal_back():
    with Screen("stubborn") as screen:
        screen.wait_for(b"EXECUTING")
        screen.process.send_signal(signal.SIGINT)
        screen.wait_for(b"Canceling goal")
        screen.process.send_signal(signal.SIGINT)
        assert screen.process.wait(30) == 130
        text = screen.rest()
        assert text.rindex(SHOW) > text.rindex(HIDE)
        assert echoes(screen.main)


def test_ctrl_z_does_not_stop_a_program_in_the_middle_of_a_display():
    with Screen("hold") as screen:
        screen.wait_for(b"EXECUTING")
        assert termios.tcgetattr(screen.main)[6][termios.VSUSP] == b"\0"


def test_a_terminal_that_goes_away_ends_the_program():
    with Screen("hold") as screen:
        screen.wait_for(b"EXECUTING")
        os.close(screen.main)
        screen.main = os.open(os.devnull, os.O_RDONLY)
        screen.process.send_signal(signal.SIGHUP)
        assert screen.process.wait(30) in (129, 141)


# --- keys -----------------------------------------------------------------------------------


def test_p_pauses_and_resumes_the_goal():
    with Screen("fibonacci", "order: 40", program=("-m", "turtleact")) as screen:
        screen.wait_for(b"EXECUTING")
        os.write(screen.main, b"x\x1b[AP")  # an arrow means nothing here
        screen.wait_for(b"  paused")
        os.write(screen.main, b"p")
        running = re.compile(r"EXECUTING \d+\.\d s +[0-9a-f]{8}")
        screen.written = b""
        while not running.search(ESCAPE.sub("", screen.written.decode(errors="ignore"))):
            screen.written += read(screen.main)


# --- Windows --------------------------------------------------------------------------------


def test_every_module_is_imported_without_posix():
    import turtleact

    said = subprocess.check_output([sys.executable, ON_WINDOWS], text=True, timeout=60)
    files = Path(turtleact.__file__).parent.rglob("*.py")
    assert len(said.splitlines()) == len([each for each in files if each.name != "__main__.py"]) - 1


def test_a_goal_is_sent_without_posix():
    ran = subprocess.run(
        [sys.executable, ON_WINDOWS, "send-goal", "now", "--plain"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert "Goal finished with status: SUCCEEDED" in ran.stdout, ran.stderr
