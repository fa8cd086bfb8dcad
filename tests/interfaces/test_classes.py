"""The types that services and actions imply, against what real ROS 2 makes of the same files."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NoReturn

import pytest

from turtleact.errors import InvalidInterface, InvalidMessage, UnknownInterface
from turtleact.interfaces import (
    Action,
    Message,
    Service,
    get_interface,
    implied,
    int32,
    known_interfaces,
    load_interface,
    load_interfaces,
    snapshot,
)
from turtleact.interfaces.classes import make_interface, make_message
from turtleact.interfaces.definition import MessageDefinition
from turtleact.interfaces.finders import Finders
from turtleact.interfaces.parse import parse
from turtleact.interfaces.standard import (
    UUID,
    CancelGoal,
    Fibonacci,
    Point,
    ServiceEventInfo,
    Time,
)
from turtleact.interfaces.types import REGISTRY, definition, fields, nested_classes

from ..registry import isolated_registry

GOLDEN = Path(__file__).parent / "golden"


def get_message(type_name: str) -> Any:
    cls = get_interface(type_name)
    assert issubclass(cls, Message)
    return cls


def get_service(type_name: str) -> type[Service]:
    cls = get_interface(type_name)
    assert issubclass(cls, Service)
    return cls


def load_action(text: str, type_name: str) -> type[Action]:
    cls = load_interface(text, type_name=type_name)
    assert issubclass(cls, Action)
    return cls


class Drill(Action, type_name="example_msgs/action/Drill"):
    class Goal(Message):
        at: Point
        depth: int32 = 1

    class Feedback(Message):
        depth: int32


@pytest.fixture(scope="module")
def golden_finders() -> Finders:
    with isolated_registry():
        load_interfaces(GOLDEN)
        return REGISTRY.finders


@pytest.fixture(autouse=True)
def ros_is_known(own_registry: None, golden_finders: Finders) -> None:
    REGISTRY.look_in(golden_finders)


# --- of the action's own classes ------------------------------------------------------------


def test_the_goal_result_and_feedback_inside_are_the_actions_own():
    types = implied(Drill)
    assert nested_classes(types.send_goal.Request) == (UUID, Drill.Goal)
    assert nested_classes(types.send_goal.Response) == (None, Time)
    assert nested_classes(types.get_result.Request) == (UUID,)
    assert nested_classes(types.get_result.Response) == (None, Drill.Result)
    assert nested_classes(types.feedback_message) == (UUID, Drill.Feedback)


# --- once, and late -------------------------------------------------------------------------


def test_a_name_gives_the_class_that_the_action_implies():
    types = implied(Fibonacci)
    name = Fibonacci.type_name
    assert get_interface(f"{name}_SendGoal") is types.send_goal
    assert get_interface(f"{name}_SendGoal_Request") is types.send_goal.Request
    assert get_interface(f"{name}_SendGoal_Response") is types.send_goal.Response
    assert get_interface(f"{name}_GetResult") is types.get_result
    assert get_interface(f"{name}_GetResult_Request") is types.get_result.Request
    assert get_interface(f"{name}_GetResult_Response") is types.get_result.Response
    assert get_interface(f"{name}_FeedbackMessage") is types.feedback_message


@pytest.mark.parametrize("part", ["Goal", "Result", "Feedback"])
def test_a_name_gives_the_part_of_an_action(part):
    assert get_interface(f"{Fibonacci.type_name}_{part}") is getattr(Fibonacci, part)


@pytest.mark.parametrize("part", ["Request", "Response"])
def test_a_name_gives_the_part_of_a_service(part):
    assert get_interface(f"{CancelGoal.type_name}_{part}") is getattr(CancelGoal, part)


def test_a_name_gives_the_event_of_a_service():
    event = get_message(f"{CancelGoal.type_name}_Event")
    assert event.__name__ == "CancelGoal_Event"
    assert nested_classes(event) == (ServiceEventInfo, CancelGoal.Request, CancelGoal.Response)
    assert [str(field.type) for field in fields(event)[1:]] == [
        "action_msgs/srv/CancelGoal_Request[<=1]",
        "action_msgs/srv/CancelGoal_Response[<=1]",
    ]


def test_an_event_holds_at_most_one_request():
    event: Any = get_message(f"{CancelGoal.type_name}_Event")
    assert event() == event(info=ServiceEventInfo(), request=[], response=[])
    with pytest.raises(InvalidMessage, match=r"^message\.request: at most 1 elements, got 2"):
        snapshot(event(request=[CancelGoal.Request(), CancelGoal.Request()]))


def test_a_class_that_is_not_registered_is_not_found_by_its_name():
    definition = parse("int32 x\n---\n---", "example_msgs/action/Late")
    action: Any = make_interface(definition, get_interface, register=False)
    assert implied(action).send_goal.Request(goal=action.Goal(x=1)).goal == action.Goal(x=1)
    for name in ("Late", "Late_Goal", "Late_SendGoal", "Late_SendGoal_Request"):
        with pytest.raises(UnknownInterface):
            get_interface(f"example_msgs/action/{name}")


# --- names ----------------------------------------------------------------------------------


def test_a_name_with_an_underscore_implies_types_too():
    class Long_Name(Action, type_name="example_msgs/action/Long_Name"):
        pass

    service = get_service("example_msgs/action/Long_Name_SendGoal")
    assert nested_classes(service.Request)[1] is Long_Name.Goal


def test_a_name_gives_the_types_of_the_latest_action():
    def declare(field: str) -> type[Action]:
        return load_action(f"int32 {field}\n---\n---", "example_msgs/action/Go")

    old, new = declare("x"), declare("y")
    assert nested_classes(implied(old).send_goal.Request)[1] is old.Goal
    request = get_message("example_msgs/action/Go_SendGoal_Request")
    assert nested_classes(request)[1] is new.Goal


@pytest.mark.parametrize(
    "name",
    [
        "example_msgs/action/Nobody_SendGoal",
        "example_interfaces/action/Fibonacci_Sneeze",
        "example_interfaces/action/Fibonacci_Request",
        "example_interfaces/action/Fibonacci_SendGoal_Goal",
        "example_interfaces/action/Fibonacci_FeedbackMessage_Goal",
        "action_msgs/srv/CancelGoal_SendGoal",
        "action_msgs/srv/CancelGoal_Goal",
        "geometry_msgs/msg/Point_Goal",
        "geometry_msgs/msg/Point_Event",
        "example_interfaces/action/Fibonacci_Event",
        "action_msgs/srv/CancelGoal_Request_Event",
    ],
)
def test_what_nothing_implies_is_unknown(name):
    with pytest.raises(UnknownInterface, match=name):
        get_interface(name)


def test_known_interfaces_leaves_out_implied_types_alone():
    class Odd(Message, type_name="example_msgs/msg/Odd_Part"):
        pass

    implied(Fibonacci)
    known = known_interfaces()
    assert "example_msgs/msg/Odd_Part" in known
    assert not [name for name in known if name.startswith(f"{Fibonacci.type_name}_")]


def nothing(type_name: str) -> NoReturn:
    raise UnknownInterface(type_name, "example_msgs/msg/Near")


def message(text: str) -> MessageDefinition:
    said = parse(text, "example_msgs/msg/Sample")
    assert isinstance(said, MessageDefinition)
    return said


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("msg", "int8 LIMIT=3\nint32 x 5\nstring<=4[<=2] y ['a']\nint32 from"),
        ("srv", "int32 a\n---\nbool b true"),
        ("action", "int32[] a [1]\n---\n---\nfloat64[2] b"),
    ],
)
def test_a_class_says_what_its_definition_says(kind, text):
    said = parse(text, f"example_msgs/{kind}/Sample")
    assert definition(make_interface(said, nothing)) == said


def test_an_unknown_message_inside_is_told():
    said = message("Other x")
    problem = "x: unknown interface 'example_msgs/msg/Other', did you mean 'example_msgs/msg/Near'"
    with pytest.raises(InvalidInterface, match=f"^example_msgs/msg/Sample: {problem}"):
        make_message(said, nothing)


def test_what_is_inside_must_be_a_message():
    said = message("Other x")
    with pytest.raises(InvalidInterface, match="x: example_msgs/msg/Other is not a message"):
        make_message(said, lambda _: CancelGoal)
