"""Types and bytes beside those of a real ROS 2."""

from __future__ import annotations

import random
import string
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

import pytest

from turtleact.interfaces import (
    Action,
    Message,
    Service,
    decode,
    encode,
    fields,
    from_dict,
    get_interface,
    implied,
    known_interfaces,
    load_interfaces,
    to_dict,
    type_hash,
)
from turtleact.interfaces.definition import INTEGER_RANGES, ArrayForm, FieldType
from turtleact.interfaces.types import nested_classes

from ..registry import isolated_registry
from .conftest import Ros

ROUNDS = 5
"""How many messages of each type are compared."""

LETTERS = string.ascii_letters + " äß€"
SEQUENCE = 4
"""The most elements of an unbounded sequence."""


class Compared(NamedTuple):
    """What both have said.

    Attributes:
        shipped: The hashes of the interfaces that ship with turtleact.
        ours: The hashes that turtleact gives the interfaces installed with ROS 2.
        theirs: ROS 2's, with those of the types that they refer to or imply.
        messages: Each with the values that rclpy has read, and the bytes that it has written.
    """

    shipped: dict[str, str]
    ours: dict[str, str]
    theirs: dict[str, str]
    messages: list[tuple[Message, object, bytes]]


@pytest.fixture(scope="module")
def compared(ros: Ros) -> Iterator[Compared]:
    """All types that this ROS 2 has as files, in one run of its Python."""
    with isolated_registry():
        shipped = {name: type_hash(get_interface(name)) for name in known_interfaces()}
        names = sorted({name for prefix in ros.prefixes for name in load_interfaces(prefix)})
        chance = random.Random(44)  # the same messages in every run
        messages = [
            made(cls, chance)
            for name in names
            for cls in message_classes(name)
            for _ in range(ROUNDS)
        ]
        sent = [[type(message).type_name, encode(message).hex()] for message in messages]
        answer = ros.run("ros_messages.py", {"types": names, "messages": sent})
        read = [
            (message, values, bytes.fromhex(data))
            for message, (values, data) in zip(messages, answer["messages"], strict=True)
        ]
        ours = {name: type_hash(get_interface(name)) for name in answer["hashes"]}
        yield Compared(shipped, ours, answer["hashes"], read)


def message_classes(type_name: str) -> list[type[Message]]:
    """The messages of an interface; of an action also those that it is sent in."""
    found: Any = get_interface(type_name)
    if issubclass(found, Service):
        return [found.Request, found.Response]
    if issubclass(found, Action):
        sent: Any = implied(found)
        wrapped = [sent.send_goal.Request, sent.get_result.Response, sent.feedback_message]
        return [found.Goal, found.Result, found.Feedback, *wrapped]
    return [found]


def made(cls: type[Message], chance: random.Random) -> Message:
    """A message with values drawn for each field."""
    drawn = {
        field.name: value_of(field.type, nested, chance)
        for field, nested in zip(fields(cls), nested_classes(cls), strict=True)
    }
    return from_dict(cls, drawn)


def value_of(of: FieldType, nested: type[Message] | None, chance: random.Random) -> object:
    if of.form is ArrayForm.SINGLE:
        return made(nested, chance) if nested else primitive(of, chance)
    most = of.size or SEQUENCE
    count = most if of.form is ArrayForm.FIXED else chance.randint(0, min(most, SEQUENCE))
    return [value_of(of.element, nested, chance) for _ in range(count)]


def primitive(of: FieldType, chance: random.Random) -> object:
    if of.is_string:
        bound = SEQUENCE if of.string_bound is None else of.string_bound
        return "".join(chance.choices(LETTERS, k=chance.randint(0, bound)))
    if of.name == "bool":
        return chance.random() < 0.5
    if of.name == "float32":
        return struct.unpack("<f", struct.pack("<f", chance.uniform(-1e9, 1e9)))[0]
    if of.name == "float64":
        return chance.uniform(-1e300, 1e300)
    low, high = INTEGER_RANGES[of.name]
    return chance.choice([low, high, chance.randint(low, high)])


def listed(value: object) -> object:
    """Plain values as the peer gives them: bytes as numbers."""
    if isinstance(value, dict):
        return {name: listed(each) for name, each in value.items()}
    if isinstance(value, (list, tuple, bytes)):
        return [listed(each) for each in value]
    return value


def test_every_type_has_the_hash_that_ros_gives_it(compared):
    assert compared.ours == compared.theirs


def test_every_interface_that_ships_has_the_hash_that_ros_gives_it(compared):
    both = compared.shipped.keys() & compared.theirs.keys()
    assert {name: compared.shipped[name] for name in both} == {
        name: compared.theirs[name] for name in both
    }
    assert {"action_msgs", "geometry_msgs", "rcl_interfaces"} <= {
        name.split("/")[0] for name in both
    }


def test_rclpy_reads_the_values_that_were_written(compared):
    for message, values, _ in compared.messages:
        assert listed(to_dict(message)) == values, type(message).type_name


def test_what_rclpy_writes_is_read(compared):
    for message, _, data in compared.messages:
        assert decode(type(message), data) == message, type(message).type_name


def test_rclpy_writes_the_same_bytes_but_for_its_garbage(compared):
    for message, _, data in compared.messages:
        written = encode(message)
        assert len(written) <= len(data), type(message).type_name
        assert all(ours in (0, its) for ours, its in zip(written, data, strict=False))
