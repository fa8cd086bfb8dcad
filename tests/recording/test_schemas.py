"""Schemas: every type survives the way through its text, and files cannot change what is known."""

from typing import Any

import pytest

from turtleact.interfaces import (
    Action,
    Message,
    Service,
    decode,
    encode,
    get_interface,
    get_message,
    implied,
    known_interfaces,
)
from turtleact.interfaces.classes import event_message
from turtleact.recording.schemas import SEPARATOR, Schema, class_of, schema_of

from .bags import FEEDBACK, POSE


def all_messages():
    """Every message class that can be on a topic."""
    for name in known_interfaces():
        found = get_interface(name)
        if issubclass(found, Message):
            yield found
        elif issubclass(found, Service):
            yield event_message(found)
        else:
            assert issubclass(found, Action)
            ways = implied(found)
            yield ways.feedback_message
            yield event_message(ways.send_goal)
            yield event_message(ways.get_result)


def test_every_known_type_is_found_by_its_schema():
    for cls in all_messages():
        assert class_of(schema_of(cls)) is cls


def test_names_are_short_everywhere_and_each_type_comes_once():
    text = schema_of(get_message("example_interfaces/action/Fibonacci_SendGoal_Event")).text
    assert "/msg/" not in text
    assert "/action/" not in text
    assert "\nexample_interfaces/Fibonacci_SendGoal_Request[<=1] request\n" in text
    headings = [line for line in text.splitlines() if line.startswith("MSG: ")]
    assert len(headings) == len(set(headings)) == text.count(f"\n{SEPARATOR}\n")
    assert len(SEPARATOR) == 80


def test_a_type_that_is_not_known_is_made_from_its_schema_and_stays_unknown():
    text = schema_of(FEEDBACK).text.replace("example_interfaces/Fibonacci", "lab_msgs/Count")
    made = class_of(Schema("lab_msgs/action/Count_FeedbackMessage", "ros2msg", text))
    assert made is not None
    bytes_of = encode(FEEDBACK(feedback=type(FEEDBACK().feedback)(sequence=[1, 2])))
    read: Any = decode(made, bytes_of)
    assert read.feedback.sequence == [1, 2]
    assert not [name for name in known_interfaces() if name.startswith("lab_msgs/")]


def test_a_type_with_another_definition_is_read_as_the_file_says():
    made: Any = class_of(Schema("turtlesim/msg/Pose", "ros2msg", "float64 x\nfloat64 y\n"))
    assert made is not None
    assert made is not POSE
    assert made(x=1.5, y=2.0) == decode(made, encode(made(x=1.5, y=2.0)))
    assert get_interface("turtlesim/msg/Pose") is POSE


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("std_msgs/msg/Empty", "uint8 structure_needs_at_least_one_member\n"),
        ("std_msgs/msg/Byte", "uint8 data\n"),
        ("geometry_msgs/msg/Vector3", "float64 x 1.0\nfloat64 y\nfloat64 z\n# a comment\n"),
    ],
)
def test_other_spellings_of_a_known_layout_are_the_known_type(name, text):
    assert class_of(Schema(name, "ros2msg", text)) is get_interface(name)


def test_full_names_are_read_too():
    text = schema_of(get_message("geometry_msgs/msg/Pose")).text.replace("_msgs/", "_msgs/msg/")
    assert class_of(Schema("geometry_msgs/msg/Pose", "ros2msg", text)) is get_interface(
        "geometry_msgs/msg/Pose"
    )


@pytest.mark.parametrize(
    "text",
    ["float46 x", "lab_msgs/Missing x", f"lab_msgs/A a\n{SEPARATOR}\nMSG: lab_msgs/A\nA a", "a"],
)
def test_what_cannot_be_read_gives_none(text):
    assert class_of(Schema("lab_msgs/msg/Root", "ros2msg", text)) is None


def test_without_a_text_the_hash_decides():
    assert class_of(Schema("turtlesim/msg/Pose")) is POSE
    assert class_of(Schema("turtlesim/msg/Pose"), "RIHS01_0") is None
    assert class_of(Schema("lab_msgs/msg/Root")) is None
