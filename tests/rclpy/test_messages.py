"""Message classes as rclpy programs know them, and what of them is sent."""

import array
import copy
import pickle
import sys
import types

import numpy as np
import pytest

from turtleact.errors import UnknownInterface
from turtleact.interfaces import encode as encode_ours
from turtleact.interfaces import get_message, load_interface
from turtleact.rclpy import rosidl_runtime
from turtleact.rclpy.messages import decode, encode, hash_of, interface_class

Point = interface_class("geometry_msgs/msg/Point")
Pose = interface_class("geometry_msgs/msg/Pose")
String = interface_class("std_msgs/msg/String")
Fibonacci = interface_class("example_interfaces/action/Fibonacci")
AddTwoInts = interface_class("example_interfaces/srv/AddTwoInts")
UUID = interface_class("unique_identifier_msgs/msg/UUID")


GEOMETRY = types.ModuleType("geometry_msgs.msg")
MIXED = (
    "byte raw 7\nbyte[] raws\nbool flag true\nchar letter\nfloat32 ratio 0.5\nstring<=4 name\n"
    "int16[<=3] few\nbool[2] pair\nfloat64[] many [1.0, 2.0]\nstring[] names\nuint8 LIMIT=3\n"
    "geometry_msgs/Point[] path"
)


@pytest.fixture
def mixed():
    """A message with one field of each kind."""
    load_interface(MIXED, type_name="rclpy_tests/msg/Mixed")
    return interface_class("rclpy_tests/msg/Mixed")


@pytest.fixture
def checked(monkeypatch):
    """The same message, as a program sees it that asks for checks."""
    monkeypatch.setenv("ROS_PYTHON_CHECK_FIELDS", "1")
    load_interface(MIXED, type_name="rclpy_tests/msg/Checked")
    return interface_class("rclpy_tests/msg/Checked")


def test_a_message_starts_with_zeros_and_defaults(mixed):
    message = mixed()
    assert (message.raw, message.flag, message.ratio) == (b"\x07", True, 0.5)
    assert message.many == array.array("d", [1.0, 2.0])
    assert (message.few, message.pair, message.path) == (array.array("h"), [False, False], [])


def test_a_list_of_numbers_becomes_an_array():
    result = Fibonacci.Result(sequence=[0, 1])
    assert repr(result.sequence) == "array('i', [0, 1])"
    result.sequence = (2, 3)
    assert result.sequence == array.array("i", [2, 3])


def test_a_fixed_array_of_numbers_is_numpys():
    assert isinstance(UUID(uuid=list(range(16))).uuid, np.ndarray)


def test_the_repr_shows_package_class_and_fields():
    shown = "example_interfaces.action.Fibonacci_Result(sequence=[1])"
    assert repr(Fibonacci.Result(sequence=[1])) == shown


def test_two_messages_with_equal_fields_are_equal():
    assert Pose() == Pose()
    assert UUID(uuid=[1] * 16) != UUID()
    assert Point() != Pose()


def test_a_message_cannot_be_hashed():
    with pytest.raises(TypeError, match="unhashable"):
        hash(Point())


def test_a_message_can_be_copied_and_pickled(monkeypatch):
    pose = Pose(position=Point(x=1.0))
    assert copy.deepcopy(pose) == pose
    for name in ("Pose", "Point", "Quaternion"):
        monkeypatch.setattr(GEOMETRY, name, interface_class(f"geometry_msgs/msg/{name}"), False)
    monkeypatch.setitem(sys.modules, "geometry_msgs", GEOMETRY)
    monkeypatch.setitem(sys.modules, "geometry_msgs.msg", GEOMETRY)
    assert pickle.loads(pickle.dumps(pose)) == pose


def test_nothing_is_checked_unless_asked_for():
    assert String(data=3).data == 3


def test_an_unknown_keyword_is_refused():
    with pytest.raises(TypeError, match="'text'"):
        String(text="")


def test_an_unknown_attribute_cannot_be_set():
    with pytest.raises(AttributeError, match="no attribute 'text'"):
        String().text = "hello"


def test_constants_and_defaults_are_on_class_and_instance_and_stay(mixed):
    assert (mixed.LIMIT, mixed().LIMIT, mixed.RATIO__DEFAULT) == (3, 3, 0.5)
    with pytest.raises(AttributeError, match="LIMIT"):
        mixed().LIMIT = 4


def test_field_types_are_named_as_in_idl(mixed):
    assert mixed.get_fields_and_field_types() == {
        "raw": "octet",
        "raws": "sequence<octet>",
        "flag": "boolean",
        "letter": "uint8",
        "ratio": "float",
        "name": "string<4>",
        "few": "sequence<int16, 3>",
        "pair": "boolean[2]",
        "many": "sequence<double>",
        "names": "sequence<string>",
        "path": "sequence<geometry_msgs/Point>",
    }


def test_a_service_or_action_cannot_be_instantiated():
    with pytest.raises(NotImplementedError, match="Action classes"):
        Fibonacci()
    with pytest.raises(NotImplementedError, match="Service classes"):
        AddTwoInts()


def test_an_action_has_the_types_that_it_travels_in():
    message = Fibonacci.Impl.FeedbackMessage()
    assert list(message.get_fields_and_field_types()) == ["goal_id", "feedback"]
    assert Fibonacci.Impl.SendGoalService.Request().goal == Fibonacci.Goal()


def test_an_unknown_interface_is_refused_with_the_nearest():
    with pytest.raises(UnknownInterface, match="did you mean"):
        interface_class("geometry_msgs/msg/Pont")


# --- what is sent -----------------------------------------------------------------------------


def test_a_message_is_sent_as_turtleacts_own_class_sends_it():
    data = encode(Pose(position=Point(x=1.5)), Pose)
    assert data == encode_ours(
        get_message("geometry_msgs/msg/Pose")(get_message("geometry_msgs/msg/Point")(x=1.5))
    )
    assert decode(data, Pose) == Pose(position=Point(x=1.5))


def test_every_kind_of_field_survives_the_way(mixed):
    message = mixed(
        raw=b"\x01",
        raws=[b"a", b"b"],
        letter=65,
        name="four",
        few=[1, 2],
        pair=[True, False],
        names=["x", "ü"],
        path=[Point(y=2.0)],
    )
    assert decode(encode(message, mixed), mixed) == message


@pytest.mark.parametrize(
    "fields",
    [
        {"ratio": 1},  # an int as a float
        {"ratio": np.float64(0.25)},
        {"flag": np.True_},
        {"letter": np.uint8(3)},
        {"pair": (True, False)},
        {"path": (Point(),)},
    ],
)
def test_what_rclpy_converts_is_converted(mixed, fields):
    assert decode(encode(mixed(**fields), mixed), mixed)


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"ratio": "1"}, "ratio"),
        ({"letter": 256}, "letter"),
        ({"letter": 1.0}, "letter"),
        ({"name": "too long"}, "name"),
        ({"flag": 1}, "flag"),
        ({"raw": b""}, "raw"),
        ({"names": [1]}, "names"),
        ({"names": "text"}, "names"),
        ({"pair": [True]}, "exactly 2 elements"),
        ({"few": [1, 2, 3, 4]}, "at most 3"),
        ({"path": [Pose()]}, "geometry_msgs/msg/Point"),
    ],
)
def test_what_does_not_fit_cannot_be_sent_nor_set_if_checks_are_asked_for(
    mixed, checked, fields, problem
):
    with pytest.raises(TypeError, match=problem):
        encode(mixed(**fields), mixed)
    with pytest.raises(AssertionError, match=problem):
        checked(**fields)
    message = checked(raw=b"a", flag=True, few=[1], names=["a"], path=[Point()])
    [(name, value)] = fields.items()
    with pytest.raises(AssertionError, match=problem):
        setattr(message, name, value)


def test_a_message_of_another_class_cannot_be_sent():
    with pytest.raises(TypeError, match=r"Expected geometry_msgs\.msg\.Pose"):
        encode(Point(), Pose)


def test_the_hash_is_that_of_the_interface():
    assert hash_of("std_msgs/msg/String").startswith("RIHS01_df668c")


def test_a_message_becomes_plain_values_and_back():
    pose = Pose(position=Point(x=1.5))
    plain = rosidl_runtime.message_to_ordereddict(pose)
    assert plain["position"] == {"x": 1.5, "y": 0.0, "z": 0.0}
    made = Pose()
    rosidl_runtime.set_message_fields(made, plain)
    assert made == pose
    assert rosidl_runtime.message_to_yaml(pose).startswith("position:\n  x: 1.5")
    path = interface_class("nav_msgs/msg/Path")()
    rosidl_runtime.set_message_fields(
        path, {"poses": [{"header": {"frame_id": "map"}}, pose_at(2.0)]}
    )
    assert rosidl_runtime.message_to_ordereddict(path)["poses"][0]["header"]["frame_id"] == "map"
    assert path.poses[1].pose.position.x == 2.0
    with pytest.raises(AttributeError, match="no field 'speed'"):
        rosidl_runtime.set_message_fields(pose, {"speed": 1})


def pose_at(x):
    stamped = interface_class("geometry_msgs/msg/PoseStamped")()
    stamped.pose.position.x = x
    return stamped


def test_a_class_is_found_by_its_name():
    assert rosidl_runtime.get_message("geometry_msgs/Point") is Point
    assert rosidl_runtime.get_service("example_interfaces/srv/AddTwoInts") is AddTwoInts
    assert rosidl_runtime.get_action("example_interfaces/action/Fibonacci") is Fibonacci
