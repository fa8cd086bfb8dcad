"""Driving over topics alone: whatever has a pose and takes twists is a turtle."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from contextlib import aclosing, asynccontextmanager
from functools import partial
from typing import NamedTuple

import anyio.lowlevel
import pytest

from turtleact.actions.driving import PATIENCE, Turtles
from turtleact.actions.robots import Robot, Sighting
from turtleact.actions.steering import Area, Steering, shortest_time, time_bound
from turtleact.clock import VirtualClock
from turtleact.errors import Abort, Reject
from turtleact.interfaces.standard import Point, TurtlePose, Twist
from turtleact.node import Node, open_node
from turtleact.tasks import Background
from turtleact.topics import Publisher, Subscription
from turtleact.transports import MemoryTransport

from ..lab import settle
from .arena import tasks_alive

AREA = Area(0.0, 0.0, 10.0, 8.0)
FAR = Point(x=10_000.0)


class Yard(NamedTuple):
    """A robot that the test moves by hand.

    Attributes:
        clock: Virtual time.
        node: Where its topics are opened by those who drive it.
        turtles: What is tested.
        poses: Says where the robot is.
        twists: What the robot was told.
        at: Where it is while it obeys: x, y, theta.
    """

    clock: VirtualClock
    node: Node
    turtles: Turtles
    poses: Publisher[TurtlePose]
    twists: Subscription[Twist]
    at: list[float]

    def told(self):
        """How fast the robot was last told to go."""
        twist = self.twists.latest
        return None if twist is None else twist.linear.x

    def drive(self, robot="robot"):
        return self.turtles.drive(robot, Steering())

    def endpoints(self, name=""):
        """The topics that are open on the driving node."""
        node = self.node.fully_qualified_name
        return [each.name for each in self.node.transport.endpoints() if each.node == node]

    async def drive_on(self, until=lambda: False):
        """Drive the robot far away."""
        async with self.drive() as drive:
            while True:
                await drive.towards(FAR)
                if until():
                    return

    async def drive_until_it_is_killed(self):
        telling = Background(self.keep_telling(), "the robot")
        async with aclosing(telling), self.drive() as drive:
            await telling.aclose()
            await self.poses.aclose()
            await drive.towards(FAR)

    @asynccontextmanager
    async def drive_beside(self):
        """Drive the robot far away, in a task of its own."""
        async with aclosing(Background(self.drive_on(), "the driver")):
            await settle()
            yield

    async def tell_every(self, seconds, times):
        """Let the robot say where it is, now and then: from ``x=5`` on."""
        for count in range(5, times + 5):
            self.poses.publish(TurtlePose(x=float(count)))
            await self.clock.sleep(seconds)

    async def obey(self, pace=0.016):
        """Let the robot do as it is told, tick by tick, and say where it is."""
        while True:
            twist = self.twists.latest or Twist()
            self.at[2] += twist.angular.z * 0.016
            self.at[0] += math.cos(self.at[2]) * twist.linear.x * 0.016
            self.at[1] += math.sin(self.at[2]) * twist.linear.x * 0.016
            self.poses.publish(TurtlePose(*self.at))
            await self.clock.sleep(pace)

    async def keep_telling(self):
        await self.tell_every(0.016, 10_000)


@asynccontextmanager
async def yard(namespace: str = "/") -> AsyncIterator[Yard]:
    clock = VirtualClock()
    transport = MemoryTransport(clock)
    async with (
        aclosing(Background(clock.run(), "the clock")),
        open_node("robot", namespace=namespace, transport=transport) as robot,
        open_node("driver", namespace=namespace, transport=transport) as node,
    ):
        poses = robot.publisher(TurtlePose, "robot/pose")
        twists = robot.subscription(Twist, "robot/cmd_vel")
        yield Yard(clock, node, Turtles(node, AREA), poses, twists, [0.0, 0.0, 0.0])


@asynccontextmanager
async def telling(place):
    """The robot says where it is 62.5 times a second."""
    async with aclosing(Background(place.keep_telling(), "the robot")):
        yield


@asynccontextmanager
async def obeying(place, pace=0.016):
    """The robot moves as a turtle of turtlesim does."""
    async with aclosing(Background(place.obey(pace), "the robot")):
        yield


# What is driven


async def test_a_turtle_that_has_a_pose_can_be_driven():
    async with yard() as place:
        place.turtles.check_turtle("robot")


async def test_a_turtle_whose_pose_is_gone_cannot_be_driven():
    async with yard() as place:
        await place.poses.aclose()
        with pytest.raises(Reject, match="there is no turtle 'robot': nobody publishes robot/pose"):
            place.turtles.check_turtle("robot")


async def test_names_are_those_of_the_drivers_namespace():
    async with yard("/lab") as place, telling(place):
        async with place.drive():
            assert place.endpoints() == ["/lab/robot/pose", "/lab/robot/cmd_vel"]
            with pytest.raises(Reject, match="being driven by another goal"):
                place.turtles.check_turtle("/lab/robot")
        place.turtles.check_turtle("/lab/robot")


async def test_a_turtle_is_driven_by_one_at_a_time():
    async with yard() as place, telling(place), place.drive():
        with pytest.raises(Abort, match=r"^turtle '/robot' is being driven by another goal$"):
            async with place.drive("/robot"):
                pytest.fail("it has two drivers")
        with pytest.raises(Reject, match="being driven by another goal"):
            place.turtles.check_turtle("robot")


@pytest.mark.parametrize("corner", [(0.0, 0.0), (10.0, 8.0)])
async def test_a_target_may_be_on_the_edge(corner):
    async with yard() as place:
        place.turtles.check_target(Point(*corner))


@pytest.mark.parametrize(
    ("target", "problem"),
    [
        ((10.5, 4.0), "x is 10.5, outside the world: from 0 to 10"),
        ((4.0, 8.25), "y is 8.25, outside the world: from 0 to 8"),
        ((-1.0, -1.0), "x is -1.0, outside the world: from 0 to 10"),
        ((4.0, math.nan), "y is nan, outside the world: from 0 to 8"),
    ],
)
async def test_a_target_outside_is_rejected_by_its_coordinate(target, problem):
    async with yard() as place:
        with pytest.raises(Reject, match=rf"^targets\[3\]\.{problem}$"):
            place.turtles.check_target(Point(*target), path="targets[3].")


async def test_the_law_of_steering_gets_the_options_of_the_goal_and_the_area():
    async with yard() as place:
        steering = place.turtles.steering(
            style="forward", max_linear=1.0, max_angular=0.5, tolerance=0.25
        )
    limits = steering.limits
    assert (steering.style, limits.max_linear, limits.max_angular) == ("forward", 1.0, 0.5)
    assert (limits.tolerance, limits.area) == (0.25, AREA)


async def test_the_fastest_turn_is_the_last_that_the_law_of_steering_takes():
    async with yard() as place:
        steering = partial(place.turtles.steering, style="arc", max_linear=2.0, tolerance=0.1)
        steering(max_angular=Robot().fastest)
        with pytest.raises(Reject, match=r"^max_angular: must be 98\.17 rad/s at most, not 98\.2$"):
            steering(max_angular=98.2)


# Poses


async def test_the_block_begins_where_the_turtle_is_seen_first():
    async with yard() as place, telling(place), place.drive() as drive:
        assert drive.travelled == 0.0
        assert drive.pose.x >= 5.0


async def test_of_several_poses_the_newest_counts():
    async with yard() as place, telling(place), place.drive() as drive:
        seen = drive.pose.x
        await place.clock.sleep(0.1)
        await drive.wait_for_pose()
        assert drive.pose.x > seen + 5
        assert drive.travelled == drive.pose.x - seen


async def test_a_tick_sends_one_twist_and_waits_for_the_pose_after_it():
    async with yard() as place, telling(place), place.drive() as drive:
        seen = drive.pose.x
        await drive.towards(FAR)
        assert [twist.linear.x for twist in place.twists.drain()] == [2.0]
        assert drive.pose.x == seen + 1


async def test_a_turtle_is_told_only_what_is_new():
    async with yard() as place, obeying(place), place.drive() as drive:
        begun = place.clock.time()
        await drive.towards(FAR)
        assert place.clock.time() - begun == pytest.approx(38 * 0.016)
        assert drive.travelled == pytest.approx(38 * 0.032, abs=1e-5)
        assert drive.pose.x == pytest.approx(drive.travelled)
        assert len(place.twists.drain()) == 1


async def test_a_turtle_whose_ticks_come_late_is_told_no_more_than_that():
    async with yard() as place, obeying(place, pace=0.1), place.drive() as drive:
        for _ in range(3):
            await drive.towards(FAR)
        assert drive.travelled > 80 * 0.032
        assert len(place.twists.drain()) == 3


async def test_a_command_that_holds_ends_with_the_tick_that_comes_at_a_time():
    async with yard() as place, obeying(place), place.drive() as drive:
        await drive.towards(FAR)
        begun = place.clock.time()
        await drive.towards(FAR, until=begun + 0.04)
        assert place.clock.time() - begun == pytest.approx(3 * 0.016)


async def test_whatever_moves_the_turtle_is_answered_at_the_next_pose():
    async with yard() as place, obeying(place), place.drive() as drive:
        await drive.towards(FAR)
        begun = place.clock.time()
        place.at[1] += 1.0
        await drive.towards(FAR)
        assert place.clock.time() - begun == pytest.approx(0.016)
        assert drive.pose.y == 1.0


async def test_where_both_ways_are_as_good_it_turns_on_the_way_it_has_begun():
    async with yard() as place, telling(place), place.drive() as drive:
        for aside in (-0.1, 0.1):
            drive._seen = Sighting((5.0, 5.0, math.pi / 2))
            await drive.towards(Point(x=9.0, y=5.0 + aside))
        turns = [twist.angular.z for twist in place.twists.drain()]
    assert turns == [2.0, 2.0]


async def test_the_distance_is_counted_in_straight_lines():
    async with yard() as place, telling(place), place.drive() as drive:
        drive._seen = Sighting((0.0, 0.0, 0.0))
        assert drive.distance_to([Point(x=3.0, y=4.0), Point(x=3.0, y=0.0)]) == 9.0


async def test_a_target_has_a_deadline_that_leaves_patience():
    async with yard() as place, telling(place), place.drive() as drive:
        here = (drive.pose.x, drive.pose.y, drive.pose.theta)
        bound = time_bound(here, [(5.0, 5.0)], Steering())
        deadline = drive.deadline(Point(x=5.0, y=5.0))
        assert deadline - place.clock.time() == pytest.approx(PATIENCE * bound)


# Silence


async def test_a_turtle_that_says_nothing_is_given_up_after_two_seconds():
    async with yard() as place:
        with pytest.raises(Abort, match=r"^nothing was heard of robot/pose for 2 s$"):
            async with place.drive():
                pytest.fail("it was heard of")
        assert place.clock.time() == 2.0


async def test_a_turtle_that_falls_silent_is_given_up_within_two_and_a_half_seconds():
    async with yard() as place:
        telling = Background(place.tell_every(0.016, 100), "the robot")
        with pytest.raises(Abort, match="nothing was heard of robot/pose"):
            async with aclosing(telling):
                await place.drive_on()
        assert 2.0 <= place.clock.time() - 1.6 <= 2.5


async def test_a_turtle_whose_pose_is_gone_is_given_up_within_a_second():
    async with yard() as place:
        telling = Background(place.tell_every(0.016, 10), "the robot")
        async with aclosing(telling), place.drive() as drive:
            await place.clock.sleep(0.2)
            await drive.wait_for_pose()
            await place.poses.aclose()
            with pytest.raises(Abort) as caught:
                await drive.wait_for_pose()
        assert place.clock.time() <= 1.2
    assert str(caught.value) == "turtle 'robot' is gone: nobody publishes robot/pose any more"


async def test_a_turtle_that_says_little_is_not_given_up():
    async with yard() as place:
        telling = Background(place.tell_every(1.9, 20), "the robot")
        async with aclosing(telling), place.drive() as drive:
            while drive.pose.x < 24.0:
                await drive.towards(FAR)
        assert place.clock.time() == pytest.approx(19 * 1.9)


async def test_a_turtle_that_is_killed_is_given_up_by_name():
    async with yard() as place:
        reason = "^turtle 'robot' is gone: nobody publishes robot/pose any more$"
        with pytest.raises(Abort, match=reason):
            await place.drive_until_it_is_killed()
        assert place.clock.time() <= 1.0
        assert place.twists.latest == Twist()


async def test_a_pose_that_is_none_waits_for_who_drives():
    async with yard() as place, telling(place), place.drive() as drive:
        for _ in range(60):
            place.poses.publish(TurtlePose(x=math.nan))
            await place.clock.sleep(0.016)
        place.poses.publish(TurtlePose(x=math.nan))
        with pytest.raises(Abort, match=r"^robot/pose: x: is nan: nobody knows where that is$"):
            await drive.towards(FAR)


async def test_a_turtle_that_falls_silent_is_stopped_within_a_second():
    async with yard() as place, place.drive_beside():
        await place.tell_every(0.016, 10)
        assert place.told() == 2.0
        await place.clock.sleep(1.0)
        assert place.twists.latest == Twist()


async def test_a_turtle_that_is_heard_of_again_is_driven_on():
    async with yard() as place, place.drive_beside():
        await place.tell_every(0.016, 10)
        await place.clock.sleep(1.2)
        await place.tell_every(0.016, 2)
        assert place.told() == 2.0


async def test_what_is_late_is_told_with_who_else_drives():
    async with yard() as place, telling(place), place.drive() as drive:
        assert str(drive.too_late("it")) == "it was not reached in time"
        place.node.publisher(Twist, "robot/cmd_vel")
        text = "it was not reached in time: somebody else publishes robot/cmd_vel too"
        assert str(drive.too_late("it")) == text


# The end


async def test_at_the_end_the_turtle_is_told_to_stand_still():
    async with yard() as place, telling(place):
        await place.drive_on(until=lambda: True)
        assert [twist.linear.x for twist in place.twists.drain()] == [2.0, 0.0]


async def test_an_error_in_the_block_stops_the_turtle_and_goes_on():
    async with yard() as place, telling(place):
        with pytest.raises(ZeroDivisionError):
            await place.drive_on(until=lambda: 1 / 0)
        assert [twist.linear.x for twist in place.twists.drain()] == [2.0, 0.0]


async def test_at_the_end_the_topics_are_closed_and_the_turtle_is_free():
    async with yard() as place, telling(place):
        async with place.drive():
            assert place.endpoints() == ["/robot/pose", "/robot/cmd_vel"]
        assert place.endpoints() == []
        place.turtles.check_turtle("robot")


async def test_a_turtle_that_was_given_up_is_stopped_and_free():
    async with yard() as place:
        with pytest.raises(Abort):
            async with place.drive():
                pytest.fail("it was heard of")
        assert place.twists.latest == Twist()
        assert place.endpoints() == []
        place.turtles.check_turtle("robot")


async def test_nobody_watches_a_turtle_that_is_driven_no_more():
    async with yard() as place, telling(place):
        before = tasks_alive()
        async with place.drive():
            assert tasks_alive() == before + 1
        await settle()
        assert tasks_alive() == before


async def test_others_have_their_turn_while_the_shortest_time_is_found_out():
    turns, stops = [], [(0.0, 1.0), (1.0, 1.0), (0.5, 1.5), (0.0, 0.0)]

    async def take_turns():
        while True:
            await anyio.lowlevel.checkpoint()
            turns.append(1)

    async with (
        yard() as place,
        obeying(place),
        place.drive() as drive,
        aclosing(Background(take_turns(), "the others")),
    ):
        least = await drive.shortest_time([Point(*stop) for stop in stops])
    assert least == shortest_time((0.0, 0.0, 0.0), stops, Steering())
    assert len(turns) > 20
