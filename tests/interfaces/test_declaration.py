# No `from __future__ import annotations` here: these annotations are objects.
from typing import Any, ClassVar

import msgspec
import pytest

from turtleact.errors import InvalidInterface
from turtleact.interfaces.standard import Point
from turtleact.interfaces.types import (
    Message,
    MessageMeta,
    array,
    bool_,
    bounded,
    byte,
    constants,
    fields,
    float64,
    int32,
    string,
    uint8,
)


class Zeros(Message, type_name="example_msgs/msg/Zeros"):
    flag: bool_
    count: int32
    size: float64
    name: string
    many: list[int32]
    three: array[list[float64], 3]
    raw: bytes
    key: array[bytes, 2]
    at: Point
    path: list[Point]
    corners: array[list[Point], 2]


def zeros() -> Zeros:
    return Zeros()  # type: ignore[call-arg]  # to a type checker, what has no default is needed


def test_what_has_no_default_is_zero():
    assert zeros() == Zeros(
        False, 0, 0.0, "", [], [0.0] * 3, b"", b"\0\0", Point(), [], [Point(), Point()]
    )


@pytest.mark.parametrize("name", ["many", "three", "at", "path", "corners"])
def test_no_two_messages_share_a_default(name):
    assert getattr(zeros(), name) is not getattr(zeros(), name)


def test_no_two_elements_of_a_fixed_array_are_one():
    first, second = zeros().corners
    assert first is not second


def test_what_has_no_default_may_follow_what_has_one():
    class Sample(Message):
        x: int32 = 5
        y: int32  # type: ignore[misc]  # a type checker wants it first

    assert Sample(y=1) == Sample(5, 1)


def declare(annotation: object, *default: object) -> Any:
    body: dict[str, Any] = {"__annotations__": {"x": annotation}, "__qualname__": "Sample"}
    if default:
        body["x"] = default[0]
    return MessageMeta("Sample", (Message,), body)


@pytest.mark.parametrize(
    ("annotation", "default", "value"),
    [
        (int32, 5, 5),
        (float64, 5, 5.0),
        (list[int32], [1, 2], [1, 2]),
        (list[int32], (1, 2), [1, 2]),
        (list[int32], [], []),
        (array[bytes, 2], b"ab", b"ab"),
        (list[uint8], b"ab", [97, 98]),
        (int32, msgspec.field(default=5), 5),
        (list[int32], msgspec.field(default_factory=lambda: [5]), [5]),
        (Point, Point(), Point()),
        (list[Point], [], []),
        (byte, b"a", 97),
    ],
)
def test_a_default_is_what_the_message_holds(annotation, default, value):
    assert declare(annotation, default)().x == value


def test_a_list_given_as_default_is_copied():
    sample = declare(list[int32], [1])
    sample().x.append(2)
    assert sample().x == [1]


def test_a_default_stands_in_the_definition():
    assert fields(declare(list[int32], [1, 2]))[0].default == (1, 2)


@pytest.mark.parametrize(
    ("annotation", "default", "problem"),
    [
        (int32, "a", r"Sample: x: its default: expected a whole number \(int32\), got 'a'"),
        (list[int32], [1, "a"], r"its default\[1\]: expected a whole number"),
        (bounded[list[int32], 1], [1, 2], "its default: at most 1 elements, got 2"),
        (float64, float("nan"), "its default nan is not finite"),
        (Point, Point(x=1.0), "ROS gives messages no default"),
        (list[Point], [Point()], "ROS gives messages no default"),
        (int32, msgspec.field(), "msgspec.field is for default and default_factory alone"),
        (int32, msgspec.field(default=1, name="y"), "msgspec.field is for default"),
    ],
)
def test_a_default_that_does_not_fit_is_refused(annotation, default, problem):
    with pytest.raises(InvalidInterface, match=problem):
        declare(annotation, default)


def test_a_keyword_is_named_without_its_underscore():
    class Sample(Message):
        from_: int32

    assert fields(Sample)[0].name == "from"


def test_any_other_underscore_at_the_end_is_refused():
    with pytest.raises(InvalidInterface, match="'place_' is no field name"):

        class Sample(Message):
            place_: int32


def test_a_constant_needs_a_value():
    with pytest.raises(InvalidInterface, match="Sample: LIMIT: a constant needs a value"):

        class Sample(Message):
            LIMIT: ClassVar[int32]


def test_a_constant_is_checked():
    with pytest.raises(InvalidInterface, match="LIMIT: its default: expected a whole number"):

        class Sample(Message):
            LIMIT: ClassVar[int32] = "a"  # type: ignore[assignment]  # on purpose


def test_a_constant_needs_a_type():
    with pytest.raises(InvalidInterface, match="ClassVar is no ROS type"):

        class Sample(Message):
            LIMIT: ClassVar = 5


def test_a_class_variable_in_lower_case_is_pythons_own():
    class Sample(Message):
        cache: ClassVar[dict[str, int]] = {}

    assert (fields(Sample), constants(Sample)) == ((), ())


def test_a_field_named_as_its_type_is_read_right():
    class Sample(Message):
        byte: "byte" = 3

    assert str(fields(Sample)[0].type) == "byte"
