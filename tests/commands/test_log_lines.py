"""What is printed beside a display is a line of its log."""

from __future__ import annotations

import sys

from turtleact.commands import terminal
from turtleact.commands.terminal import LogLines


def full(log):
    return [line.full for line in log.lines()]


def test_what_is_printed_comes_line_by_line(monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    log = LogLines()
    with log.listening():
        print("one", end="")
        print(" and", "two", file=sys.stderr)
        print("three")
    assert full(log) == ["one and two", "three"]


def test_a_body_that_closes_stdout_does_not_end_the_log():
    log = LogLines()
    with log.listening():
        sys.stdout.close()
        print("still here", flush=True)
    assert full(log) == ["still here"]


def test_what_stderr_takes_elsewhere_goes_there(capsys):
    log = LogLines()
    with log.listening():
        print("for a file", file=sys.stderr)
    assert (full(log), capsys.readouterr().err) == ([], "for a file\n")


def test_a_line_that_differs_from_the_last_in_numbers_replaces_it():
    log = LogLines()
    for x in ("11.1", "-0.5"):
        log.write(f"hit the wall at x={x}\n")
    log.write("other\n")
    assert full(log) == ["hit the wall at x=-0.5", "other"]


def test_a_line_that_is_added_replaces_none():
    log = LogLines()
    log.add("goal 1", "1")
    log.add("goal 2", "2")
    assert [line.short for line in log.lines()] == ["1", "2"]


def test_a_line_is_told_again_in_place_of_the_last_one_about_its_subject():
    log = LogLines()
    log.retell("reload", "failed:\nline 3")
    log.add("goal 1")
    log.retell("reload", "failed again")
    assert full(log) == ["goal 1", "failed again"]


def test_the_newest_lines_are_kept():
    log = LogLines()
    for number in range(terminal.MOST + 1):
        log.add(f"{number}")
    assert full(log)[0] == "1"
    assert len(full(log)) == terminal.MOST
