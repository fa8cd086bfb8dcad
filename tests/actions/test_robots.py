"""Robots that are not ours: other topics, other types, wheels, and odometry that can be wrong."""

from __future__ import annotations

import math
from itertools import pairwise

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.actions import Area
from turtleact.actions.go_to import GoTo
from turtleact.actions.patrol import Patrol
from turtleact.actions.robots import POSE_TYPES, TWIST_TYPES, Robot
from turtleact.errors import GoalAborted, GoalRejected, InvalidMessage, InvalidName, InvalidOption
from turtleact.interfaces import from_dict
from turtleact.interfaces.standard import Point, TurtlePose
from turtleact.tasks.clock import EPOCH

from .rover import DT, ODOMETRY, rover

TARGETS = [Point(x=3.0, y=1.0), Point(x=0.0, y=-2.0), Point(x=-3.0, y=2.0)]
GENTLE = {"turtle": "rover", "max_linear": 0.8, "max_angular": 1.0}
STAMPED = [name for name in POSE_TYPES if not name.startswith("turtlesim")]


def tour(**options):
    return Patrol.Goal(**{"targets": TARGETS, **GENTLE, **options})


def patrol_of(one):
    return one.node.action_client(Patrol, "/patrol")


def robot(**options):
    return msgspec.structs.replace(ODOMETRY, **options)


async def abort_reason(one, goal=None):
    with pytest.raises(GoalAborted) as caught:
        await patrol_of(one).send_goal(goal or tour())
    return caught.value.reason


# A patrol of a rover


@pytest.mark.parametrize("style", ["natural", "rotate_then_drive"])
async def test_a_rover_with_odometry_patrols(style):
    async with rover() as one:
        result = await patrol_of(one).send_goal(tour(style=style, loops=1))
        x, y, _ = one.pose
    assert (result.reached, result.missed) == (6, [])
    assert math.hypot(x + 3.0, y - 2.0) <= 0.15
    assert result.duration < 60.0


@pytest.mark.parametrize(
    ("pose_type", "share"), [("nav_msgs/msg/Odometry", 1.0), ("turtlesim/msg/Pose", 0.5)]
)
async def test_a_robot_is_told_at_each_pose_unless_it_keeps_commands(pose_type, share):
    pace = {"max_acceleration": math.inf, "max_angular_acceleration": math.inf}
    async with rover(robot(pose_type=pose_type, **pace)) as one:
        result = await patrol_of(one).send_goal(tour())
    told = len(one.messages) * DT / result.duration
    assert told == pytest.approx(1.0, abs=0.02) if share == 1.0 else told <= share


@pytest.mark.parametrize("pose_type", POSE_TYPES)
async def test_a_rover_may_tell_its_pose_in_any_of_the_types(pose_type):
    async with rover(robot(pose_type=pose_type)) as one:
        result = await patrol_of(one).send_goal(tour(targets=TARGETS[:1]))
    assert result.reached == 1


@pytest.mark.parametrize("twist_type", TWIST_TYPES)
async def test_a_rover_may_be_told_in_any_of_the_types(twist_type):
    async with rover(robot(twist_type=twist_type)) as one:
        result = await patrol_of(one).send_goal(tour(targets=TARGETS[:1]))
    assert {type(each).type_name for each in one.messages} == {twist_type}
    assert result.reached == 1


async def test_a_rover_goes_to_a_place_in_a_heading():
    goal = GoTo.Goal(2.0, 2.0, "rover", 0.1, 0.8, 1.0, theta=math.pi / 2, heading_tolerance=0.1)
    async with rover() as one:
        await one.node.action_client(GoTo, "/go_to").send_goal(goal)
        x, y, theta = one.pose
    assert math.hypot(x - 2.0, y - 2.0) <= 0.15
    assert abs(theta - math.pi / 2) <= 0.12


async def test_a_rover_is_asked_for_no_more_than_it_can():
    async with rover() as one:
        await patrol_of(one).send_goal(tour())
        told = one.told
    for before, after in pairwise(told):
        assert abs(after[0] - before[0]) <= 1.0 * DT + 1e-9
        assert abs(after[1] - before[1]) <= 3.0 * DT + 1e-9


async def test_a_target_where_a_rover_stands_takes_one_pose():
    place = {"targets": [Point(), Point(x=0.05)]}
    async with rover() as one:
        result = await patrol_of(one).send_goal(tour(**place, loops=50))
        assert one.pose == (0.0, 0.0, 0.0)
    assert (result.reached, result.missed) == (102, [])
    assert result.duration == pytest.approx(102 * DT, abs=2.5 * DT)


async def test_a_stamped_twist_tells_when_and_of_what_frame_it_is():
    async with rover(robot(frame_id="base_footprint")) as one:
        await patrol_of(one).send_goal(tour())
        stamps = [
            each.header.stamp.sec * 10**9 + each.header.stamp.nanosec for each in one.messages
        ]
    assert {each.header.frame_id for each in one.messages} == {"base_footprint"}
    assert EPOCH <= stamps[0] <= EPOCH + 10**8
    assert stamps == sorted(stamps)


async def test_the_topics_of_a_lone_robot_need_not_name_it():
    lone = robot(pose_topic="/odom", twist_topic="/cmd_vel")
    async with rover(lone) as one:
        result = await patrol_of(one).send_goal(tour(turtle=""))
        async with patrol_of(one).send_goal(tour(turtle="one")):
            await one.node.clock.sleep(0.1)
            with pytest.raises(GoalRejected, match="'two' is being driven by another goal"):
                await patrol_of(one).send_goal(tour(turtle="two"))
    assert result.reached == 3


async def test_a_robot_that_is_not_there_is_rejected_by_its_own_topic():
    async with rover() as one:
        with pytest.raises(GoalRejected, match="'r2': nobody publishes /r2/odom"):
            await patrol_of(one).send_goal(tour(turtle="r2"))


async def test_a_robot_that_nothing_fences_in_goes_anywhere():
    goal = tour(targets=[Point(x=-1e5, y=0.0)], tolerance=1e5 - 1.0)
    async with rover(area=Area()) as one:
        assert (await patrol_of(one).send_goal(goal)).reached == 1
    assert one.pose[0] < -0.9


# What odometry can do wrong


@pytest.mark.parametrize(("dt", "most"), [(0.2, 1.6), (0.016, 4.0)], ids=["as told", "unknown"])
async def test_poses_that_come_rarely_make_no_lasting_zigzag(dt, most):
    quick = Robot(pose_topic="/odom", pose_type="nav_msgs/msg/Odometry", dt=dt)
    goal = tour(targets=[Point(x=3.0, y=3.0)], max_linear=0.5, max_angular=2.0)
    async with rover(quick) as one:
        one.every = 10  # 5 times a second
        assert (await patrol_of(one).send_goal(goal)).reached == 1
    assert one.turned <= most * math.pi / 4


async def test_a_robot_whose_poses_are_old_is_not_driven_by_them():
    async with rover() as one:
        one.age = 60.0
        reason = await abort_reason(one)
        assert set(one.told) == {(0.0, 0.0)}
    assert reason == (
        "/rover/odom publishes old poses: by its stamp, the last one is 60 s old; "
        "set the clocks, or max_age"
    )


async def test_a_robot_whose_poses_grow_old_on_the_way_is_stopped_and_given_up():
    async with rover() as one, patrol_of(one).send_goal(tour()) as goal:
        await one.node.clock.sleep(2.0)
        one.age = 5.0
        await one.node.clock.sleep(1.2)
        assert one.told[-1] == (0.0, 0.0)
        outcome = await goal.outcome()
        assert one.node.clock.time() <= 2.0 + 2.5 + 0.1
    assert "/rover/odom publishes old poses" in outcome.reason


async def test_any_age_will_do_where_the_clocks_are_not_the_same():
    async with rover(robot(max_age=math.inf)) as one:
        one.age = 1e6
        assert (await patrol_of(one).send_goal(tour())).reached == 3


async def test_a_robot_whose_stamps_go_back_is_given_up():
    async with rover(robot(max_age=math.inf)) as one, patrol_of(one).send_goal(tour()) as goal:
        await one.node.clock.sleep(2.0)
        one.age = 100.0
        reason = (await goal.outcome()).reason
    assert reason.startswith("the stamps of /rover/odom went back by ")


async def test_a_robot_that_is_silent_for_a_second_is_stopped_and_then_driven_on():
    async with rover() as one, patrol_of(one).send_goal(tour()) as goal:
        await one.node.clock.sleep(2.0)
        one.is_silent = True
        await one.node.clock.sleep(1.2)
        assert one.told[-1] == one.speeds == (0.0, 0.0)
        one.is_silent = False
        assert (await goal.result()).reached == 3


async def test_a_heading_that_is_no_rotation_aborts_the_goal():
    async with rover() as one:
        one.orientation = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}
        reason = await abort_reason(one)
    assert reason == "/rover/odom: pose.pose.orientation: (0.0, 0.0, 0.0, 0.0) is no rotation"


# Messages


@pytest.mark.parametrize("pose_type", STAMPED)
@given(theta=st.floats(-3.14, 3.14), length=st.floats(0.1, 10.0))
def test_the_heading_of_a_quaternion_of_any_length_is_read(pose_type, theta, length):
    one = robot(pose_type=pose_type)
    quaternion = {"z": length * math.sin(theta / 2), "w": length * math.cos(theta / 2)}
    pose = {"position": {"x": 1.0, "y": 2.0}, "orientation": quaternion}
    fields = pose if pose_type.endswith("PoseStamped") else {"pose": pose}
    message = from_dict(one.pose_class, {"pose": fields})
    assert one.read(message).pose == pytest.approx((1.0, 2.0, theta))


def test_a_robot_that_is_tilted_has_the_heading_that_is_seen_from_above():
    # Half a turn about x, then a quarter turn about z.
    quaternion = {"x": math.sqrt(0.5), "y": math.sqrt(0.5), "z": 0.0, "w": 0.0}
    message = from_dict(ODOMETRY.pose_class, {"pose": {"pose": {"orientation": quaternion}}})
    assert ODOMETRY.read(message).pose[2] == pytest.approx(math.pi / 2)


@pytest.mark.parametrize("name", ["x", "y", "theta"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_turtle_that_is_nowhere_is_no_sighting(name, value):
    with pytest.raises(InvalidMessage, match=f"^{name}: is {value}, which is not a place$"):
        Robot().read(TurtlePose(**{name: value}))


# Mistakes


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"pose_type": "nav_msgs/msg/Path"}, "'nav_msgs/msg/Path' is none of turtlesim/msg/Pose, "),
        ({"twist_type": "Twist"}, "'Twist' is none of geometry_msgs/msg/Twist, "),
        ({"dt": 0.0}, "must be finite and above zero, not 0.0"),
        ({"dt": math.inf}, "must be finite and above zero, not inf"),
        ({"max_age": -1.0}, "must be above zero, not -1.0"),
        ({"max_acceleration": 0.0}, "must be above zero, not 0.0"),
        ({"max_angular_acceleration": math.nan}, "must be above zero, not nan"),
    ],
)
def test_what_no_robot_has_is_refused_by_its_option(options, problem):
    with pytest.raises(InvalidOption) as caught:
        Robot(**options)
    assert caught.value.name == next(iter(options))
    assert caught.value.problem.startswith(problem)


@pytest.mark.parametrize("option", ["pose_topic", "twist_topic"])
def test_a_topic_that_can_be_none_is_refused_with_its_place(option):
    with pytest.raises(InvalidName, match=r"^invalid name: (.|\n)*my topic"):
        robot(**{option: "{turtle}/my topic"})
