"""Which turtles there are to be driven, where to, and by whom."""

from __future__ import annotations

import math
from functools import partial

import pytest

from turtleact.actions.robots import Robot
from turtleact.errors import Abort, Reject
from turtleact.interfaces.standard import Point

from .yard import AREA, telling, yard


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
            style="rotate_then_drive", max_linear=1.0, max_angular=0.5, tolerance=0.25
        )
    limits = steering.limits
    assert (steering.style, limits.max_linear, limits.max_angular) == (
        "rotate_then_drive",
        1.0,
        0.5,
    )
    assert (limits.tolerance, limits.area) == (0.25, AREA)


async def test_the_fastest_turn_is_the_last_that_the_law_of_steering_takes():
    async with yard() as place:
        steering = partial(place.turtles.steering, style="natural", max_linear=2.0, tolerance=0.1)
        steering(max_angular=Robot().fastest)
        with pytest.raises(Reject, match=r"^max_angular: must be 98\.17 rad/s at most, not 98\.2$"):
            steering(max_angular=98.2)
