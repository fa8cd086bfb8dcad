"""Driving over topics alone: whatever has a pose and takes twists is a turtle."""

from __future__ import annotations

from contextlib import aclosing

import pytest

from turtleact.errors import Abort
from turtleact.interfaces.standard import Twist
from turtleact.tasks import Background

from .yard import FAR, telling, yard

# Poses


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
