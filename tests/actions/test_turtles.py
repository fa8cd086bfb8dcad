"""Which turtles there are to be driven, where to, and by whom."""

from __future__ import annotations

import pytest

from turtleact.errors import Abort, Reject
from turtleact.interfaces.standard import Point

from .yard import telling, yard


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
