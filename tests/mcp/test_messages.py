"""The schemas of interfaces, and arguments that fit them."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import jsonschema
import pytest

from turtleact.errors import InvalidGoal, InvalidMessage
from turtleact.interfaces import (
    Message,
    array,
    bool_,
    bounded,
    float64,
    get_action,
    int8,
    load_interfaces,
    string,
    uint8,
    uint64,
)
from turtleact.interfaces.standard import Fibonacci, Point
from turtleact.mcp.messages import input_schema, message_from, output_schema, plain


class Lift(Message, type_name="mcp_tests/msg/Lift"):
    """Lift something.

    Attributes:
        height: How high (m).
    """

    MODE_SLOW: ClassVar[uint8] = 0
    MODE_FAST: ClassVar[uint8] = 1
    LAMP_RED: ClassVar[uint8] = 1
    LAMP_GREEN: ClassVar[uint8] = 2
    LAMP_BLUE: ClassVar[uint8] = 4
    HEIGHT_TOP: ClassVar[float64] = -1.0

    height: float64 = 0.0
    mode: uint8 = 0
    lamp: uint8 = 0
    label: bounded[string, 8] = ""
    steps: bounded[list[int8], 3] = []
    corner: array[list[float64], 2] = [0.0, 0.0]
    serial: uint64 = 0
    is_gentle: bool_ = False
    at: Point = Point()


class Turn(Message, type_name="mcp_tests/msg/Turn"):
    """Turn."""

    angle: float64 = 0.0
    speed: float64 = 2.0
    stops: list[Point] = []


PROPERTIES = input_schema(Lift)["properties"]


@pytest.mark.parametrize(
    ("field", "schema"),
    [
        (
            "height",
            {"type": "number", "description": "How high (m). Constants: HEIGHT_TOP = -1.0."},
        ),
        (
            "mode",
            {
                "type": "integer",
                "minimum": 0,
                "maximum": 255,
                "enum": [0, 1],
                "description": "Constants: MODE_SLOW = 0, MODE_FAST = 1.",
            },
        ),
        ("label", {"type": "string", "maxLength": 8}),
        (
            "steps",
            {
                "type": "array",
                "items": {"type": "integer", "minimum": -128, "maximum": 127},
                "maxItems": 3,
            },
        ),
        (
            "corner",
            {"type": "array", "items": {"type": "number"}, "maxItems": 2, "minItems": 2},
        ),
        ("serial", {"type": "integer", "minimum": 0, "maximum": 2**64 - 1}),
        ("is_gentle", {"type": "boolean"}),
        (
            "at",
            {
                "type": "object",
                "properties": {axis: {"type": "number", "default": 0.0} for axis in "xyz"},
                "additionalProperties": False,
            },
        ),
    ],
)
def test_schema_of_a_field_has_all_that_is_known(field, schema):
    assert PROPERTIES[field] == schema


def test_constants_that_are_bits_are_listed_but_may_be_combined():
    lamp = PROPERTIES["lamp"]
    assert "enum" not in lamp
    assert "LAMP_BLUE = 4" in lamp["description"]


def test_fields_of_a_goal_without_any_default_are_required():
    assert input_schema(Lift)["required"] == list(PROPERTIES)


def test_other_defaults_leave_only_lists_and_messages_required():
    schema = input_schema(Turn)
    assert schema["required"] == ["stops"]
    assert [schema["properties"][name]["default"] for name in ("angle", "speed")] == [0.0, 2.0]


def test_comments_of_a_file_are_beside_a_field_or_above_it(tmp_path):
    file = tmp_path / "mcp_tests" / "action" / "Dig.action"
    file.parent.mkdir(parents=True)
    file.write_text("# how deep\n# (m)\nfloat64 depth\nint8 tool # which\n---\n---\nint8 done\n")
    load_interfaces(tmp_path)
    dig = get_action("mcp_tests/action/Dig")
    properties = input_schema(dig.Goal)["properties"]
    assert [each["description"] for each in properties.values()] == ["how deep (m)", "which"]


@pytest.mark.parametrize(
    "message", [Lift(corner=[math.nan, 1.0]), Turn(stops=[Point(x=math.inf)]), Lift(mode=7)]
)
def test_what_plain_gives_fits_the_output_schema(message: Message):
    cls: Any = type(message)
    jsonschema.validate(plain(message), output_schema(cls))


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ({"stops": [{"x": 1, "yy": 2}]}, r"goal\.stops\[0\]: unknown field 'yy', did you mean 'y'"),
        ({"stops": [{"x": True}]}, r"goal\.stops\[0\]\.x: expected a number .*, got True"),
        ({}, r"goal\.stops: it is missing"),
        ({"stops": None}, r"goal\.stops: expected a list"),
    ],
)
def test_arguments_that_do_not_fit_are_refused_with_a_path(arguments, problem):
    with pytest.raises(InvalidGoal, match=problem):
        message_from(Turn, arguments, root="goal")


def test_errors_of_a_request_name_the_request():
    with pytest.raises(InvalidMessage, match=r"request\.order: it is missing"):
        message_from(Fibonacci.Goal, {}, root="request")


def test_arguments_become_a_message():
    assert message_from(Turn, {"stops": [{"x": 1}]}, root="goal") == Turn(stops=[Point(x=1.0)])
