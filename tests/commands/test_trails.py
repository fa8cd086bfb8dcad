"""Where turtles have been, as the graph tells it, and where goals send them."""

from __future__ import annotations

import math
from contextlib import asynccontextmanager

import pytest

from turtleact.commands import trails
from turtleact.commands.trails import Course, Motion, PoseTrails, colour_of, pose_topics
from turtleact.interfaces import Message, float64, get_interface, int32
from turtleact.interfaces.standard import Point, TurtlePose
from turtleact.node import open_node


class Tour(Message, type_name="tracks_test_interfaces/msg/Tour"):
    targets: list[Point] = []
    loops: int32 = 0
    tolerance: float64 = 0.0


def course(*places, loops=0, tolerance=0.0):
    return Course(Tour([Point(x=x, y=y) for x, y in places], loops, tolerance))


# --- the course -----------------------------------------------------------------------------


def numbers(course):
    """The numbers of the places ahead."""
    return [target.number for target in course.targets() if not target.is_reached]


def test_a_place_is_behind_the_turtle_once_it_has_come_near():
    tour = course((1.0, 1.0), (5.0, 5.0))
    tour.follow(1.1, 1.0)
    assert (tour.passed, numbers(tour), tour.told()) == (1, [2], "1 of 2 targets")


def test_a_place_that_was_passed_between_two_looks_is_behind_it_too():
    tour = course((3.0, 1.1))
    tour.follow(1.0, 1.0)
    tour.follow(9.0, 1.0)
    assert numbers(tour) == []


def test_places_count_in_their_order():
    tour = course((1.0, 1.0), (5.0, 5.0))
    tour.follow(5.0, 5.0)
    assert numbers(tour) == [1, 2]


def test_a_further_round_begins_with_all_places():
    tour = course((1.0, 1.0), (5.0, 5.0), loops=1)
    for x in (1.0, 5.0):
        tour.follow(x, x)
    assert (numbers(tour), tour.told()) == ([1, 2], "2 of 4 targets")


def test_a_goal_without_places_leads_nowhere():
    assert (course().targets(), course().told()) == ([], "")


def test_a_place_counts_from_as_far_as_the_goal_allows():
    tour = course((1.0, 1.0), tolerance=0.8)
    tour.follow(1.7, 1.0)
    assert tour.passed == 1


# --- motion ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("theta", "step", "is_reversing"),
    [
        (0.0, 0.03, False),
        (0.0, -0.03, True),
        (math.pi, 0.03, True),
        (math.pi / 2, 0.03, False),
        (math.pi, 3.0, False),  # a teleport
    ],
)
def test_a_turtle_reverses_while_it_moves_against_its_heading(theta, step, is_reversing):
    motion = Motion()
    motion.follow(5.0, 5.0, theta)
    motion.follow(5.0 + step, 5.0, theta)
    assert (motion.is_reversing, motion.told()) == (is_reversing, "reversing" * is_reversing)
    motion.follow(5.0 + step, 5.0, theta)
    assert not motion.is_reversing


# --- the trails -----------------------------------------------------------------------------


@asynccontextmanager
async def tracked(*names, leader=""):
    """A look at turtles, and what publishes where they are."""
    async with open_node("stage") as node:
        publishers = {name: node.publisher(TurtlePose, f"/{name}/pose") for name in names}
        yield PoseTrails(node, leader), publishers, node


async def test_turtles_have_a_place_a_name_and_a_colour_each():
    async with tracked("b", "a") as (looked_at, publishers, _):
        publishers["a"].publish(TurtlePose(x=1.0, y=2.0, theta=3.0))
        publishers["b"].publish(TurtlePose())
        a, b = looked_at.look().turtles
    assert a == (1.0, 2.0, 3.0, "a", colour_of("a"))
    assert (b.name, b.colour) == ("b", colour_of("b"))


async def test_a_turtle_that_has_told_nothing_is_nowhere():
    async with tracked("a") as (looked_at, _, _):
        assert looked_at.look().turtles == []


async def test_a_trail_has_the_colour_of_its_turtle():
    async with tracked("a") as (looked_at, publishers, _):
        for x in (1.0, 2.0):
            publishers["a"].publish(TurtlePose(x=x))
        ink = looked_at.look().ink
    assert ink is not None
    assert colour_of("a") in ink.canvas(20, 10).colours()[-1]


async def test_a_turtle_that_comes_is_found_and_one_that_goes_is_forgotten():
    async with tracked("a") as (looked_at, publishers, node):
        publishers["a"].publish(TurtlePose())
        late = node.publisher(TurtlePose, "/b/pose")
        await publishers["a"].aclose()
        for _ in range(trails.LOOKS):
            looked_at.look()
        late.publish(TurtlePose())
        assert [turtle.name for turtle in looked_at.look().turtles] == ["b"]


async def test_of_many_turtles_only_some_are_followed(monkeypatch):
    monkeypatch.setattr(trails, "MOST_TURTLES", 2)
    async with tracked("a", "b", "c") as (looked_at, publishers, _):
        for each in publishers.values():
            each.publish(TurtlePose())
        assert [turtle.name for turtle in looked_at.look().turtles] == ["a", "b"]


async def test_the_one_that_matters_is_followed_in_any_case(monkeypatch):
    monkeypatch.setattr(trails, "MOST_TURTLES", 2)
    async with tracked("a", "b", "c", leader="/c/pose") as (looked_at, publishers, _):
        for each in publishers.values():
            each.publish(TurtlePose())
        assert [turtle.name for turtle in looked_at.look().turtles] == ["c", "a"]


async def test_turtles_of_newer_distributions_are_turtles_too():
    newer = get_interface("turtlesim_msgs/msg/Pose")
    async with open_node("stage") as node:
        node.publisher(newer, "/new/pose")  # type: ignore[type-var]  # a message, as its name says
        node.publisher(Point, "/other/pose")
        assert pose_topics(node) == {"/new/pose": "turtlesim_msgs/msg/Pose"}


@pytest.mark.parametrize(
    ("start", "end", "offset"),
    [((0.0, 0.0), (4.0, 0.0), 3.0), ((0.0, 0.0), (0.0, 0.0), 5.0), ((4.0, 0.0), (9.0, 0.0), 3.0)],
)
def test_the_distance_from_a_line_is_that_of_its_nearest_point(start, end, offset):
    place = (4.0, 3.0) if offset == 3.0 else (3.0, 4.0)
    assert trails.offset(place, start, end) == offset
