"""Driving over topics alone: whatever has a pose and takes twists is a turtle."""

from __future__ import annotations

from contextlib import aclosing

import pytest

from turtleact.actions.steering import Limits
from turtleact.errors import Abort
from turtleact.interfaces.standard import Twist
from turtleact.tasks import Background

from .yard import FAR, obeying, telling, yard

# Poses


async def test_of_several_poses_the_newest_counts():
    async with yard() as place, telling(place), place.drive() as drive:
        seen = drive.pose.x
        await place.clock.sleep(0.1)
        await drive.wait_for_pose()
        assert drive.pose.x > seen + 5
        assert drive.travelled == drive.pose.x - seen


async def test_a_command_is_held_for_eight_poses():
    async with yard() as place, obeying(place), place.drive() as drive:
        for _ in range(5):
            begun = place.clock.time()
            await drive.towards(FAR)
            assert place.clock.time() - begun == pytest.approx(8 * 0.016)
        assert drive.travelled == pytest.approx(40 * 0.032, abs=1e-5)
        assert drive.pose.x == pytest.approx(drive.travelled)
        assert len(place.twists.drain()) == 5


@pytest.mark.parametrize(
    "limits", [{"max_angular": 20.0}, {"tolerance": 0.01}, {"max_acceleration": 1.0}]
)
async def test_a_turtle_that_is_fast_or_eased_is_told_at_each_pose(limits):
    async with yard() as place, obeying(place), place.drive(limits=Limits(**limits)) as drive:
        begun = place.clock.time()
        await drive.towards(FAR)
        assert place.clock.time() - begun == pytest.approx(0.016)


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


async def test_a_turtle_that_says_little_is_not_given_up():
    async with yard() as place:
        telling = Background(place.tell_every(1.9, 20), "the robot")
        async with aclosing(telling), place.drive() as drive:
            while drive.pose.x < 24.0:
                await drive.towards(FAR)
        assert place.clock.time() == pytest.approx(19 * 1.9)


async def test_a_turtle_that_falls_silent_is_stopped_within_a_second():
    async with yard() as place, place.drive_beside():
        await place.tell_every(0.016, 10)
        assert place.told() == 2.0
        await place.clock.sleep(1.0)
        assert place.twists.latest == Twist()


# The end


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
