"""Where the text of a goal comes from, and what is refused."""

from __future__ import annotations

import os
import signal

import pytest

GOAL = ["send-goal", "fibonacci", "--embedded", "--speed", "max", "--plain"]


def test_a_goal_comes_from_a_file_or_from_standard_input(turtleact, tmp_path, stdin_of):
    path = tmp_path / "goal.yaml"
    path.write_text("order: 4", "utf-8")
    assert "     order: 4\n" in turtleact(*GOAL, "--goal-file", str(path)).out
    stdin_of(b"order: 3\n")
    assert "     order: 3\n" in turtleact(*GOAL, "--stdin").out


@pytest.mark.parametrize(("option", "data"), [("--stdin", b"\n \n"), ("", b"")])
def test_an_empty_text_is_an_error(turtleact, stdin_of, option, data):
    stdin_of(data)
    ran = turtleact(*GOAL, option)
    source = "stdin" if option else "goal"
    assert ran == (2, "", f"turtleact: {source}: is empty; the default goal is {{}}\n")


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("missing.yaml", "missing.yaml: cannot be read: No such file or directory"),
        ("a\nb", "'a\\nb': cannot be read: No such file or directory"),
        ("", ": cannot be read: Is a directory"),
        ("binary", "binary: is not UTF-8: byte 0xFF at 7"),
        ("/dev/zero", "/dev/zero: is longer than 4194304 bytes, which no message is"),
    ],
)
def test_a_file_that_cannot_be_read_is_an_error(turtleact, tmp_path, monkeypatch, name, problem):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "binary").write_bytes(b"order: \xff")
    ran = turtleact(*GOAL, "--goal-file", name)
    assert (ran.status, ran.out) == (2, "")
    assert problem in ran.err


def test_ctrl_c_ends_a_program_that_waits_for_its_goal(start, tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    program = start("send-goal", "fibonacci", "--goal-file", path, module=True, warnings="ignore")
    writing = os.open(path, os.O_WRONLY)  # returns once the program reads
    program.send(signal.SIGINT)
    ran = program.end()
    os.close(writing)
    assert ran == (130, "", "turtleact: interrupted\n")
