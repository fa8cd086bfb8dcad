from __future__ import annotations

import math
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.errors import InvalidGoal, InvalidMessage
from turtleact.interfaces.mapping import from_dict, to_dict
from turtleact.interfaces.standard import UUID, GoalInfo, Point, Time
from turtleact.interfaces.types import Message, array, bool_, bounded, float64, int32, string, uint8


class Empty(Message, type_name="example_msgs/msg/Empty"):
    pass


class Sample(Message, type_name="example_msgs/msg/Sample"):
    flag: bool_ = False
    name: string = ""
    at: Point = Point()
    path: bounded[list[Point], 2] = []
    raw: bytes = b""
    bytes_as_list: list[uint8] = []
    ranks: array[list[int32], 2] = [0, 0]
    from_: float64 = 0.0


FULL = Sample(True, "a", Point(1.0), [Point(y=2.0)], b"ab", [1], [1, 2], 0.5)
AS_DICT = {
    "flag": True,
    "name": "a",
    "at": {"x": 1.0, "y": 0.0, "z": 0.0},
    "path": [{"x": 0.0, "y": 2.0, "z": 0.0}],
    "raw": b"ab",
    "bytes_as_list": [1],
    "ranks": [1, 2],
    "from": 0.5,
}


def test_a_message_becomes_a_dict_by_ros_names():
    assert to_dict(FULL) == AS_DICT


def test_a_dict_shares_nothing_with_the_message():
    message = Sample(ranks=[1, 2])
    ranks = to_dict(message)["ranks"]
    assert isinstance(ranks, list)
    ranks.append(3)
    assert message.ranks == [1, 2]


def test_a_dict_holds_plain_values():
    point = Point(x=np.float32(1.0))  # type: ignore[arg-type]  # numpy's own, on purpose
    assert type(to_dict(point)["x"]) is float


def test_a_message_that_does_not_fit_gives_no_dict():
    message = Sample(at=Point(x="a"))  # type: ignore[arg-type]  # on purpose
    with pytest.raises(InvalidMessage, match=r"message.at.x: expected a number"):
        to_dict(message)


def test_a_dict_becomes_a_message():
    assert from_dict(Sample, AS_DICT) == FULL


def test_what_is_left_out_keeps_its_default():
    assert from_dict(Point, {"x": 1}) == Point(x=1.0)


@pytest.mark.parametrize("at", [Point(1.0), {"x": 1.0}, MappingProxyType({"x": 1.0})])
def test_a_nested_message_may_be_a_message_or_a_mapping(at):
    assert from_dict(Sample, {"at": at}).at == Point(1.0)


def test_a_message_inside_is_copied():
    at = Point(1.0)
    assert from_dict(Sample, {"at": at}).at is not at


@pytest.mark.parametrize("uuid", [bytes(16), [0] * 16, bytearray(16)])
def test_bytes_are_made_of_bytes_or_numbers(uuid):
    assert from_dict(UUID, {"uuid": uuid}) == UUID()


@pytest.mark.parametrize(
    ("cls", "mapping", "text"),
    [
        (Sample, {"at": {"x": "a"}}, "message.at.x: expected a number (float64), got 'a'"),
        (Sample, {"path": [{}, 5]}, "message.path[1]: expected fields such as {x: 0.0, y: 0.0, z"),
        (Sample, {"path": [{}] * 3}, "message.path: at most 2 elements, got 3"),
        (Sample, {"raw": [256]}, "message.raw[0]: 256 is out of range"),
        (Sample, {"at": Time()}, "message.at: expected a message (geometry_msgs/msg/Point), got"),
        (Sample, {"nmae": 1}, "message: unknown field 'nmae', did you mean 'name'?"),
        (Sample, {"from_": 1}, "message: unknown field 'from_', did you mean 'from'?"),
        (Point, {"q": 1}, "message: unknown field 'q': the fields are x, y, z"),
        (Sample, {"at": {"q": 1}}, "message.at: unknown field 'q': the fields are x, y, z"),
        (Point, {1: 1}, "message: unknown field 1: the fields are x, y, z"),
        (Empty, {"x": 1}, "message: unknown field 'x': there are no fields"),
        (Empty, 5, "message: expected {}, for it has no fields, got 5"),
        (Sample, 5, 'message: expected fields such as {flag: false, name: "", at: {}}, got 5'),
        (Point, None, "message: expected fields such as {x: 0.0, y: 0.0, z: 0.0}, got None"),
        (GoalInfo, [], "message: expected fields such as {goal_id: {}, stamp: {}}, got []"),
        (UUID, [], "message: expected fields such as {uuid: []}, got []"),
    ],
)
def test_what_does_not_fit_is_told_with_its_path(cls, mapping, text):
    with pytest.raises(InvalidMessage) as caught:
        from_dict(cls, mapping)
    assert str(caught.value).startswith(text)


def test_a_goal_names_its_root():
    with pytest.raises(InvalidGoal, match=r"^goal.x: expected a number"):
        from_dict(Point, {"x": "a"}, root="goal")


@given(
    st.builds(
        Sample,
        flag=st.booleans(),
        name=st.text(st.characters(exclude_categories=["Cs"])),
        at=st.builds(Point, st.floats()),
        raw=st.binary(),
    )
)
def test_there_and_back_is_the_same(message):
    back = from_dict(Sample, to_dict(message))
    assert back == message or math.isnan(message.at.x)
