"""The types that services and actions imply, against what real ROS 2 makes of the same files."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, NoReturn

import pytest

from turtleact.errors import InvalidGoal, InvalidInterface, InvalidMessage, UnknownInterface
from turtleact.interfaces import (
    Action,
    Message,
    Service,
    from_dict,
    get_interface,
    implied,
    int32,
    known_interfaces,
    load_interface,
    load_interfaces,
    snapshot,
    snapshotter,
    to_dict,
)
from turtleact.interfaces.classes import event_message, make_action, make_message, make_service
from turtleact.interfaces.definition import ActionDefinition, ArrayForm, MessageDefinition
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

from ..tables import together

GOLDEN = Path(__file__).parent / "golden"

# RIHS01 hashes by the official generator of ROS 2 Jazzy, recorded on 2026-11-21.
HASHES = {
    "action_tutorials_interfaces/action/Fibonacci": {
        "Goal": "1777164fa0531c60597c89fa7f70d22944bb360df049a77689100b1360c43960",
        "Result": "6158c1af5630cccfabec7f0c4b75a11fa39e313a4231d8eae6e5ce921c739ab0",
        "Feedback": "e852234f7e7085fc3e14da27175b5b56a59463eea51e9146e8da58a5115f5f3d",
        "SendGoal_Request": "cf867fa8462d62fc5436ec5605ff7894053a03a856d4bbaaef97808389ded602",
        "SendGoal_Response": "7fbc4b8abac3cd2a14e146c4b635ecee917cb7ffcad38868d8afa4a31115b542",
        "GetResult_Request": "b200a8bd0b94170de44d257a5147443fb863c3e608fcda16399e090018b1af0d",
        "GetResult_Response": "b3385a6fc65e215c75cd72821baaf303335df6ead7c7be343d2f2ff94bdf29b6",
        "FeedbackMessage": "50fc26b9cac313652ecbeab3adf9b5414d59fd4d4d5f9058ddcc7525169927f1",
    },
    "example_interfaces/action/Fibonacci": {
        "Goal": "226cb437e4355dcd3e914f930382a3b0cc1da81545bd319ed554e95a03255f51",
        "Result": "fea81394f25aa4502217953f1a021fb750e79c10bbd43f13dd94632da6569649",
        "Feedback": "2b12e37361da6f408d4c85bc24a18de64333f29082f2ca34b5ee33dc4c8b42a9",
        "SendGoal_Request": "3d088942b413247db536576f0286768c6be8fcd5d0c9a5d544f359fba090a238",
        "SendGoal_Response": "d8c07bb3d5b766fe4b43159c9a5222af5214e2fcc29229b991d826166c512be1",
        "GetResult_Request": "c8a4f5e7d13b81286ee1043e2ecd084281cecf1ff06aaa799464f5f15479f003",
        "GetResult_Response": "6021dc98ab9b4bbe395e48aa4de81ee5f68eb570f88358affcc648146668b24f",
        "FeedbackMessage": "c1de71afd52e49a89c53d8262366884185bc0a02f78ce051c4e46b0a7fe59bb2",
    },
    "patrol_interfaces/action/PatrolCommandInterface": {
        "Goal": "0bd4e063d7a39840252c7ae127622f4da2d7d57e4f86dd476f8f8cd7a552ce79",
        "Result": "76702855184c1bfa49aaa150e0863ea47f1cb6e668ad28aa122abc1415565460",
        "Feedback": "2f376d55ec95d6e9bf7fa6f14850e0cf779628847a800029a52ef48a1d589612",
        "SendGoal_Request": "eed25c464ea91fac29fec3f15f21aa133a0c1b1c8655388bca5389ada8a6cfd2",
        "SendGoal_Response": "10a2bf0c72e7a8a94473ed49662dfd58724351d264109827b71e7b634b5d3a32",
        "GetResult_Request": "460e840394b6eda09773dce23f51b932851c66cac3f3ee4df030863c105cfdbd",
        "GetResult_Response": "17df1916c9cc7dd03002b9d606209165a5641705a42234a287d00d88e5ecc6cb",
        "FeedbackMessage": "dbff465aff38ab904a9b6acbb01feb61b24c02ff0eea53fb64ba4573e23761ea",
    },
    "tf2_msgs/action/LookupTransform": {
        "Result": "061d4423af5352ff5314c8effef8faab133991a78f1b2bcd1fecabad80871225",
        "SendGoal_Request": "eb1312eb7aab35e35c71bb87c2ba3a94747c5a6544ea32bb2b32b0f75775b8ca",
        "SendGoal_Response": "c1ada93304793c08813657255e7bde2e40e2114aa634b702c3f8d4b72ae098bc",
        "GetResult_Request": "148f9bdc01f98922d6fb2072cb64468b89c57c7825d9d83b932c183deaa4697d",
        "GetResult_Response": "954de3efc36b164c4d21116abdbdcc52746e454fd9c169b55d9cfd89e83d299d",
        "FeedbackMessage": "10cb89922dcb103e95c185d43e8a5efa3d38db996f733151a2f3e2ac133f4839",
    },
    "turtlesim_msgs/action/RotateAbsolute": {
        "Goal": "fd5e33ea83e08981c70c771972b70bd9b8fc70c6dcc4220f7af9bedde3322208",
        "Feedback": "723543631aa0eb39a542d5d1a99972b4111db0640add8466ba6673f4f52289d8",
        "SendGoal_Response": "7d8bf70acfef5b46a372455f1878d51fe2278ffd4c5c99bcca4c6c4490721a64",
        "GetResult_Response": "507ee2311b20d79b9a692bf4a445d09a575ea48cf3b032adc2cf050c0bf344e1",
    },
    "action_msgs/srv/CancelGoal": {
        "Request": "3d3c84653c1f96918086887e1dcb236faec88b81a5b14fd4cf4840065bcdf8af",
        "Response": "35e682cf3f510e83c70a82a4aac888496dedee56773bf9d8e5e0aa81f9e1c960",
    },
    "std_srvs/srv/SetBool": {
        "Request": "c62fbb99d94e1b25e8ef9e109f9581956bb1b3361a45a4e5810c36a90d29932e",
        "Response": "d0814e7f7b4880ab77e9c57426c7aa1562ab69f11eef8e2e968812f9cbd0b059",
    },
    "turtlesim/srv/Spawn": {
        "Request": "1e6ade2639543952ce3471ce7df5a75ec62040cebe60fca7c49be96cab87e47c",
        "Response": "be5ddd6e34ad37a97f4092ba04693f8384b3b20ebdf7cc48860a39aedece8055",
    },
}

# What rclpy of the same day serialized, byte fields as lists.
ID = list(range(1, 17))
RECORDED = {
    "example_interfaces/action/Fibonacci_SendGoal_Response": {
        "accepted": True,
        "stamp": {"sec": 1732147200, "nanosec": 123456789},
    },
    "example_interfaces/action/Fibonacci_GetResult_Request": {"goal_id": {"uuid": ID}},
    "example_interfaces/action/Fibonacci_FeedbackMessage": {
        "goal_id": {"uuid": ID},
        "feedback": {"sequence": [0, 1]},
    },
    "turtlesim/action/RotateAbsolute_FeedbackMessage": {
        "goal_id": {"uuid": ID},
        "feedback": {"remaining": 1.57},
    },
}

# Numbers of REP 2016 for the types that occur here; a char is a uint8.
TYPE_IDS = {
    **{"int8": 2, "uint8": 3, "char": 3, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9},
    **{"float32": 10, "float64": 11, "bool": 15, "string": 17},
}
FORM_IDS = {
    ArrayForm.SINGLE: 0,
    ArrayForm.FIXED: 48,
    ArrayForm.BOUNDED: 96,
    ArrayForm.UNBOUNDED: 144,
}


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


def type_hash(cls: type[Message]) -> str:
    """The digest of RIHS01, by the rule of REP 2016 alone."""
    used = sorted(inside(cls), key=lambda other: other.type_name)
    said = {
        "type_description": described(cls),
        "referenced_type_descriptions": [described(other) for other in used],
    }
    return hashlib.sha256(json.dumps(said).encode()).hexdigest()


def inside(cls: type[Message]) -> set[type[Message]]:
    direct = {nested for nested in nested_classes(cls) if nested is not None}
    return direct.union(*map(inside, direct))


def described(cls: type[Message]) -> dict[str, Any]:
    members = [
        (field.name, 1 if field.type.is_nested else TYPE_IDS[field.type.name], field.type)
        for field in fields(cls)
    ]
    rows = [
        {
            "name": name,
            "type": {
                "type_id": type_id + FORM_IDS[kind.form],
                "capacity": kind.size,
                "string_capacity": 0,
                "nested_type_name": kind.name if kind.is_nested else "",
            },
        }
        for name, type_id, kind in members
    ]
    return {"type_name": cls.type_name, "fields": rows or [EMPTY]}


EMPTY = {
    "name": "structure_needs_at_least_one_member",
    "type": {"type_id": 3, "capacity": 0, "string_capacity": 0, "nested_type_name": ""},
}


class Drill(Action, type_name="example_msgs/action/Drill"):
    class Goal(Message):
        at: Point
        depth: int32 = 1

    class Feedback(Message):
        depth: int32


@pytest.fixture(scope="module")
def golden_finders() -> Finders:
    with REGISTRY.isolated():
        load_interfaces(GOLDEN)
        return REGISTRY.finders


@pytest.fixture(autouse=True)
def ros_is_known(own_registry: None, golden_finders: Finders) -> None:
    REGISTRY.look_in(golden_finders)


# --- as in ROS ------------------------------------------------------------------------------


@together
@pytest.mark.parametrize(
    ("type_name", "digest"),
    [
        (f"{whole}_{suffix}", digest)
        for whole, parts in HASHES.items()
        for suffix, digest in parts.items()
    ],
)
def test_an_implied_message_has_the_type_hash_that_ros_gives_it(type_name, digest):
    assert type_hash(get_message(type_name)) == digest


@pytest.mark.parametrize(("type_name", "value"), RECORDED.items(), ids=RECORDED)
def test_an_implied_message_holds_what_ros_sent(type_name, value):
    message = snapshot(from_dict(get_message(type_name), value))
    assert json.loads(json.dumps(to_dict(message), default=list)) == value


@pytest.mark.parametrize(
    "suffix",
    [
        "SendGoal",
        "SendGoal_Request",
        "SendGoal_Response",
        "GetResult",
        "GetResult_Request",
        "GetResult_Response",
        "FeedbackMessage",
    ],
)
def test_an_implied_class_is_named_as_in_ros(suffix):
    cls = get_interface(f"{Fibonacci.type_name}_{suffix}")
    assert cls.type_name == f"{Fibonacci.type_name}_{suffix}"
    assert cls.__name__ == cls.__qualname__ == f"Fibonacci_{suffix}"
    assert cls.__module__ == "action_tutorials_interfaces.action"


def test_a_request_says_its_name_when_printed():
    assert repr(implied(Fibonacci).send_goal.Request(UUID(), Fibonacci.Goal(order=5))) == (
        f"Fibonacci_SendGoal_Request(goal_id=UUID(uuid={bytes(16)!r}), goal=Goal(order=5))"
    )


# --- of the action's own classes ------------------------------------------------------------


def test_the_goal_result_and_feedback_inside_are_the_actions_own():
    types = implied(Drill)
    assert nested_classes(types.send_goal.Request) == (UUID, Drill.Goal)
    assert nested_classes(types.send_goal.Response) == (None, Time)
    assert nested_classes(types.get_result.Request) == (UUID,)
    assert nested_classes(types.get_result.Response) == (None, Drill.Result)
    assert nested_classes(types.feedback_message) == (UUID, Drill.Feedback)


def test_an_equal_action_gets_types_of_its_own_classes():
    def declare() -> type[Action]:
        class Wait(Action, type_name="example_msgs/action/Wait"):
            class Feedback(Message):
                left: int32

        return Wait

    first, second = declare(), declare()
    assert nested_classes(implied(first).feedback_message)[1] is first.Feedback
    assert nested_classes(implied(second).feedback_message)[1] is second.Feedback


def test_a_new_message_holds_zeros_of_its_own():
    request: Any = implied(Drill).send_goal.Request
    first, second = request(), request()
    assert first == request(goal_id=UUID(bytes(16)), goal=Drill.Goal(at=Point(), depth=1))
    assert first.goal is not second.goal
    assert first.goal_id is not second.goal_id


def test_an_empty_answer_is_of_status_unknown_and_holds_an_empty_result():
    response = implied(Drill).get_result.Response()
    assert (response.status, response.result) == (0, Drill.Result())


def test_a_snapshot_copies_down_to_the_feedback():
    feedback = Fibonacci.Feedback(partial_sequence=[0, 1])
    cls: Any = implied(Fibonacci).feedback_message
    message = cls(goal_id=UUID(bytes(range(16))), feedback=feedback)
    copy = snapshotter(cls)(message)
    assert copy == message
    assert type(copy.feedback) is Fibonacci.Feedback
    assert copy.feedback.partial_sequence is not feedback.partial_sequence


@pytest.mark.parametrize(("root", "error"), [("message", InvalidMessage), ("goal", InvalidGoal)])
def test_a_snapshot_tells_the_path_of_a_misfit_below_the_goal(root, error):
    request: Any = implied(Drill).send_goal.Request
    copy = snapshotter(request, root=root)
    with pytest.raises(error, match=rf"^{root}\.goal\.depth"):
        copy(request(goal=Drill.Goal(at=Point(), depth=2**31)))


def test_a_snapshot_refuses_the_feedback_of_another_action():
    message: Any = implied(Drill).feedback_message
    with pytest.raises(InvalidMessage, match=r"^message\.feedback: .*example_msgs/action/Drill"):
        snapshot(message(feedback=Fibonacci.Feedback()))


# --- once, and late -------------------------------------------------------------------------


def test_the_same_types_are_given_every_time():
    assert implied(Drill) is implied(Drill)


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


def test_a_name_may_leave_the_kind_out():
    found = get_interface("action_tutorials_interfaces/Fibonacci_SendGoal")
    assert found is implied(Fibonacci).send_goal


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


def test_an_event_is_the_same_every_time():
    name = f"{Fibonacci.type_name}_SendGoal_Event"
    assert get_interface(name) is get_interface(name)
    assert nested_classes(get_message(name))[1] is implied(Fibonacci).send_goal.Request


def test_an_event_holds_at_most_one_request():
    event: Any = get_message(f"{CancelGoal.type_name}_Event")
    assert event() == event(info=ServiceEventInfo(), request=[], response=[])
    with pytest.raises(InvalidMessage, match=r"^message\.request: at most 1 elements, got 2"):
        snapshot(event(request=[CancelGoal.Request(), CancelGoal.Request()]))


def test_the_base_of_all_services_implies_nothing():
    with pytest.raises(InvalidInterface, match="'' is not a full interface name"):
        event_message(Service)


def test_a_class_that_is_not_registered_is_not_found_by_its_name():
    definition = parse("int32 x\n---\n---", "example_msgs/action/Late")
    assert isinstance(definition, ActionDefinition)
    action = make_action(definition, get_interface, register=False)
    assert implied(action).send_goal.Request(goal=action.Goal(x=1)).goal == action.Goal(x=1)
    for name in ("Late", "Late_Goal", "Late_SendGoal", "Late_SendGoal_Request"):
        with pytest.raises(UnknownInterface):
            get_interface(f"example_msgs/action/{name}")


def test_the_types_are_frozen_together():
    types: Any = implied(Drill)
    with pytest.raises(AttributeError, match="immutable"):
        types.send_goal = CancelGoal


# --- names ----------------------------------------------------------------------------------


def test_an_action_in_a_text_implies_its_types():
    action = load_action("int32 x\n---\n---", "example_msgs/action/Told")
    request = get_message("example_msgs/action/Told_SendGoal_Request")
    assert nested_classes(request)[1] is action.Goal


def test_an_action_in_a_file_implies_its_types():
    get_service("tf2_msgs/action/LookupTransform_GetResult")
    assert issubclass(get_interface("tf2_msgs/action/LookupTransform"), Action)


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


def test_a_message_file_may_be_named_like_a_part(tmp_path):
    folder = tmp_path / "example_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Trip.msg").write_text("int32 x")
    (folder / "Trip_Goal.msg").write_text("int32 y")
    names = load_interfaces(tmp_path)
    assert [get_interface(name).type_name for name in names] == list(names)
    assert set(names) <= set(known_interfaces())


def test_known_interfaces_leaves_out_implied_types_alone():
    class Odd(Message, type_name="example_msgs/msg/Odd_Part"):
        pass

    implied(Fibonacci)
    known = known_interfaces()
    assert "example_msgs/msg/Odd_Part" in known
    assert not [name for name in known if name.startswith(f"{Fibonacci.type_name}_")]


def test_the_base_of_all_actions_implies_nothing():
    with pytest.raises(InvalidInterface, match="'' is not a full interface name"):
        implied(Action)


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
    with pytest.raises(InvalidInterface, match="x: example_msgs/msg/Other is not a message"):
        make_message(said, lambda _: CancelGoal)
