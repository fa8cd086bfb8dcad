"""What pages are told is bounded, and a page that asks again gets what has changed."""

from __future__ import annotations

from itertools import count, pairwise
from math import cos, hypot, pi, sin

from hypothesis import given
from hypothesis import strategies as st

from turtleact.web.page_history import (
    MOST_ACTIVE,
    MOST_CORNERS,
    MOST_POINTS,
    GoalHistory,
    GoalRecord,
    PenTrails,
    Series,
)


def record(id: int) -> GoalRecord:
    return GoalRecord(f"{id:032x}", "/count", "lab_interfaces/action/Count", 1.0, 2.0)


def history() -> GoalHistory:
    revisions = count(1)
    return GoalHistory(lambda: next(revisions))


def ids(history: GoalHistory, since: int) -> list[int]:
    return [int(each.id, 16) for each in history.since(since).goals]


def test_running_goals_are_bounded_too():
    kept = history()
    for id in range(MOST_ACTIVE + 5):
        kept.change(record(id))
    assert len(kept) == MOST_ACTIVE
    assert kept.find(f"{0:032x}") is None


@given(st.lists(st.floats(0.0, 10.0), min_size=1, max_size=400))
def test_a_series_is_bounded_and_keeps_its_ends(steps):
    series, time = Series(), 0.0
    for index, step in enumerate(steps):
        time += step
        series.add(time, float(index))
    times = [time for time, _ in series.points]
    assert len(series.points) <= MOST_POINTS
    assert times == sorted(set(times))
    assert series.points[-1] == (round(time, 3), len(steps) - 1)
    assert times[0] == round(steps[0], 3)


# trails


def trails() -> PenTrails:
    revisions = count(1)
    return PenTrails(lambda: next(revisions))


def places(trails: PenTrails, since: int = 0) -> list[tuple[float, float]]:
    return [point[:2] for point in trails.since(since)["turtle1"].points]


def drive(trails: PenTrails, *way: tuple[float, float]) -> None:
    for x, y in way:
        trails.follow("turtle1", x, y)


def test_a_straight_way_needs_few_points_and_a_corner_is_one():
    drawn = trails()
    drive(drawn, *((index / 100, 0.0) for index in range(101)))
    drive(drawn, *((1.0, index / 100) for index in range(1, 101)))
    assert (1.0, 0.0) in places(drawn)
    assert len(places(drawn)) < 12


def test_an_arc_stays_near_the_way():
    drawn = trails()
    drive(drawn, *((cos(a / 50), sin(a / 50)) for a in range(int(100 * pi))))
    points = places(drawn)
    middles = [((a + c) / 2, (b + d) / 2) for (a, b), (c, d) in pairwise(points)]
    assert all(abs(hypot(*middle) - 1.0) < 0.015 for middle in middles)


def test_a_trail_is_bounded():
    drawn = trails()
    for index in range(4 * MOST_CORNERS):
        drive(drawn, (index % 2, index / 1000))
    assert MOST_CORNERS / 2 < len(places(drawn)) <= MOST_CORNERS
