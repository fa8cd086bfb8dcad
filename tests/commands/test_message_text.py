"""Where the text of a goal comes from, and what is refused."""

from __future__ import annotations

import os
import signal
import sys

import pytest

from turtleact.commands.message_text import MOST, GoalText
from turtleact.errors import UsageError


@pytest.fixture
def read():
    def read(given=None, *, stdin=False, path=None, what="goal"):
        return GoalText.read(given, stdin=stdin, path=path, what=what)

    return read


def test_what_is_given_is_the_text(read):
    assert read("order: 5") == GoalText("order: 5", "goal")


def test_nothing_given_is_the_default_goal(read):
    assert read() == GoalText("{}", "goal")


def test_standard_input_is_read_to_its_end(read, stdin_of):
    stdin_of(b"order: 5\n")
    assert read(stdin=True) == GoalText("order: 5\n", "stdin")


@pytest.mark.parametrize("data", [b"", b"\n \n"])
def test_empty_standard_input_is_an_error(read, stdin_of, data):
    stdin_of(data)
    with pytest.raises(UsageError, match=r"stdin: is empty; the default goal is \{\}"):
        read(stdin=True)


def test_an_empty_argument_is_an_error(read):
    with pytest.raises(UsageError, match=r"goal: is empty; the default goal is \{\}"):
        read("")


def test_an_empty_path_is_an_error(read):
    with pytest.raises(UsageError, match="--goal-file: the path is empty"):
        read(path="")


def test_a_path_that_breaks_the_line_is_quoted(read):
    with pytest.raises(UsageError, match=r"^'a\\nb': cannot be read"):
        read(path="a\nb")


def test_closed_standard_input_is_an_error(read, monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(UsageError, match="stdin: is closed"):
        read(stdin=True)


def test_a_file_is_read(read, tmp_path):
    path = tmp_path / "goal.yaml"
    path.write_text("order: 5", "utf-8")
    assert read(path=str(path)) == GoalText("order: 5", str(path))


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("missing.yaml", "missing.yaml: cannot be read: No such file or directory"),
        (".", "cannot be read: Is a directory"),
        ("null\0", "a path cannot contain a null character"),
    ],
)
def test_a_file_that_cannot_be_read_is_an_error(read, tmp_path, name, problem):
    with pytest.raises(UsageError, match=problem):
        read(path=str(tmp_path) + "/" + name)


def test_a_file_that_is_not_utf8_is_an_error(read, tmp_path):
    path = tmp_path / "goal"
    path.write_bytes(b"order: \xff")
    with pytest.raises(UsageError, match="goal: is not UTF-8: byte 0xFF at 7"):
        read(path=str(path))


@pytest.mark.parametrize("what", ["goal", "request"])
def test_an_endless_file_is_an_error(read, what):
    with pytest.raises(
        UsageError, match=f"/dev/zero: is longer than {MOST} bytes; no {what} is that long"
    ):
        read(path="/dev/zero", what=what)


def test_ctrl_c_ends_a_program_that_waits_for_its_goal(start, tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    program = start("send-goal", "fibonacci", "--goal-file", path, module=True, warnings="ignore")
    writing = os.open(path, os.O_WRONLY)  # returns once the program reads
    program.send(signal.SIGINT)
    ran = program.end()
    os.close(writing)
    assert ran == (130, "", "turtleact: interrupted\n")
