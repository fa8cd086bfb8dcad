"""Times, durations, profiles, parameters and other values of rclpy's API."""

from __future__ import annotations

import array
import operator

import pytest

from turtleact.rclpy.clock import ClockChange, JumpThreshold, TimeJump
from turtleact.rclpy.graph import (
    TypeHash,
)
from turtleact.rclpy.messages import interface_class
from turtleact.rclpy.parameter import (
    Parameter,
    parameter_dict_from_yaml_file,
    parameter_value_to_python,
)
from turtleact.rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    InvalidQoSProfileException,
    LivelinessPolicy,
    QoSPolicyKind,
    QoSPresetProfiles,
    QoSProfile,
    ReliabilityPolicy,
    profile_of,
    qos_policy_name_from_kind,
    qos_profile_default,
    qos_profile_sensor_data,
)
from turtleact.rclpy.time import ClockType, Duration, Infinite, Time
from turtleact.transports import QoS
from turtleact.transports.base import TimePolicies

LARGEST = 2**63
COMPARE = [operator.lt, operator.le, operator.eq, operator.ne, operator.ge, operator.gt]

# --- durations and times ------------------------------------------------------------------------


def test_a_duration_is_a_number_of_nanoseconds():
    duration = Duration(seconds=1.5, nanoseconds=3)
    assert repr(duration) == "Duration(nanoseconds=1500000003)"
    assert str(duration) == "1500000003 nanoseconds"
    assert str(Infinite) == "Infinite"
    assert hash(duration) == hash(Duration(nanoseconds=1_500_000_003))


@pytest.mark.parametrize("compare", COMPARE)
@pytest.mark.parametrize("kind", [Duration, Time])
def test_durations_and_times_are_ordered(kind, compare):
    for a, b in ((1, 2), (2, 2), (3, 2)):
        assert compare(kind(nanoseconds=a), kind(nanoseconds=b)) == compare(a, b)


@pytest.mark.parametrize("kind", [Duration, Time])
@pytest.mark.parametrize("compare", [operator.lt, operator.le, operator.ge, operator.gt])
def test_durations_and_times_are_not_ordered_among_other_things(kind, compare):
    assert kind() != "now"
    with pytest.raises(TypeError):
        compare(kind(), "now")


def test_durations_are_added_and_scaled():
    second = Duration(seconds=1)
    assert second + second - Duration(nanoseconds=1) == Duration(nanoseconds=1_999_999_999)
    assert 2 * second * 1.5 == Duration(seconds=3)
    assert second * float("inf") == Infinite
    for combine in (operator.add, operator.sub, operator.mul):
        with pytest.raises(TypeError):
            combine(second, "two")


@pytest.mark.parametrize("nanoseconds", [LARGEST, -LARGEST - 1])
def test_a_duration_has_63_bits(nanoseconds):
    with pytest.raises(OverflowError):
        Duration(nanoseconds=nanoseconds)


def test_a_duration_is_a_message():
    message = Duration(seconds=-1, nanoseconds=5).to_msg()
    assert (message.sec, message.nanosec) == (-1, 5)
    assert Duration.from_msg(message) == Duration(seconds=-1, nanoseconds=5)
    with pytest.raises(TypeError, match="builtin_interfaces"):
        Duration.from_msg(Time().to_msg())


def test_a_time_belongs_to_a_clock():
    time = Time(seconds=2, nanoseconds=5, clock_type=ClockType.STEADY_TIME)
    assert time.seconds_nanoseconds() == (2, 5)
    assert (time.nanoseconds, time.clock_type) == (2_000_000_005, ClockType.STEADY_TIME)
    assert repr(time) == "Time(nanoseconds=2000000005, clock_type=STEADY_TIME)"
    assert len({time, Time(seconds=2, nanoseconds=5, clock_type=ClockType.STEADY_TIME)}) == 1
    for compare in (*COMPARE[:3], operator.ge, operator.gt, operator.sub):
        with pytest.raises(TypeError, match="different clock types"):
            compare(time, Time())


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"seconds": -1}, ValueError),
        ({"nanoseconds": -1}, ValueError),
        ({"nanoseconds": LARGEST}, OverflowError),
        ({"clock_type": "ROS"}, TypeError),
    ],
)
def test_a_time_is_a_point_of_a_clock(options, error):
    with pytest.raises(error):
        Time(**options)


def test_a_time_is_moved_by_durations():
    time, second = Time(seconds=5), Duration(seconds=1)
    assert time + second == second + time == Time(seconds=6)
    assert time - second == Time(seconds=4)
    assert time - Time(seconds=2) == Duration(seconds=3)
    with pytest.raises(OverflowError, match="Addition"):
        time + Infinite
    with pytest.raises(ValueError, match="negative"):
        Time() - second
    for combine in (operator.add, operator.sub):
        with pytest.raises(TypeError):
            combine(time, 1)


def test_a_time_is_a_message():
    message = Time(seconds=3, nanoseconds=4).to_msg()
    assert (message.sec, message.nanosec) == (3, 4)
    assert Time.from_msg(message).clock_type is ClockType.ROS_TIME
    with pytest.raises(TypeError, match="builtin_interfaces"):
        Time.from_msg("now")


@pytest.mark.parametrize(
    ("forward", "backward", "on_change"),
    [
        (Duration(seconds=-1), None, True),
        (Duration(), None, True),
        (None, Duration(), True),
        (None, None, False),
    ],
)
def test_a_threshold_reports_something(forward, backward, on_change):
    with pytest.raises(ValueError, match="must be"):
        JumpThreshold(min_forward=forward, min_backward=backward, on_clock_change=on_change)


def test_a_threshold_is_met_by_jumps_that_are_large_enough():
    threshold = JumpThreshold(
        min_forward=Duration(seconds=1), min_backward=Duration(seconds=-1), on_clock_change=False
    )
    met = [
        threshold.is_met_by(TimeJump(ClockChange.ROS_TIME_NO_CHANGE, Duration(nanoseconds=delta)))
        for delta in (10**9, 10**9 - 1, 1 - 10**9, -(10**9))
    ]
    assert met == [True, False, False, True]
    assert not threshold.is_met_by(TimeJump(ClockChange.ROS_TIME_ACTIVATED, Duration(seconds=2)))


# --- quality of service -------------------------------------------------------------------------


def test_a_profile_needs_history_or_depth():
    with pytest.raises(InvalidQoSProfileException, match="required"):
        QoSProfile()
    with pytest.raises(InvalidQoSProfileException, match="KEEP_LAST without"):
        QoSProfile(history=HistoryPolicy.KEEP_LAST)
    with pytest.raises(AssertionError, match="speed"):
        QoSProfile(depth=1, speed=2)
    assert QoSProfile(history=HistoryPolicy.KEEP_ALL).kept is None


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        ("depth", "ten", AssertionError),
        ("depth", -1, ValueError),
        ("history", "all", AssertionError),
        ("lifespan", 3, AssertionError),
        ("avoid_ros_namespace_conventions", 1, AssertionError),
    ],
)
def test_a_policy_has_its_type(name, value, error):
    profile = QoSProfile(depth=1)
    with pytest.raises(error):
        setattr(profile, name, value)


def test_a_depth_of_zero_is_warned_about():
    with pytest.warns(UserWarning, match="zero depth"):
        profile = QoSProfile(depth=0)
    assert profile.kept == 10


def test_profiles_are_compared_and_shown():
    profile = QoSProfile(depth=3, deadline=Duration(seconds=1))
    assert profile == QoSProfile(depth=3, deadline=Duration(seconds=1))
    assert profile != QoSProfile(depth=3)
    assert profile != 3
    assert "depth=3" in str(profile)
    assert profile.to_dict()["depth"] == 3
    assert profile.get_c_qos_profile() is profile
    with pytest.raises(TypeError):
        hash(profile)


def test_a_profile_becomes_one_of_turtleact():
    profile = QoSProfile(
        depth=3,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        deadline=Duration(seconds=1),
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
    )
    assert profile.for_transport() == QoS(
        depth=3, durability="transient_local", reliability="best_effort"
    )
    assert profile.times() == TimePolicies(deadline=10**9, liveliness="manual_by_topic")


def test_policies_and_presets_have_short_names():
    assert ReliabilityPolicy.short_keys()[1:3] == ["reliable", "best_effort"]
    assert ReliabilityPolicy.get_from_short_key("best_effort") == ReliabilityPolicy.BEST_EFFORT
    assert ReliabilityPolicy.RELIABLE.short_key == "reliable"
    assert QoSPresetProfiles.get_from_short_key("sensor_data") is qos_profile_sensor_data
    assert "default" in QoSPresetProfiles.short_keys()
    assert qos_policy_name_from_kind(QoSPolicyKind.DEADLINE) == "DEADLINE"


def test_a_number_is_the_depth_of_a_profile():
    assert profile_of(qos_profile_default) is qos_profile_default
    assert profile_of(7).depth == 7
    with pytest.raises(ValueError, match="history depth"):
        profile_of(-1)
    with pytest.raises(TypeError, match="QoSProfile or int"):
        profile_of("deep")  # type: ignore[arg-type]


# --- parameters ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (None, "NOT_SET"),
        (True, "BOOL"),
        (3, "INTEGER"),
        (2.5, "DOUBLE"),
        ("text", "STRING"),
        ([b"a"], "BYTE_ARRAY"),
        ([True], "BOOL_ARRAY"),
        ((1, 2), "INTEGER_ARRAY"),
        (array.array("d", [1.0]), "DOUBLE_ARRAY"),
        (["a", "b"], "STRING_ARRAY"),
    ],
)
def test_a_parameter_has_the_type_of_its_value(value, kind):
    parameter = Parameter("p", value=value)
    assert parameter.type_ is Parameter.Type[kind]
    again = Parameter.from_parameter_msg(parameter.to_parameter_msg())
    assert (again.name, again.type_) == ("p", parameter.type_)
    assert again.value == (list(value) if kind.endswith("ARRAY") else value)


def test_parameters_are_compared_and_shown():
    parameter = Parameter("p", value=1)
    assert parameter == Parameter("p", Parameter.Type.INTEGER, 1)
    assert parameter != Parameter("p", value=2)
    assert parameter != 1
    assert len({parameter, Parameter("p", value=1)}) == 1
    assert repr(parameter) == "Parameter(name='p', type=Type.INTEGER, value=1)"


def test_a_list_of_whole_numbers_may_hold_bools():
    assert Parameter("p", value=[1, True]).type_ is Parameter.Type.INTEGER_ARRAY


@pytest.mark.parametrize("value", [[1, "a"], [None], object(), [object()]])
def test_other_values_are_refused(value):
    with pytest.raises(TypeError, match="not one of the allowed types"):
        Parameter("p", value=value)


def test_type_and_value_of_a_parameter_agree():
    with pytest.raises(ValueError, match="do not agree"):
        Parameter("p", Parameter.Type.STRING, 1)
    with pytest.raises(ValueError, match="do not agree"):
        Parameter("p", Parameter.Type.STRING, object())
    with pytest.raises(TypeError, match="must be an instance"):
        Parameter("p", "STRING", "a")  # type: ignore[arg-type]
    assert Parameter("p", Parameter.Type.STRING_ARRAY, []).value == []


def test_a_value_of_an_unknown_type_is_refused():
    message = interface_class("rcl_interfaces/msg/ParameterValue")(type=77)
    with pytest.raises(RuntimeError, match="type 77"):
        parameter_value_to_python(message)


def test_parameters_are_read_from_a_file(tmp_path):
    path = tmp_path / "params.yaml"
    path.write_text(
        "/**: {ros__parameters: {all: 1}}\n"
        "/lab/arm: {ros__parameters: {speed: 2.5, nested: {deep: x}}}\n"
    )
    everything = parameter_dict_from_yaml_file(str(path))
    assert sorted(everything) == ["all", "nested.deep", "speed"]
    arm = parameter_dict_from_yaml_file(str(path), target_nodes=["/lab/arm"])
    assert sorted(arm) == ["nested.deep", "speed"]
    wild = parameter_dict_from_yaml_file(str(path), True, ["lab/arm"], "robot.")
    assert sorted(wild) == ["robot.all", "robot.nested.deep", "robot.speed"]
    with pytest.raises(RuntimeError, match="/leg"):
        parameter_dict_from_yaml_file(str(path), target_nodes=["/leg"])


# --- endpoints ----------------------------------------------------------------------------------


def test_a_hash_is_shown_as_ros_does():
    text = f"RIHS01_{'ab' * 32}"
    assert str(TypeHash.from_text(text)) == text
    assert TypeHash.from_text(text) == TypeHash(1, b"\xab" * 32)
    assert TypeHash.from_text("?") == TypeHash()
    assert str(TypeHash()) == "INVALID"
    assert len({TypeHash(), TypeHash()}) == 1
