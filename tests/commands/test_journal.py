"""Goals in a journal, as the command line shows them, and ``serve`` with a journal."""

from __future__ import annotations

import json
import re
import signal
import sqlite3
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from turtleact.goals.records import GoalChange, GoalRecord
from turtleact.goals.state import GoalStatus
from turtleact.interfaces import WireFormat, type_hash
from turtleact.interfaces.standard import Fibonacci
from turtleact.journal.database import Accept, Change, Database

from ..lab import free_endpoint
from .test_serve import start_python

HOUR = 3600 * 10**9
DAY = 24 * HOUR


def goal_id(number):
    return bytes([number, *range(1, 16)])


def record(number, now, **values):
    made = GoalRecord(
        id=goal_id(number),
        action="/fibonacci",
        type_name=Fibonacci.type_name,
        type_hash=type_hash(Fibonacci),
        request=WireFormat(Fibonacci.Goal).encode(Fibonacci.Goal(order=3)),
        stamp=now,
        accepted=now,
        status=GoalStatus.EXECUTING,
    )
    for name, value in values.items():
        setattr(made, name, value)
    return made


@pytest.fixture
def path(tmp_path):
    return tmp_path / "goals.db"


@pytest.fixture
def file(path):
    """Writes a journal with a goal that succeeded, one that was aborted and one that runs."""
    now = time.time_ns()
    result = WireFormat(Fibonacci.Result).encode(Fibonacci.Result(sequence=[0, 1, 1, 2]))
    database = Database(path)
    database.write(
        [
            Accept(record(0xA0, now - 30 * DAY)),
            Change(
                goal_id(0xA0),
                GoalChange(
                    status=GoalStatus.SUCCEEDED,
                    result=result,
                    ended=now - 30 * DAY + 10**9,
                    expires=now - 29 * DAY,
                ),
            ),
            Accept(record(0xA1, now - 2 * HOUR, action="/other", type_hash="RIHS01_0")),
            Change(
                goal_id(0xA1),
                GoalChange(
                    status=GoalStatus.ABORTED,
                    result=result,
                    reason="out of\npaper",
                    ended=now - HOUR,
                    expires=now - 1,
                ),
            ),
            Accept(record(0xB0, now - 90 * 10**9)),
            Change(goal_id(0xB0), GoalChange(feedback=b"1", is_paused=True)),
        ],
        is_durable=False,
    )
    database.close()
    return path


def rows(ran):
    return [re.split(r"  +", line) for line in ran.out.splitlines()]


# --- reading --------------------------------------------------------------------------------


def test_goals_lists_a_journal(turtleact, file):
    ran = turtleact("goals", "--journal", str(file))
    assert (ran.status, ran.err) == (0, "")
    first = goal_id(0xA0).hex()
    second = goal_id(0xA1).hex()
    third = goal_id(0xB0).hex()
    *told, (*running, age) = rows(ran)
    assert age.startswith("1 min ")
    assert [*told, running] == [
        ["id", "action", "state", "age", "took", "reason"],
        [first, "/fibonacci", "SUCCEEDED", "720 h 0 min", "1.0 s"],
        [second, "/other", "ABORTED", "2 h 0 min", "1 h 0 min", "out of paper"],
        [third, "/fibonacci", "EXECUTING (paused)"],
    ]


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (["--since", "1h"], [0xB0]),
        (["--since", "1 d"], [0xA1, 0xB0]),
        (["--since", "2000-01-01"], [0xA0, 0xA1, 0xB0]),
        (["fibonacci"], [0xA0, 0xB0]),
    ],
    ids=["span", "days", "moment", "action"],
)
def test_goals_are_chosen_by_time_and_action(turtleact, file, arguments, found):
    ran = turtleact("goals", *arguments, "--journal", str(file), "--json")
    assert [json.loads(line)["id"] for line in ran.out.splitlines()] == [
        goal_id(number).hex() for number in found
    ]


def test_each_goal_is_a_json_object(turtleact, file):
    ran = turtleact("goals", "--journal", str(file), "--json", "--since", "1h")
    told = json.loads(ran.out)
    assert told.pop("age") == pytest.approx(90, abs=30)
    assert told.pop("stamp") == told.pop("accepted")
    assert told == {
        "id": goal_id(0xB0).hex(),
        "action": "/fibonacci",
        "type": "action_tutorials_interfaces/action/Fibonacci",
        "state": "EXECUTING",
        "paused": True,
        "ended": None,
        "reason": "",
        "feedback_count": 1,
        "crashes": 0,
    }


def test_an_empty_journal_is_told(turtleact, path):
    Database(path).close()
    ran = turtleact("goals", "--journal", str(path))
    assert ran == (0, "", "turtleact: the journal has no goals\n")


def test_a_result_is_read_by_the_first_digits_of_its_id(turtleact, file):
    ran = turtleact("result", "a001", "--journal", str(file))
    assert (ran.status, ran.err) == (0, "")
    assert ran.out.endswith("Goal finished with status: SUCCEEDED\n")
    assert "    sequence:\n    - 0\n    - 1\n    - 1\n    - 2\n" in ran.out


@pytest.mark.parametrize(
    ("digits", "status", "problem"),
    [
        ("ffff", 1, "has no goal ffff"),
        ("b001", 1, "has not ended: the journal says EXECUTING, with 1 feedback messages"),
        (
            "a101",
            1,
            "but its result cannot be read: action_tutorials_interfaces/action/Fibonacci has",
        ),
    ],
)
def test_a_missing_result_is_one_clear_line(turtleact, file, digits, status, problem):
    ran = turtleact("result", digits, "--journal", str(file))
    assert (ran.status, ran.out, ran.err.count("\n")) == (status, "", 1)
    assert problem in ran.err


def test_prune_deletes_what_ended_long_ago(turtleact, file):
    ran = turtleact("journal", "prune", str(file), "--keep", "7d")
    assert ran == (0, "deleted 1 goal\n", "")
    ran = turtleact("goals", "--journal", str(file), "--json")
    assert [json.loads(line)["id"][:2] for line in ran.out.splitlines()] == ["a1", "b0"]


# --- files that cannot be read ---------------------------------------------------------------


def damaged(path):
    path.write_bytes(b"nonsense" * 1000)


def newer(path):
    Database(path).close()
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA user_version = 99")
    connection.close()


def foreign(path):
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE mine (number INTEGER)")
    connection.close()


@pytest.mark.parametrize(
    "arguments",
    [["goals"], ["result", "0000"], ["journal", "prune", "--keep", "1d"]],
    ids=lambda each: each[0],
)
@pytest.mark.parametrize(
    ("prepare", "problem"),
    [
        (lambda _: None, "there is no such file"),
        (damaged, "it is damaged, or no journal"),
        (newer, "from a newer turtleact"),
        (foreign, "it is the file of another program"),
    ],
    ids=["missing", "damaged", "newer", "foreign"],
)
def test_a_journal_that_cannot_be_read_is_one_clear_line(
    turtleact, path, arguments, prepare, problem
):
    prepare(path)
    file = [str(path)] if arguments[0] == "journal" else ["--journal", str(path)]
    ran = turtleact(*arguments, *file)
    assert (ran.status, ran.out, ran.err.count("\n")) == (1, "", 1)
    assert ran.err.startswith(f"turtleact: journal '{path}': ")
    assert problem in ran.err


# --- usage -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("goals --since 1h", "--since needs --journal"),
        ("goals --journal x.db --since soon", "--since takes a length of time such as 1h, or"),
        ("journal prune x.db --keep 7", "'7' is not a time such as 90s"),
        (
            "serve --on-restart resume",
            "--on-restart, --max-starts and --abort-goals need --journal",
        ),
        ("serve --journal x.db --abort-goals", "--abort-goals needs --on-restart resume"),
        ("send-goal patrol --reattach 5 --embedded", "not for an embedded world"),
    ],
)
def test_options_that_make_no_sense_are_refused(turtleact, line, problem):
    ran = turtleact(*line.split())
    assert ran.status == 2
    assert problem in " ".join(re.sub(r"[│╭╮╰╯─]", " ", ran.err).split())


# --- serve -----------------------------------------------------------------------------------

LAB = """
import anyio
import turtleact
from turtleact.interfaces.standard import Fibonacci


@turtleact.action(Fibonacci, "steps")
async def steps(goal, handle):
    left = handle.resumed
    sequence = list(left.feedback.partial_sequence) if left and left.feedback else []
    for number in range(len(sequence), goal.order):
        if number == 2 and not left:
            await anyio.sleep_forever()
        sequence.append(number)
        yield Fibonacci.Feedback(partial_sequence=sequence)
    yield Fibonacci.Result(sequence=sequence)
"""


def start(folder, *arguments):
    return start_python(folder, "-m", "turtleact", *arguments, stderr=subprocess.STDOUT)


@contextmanager
def serving(folder, at, *options):
    """A server of ``lab.py`` with a journal, ready."""
    process = start(
        folder,
        *("serve", "lab.py", "--no-sim", "--plain", "--listen", at),
        *("--journal", "goals.db", *options),
    )
    try:
        lines_until(process, "ready")
        yield process
    finally:
        process.kill()
        process.communicate()


def lines_until(process, text):
    """Read what a process prints, to the first line that has a text."""
    for line in process.stdout:
        if text in line:
            return line
    pytest.fail(f"no line has {text!r}")


@pytest.fixture
def at(tmp_path):
    """Where the server of ``lab.py`` listens."""
    Path(tmp_path, "lab.py").write_text(LAB)
    return free_endpoint()


def test_a_goal_goes_on_after_a_kill_and_a_reload_and_its_sender_sees_one_run(
    tmp_path, at, turtleact
):
    file = str(tmp_path / "goals.db")
    with serving(tmp_path, at, "--on-restart", "resume") as server:
        sender = start(
            tmp_path,
            *("send-goal", "steps", "order: 4", "--plain", "--feedback"),
            *("--reattach", "60", "--connect", at),
        )
        lines_until(sender, "- 1")
        held = json.loads(turtleact("goals", "--journal", file, "--json").out)
        server.kill()
        server.wait()
    (tmp_path / "lab.py").write_text(LAB.replace("number == 2 and not left", "number == 3"))
    with serving(tmp_path, at, "--on-restart", "resume", "--reload") as server:
        (tmp_path / "lab.new").write_text(LAB.replace("number == 2", "False"))
        (tmp_path / "lab.new").rename(tmp_path / "lab.py")
        assert "EXECUTING (resumed)" in lines_until(server, "EXECUTING")
        assert held["id"] in lines_until(server, "SUCCEEDED")
        second = start(tmp_path, "serve", "--no-sim", "--journal", "goals.db", "--listen", at)
        out, _ = sender.communicate(timeout=30)
        assert (sender.returncode, held["state"]) == (0, "EXECUTING")
        assert out.endswith("Goal finished with status: SUCCEEDED\n")
        assert "turtleact: the server of /steps is back\n" in out
        assert "    sequence:\n    - 0\n    - 1\n    - 2\n    - 3\n" in out
        refused, _ = second.communicate(timeout=30)
        assert second.returncode == 1
        assert f"process {server.pid} (" in refused
        told = turtleact("result", held["id"], "--journal", file)  # while the server runs
        assert told.out in out


def test_a_standby_waits_for_the_journal_and_goes_on_with_its_goals(tmp_path, at):
    resume = ["--journal", "goals.db", "--on-restart", "resume"]
    with serving(tmp_path, at, "--on-restart", "resume") as server:
        sent = start(tmp_path, "send-goal", "steps", "order: 4", "--timeout", "0", "--connect", at)
        lines_until(server, "EXECUTING")
        sent.communicate(timeout=30)
        command = ["serve", "lab.py", "--no-sim", "--plain", "--wait", "--listen", at, *resume]
        standby = start(tmp_path, *command)
        try:
            waiting = lines_until(standby, "waiting until that process has gone")
            assert f"process {server.pid} (" in waiting
            server.kill()
            lines_until(standby, "EXECUTING (resumed)")
            lines_until(standby, "SUCCEEDED")
        finally:
            standby.kill()
            standby.communicate()


@pytest.mark.parametrize(
    ("options", "state"),
    [
        (["--on-restart", "resume"], "EXECUTING"),
        (["--on-restart", "resume", "--abort-goals"], "ABORTED"),
    ],
    ids=["resume", "abort"],
)
def test_a_clean_stop_keeps_goals_or_ends_them(tmp_path, at, turtleact, options, state):
    with serving(tmp_path, at, *options) as server:
        sent = start(tmp_path, "send-goal", "steps", "order: 4", "--timeout", "0", "--connect", at)
        lines_until(server, "EXECUTING")
        sent.communicate(timeout=30)
        server.send_signal(signal.SIGTERM)
        out, _ = server.communicate(timeout=30)
        assert server.returncode == 0
        rest = "go on when the server is back" if state == "EXECUTING" else "are ended"
        assert f"running goals {rest}\n" in out
    told = json.loads(turtleact("goals", "--journal", str(tmp_path / "goals.db"), "--json").out)
    reason = "shutdown" if state == "ABORTED" else ""
    assert (told["state"], told["reason"]) == (state, reason)
