"""What is printed of a goal: as ROS 2 prints it, and as JSON."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import pytest

from turtleact.commands.transcript import Followed, JsonTranscript, PlainTranscript
from turtleact.goals.client_handle import Outcome
from turtleact.goals.state import GoalStatus
from turtleact.interfaces.standard import Fibonacci, PatrolCommandInterface, Point, Time

ID = bytes(range(16))


@pytest.fixture
def sent():
    """A goal that was accepted."""
    request = Fibonacci.Goal(order=5)
    handle: Any = SimpleNamespace(goal_id=ID, stamp=Time(sec=1, nanosec=2), request=request)
    node: Any = None
    return Followed(node, "/fibonacci", Fibonacci, handle)


@pytest.fixture
def plain():
    return PlainTranscript(wants_feedback=True)


def outcome(status=GoalStatus.SUCCEEDED, reason=""):
    return Outcome(status, Fibonacci.Result(sequence=[0, 1]), reason)


def test_the_goal_is_indented_by_five(plain, capsys):
    plain.sending(Fibonacci.Goal(order=5))
    assert capsys.readouterr().out == "Sending goal:\n     order: 5\n\n"


def test_what_goes_on_over_lines_is_indented_alike(plain, capsys):
    plain.sending(PatrolCommandInterface.Goal(targets=[Point(x=9.0, y=7.0)]))
    assert capsys.readouterr().out == (
        "Sending goal:\n     targets:\n     - x: 9.0\n       y: 7.0\n       z: 0.0\n\n"
    )


@pytest.mark.parametrize("most", [1, 2, 3, 7, 8])
def test_a_goal_has_no_more_lines_than_it_may(most, capsys):
    plain = PlainTranscript(wants_feedback=False, most_lines=most)
    plain.sending(PatrolCommandInterface.Goal(targets=[Point()] * 3))  # ten lines
    _, *lines, last = capsys.readouterr().out.splitlines()
    assert (len(lines), last) == (most, "")
    assert f"     … {10 - most + 1} more lines …" in lines


def test_a_goal_that_may_have_so_many_lines_has_all(capsys):
    plain = PlainTranscript(wants_feedback=False, most_lines=4)
    plain.sending(PatrolCommandInterface.Goal(targets=[Point()]))
    assert capsys.readouterr().out.endswith("- x: 0.0\n       y: 0.0\n       z: 0.0\n\n")


def test_the_id_is_printed_when_the_goal_is_accepted(plain, sent, capsys):
    plain.accepted(sent)
    assert capsys.readouterr().out == (
        "Goal accepted with ID: 000102030405060708090a0b0c0d0e0f\n\n"
    )


def test_feedback_is_indented_by_four(plain, capsys):
    plain.feedback(Fibonacci.Feedback(partial_sequence=[0, 1]))
    assert capsys.readouterr().out == ("Feedback:\n    partial_sequence:\n    - 0\n    - 1\n\n")


def test_the_result_is_followed_by_the_status(plain, capsys):
    plain.ended(outcome(GoalStatus.CANCELED))
    assert capsys.readouterr().out == (
        "Result:\n    sequence:\n    - 0\n    - 1\n\nGoal finished with status: CANCELED\n"
    )


def test_a_rejected_goal_has_its_line(plain, capsys):
    plain.rejected("not today")
    assert capsys.readouterr().out == "Goal was rejected.\n"


def test_plain_text_says_nothing_of_states_on_the_way(plain, capsys):
    plain.status(GoalStatus.EXECUTING)
    plain.close()
    assert capsys.readouterr().out == ""


@pytest.fixture
def told(capsys):
    """The events that were printed."""
    return lambda: [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_the_acceptance_tells_all_that_was_sent(sent, told):
    JsonTranscript().accepted(sent)
    assert told() == [
        {
            "event": "accepted",
            "goal_id": ID.hex(),
            "name": "/fibonacci",
            "type": "action_tutorials_interfaces/action/Fibonacci",
            "stamp": {"sec": 1, "nanosec": 2},
            "goal": {"order": 5},
        }
    ]


def test_a_status_is_told_once(told):
    transcript = JsonTranscript()
    for status in (GoalStatus.EXECUTING, GoalStatus.EXECUTING, GoalStatus.CANCELING):
        transcript.status(status)
    assert [each["status"] for each in told()] == ["EXECUTING", "CANCELING"]


def test_the_result_tells_why(told):
    JsonTranscript().ended(outcome(GoalStatus.ABORTED, 'the "reason" – ⠿'))
    assert told()[-1] == {
        "event": "result",
        "goal_id": "",
        "status": "ABORTED",
        "result": {"sequence": [0, 1]},
        "reason": 'the "reason" – ⠿',
    }


def test_what_is_not_an_event_is_not_printed(told):
    transcript = JsonTranscript()
    transcript.sending(Fibonacci.Goal())
    transcript.canceling()
    transcript.close()
    assert told() == []


def test_a_rejection_tells_why(told):
    JsonTranscript().rejected("not today")
    assert told() == [{"event": "rejected", "goal_id": "", "reason": "not today"}]


@pytest.mark.parametrize("transcript", [JsonTranscript(), PlainTranscript(wants_feedback=False)])
def test_a_note_goes_to_stderr(transcript, capsys):
    transcript.note("by the way")
    assert capsys.readouterr() == ("", "turtleact: by the way\n")


@pytest.mark.parametrize("transcript", [JsonTranscript(), PlainTranscript(wants_feedback=False)])
async def test_nothing_moves(transcript):
    await transcript.animate()
