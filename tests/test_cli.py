"""The door: exit statuses, one line for every mistake, never a traceback."""

from __future__ import annotations

import errno
import io
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from turtleact import __version__, cli
from turtleact.commands import VERBS, app
from turtleact.errors import InvalidGoal, InvalidName, ServerUnavailable, SimError, UsageError

from . import warm


@pytest.fixture
def ends(monkeypatch, capsys):
    """Runs a job through the door: its exit status and what stands on stderr."""

    def run(job):
        monkeypatch.setattr(app, "run", lambda _: job())
        return cli.run(["verb"]), capsys.readouterr().err

    return run


def raises(error):
    def job():
        raise error

    return job


def test_a_verb_says_the_exit_status(ends):
    assert ends(lambda: 5) == (5, "")


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (UsageError("no"), 2),
        (InvalidName("a b", "it has a space", 1), 2),
        (InvalidGoal("goal.x", "expected a number"), 2),
        (ServerUnavailable("/x"), 1),
        (SimError("no"), 1),
        (ExceptionGroup("", [ExceptionGroup("", [SimError("no")])]), 1),
        (ZeroDivisionError("by hand"), 1),
    ],
    ids=lambda each: type(each).__name__,
)
def test_the_exit_status_says_what_kind_of_error_it_was(ends, error, status):
    assert ends(raises(error))[0] == status


def test_an_error_is_its_message(ends):
    assert ends(raises(ServerUnavailable("/x")))[1] == "turtleact: action '/x': no server answers\n"


def test_a_bug_is_one_line_that_says_how_to_see_more(ends):
    assert ends(raises(ZeroDivisionError("by hand")))[1] == (
        "turtleact: a bug in turtleact: ZeroDivisionError: by hand; "
        "'PYTHONDEVMODE=1 turtleact …' shows where\n"
    )


def test_in_dev_mode_a_bug_shows_its_traceback():
    code = (
        "import sys; from turtleact import cli; from turtleact.commands import VERBS, app;"
        "app.run = lambda _: 1 / 0; sys.argv = ['turtleact', 'verb']; cli.main()"
    )
    outcome = subprocess.run(
        [sys.executable, "-X", "dev", "-c", code], capture_output=True, text=True, check=False
    )
    assert outcome.stderr.splitlines()[-1] == "ZeroDivisionError: division by zero"


def test_ctrl_c_is_one_line(ends):
    assert ends(raises(KeyboardInterrupt())) == (130, "turtleact: interrupted\n")


@pytest.mark.parametrize("number", [errno.EPIPE, errno.EIO])
def test_an_output_that_is_gone_is_no_error_to_speak_of(ends, monkeypatch, number):
    reading, writing = os.pipe()
    monkeypatch.setattr(sys, "stdout", os.fdopen(writing, "w"))
    os.close(reading)
    assert ends(raises(OSError(number, "gone"))) == (141, "")
    sys.stdout.write("more")
    sys.stdout.close()


def test_a_full_disk_is_an_error():
    with Path("/dev/full").open("w") as full:
        outcome = warm.run(
            [sys.executable, "-m", "turtleact", "--version"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert outcome.returncode == 1
    assert outcome.stderr == ("turtleact: the output cannot be written: No space left on device\n")


def test_characters_that_the_output_cannot_show_are_escaped(ends, monkeypatch):
    latin = io.TextIOWrapper(io.BytesIO(), "latin-1")
    monkeypatch.setattr(sys, "stdout", latin)
    assert ends(lambda: print("⠿") or 0)[0] == 0
    assert latin.buffer.getvalue() == b"\\u283f\n"


@pytest.mark.parametrize("arguments", [[], ["-h"], ["--help"], ["--help", "send-goal"]])
def test_help_is_printed(arguments, capsys):
    assert cli.run(arguments) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "Usage: turtleact [OPTIONS] COMMAND [ARGS]..." in out
    listed = [line.split()[1] for line in out.splitlines() if re.match("│ [a-z]", line)]
    assert listed == list(VERBS)


def test_the_version_is_printed(capsys):
    assert cli.run(["--version"]) == 0
    assert capsys.readouterr().out == f"turtleact {__version__}\n"


def test_a_signal_that_the_parent_ignores_stays_ignored():
    code = (
        "import signal, sys; from turtleact import cli\n"
        "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "sys.argv = ['turtleact', '--version']; cli.main()"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert ran.returncode == 0


DEPENDENCIES = ["anyio", "cbor2", "zenoh", "msgspec", "numpy", "yaml", "rich", "starlette", "typer"]
DEPENDENCIES += ["uvicorn", "websockets", "xxhash", "mcap", "mcp", "opentelemetry"]


@pytest.mark.parametrize("line", [["--help"], ["action", "--help"], ["send-goal", "--help"]])
def test_help_imports_nothing_that_takes_long(line):
    code = (
        f"import sys; from turtleact import cli; sys.argv = ['turtleact', *{line}]; cli.main();"
        "print(*{each.partition('.')[0] for each in sys.modules})"
    )
    out = subprocess.check_output([sys.executable, "-c", code], text=True)
    found = set(out.splitlines()[-1].split())
    assert found & {*DEPENDENCIES, "pydantic", "asyncio", "ssl"} == {"rich", "typer"}
