"""The exception tree: what derives from what, and what each one says."""

from __future__ import annotations

import pickle

import pytest

from turtleact import errors
from turtleact.errors import LONGEST, TurtleactError, encodable, summary, text_of
from turtleact.goals.state import GoalEvent, GoalStatus

from .tables import together

# Each exception with its facts, and the text that these make.
SAID = [
    (
        errors.InvalidName("pen up", "no blanks", 3),
        "invalid name: no blanks\n  pen up\n     ^",
    ),
    (
        errors.InvalidInterface("unknown type", source="A.msg", line=3, column=2, text=" float46"),
        "A.msg:3:2: unknown type\n   float46\n   ^",
    ),
    (errors.InvalidInterface("no fields", source="pkg/msg/A"), "pkg/msg/A: no fields"),
    (errors.UnknownInterface("pkg/msg/A"), "unknown interface 'pkg/msg/A'"),
    (
        errors.UnknownInterface("pkg/msg/A", "pkg/msg/B"),
        "unknown interface 'pkg/msg/A', did you mean 'pkg/msg/B'?",
    ),
    (errors.InvalidMessage("pose.x", "expected a float"), "pose.x: expected a float"),
    (errors.InvalidGoal("goal.order", "expected an int"), "goal.order: expected an int"),
    (
        errors.InvalidGoalId("xy", "a goal id has 32 hexadecimal digits", 0),
        "invalid name: a goal id has 32 hexadecimal digits\n  xy\n  ^",
    ),
    (errors.InvalidBody("count", "is none"), "the body of action 'count' is none"),
    (
        errors.InvalidTransition(GoalStatus.SUCCEEDED, GoalEvent.ABORT),
        "the goal is SUCCEEDED: ABORT is not allowed",
    ),
    (
        errors.InvalidTransition(GoalStatus.SUCCEEDED, "feedback", "1f3a"),
        "goal 1f3a is SUCCEEDED: feedback is not allowed",
    ),
    (errors.GoalError("why"), "the goal did not succeed: why"),
    (errors.GoalRejected(), "the goal was rejected"),
    (errors.GoalRejected("too far"), "the goal was rejected: too far"),
    (errors.GoalAborted("no pen", 7), "the goal was aborted: no pen"),
    (errors.GoalCanceled("", 7), "the goal was canceled"),
    (
        errors.PauseRefused("it has ended"),
        "the goal cannot be paused or resumed: it has ended",
    ),
    (errors.UnknownGoal(), "the goal is not known to the server"),
    (errors.ServerUnavailable("/count"), "action '/count': no server answers"),
    (errors.ServerUnavailable("/count", "it is gone"), "action '/count': it is gone"),
    (
        errors.ServerUnavailable("/count", "it left", when="before it replied"),
        "action '/count': it left before it replied",
    ),
    (
        errors.ServerUnavailable("/count", "it is gone", otherwise="is deaf"),
        "action '/count': it is gone, or is deaf",
    ),
    (
        errors.ServerUnavailable("/clear", kind="service"),
        "service '/clear': no server answers",
    ),
    (errors.ServiceError("/clear", "it failed"), "service '/clear': it failed"),
    (errors.ServiceTimeout("/clear", 1.5), "service '/clear': no response within 1.5 s"),
    (errors.SimError("off the map"), "off the map"),
    (errors.SimError("off the map", turtle="turtle1"), "turtle1: off the map"),
    (errors.Abort("no pen", 7), "no pen"),
    (errors.Cancel(7), "7"),
    (errors.Reject("too far"), "too far"),
]
KINDS = [
    each
    for each in vars(errors).values()
    if isinstance(each, type)
    and issubclass(each, Exception)
    and each.__module__ == errors.__name__
    and not each.__name__.startswith("_")
]


@together
@pytest.mark.parametrize(("error", "text"), SAID, ids=lambda value: type(value).__name__)
def test_an_exception_builds_its_text_from_its_facts(error, text):
    assert str(error) == text


@together
@pytest.mark.parametrize("kind", KINDS)
def test_each_exception_is_a_public_turtleact_error(kind):
    assert issubclass(kind, TurtleactError)
    assert kind.__name__ in errors.__all__


@together
@pytest.mark.parametrize("kind", KINDS)
def test_each_exception_stands_in_the_picture_of_the_tree(kind):
    assert f" {kind.__name__} " in f"{errors.__doc__} ".replace("\n", " ")


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (ValueError("no pen"), "ValueError: no pen"),
        (ValueError(), "ValueError"),
        (ExceptionGroup("both", [ValueError("no pen"), OSError()]), "ValueError: no pen; OSError"),
        (
            ExceptionGroup("deep", [ExceptionGroup("deeper", [KeyError("x")])]),
            "KeyError: 'x'",
        ),
    ],
)
def test_an_exception_is_summed_up_in_a_line(error, line):
    assert summary(error) == line


@together
@pytest.mark.parametrize("error", [error for error, _ in SAID], ids=lambda e: type(e).__name__)
def test_an_exception_can_be_sent_to_another_process(error):
    sent = pickle.loads(pickle.dumps(error))
    assert (type(sent), vars(sent), str(sent)) == (type(error), vars(error), str(error))


def test_a_text_of_several_lines_becomes_one():
    assert summary(ValueError("one\ntwo")) == "ValueError: one two"


# --- the texts of what users' code raises ---------------------------------------------------


def test_a_long_text_is_cut_and_its_length_said():
    assert text_of("a" * LONGEST) == "a" * LONGEST
    assert text_of("a" * 50_000) == "a" * LONGEST + "… (50,000 characters)"


def test_a_group_of_long_texts_is_cut_as_a_whole():
    group = ExceptionGroup("many", [ValueError("a" * 9_000) for _ in range(9)])
    assert len(summary(group)) < LONGEST + 40


def test_half_a_surrogate_pair_is_escaped():
    assert encodable("caf\udce9 🐢") == r"caf\udce9 🐢"
