"""What pages are told is bounded, and a page that asks again gets what has changed."""

from __future__ import annotations

from itertools import count, pairwise
from math import cos, hypot, pi, sin

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from turtleact.interfaces.standard import RotateAbsolute
from turtleact.web.page_history import (
    FIRST_PEN,
    MOST_ACTIVE,
    MOST_CORNERS,
    MOST_ENDED,
    MOST_LINES,
    MOST_POINTS,
    REJECTED,
    GoalHistory,
    GoalRecord,
    Pen,
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


def test_only_what_has_changed_is_told_the_latest_change_first():
    kept, one, two = history(), record(1), record(2)
    kept.change(one)
    kept.change(two)
    assert ids(kept, 0) == [2, 1]
    kept.change(one)
    assert ids(kept, 2) == [1]
    assert ids(kept, 3) == []


def test_the_last_goals_that_have_ended_are_kept_and_the_others_are_told_as_dropped():
    kept = history()
    for id in range(1000):
        each = record(id)
        kept.change(each)
        kept.end(each, "SUCCEEDED", 3.0)
    assert ids(kept, 0) == list(reversed(range(1000 - MOST_ENDED, 1000)))
    last = kept.find(f"{999:032x}")
    assert last is not None
    changes = kept.since(last.revision)
    assert (changes.goals, changes.is_complete) == ([], True)
    assert changes.dropped == [f"{1000 - MOST_ENDED - 1:032x}"]


def test_a_page_that_has_missed_too_much_is_told_to_ask_for_everything():
    kept = history()
    for id in range(3000):
        each = record(id)
        kept.change(each)
        kept.end(each, "ABORTED")
    assert not kept.since(1).is_complete


def test_running_goals_are_bounded_too():
    kept = history()
    for id in range(MOST_ACTIVE + 5):
        kept.change(record(id))
    assert len(kept) == MOST_ACTIVE
    assert kept.find(f"{0:032x}") is None


def test_a_record_tells_how_its_goal_ended():
    kept, rejected, ended = history(), record(1), record(2)
    kept.end(rejected, REJECTED)
    ended.take(RotateAbsolute.Feedback(1.5), 2.0)
    kept.change(ended)
    kept.end(ended, "SUCCEEDED", 3.5)
    assert rejected.duration is None
    plain = msgspec.json.decode(msgspec.json.encode(ended.told()))
    assert (plain["status"], plain["has_ended"], plain["duration"]) == ("SUCCEEDED", True, 2.5)
    assert (plain["feedback"], plain["series"]) == ({"remaining": 1.5}, {"remaining": [[1.0, 1.5]]})


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


def test_feedback_at_100_hz_is_thinned_out_evenly():
    series = Series()
    for index in range(100_000):
        series.add(index / 100, 0.0)
    gaps = [
        there[0] - here[0] for here, there in zip(series.points, series.points[1:], strict=False)
    ]
    assert len(series.points) > MOST_POINTS / 3
    assert max(gaps) < 4 * 1000 / MOST_POINTS


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


def test_only_the_new_end_is_told():
    drawn = trails()
    drive(drawn, (0.0, 0.0), (0.5, 0.0), (1.0, 0.0))
    assert not drawn.since(3)
    drive(drawn, (1.5, 0.0))
    assert not drawn.since(3)["turtle1"].is_whole
    assert places(drawn, 3) == [(1.0, 0.0)]


def test_the_pen_is_told_with_each_point():
    drawn = trails()
    drive(drawn, (0.0, 0.0), (0.5, 0.0))
    drawn.set_pen("turtle1", Pen("#ff0000", 5))
    drive(drawn, (1.0, 0.0), (1.5, 0.0))
    drawn.set_pen("turtle1", Pen("#ff0000", 5, is_off=True))
    drive(drawn, (2.0, 0.0), (2.5, 0.0))
    pens = [(x, colour, width) for x, _, colour, width in drawn.since(0)["turtle1"].points]
    assert pens[:3] == [(0.0, "", 0), (0.5, FIRST_PEN.colour, 3), (1.0, "#ff0000", 5)]
    assert pens[-1] == (2.0, "", 5)


def test_clearing_tells_every_page_to_begin_anew_and_keeps_pens():
    drawn = trails()
    drawn.set_pen("turtle1", Pen("#ff0000", 5))
    drive(drawn, (0.0, 0.0), (1.0, 0.0))
    drawn.clear()
    tail = drawn.since(2)["turtle1"]
    assert (tail.is_whole, tail.points) == (True, [])
    drive(drawn, (5.0, 5.0), (6.0, 5.0), (7.0, 5.0))
    assert drawn.since(0)["turtle1"].points[1][2] == "#ff0000"
    drawn.reset()
    drive(drawn, (5.0, 5.0), (6.0, 5.0), (7.0, 5.0))
    assert drawn.since(0)["turtle1"].points[1][2] == FIRST_PEN.colour


def test_a_turtle_that_comes_back_elsewhere_draws_no_line_to_there():
    drawn = trails()
    drive(drawn, (0.0, 0.0), (1.0, 0.0))
    drawn.lift("turtle1")
    drawn.lift("nobody")
    drive(drawn, (5.0, 5.0))
    assert drawn.since(0)["turtle1"].points[-1] == (5.0, 5.0, "", 0)


def test_the_lines_of_turtles_that_are_gone_are_dropped_first():
    drawn = trails()
    drive(drawn, (1.0, 1.0))
    for index in range(2 * MOST_LINES):
        drawn.follow(f"gone{index}", 0.0, 0.0)
        drawn.lift(f"gone{index}")
    kept = drawn.since(0)
    assert len(kept) == MOST_LINES
    assert "turtle1" in kept


def test_a_trail_is_bounded():
    drawn = trails()
    for index in range(4 * MOST_CORNERS):
        drive(drawn, (index % 2, index / 1000))
    assert MOST_CORNERS / 2 < len(places(drawn)) <= MOST_CORNERS
