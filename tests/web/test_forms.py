"""What a form is made from: each field with its type, default, bounds and comment."""

from __future__ import annotations

from typing import Any, get_args

import pytest

from turtleact.actions.go_to import GoTo
from turtleact.actions.patrol import Patrol
from turtleact.actions.steering import Style
from turtleact.interfaces import (
    Action,
    Message,
    load_action,
    load_message,
    string,
)
from turtleact.web.page_values import form

INNER = """\
float64 x 1.5   # where to go [m]
string<=3 tag "abc"
"""
OUTER = """\
# A comment of the whole goal.
bool[2] flags
lab_forms/Inner[<=4] many      # up to four
lab_forms/Inner one
uint64 large 18446744073709551615
string[] names ["a", "b"]
int8 KIND=1   # a constant is no field
---
---
float32 left  # how far it is [m]
"""

CHOICES = """\
uint8 MODE_SLOW=0
uint8 MODE_FAST=1
string PEN_RED="red"
string PEN_BLACK="black"
uint8 LAMP_LEFT=1
uint8 LAMP_MIDDLE=2
uint8 LAMP_RIGHT=4
uint8 mode
string pen "blue"
uint8 lamp
float64 TIMEOUT_NEVER=-1.0
float64 TIMEOUT_USUAL=10.0
float64 timeout 10.0
bool SIDE_LEFT=false
bool SIDE_RIGHT=true
bool side
string TAG_NONE=""
string TAG_FIRST="first"
string tag
int32 COUNT_NONE=0
int32 count
int32 STEPS_NONE=0
int32 STEPS_ONE=1
int32[] steps [0, 1]
---
---
"""


@pytest.fixture(scope="module")
def fields() -> dict[str, Any]:
    load_message(INNER, type_name="lab_forms/msg/Inner")
    described = form(load_action(OUTER, type_name="lab_forms/action/Outer"))
    return {field["name"]: field for field in described["goal"]}


def test_arrays_tell_their_form_and_bound(fields):
    assert fields["flags"]["array"] == {"form": "fixed", "size": 2}
    assert fields["many"]["array"] == {"form": "bounded", "size": 4}
    assert fields["names"]["array"] == {"form": "unbounded", "size": 0}


def test_defaults_are_filled_in(fields):
    assert fields["flags"]["default"] == [False, False]
    assert fields["names"]["default"] == ["a", "b"]
    assert fields["one"]["default"] == {"x": 1.5, "tag": "abc"}


def test_whole_numbers_tell_their_range_as_text(fields):
    large = fields["large"]
    assert (large["least"], large["most"], large["default"]) == (
        "0",
        str(2**64 - 1),
        str(2**64 - 1),
    )


def test_nested_fields_are_described(fields):
    x, tag = fields["one"]["fields"]
    assert (x["type"], x["default"]) == ("float64", 1.5)
    assert (tag["longest"], tag["default"]) == (3, "abc")


@pytest.fixture(scope="module")
def named() -> dict[str, Any]:
    described = form(load_action(CHOICES, type_name="lab_forms/action/Choices"))
    return {field["name"]: field for field in described["goal"]}


def test_a_field_with_a_named_default_is_limited_to_the_named_values(named):
    assert named["mode"]["values"] == [("0", "slow (0)"), ("1", "fast (1)")]
    assert "suggested" not in named["mode"]
    assert named["tag"]["values"] == [("", "(empty)"), ("first", "first")]


@pytest.mark.parametrize(
    ("field", "suggested"),
    [
        ("pen", [("red", "red"), ("black", "black")]),  # its default has no name
        ("timeout", [("-1.0", "never (-1.0)"), ("10.0", "usual (10.0)")]),
        ("count", [("0", "none (0)")]),
        ("steps", [("0", "none (0)"), ("1", "one (1)")]),
    ],
)
def test_the_named_values_of_a_field_that_may_have_others_are_suggested(named, field, suggested):
    assert named[field]["suggested"] == suggested
    assert "values" not in named[field]


@pytest.mark.parametrize("field", ["lamp", "side"])
def test_the_named_values_of_flags_and_of_a_bool_are_not_offered(named, field):
    assert not {"values", "suggested"} & named[field].keys()


class Steer(Action, type_name="lab_forms/action/Steer"):
    """Steer."""

    class Goal(Message):
        """Where to.

        Attributes:
            style: ``slow`` or ``fast``.
            label: Not ``empty``.
        """

        style: string = "slow"
        label: string = ""

    class Result(Message):
        pass

    class Feedback(Message):
        pass


def test_the_words_that_the_comment_of_a_text_quotes_are_suggested():
    style, label = form(Steer)["goal"]
    assert style["suggested"] == [("slow", "slow"), ("fast", "fast")]
    assert "suggested" not in label  # one word is no choice


@pytest.mark.parametrize("action", [Patrol, GoTo])
def test_the_styles_are_choices(action):
    style = next(each for each in form(action)["goal"] if each["name"] == "style")
    assert [value for value, _ in style["values"]] == list(get_args(Style))


def test_the_comments_of_a_docstring_are_kept():
    described = form(Patrol)
    assert described["type"] == "turtleact_interfaces/action/Patrol"
    comments = {field["name"]: field["comment"] for field in described["goal"]}
    assert comments["tolerance"].endswith("(m), above zero.")
    (left,) = [each for each in described["feedback"] if each["name"] == "distance_remaining"]
    assert "(m)" in left["comment"]
