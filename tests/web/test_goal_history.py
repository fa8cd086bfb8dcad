"""The history is bounded, and tells a page what has changed since it last asked."""

from __future__ import annotations

from itertools import count

from hypothesis import given
from hypothesis import strategies as st

from turtleact.interfaces.standard import RotateAbsolute
from turtleact.web.goal_history import (
    MOST_ACTIVE,
    MOST_ENDED,
    MOST_POINTS,
    REJECTED,
    GoalHistory,
    GoalRecord,
    Series,
)


def record(id: int) -> GoalRecord:
    return GoalRecord(f"{id:032x}", "/count", "lab_interfaces/action/Count", accepted=1.0, at=2.0)


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
    assert rejected.plain()["duration"] is None
    plain = ended.plain()
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
