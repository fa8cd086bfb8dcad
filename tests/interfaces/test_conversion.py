from __future__ import annotations

import copy
import math
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.errors import InvalidGoal, InvalidMessage
from turtleact.interfaces.conversion import from_dict, snapshot, snapshotter, to_dict
from turtleact.interfaces.standard import (
    UUID,
    Fibonacci,
    GoalInfo,
    PatrolCommandInterface,
    Point,
    Time,
)
from turtleact.interfaces.types import (
    Message,
    MessageMeta,
    array,
    bool_,
    bounded,
    float32,
    float64,
    int8,
    int32,
    string,
    uint8,
)

from ..tables import together


class Lists(Message, type_name="example_msgs/msg/Lists"):
    numbers: list[int32] = []
    three: array[list[float64], 3] = [0.0] * 3
    two: bounded[list[string], 2] = []
    raw: list[uint8] = []
    key: array[bytes, 2] = bytes(2)
    flags: list[bool_] = []
    singles: list[float32] = []
    points: bounded[list[Point], 2] = []
    corners: array[list[Point], 2] = [Point(), Point()]
    from_: int8 = 0


class Tree(Message, type_name="example_msgs/msg/Tree"):
    root: Lists = Lists()
    twigs: list[Lists] = []


def unchecked(value: object) -> Any:
    """A value that a type checker would not take here; making a message checks nothing."""
    return value


def test_a_snapshot_shares_nothing_that_changes():
    message = Tree(Lists([1]), [Lists([2])])
    before = copy.deepcopy(message)
    taken = snapshot(message)
    message.root.numbers.append(2)
    message.root.corners[0].x = 1.0
    message.twigs[0].numbers.append(3)
    message.twigs.append(Lists())
    assert taken == before


def test_a_snapshot_holds_plain_values():
    numbers, three, single = map(unchecked, (np.array([1, 2]), (1, 2, 3), np.float32(0.5)))
    taken = snapshot(Lists(numbers=numbers, three=three, singles=[single]))
    held = (*taken.numbers, *taken.three, *taken.singles)
    assert [type(value) for value in held] == [int] * 2 + [float] * 4


@together
@pytest.mark.parametrize(
    ("message", "text"),
    [
        (Lists(from_=unchecked("a")), "from: expected a whole number (int8), got 'a'"),
        (Lists(numbers=[1, 2, unchecked("a")]), "numbers[2]: expected a whole number"),
        (Lists(numbers=unchecked("ab")), "numbers: expected a list of int32, got 'ab'"),
        (Lists(three=[1.0]), "three: exactly 3 elements, got 1"),
        (Lists(two=["a"] * 3), "two: at most 2 elements, got 3"),
        (Lists(key=b"abc"), "key: exactly 2 elements, got 3"),
        (Lists(raw=[256]), "raw[0]: 256 is out of range for uint8"),
        (Lists(points=[Point(), Point(x=unchecked("a"))]), "points[1].x: expected a number"),
        (Lists(points=[unchecked(5)]), "points[0]: expected a message (geometry_msgs/msg/Point)"),
        (Tree(root=unchecked(None)), "root: expected a message (example_msgs/msg/Lists), got None"),
        (Tree(twigs=[Lists(points=[Point(z=unchecked([]))])]), "twigs[0].points[0].z: expected"),
    ],
)
def test_a_misfit_is_told_with_its_path(message, text):
    with pytest.raises(InvalidMessage) as caught:
        snapshot(message)
    assert str(caught.value).startswith(f"message.{text}")


def test_a_goal_names_its_root():
    take = snapshotter(PatrolCommandInterface.Goal, root="goal")
    with pytest.raises(InvalidGoal, match=r"^goal.targets\[2\].x: expected a number \(float64\)"):
        take(PatrolCommandInterface.Goal([Point(), Point(), Point(unchecked("abc"))]))


@pytest.mark.parametrize("value", [5, None, Point])
def test_what_is_no_message_is_refused(value):
    with pytest.raises(InvalidMessage, match="message: expected a message, got"):
        snapshot(value)


def twin(kind: object, *, name: str = "geometry_msgs/msg/Point") -> Any:
    body = {"__annotations__": dict.fromkeys("xyz", kind)}
    return MessageMeta("Point", (Message,), body, type_name=name)


def test_a_twin_of_the_same_name_and_fields_is_converted():
    taken = snapshotter(Point)(twin(float64)(x=1))
    assert (taken, type(taken)) == (Point(x=1.0), Point)


@pytest.mark.parametrize(
    "other",
    [
        lambda: twin(float32),
        lambda: twin(float64, name="example_msgs/msg/Point"),
        lambda: GoalInfo,
    ],
)
def test_a_message_that_says_something_else_is_refused(other):
    with pytest.raises(InvalidMessage, match="message: expected geometry_msgs/msg/Point, not "):
        snapshotter(Point)(other()())


@given(
    st.builds(
        Lists,
        numbers=st.lists(st.integers(-(2**31), 2**31 - 1)),
        two=st.lists(st.text(st.characters(exclude_categories=["Cs"])), max_size=2),
        raw=st.binary(),
        singles=st.lists(st.floats(width=32, allow_nan=False)),
        points=st.lists(st.builds(Point, st.floats(allow_nan=False)), max_size=2),
    )
)
def test_a_snapshot_of_any_message_equals_it(message):
    assert snapshot(message) == message


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


def test_a_dict_becomes_a_message():
    assert from_dict(Sample, AS_DICT) == FULL


@pytest.mark.parametrize("at", [Point(1.0), {"x": 1.0}, MappingProxyType({"x": 1.0})])
def test_a_nested_message_may_be_a_message_or_a_mapping(at):
    assert from_dict(Sample, {"at": at}).at == Point(1.0)


def test_a_message_inside_is_copied():
    at = Point(1.0)
    assert from_dict(Sample, {"at": at}).at is not at


@pytest.mark.parametrize("uuid", [bytes(16), [0] * 16, bytearray(16)])
def test_bytes_are_made_of_bytes_or_numbers(uuid):
    assert from_dict(UUID, {"uuid": uuid}) == UUID()


@together
@pytest.mark.parametrize(
    ("cls", "mapping", "text"),
    [
        (Sample, {"at": {"x": "a"}}, "message.at.x: expected a number (float64), got 'a'"),
        (Sample, {"path": [{}, 5]}, "message.path[1]: expected fields such as {x: 0.0, y: 0.0, z"),
        (Sample, {"path": [{}] * 3}, "message.path: at most 2 elements, got 3"),
        (Sample, {"raw": [256]}, "message.raw[0]: 256 is out of range"),
        (
            Sample,
            {"at": Time()},
            "message.at: expected geometry_msgs/msg/Point, not builtin_",
        ),
        (Sample, {"nmae": 1}, "message: unknown field 'nmae', did you mean 'name'?"),
        (Point, {"q": 1}, "message: unknown field 'q': the fields are x, y, z"),
        (Point, {1: 1}, "message: unknown field 1: the fields are x, y, z"),
        (
            Point,
            {"x:2.0": None},
            "message: unknown field 'x:2.0': a space is missing after the colon of 'x: 2.0'",
        ),
        (
            Point,
            "x:2.0",
            "message: expected fields such as {x: 0.0, y: 0.0, z: 0.0}, got 'x:2.0': a space is "
            "missing after the colon of 'x: 2.0'",
        ),
        (Empty, {"x": 1}, "message: unknown field 'x': there are no fields"),
        (Empty, 5, "message: expected {}, because it has no fields, got 5"),
        (Sample, 5, 'message: expected fields such as {flag: false, name: "", at: {}}, got 5'),
        (Point, None, "message: expected fields such as {x: 0.0, y: 0.0, z: 0.0}, got None"),
        (UUID, [], "message: expected fields such as {uuid: []}, got []"),
    ],
)
def test_what_does_not_fit_is_told_with_its_path(cls, mapping, text):
    with pytest.raises(InvalidMessage) as caught:
        from_dict(cls, mapping)
    assert str(caught.value).startswith(text)


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


def test_a_result_given_as_feedback_is_told_by_both_full_names():
    action = "action_tutorials_interfaces/action/Fibonacci"
    with pytest.raises(InvalidMessage) as caught:
        snapshotter(Fibonacci.Feedback, root="feedback")(unchecked(Fibonacci.Result()))
    assert str(caught.value) == f"feedback: expected {action}_Feedback, not {action}_Result"
