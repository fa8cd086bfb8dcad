from __future__ import annotations

from typing import Any, NoReturn

import pytest

from turtleact.errors import InvalidInterface, UnknownInterface
from turtleact.interfaces.definition import ActionDefinition, MessageDefinition
from turtleact.interfaces.making import make_action, make_message, make_service
from turtleact.interfaces.parse import parse
from turtleact.interfaces.standard import CancelGoal, Point
from turtleact.interfaces.types import definition, nested_classes


def nothing(type_name: str) -> NoReturn:
    raise UnknownInterface(type_name, "example_msgs/msg/Near")


def message(text: str) -> MessageDefinition:
    said = parse(text, "example_msgs/msg/Sample")
    assert isinstance(said, MessageDefinition)
    return said


@pytest.mark.parametrize(
    ("make", "kind", "text"),
    [
        (make_message, "msg", "int8 LIMIT=3\nint32 x 5\nstring<=4[<=2] y ['a']\nint32 from"),
        (make_service, "srv", "int32 a\n---\nbool b true"),
        (make_action, "action", "int32[] a [1]\n---\n---\nfloat64[2] b"),
    ],
)
def test_a_class_says_what_its_definition_says(make, kind, text):
    said = parse(text, f"example_msgs/{kind}/Sample")
    assert definition(make(said, nothing)) == said


def test_a_class_is_named_as_in_rclpy():
    sample = make_message(message(""), nothing)
    assert (sample.__module__, sample.__qualname__) == ("example_msgs.msg", "Sample")


def test_a_part_is_named_by_the_whole():
    said = parse("---\n---", "example_msgs/action/Sample")
    assert isinstance(said, ActionDefinition)
    sample = make_action(said, nothing)
    assert (sample.Goal.__name__, sample.Goal.__qualname__) == ("Goal", "Sample.Goal")


def test_constants_and_defaults_are_in_the_class():
    sample: Any = make_message(message("int8 LIMIT=3\nint32 x 5"), nothing)
    assert (sample.LIMIT, sample().x) == (3, 5)


def test_messages_inside_are_found():
    said = message("geometry_msgs/Point at")
    assert nested_classes(make_message(said, lambda _: Point)) == (Point,)


def test_an_unknown_message_inside_is_told():
    said = message("Other x")
    problem = "x: unknown interface 'example_msgs/msg/Other', did you mean 'example_msgs/msg/Near'"
    with pytest.raises(InvalidInterface, match=f"^example_msgs/msg/Sample: {problem}"):
        make_message(said, nothing)


def test_what_is_inside_must_be_a_message():
    said = message("Other x")
    with pytest.raises(InvalidInterface, match="x: example_msgs/msg/Other is no message"):
        make_message(said, lambda _: CancelGoal)
