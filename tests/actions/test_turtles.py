"""Which turtles there are to be driven, where to, and by whom."""

from __future__ import annotations

import pytest

from turtleact.interfaces.standard import Point

from .yard import yard


@pytest.mark.parametrize("corner", [(0.0, 0.0), (10.0, 8.0)])
async def test_a_target_may_be_on_the_edge(corner):
    async with yard() as place:
        place.turtles.check_target(Point(*corner))
