from __future__ import annotations

import re

# No `from __future__ import annotations` here: these annotations are objects.
from typing import Any, ClassVar

import msgspec
import pytest

from turtleact.errors import InvalidInterface
from turtleact.interfaces.standard import Fibonacci, Point, Time
from turtleact.interfaces.types import (
    Action,
    Message,
    MessageMeta,
    Service,
    array,
    bool_,
    bounded,
    byte,
    expect_interface,
    fields,
    float64,
    int8,
    int32,
    nested_classes,
    string,
    uint8,
)

from ..tables import together


class Count(Action, type_name="example_msgs/action/Count"):
    class Goal(Message):
        target: int32 = 0


class Add(Service, type_name="example_msgs/srv/Add"):
    class Request(Message):
        left: int32 = 0


class Sample(Message, type_name="example_msgs/msg/Sample"):
    LIMIT: ClassVar[int8] = 3
    name: string
    at: Point
    path: bounded[list[Point], 2]
    ranks: array[list[int32], 2]


def test_a_field_may_be_called_type_name():
    class Named(Message, type_name="example_msgs/msg/Named"):
        type_name: string = "a"

    assert (Named().type_name, Named.type_name) == ("a", "example_msgs/msg/Named")


def test_a_part_left_out_has_no_fields():
    assert (fields(Count.Result), fields(Add.Response)) == ((), ())


def test_a_class_in_a_function_sees_its_names():
    class Local(Message, type_name="example_msgs/msg/Local"):
        x: int32

    class Outer(Message, type_name="example_msgs/msg/Outer"):
        local: Local
        stamp: Time

    assert nested_classes(Outer) == (Local, Time)


def test_a_name_of_no_scope_is_refused():
    with pytest.raises(InvalidInterface, match=r"Lost: x: cannot make out 'Nowhere'"):

        class Lost(Message, type_name="example_msgs/msg/Lost"):
            x: Nowhere  # type: ignore[name-defined]  # noqa: F821  # on purpose


def test_a_message_derives_from_message_alone():
    with pytest.raises(InvalidInterface, match="derive a message only from Message"):

        class Deeper(Point): ...


@pytest.mark.parametrize("base", [Action, Service])
def test_a_whole_needs_a_name(base):
    with pytest.raises(
        InvalidInterface, match=rf"give it a name: class Go\({base.__name__}, type_na"
    ):
        type("Go", (base,), {})


def test_an_action_is_not_named_as_a_message():
    with pytest.raises(InvalidInterface, match="write it as package_name/action/InterfaceName"):
        type("Go", (Action,), {}, type_name="example_msgs/msg/Go")


def test_a_message_name_is_checked():
    with pytest.raises(InvalidInterface, match="'point' is not a full interface name"):

        class Wrong(Message, type_name="point"): ...


@pytest.mark.parametrize("part", [int, Message, 5])
def test_a_part_is_a_message(part):
    with pytest.raises(
        InvalidInterface, match=r"Go.Goal: not a message: write class Goal\(Message\)"
    ):
        type("Go", (Action,), {"Goal": part}, type_name="example_msgs/action/Go")


def test_a_misspelled_part_gets_a_hint():
    with pytest.raises(InvalidInterface, match=r"Go.Gaol: the parts are .*did you mean 'Goal'"):

        class Go(Action, type_name="example_msgs/action/Go"):
            class Gaol(Message): ...


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


@together
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


@pytest.mark.parametrize(
    ("annotation", "default", "problem"),
    [
        (int32, "a", r"Sample: x: its default: expected a whole number \(int32\), got 'a'"),
        (list[int32], [1, "a"], r"its default\[1\]: expected a whole number"),
        (bounded[list[int32], 1], [1, 2], "its default: at most 1 elements, got 2"),
        (float64, float("nan"), "its default nan is not finite"),
        (Point, Point(x=1.0), "ROS has no defaults for messages"),
        (list[Point], [Point()], "ROS has no defaults for messages"),
        (int32, msgspec.field(), "msgspec.field may only have default or default_factory"),
        (int32, msgspec.field(default=1, name="y"), "msgspec.field may only have default"),
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
    with pytest.raises(InvalidInterface, match="'place_' is not a valid field name"):

        class Sample(Message):
            place_: int32


def test_a_constant_needs_a_value():
    with pytest.raises(InvalidInterface, match="Sample: LIMIT: a constant needs a value"):

        class Sample(Message):
            LIMIT: ClassVar[int32]


def test_a_constant_needs_a_type():
    with pytest.raises(InvalidInterface, match="ClassVar is not a ROS type"):

        class Sample(Message):
            LIMIT: ClassVar = 5


@pytest.mark.parametrize(
    ("kind", "given", "end"),
    [
        (Action, Count.Goal, "Action, not Count.Goal: give Count itself"),
        (Service, Add.Request, "Service, not Add.Request: give Add itself"),
        (Action, Add.Request, "Action, not Add.Request"),
        (Service, Count.Goal, "Service, not Count.Goal"),
        (Message, Count, "Message, not Count"),
        (Action, "Count", "'Count': give the class, for example turtleact.get_action(TYPE)"),
    ],
)
def test_only_a_part_of_the_expected_kind_gets_the_advice_to_give_the_whole(kind, given, end):
    with pytest.raises(TypeError) as refused:
        expect_interface(kind, given)
    assert str(refused.value).endswith(end)


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({"ordr": 4}, "Fibonacci.Goal has no field 'ordr', did you mean 'order'?"),
        ({"order": 4, "speed": 1}, "Fibonacci.Goal has no field 'speed'; it has order"),
    ],
)
def test_a_goal_with_an_unknown_field_suggests_a_known_one(values, problem):
    with pytest.raises(TypeError, match=f"^{re.escape(problem)}$"):
        Fibonacci.Goal(**values)
