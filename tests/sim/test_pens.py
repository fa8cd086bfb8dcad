"""The pens of a world: what each turtle draws in a tick, and what it sees."""

from __future__ import annotations

import pytest

from turtleact.sim.drawing import Pens
from turtleact.sim.pictures import METER, Colour, Pen
from turtleact.sim.world import World

RED, GREEN = Colour(255, 0, 0), Colour(0, 255, 0)
WHITE = Colour(255, 255, 255)
FEW = 3


def run(world, pens, ticks=1, sensed=()):
    colours = {}
    for _ in range(ticks):
        world.step()
        colours = pens.follow(sensed)
    return colours


def spawn(world, pens, *where):
    pens.hand_out(world.spawn(*where))


def kill(world, pens, name):
    world.kill(name)
    pens.take_back(name)


def strokes(pens):
    """The polylines in metres, rounded."""
    return [
        [complex(round(p.real / METER, 3), round(p.imag / METER, 3)) for p in stroke.points]
        for stroke in pens.drawing.polylines()
    ]


def world_of(turtles=1):
    world = World(turtles)
    pens = Pens(world)
    run(world, pens)
    return world, pens


@pytest.mark.parametrize("turtles", [1, FEW])
def test_a_turtle_that_moves_draws_a_line_from_where_it_was(turtles):
    world, pens = world_of(turtles)
    world.set_velocity("turtle1", 1.0)
    run(world, pens, 100)
    assert strokes(pens) == [[5.544 + 5.544j, 6.552 + 5.544j]]


@pytest.mark.parametrize("turtles", [1, FEW])
def test_a_turtle_that_stands_still_or_only_turns_draws_nothing(turtles):
    world, pens = world_of(turtles)
    world.set_velocity("turtle1", 0.0, 0.0, 1.0)
    run(world, pens, 100)
    assert strokes(pens) == []


def test_a_teleport_draws_a_line_to_where_it_leads_and_the_walls_another():
    world, pens = world_of()
    world.teleport_absolute("turtle1", 20.0, 4.0, 0.0)
    run(world, pens)
    assert strokes(pens) == [[5.544 + 5.544j, 20 + 7.089j, 11.089 + 7.089j]]


def test_a_pen_that_is_off_draws_no_teleport_and_cuts_the_line():
    world, pens = world_of()
    world.set_velocity("turtle1", 1.0)
    run(world, pens, 10)
    pens.set("turtle1", RED, is_off=True)
    world.teleport_absolute("turtle1", 1.0, 1.0, 0.0)
    run(world, pens, 10)
    pens.set("turtle1", RED)
    run(world, pens, 10)
    first, second = strokes(pens)
    assert first[0] == 5.544 + 5.544j
    assert second[0] == 1.16 + 10.089j


def test_switching_off_leaves_the_colour_as_it_was():
    _, pens = world_of()
    pens.set("turtle1", GREEN, 7)
    pens.set("turtle1", RED, 9, is_off=True)
    assert pens.colour("turtle1") == GREEN


def test_no_width_is_one_pixel_and_the_usual_one_is_three():
    world, pens = world_of()
    world.set_velocity("turtle1", 1.0)
    run(world, pens)
    pens.set("turtle1", RED)
    run(world, pens)
    assert [stroke.pen.width for stroke in pens.drawing.polylines()] == [3, 1]


def test_a_turtle_sees_the_lines_of_those_before_it_and_not_of_those_behind():
    world, pens = world_of(2)
    for name in world.names:
        world.teleport_absolute(name, 5.0, 5.0, 0.0)
    run(world, pens)
    pens.drawing.clear()
    pens.set("turtle1", RED, 9)
    pens.set("turtle2", GREEN, 9)
    for name in world.names:
        world.set_velocity(name, 1.0)
    assert run(world, pens, sensed=world.names) == {"turtle1": WHITE, "turtle2": RED}
    assert run(world, pens, sensed=world.names)["turtle1"] == GREEN


def test_a_turtle_of_the_same_name_draws_a_line_of_its_own():
    world, pens = world_of()
    for _ in range(2):
        spawn(world, pens, 1.0, 1.0, 0.0, "bob")
        pens.set("bob", RED, 9)
        world.set_velocity("bob", 1.0)
        run(world, pens, 3)
        kill(world, pens, "bob")
    assert [len(stroke) for stroke in strokes(pens)] == [2, 2]
    with pytest.raises(KeyError):
        pens.colour("bob")


def test_forgetting_all_erases_the_drawing_and_renews_the_pens():
    world, pens = world_of()
    pens.set("turtle1", RED, 9)
    world.set_velocity("turtle1", 1.0)
    run(world, pens, 3)
    pens.forget_all()
    assert strokes(pens) == []
    run(world, pens)
    assert pens.drawing.polylines()[0].pen == Pen()
