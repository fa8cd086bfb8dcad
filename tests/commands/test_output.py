"""Lines on stderr: no control characters, and no failure."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from turtleact.commands.output import note, printable

from .. import warm


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\x1b[31mred\x07\0", r"\x1b[31mred\x07\x00"),
        ("one\ntwo", "one\ntwo"),
        ("one\r\ttwo", r"one\r\ttwo"),
        ("Zoë 🐢 →", "Zoë 🐢 →"),
        ("\u202edrawkcab", r"\u202edrawkcab"),
        ("\udce9", r"\udce9"),
    ],
)
def test_control_characters_are_escaped(text, shown):
    assert printable(text) == shown


def test_a_note_is_a_line_on_stderr(capsys):
    note("by the way\x07")
    assert capsys.readouterr() == ("", "turtleact: by the way\\x07\n")


def test_a_stderr_that_is_full_does_not_stop_the_goal():
    with Path("/dev/full").open("w") as full:
        program = [sys.executable, "-m", "turtleact", "send-goal", "fibonacci", "--speed", "max"]
        ran = warm.run(
            program, stdout=subprocess.PIPE, stderr=full, text=True, check=False, timeout=30
        )
    assert ran.returncode == 0
    assert ran.stdout.endswith("Goal finished with status: SUCCEEDED\n")


@pytest.mark.parametrize(
    "arguments",
    [
        ["fib\x1b[31m"],
        ["go_to", '{x: 2, turtle: "\\e[31mred\\a"}'],
        ["go_to", "--goal-file", "a\x1b"],
        ["go_to", "--speed", "\x1b"],
    ],
)
def test_no_argument_commands_the_terminal(turtleact, arguments):
    err = turtleact("send-goal", *arguments).err
    assert "\x1b" not in err
    assert "\\x1b" in err
