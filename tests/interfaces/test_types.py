from __future__ import annotations

import gc
import inspect
from typing import ClassVar

import msgspec
import pytest

from turtleact.errors import InvalidInterface
from turtleact.interfaces import get_interface
from turtleact.interfaces.standard import Point, Time
from turtleact.interfaces.types import (
    Action,
    Message,
    Service,
    array,
    bounded,
    constants,
    definition,
    fields,
    int8,
    int32,
    nested_classes,
    string,
)


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


def test_fields_are_in_order():
    assert [f.name for f in fields(Sample)] == ["name", "at", "path", "ranks"]


def test_constants_are_listed():
    assert [(c.name, c.value) for c in constants(Sample)] == [("LIMIT", 3)]


def test_nested_classes_stand_beside_their_fields():
    assert nested_classes(Sample) == (None, Point, Point, None)


def test_a_message_has_no_fields_of_its_own():
    assert fields(Message) == ()


def test_a_field_may_be_called_type_name():
    class Named(Message, type_name="example_msgs/msg/Named"):
        type_name: string = "a"

    assert (Named().type_name, Named.type_name) == ("a", "example_msgs/msg/Named")


def test_parts_are_named_after_the_whole():
    assert Count.Goal.type_name == "example_msgs/action/Count_Goal"


def test_a_part_left_out_has_no_fields():
    assert (fields(Count.Result), fields(Add.Response)) == ((), ())


def test_a_part_left_out_is_a_class_of_its_own():
    assert Count.Result is not Count.Feedback


def test_an_action_is_known_by_its_name():
    assert get_interface("example_msgs/action/Count_Feedback") is Count.Feedback


def test_an_empty_part_says_where_it_belongs():
    assert Count.Feedback.__qualname__ == "Count.Feedback"


def test_messages_compare_by_value():
    assert Point(x=1.0) == Point(x=1.0) != Point(x=2.0)


def test_the_garbage_collector_need_not_look_at_messages():
    assert not gc.is_tracked(Sample("a", Point(), [Point()], [1, 2]))


def test_a_message_is_a_plain_struct():
    assert issubclass(Point, msgspec.Struct)
    assert "__post_init__" not in vars(Point)


def test_a_class_in_a_function_sees_its_names():
    class Local(Message, type_name="example_msgs/msg/Local"):
        x: int32

    class Outer(Message, type_name="example_msgs/msg/Outer"):
        local: Local
        stamp: Time

    assert nested_classes(Outer) == (Local, Time)


def test_an_action_in_a_function_sees_its_names():
    class Local(Message, type_name="example_msgs/msg/Local"):
        x: int32

    class Go(Action, type_name="example_msgs/action/Go"):
        class Goal(Message):
            places: list[Local]

    assert nested_classes(Go.Goal) == (Local,)


def test_a_class_in_a_function_has_a_signature():
    class Local(Message, type_name="example_msgs/msg/Local"):
        x: int32

    class Outer(Message, type_name="example_msgs/msg/Outer"):
        local: Local

    assert inspect.signature(Outer).parameters["local"].annotation is Local


def test_a_name_of_no_scope_is_refused():
    with pytest.raises(InvalidInterface, match=r"Lost: x: cannot make out 'Nowhere'"):

        class Lost(Message, type_name="example_msgs/msg/Lost"):
            x: Nowhere  # type: ignore[name-defined]  # noqa: F821  # on purpose


def test_a_message_derives_from_message_alone():
    with pytest.raises(InvalidInterface, match="derive a message from Message alone"):

        class Deeper(Point): ...


@pytest.mark.parametrize("base", [Action, Service])
def test_a_whole_needs_a_name(base):
    with pytest.raises(
        InvalidInterface, match=rf"say its name: class Go\({base.__name__}, type_na"
    ):
        type("Go", (base,), {})


def test_an_action_derives_from_action_alone():
    with pytest.raises(InvalidInterface, match="derive it from Action alone"):
        type("Go", (Count,), {}, type_name="example_msgs/action/Go")


def test_an_action_is_not_named_as_a_message():
    with pytest.raises(InvalidInterface, match="say it as package_name/action/InterfaceName"):
        type("Go", (Action,), {}, type_name="example_msgs/msg/Go")


def test_a_message_name_is_checked():
    with pytest.raises(InvalidInterface, match="'point' is no full interface name"):

        class Wrong(Message, type_name="point"): ...


@pytest.mark.parametrize("part", [int, Message, 5])
def test_a_part_is_a_message(part):
    with pytest.raises(
        InvalidInterface, match=r"Go.Goal: is no message: write class Goal\(Message\)"
    ):
        type("Go", (Action,), {"Goal": part}, type_name="example_msgs/action/Go")


def test_a_part_belongs_to_one_action():
    with pytest.raises(InvalidInterface, match="belongs to example_msgs/action/Count_Goal: write"):
        type("Go", (Action,), {"Goal": Count.Goal}, type_name="example_msgs/action/Go")


def test_a_misspelled_part_gets_a_hint():
    with pytest.raises(InvalidInterface, match=r"Go.Gaol: the parts are .*did you mean 'Goal'"):

        class Go(Action, type_name="example_msgs/action/Go"):
            class Gaol(Message): ...


def test_a_class_attribute_may_name_a_message():
    class Go(Action, type_name="example_msgs/action/Go"):
        Place = Point

    assert Go.Place is Point


def test_definition_of_a_nameless_message_is_refused():
    class Nameless(Message): ...

    with pytest.raises(InvalidInterface, match="is no full interface name"):
        definition(Nameless)


def test_a_changed_action_takes_the_name_over_with_its_parts():
    class Go(Action, type_name="example_msgs/action/Go"):
        class Goal(Message):
            x: int32

    class Changed(Action, type_name="example_msgs/action/Go"):
        class Goal(Message):
            x: string

    assert get_interface("example_msgs/action/Go_Goal") is Changed.Goal
