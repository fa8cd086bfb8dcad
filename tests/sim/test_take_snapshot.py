"""Pictures as a service."""

from __future__ import annotations

import pytest

from turtleact.sim.pictures import to_png, to_svg
from turtleact.sim.world_services import TakeSnapshot

from .stage import stage


@pytest.mark.parametrize(
    ("format", "make"), [("png", to_png), ("svg", lambda snapshot: to_svg(snapshot).encode())]
)
async def test_a_picture_is_that_of_the_world_as_it_looks_now(format, make):
    async with stage() as here:
        here.command(x=2.0, turn=1.0)
        await here.pass_ticks(30)
        here.sim.ticking.pause()
        answer = await here.call(TakeSnapshot, "world/snapshot", format)
        assert (answer.data, answer.problem) == (make(here.sim.snapshot()), "")


async def test_a_picture_of_another_kind_is_refused():
    async with stage() as here:
        answer = await here.call(TakeSnapshot, "world/snapshot", "bmp")
    assert answer == TakeSnapshot.Response(
        problem="there is no picture format 'bmp': ask for png or svg"
    )
