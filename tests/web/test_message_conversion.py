"""Messages as JSON and CBOR say them, and back."""

from __future__ import annotations

import base64
import json
import math
import struct
from typing import Any

import anyio
import anyio.lowlevel
import cbor2
import msgspec
import pytest

from turtleact.errors import InvalidMessage
from turtleact.interfaces import (
    Message,
    byte,
    char,
    float32,
    float64,
    int8,
    int16,
    int32,
    int64,
    string,
    uint8,
    uint16,
    uint32,
    uint64,
)
from turtleact.interfaces.standard import (
    UUID,
    GoalInfo,
    Point,
    Time,
    Twist,
    Vector3,
)
from turtleact.web.message_conversion import cbor_values, json_values, message_from, read_message


class Everything(Message, type_name="lab_interfaces/msg/Everything"):
    """One field of each sort that JSON or CBOR treats in its own way."""

    from_: string = ""
    pixels: list[uint8] = []
    letters: list[char] = []
    octets: list[byte] = []
    ratios: list[float64] = []
    ratio: float32 = 0.0
    whole: int32 = 0
    stamps: list[Time] = []
    ids: list[UUID] = []
    word: string = ""


class Numbers(Message, type_name="lab_interfaces/msg/Numbers"):
    """A list of each type of number that CBOR has a tag for."""

    a: list[uint16] = []
    b: list[uint32] = []
    c: list[uint64] = []
    d: list[byte] = []
    e: list[int8] = []
    f: list[int16] = []
    g: list[int32] = []
    h: list[int64] = []
    i: list[float32] = []
    j: list[float64] = []
    k: list[uint8] = []


def said(message: Message) -> Any:
    """What a client reads of the JSON of a message."""
    return json.loads(msgspec.json.encode(json_values(message)))


# out


@pytest.mark.parametrize(
    ("message", "name", "written"),
    [
        (Everything(pixels=[0, 1, 255]), "pixels", "AAH/"),
        (Everything(letters=[65]), "letters", "QQ=="),
        (Everything(octets=[1, 255]), "octets", [1, 255]),
        (Everything(from_="here"), "from", "here"),
        (Everything(stamps=[Time(1, 2)]), "stamps", [{"sec": 1, "nanosec": 2}]),
        (Everything(ids=[UUID(bytes(16))]), "ids", [{"uuid": "AAAAAAAAAAAAAAAAAAAAAA=="}]),
    ],
)
def test_a_field_is_written_under_its_name_in_ros(message, name, written):
    assert said(message)[name] == written


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_what_json_cannot_say_is_null(number):
    assert said(Everything(ratio=number, ratios=[number]))["ratio"] is None
    assert said(Everything(ratio=number, ratios=[1.0, number]))["ratios"] == [1.0, None]


def test_cbor_tags_lists_of_numbers():
    numbers = [1, 2, 127]
    lists: dict[str, Any] = {name: list(numbers) for name in "abcdefghijk"}
    message = Numbers(**lists)
    values = cbor2.loads(cbor2.dumps(cbor_values(message)))
    codes = {69: "H", 70: "I", 71: "Q", 72: "b", 77: "h", 78: "i", 79: "q", 85: "f", 86: "d"}
    tags = {name: value.tag for name, value in values.items() if name != "k"}
    assert list(tags.values()) == [69, 70, 71, 72, 72, 77, 78, 79, 85, 86]
    for name, tag in tags.items():
        assert struct.unpack(f"<3{codes[tag]}", values[name].value) == tuple(numbers)


def test_cbor_has_bytes_for_uint8():
    assert cbor_values(Numbers(k=[1, 2]))["k"] == b"\x01\x02"


def test_cbor_has_maps_for_messages_and_keeps_nan():
    values: Any = cbor_values(Twist(linear=Vector3(x=math.nan)))
    assert math.isnan(values["linear"]["x"])
    assert values["angular"] == {"x": 0.0, "y": 0.0, "z": 0.0}


# in


def test_what_is_left_out_keeps_its_default():
    assert message_from(Twist, {"linear": {"x": 1}}, root="msg") == Twist(linear=Vector3(x=1.0))


def test_a_list_gives_the_fields_in_their_order():
    assert message_from(Point, [1, 2], root="args") == Point(x=1.0, y=2.0)


@pytest.mark.parametrize("given", [[0, 1, 255], "AAH/"])
def test_bytes_are_taken_as_base64_and_as_numbers(given):
    assert list(message_from(Everything, {"pixels": given}, root="msg").pixels) == [0, 1, 255]


def test_a_goals_id_is_taken_as_base64():
    given = {"goal_id": {"uuid": base64.b64encode(bytes(range(16))).decode()}}
    assert message_from(GoalInfo, given, root="args").goal_id.uuid == bytes(range(16))


@pytest.mark.parametrize("given", ["AAH", "A!H/", "AAH/ "])
def test_text_that_is_no_base64_is_refused(given):
    with pytest.raises(InvalidMessage, match=r"pixels.*expected base64 text or a list of numbers"):
        message_from(Everything, {"pixels": given}, root="msg")


def test_null_is_taken_for_nan():
    message = message_from(Everything, {"ratio": None, "ratios": [1, None]}, root="msg")
    assert math.isnan(message.ratio)
    assert math.isnan(message.ratios[1])


async def test_a_large_message_is_read_while_others_go_on():
    stamps = [{"secs": number} for number in range(5000)]
    turns, is_read = [0], anyio.Event()

    async def go_on() -> None:
        while not is_read.is_set():
            turns[0] += 1
            await anyio.lowlevel.checkpoint()

    async with anyio.create_task_group() as group:
        group.start_soon(go_on)
        message = await read_message(Everything, {"stamps": stamps}, root="msg")
        is_read.set()
    assert message.stamps[4999] == Time(4999, 0)
    assert turns[0] > 1


async def test_a_mistake_in_a_large_message_is_told():
    stamps: list[Any] = [{"secs": number} for number in range(5000)]
    stamps[4000] = {"secs": "late"}
    with pytest.raises(InvalidMessage, match=r"msg.stamps\[4000\].sec: expected a whole number"):
        await read_message(Everything, {"stamps": stamps}, root="msg")


def test_null_is_not_taken_for_a_whole_number():
    with pytest.raises(InvalidMessage, match=r"msg.whole: expected a whole number \(int32\)"):
        message_from(Everything, {"whole": None}, root="msg")


def test_a_time_is_taken_as_in_ros_1():
    given = {"stamps": [{"secs": 1, "nsecs": 2}, {"sec": 3, "nanosec": 4}]}
    assert message_from(Everything, given, root="msg").stamps == [Time(1, 2), Time(3, 4)]


@pytest.mark.parametrize("given", [{"stamps": 3}, {"stamps": [3]}, {"ids": {"uuid": 1}}])
def test_what_is_no_list_and_no_object_is_refused(given):
    with pytest.raises(InvalidMessage, match="msg"):
        message_from(Everything, given, root="msg")
