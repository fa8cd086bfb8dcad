"""What may happen to a goal: every state times every event, cancel selection, retention."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from turtleact.errors import GoalAborted, GoalCanceled, InvalidTransition
from turtleact.goals.state import (
    CancelCode,
    CancelResponse,
    Goal,
    GoalEvent,
    GoalResponse,
    GoalStatus,
    GoalTable,
    cancel_code,
    failure,
    select,
)

from ..tables import together

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND

ID_1, ID_2, ID_3 = (bytes([number]) * 16 for number in (1, 2, 3))

NO = None
# Written out from the contract, one row a state; the columns are the events in this order.
EVENTS = ("EXECUTE", "CANCEL_GOAL", "SUCCEED", "ABORT", "CANCELED")
EXPECTED = {
    "UNKNOWN": (NO, NO, NO, NO, NO),
    "ACCEPTED": ("EXECUTING", "CANCELING", NO, NO, NO),
    "EXECUTING": (NO, "CANCELING", "SUCCEEDED", "ABORTED", NO),
    "CANCELING": (NO, NO, "SUCCEEDED", "ABORTED", "CANCELED"),
    "SUCCEEDED": (NO, NO, NO, NO, NO),
    "CANCELED": (NO, NO, NO, NO, NO),
    "ABORTED": (NO, NO, NO, NO, NO),
}
PRODUCT = [
    pytest.param(GoalStatus[status], GoalEvent[event], after and GoalStatus[after])
    for status, row in EXPECTED.items()
    for event, after in zip(EVENTS, row, strict=True)
]
LEGAL = [case for case in PRODUCT if case.values[2]]
ILLEGAL = [case for case in PRODUCT if not case.values[2]]


class Bell:
    """Counts how often it was rung."""

    def __init__(self) -> None:
        self.rung = 0

    def fire(self) -> None:
        self.rung += 1


_numbers = itertools.count(1 << 32)


def make_goal(
    stamp: int = START,
    status: GoalStatus = GoalStatus.EXECUTING,
    *,
    id: bytes | None = None,
    changed: Any = None,
    **facts,
) -> Goal:
    goal_id = next(_numbers).to_bytes(16, "big") if id is None else id
    signal: Any = changed or Bell()
    return Goal(goal_id, "request", signal, stamp, status, **facts)


# --- states and events ----------------------------------------------------------------------


@pytest.mark.parametrize(("status", "event", "after"), LEGAL)
def test_a_goal_moves_with_a_legal_event(status, event, after):
    goal = make_goal(status=status)
    goal.apply(event)
    assert goal.status is after


@together
@pytest.mark.parametrize(("status", "event", "after"), ILLEGAL)
def test_a_goal_stays_as_it_is_with_an_illegal_event(status, event, after):
    bell = Bell()
    goal = make_goal(status=status, changed=bell)
    with pytest.raises(InvalidTransition, match=f"is {status.name}: {event.name} is not allowed"):
        goal.apply(event)
    assert (goal.status, bell.rung) == (status, 0)


def test_an_illegal_event_names_the_goal():
    goal = make_goal(status=GoalStatus.SUCCEEDED, id=ID_1)
    with pytest.raises(InvalidTransition, match=f"^goal {ID_1.hex()} is SUCCEEDED: ABORT is not"):
        goal.apply(GoalEvent.ABORT)


def test_states_answers_and_codes_have_the_values_of_ros():
    assert [GoalStatus(value).name for value in range(7)] == list(EXPECTED)
    assert (GoalResponse.REJECT, GoalResponse.ACCEPT) == (1, 2)
    assert (CancelResponse.REJECT, CancelResponse.ACCEPT) == (1, 2)
    codes = ["NONE", "REJECTED", "UNKNOWN_GOAL_ID", "GOAL_TERMINATED"]
    assert [CancelCode(value).name for value in range(4)] == codes


def test_the_active_states_are_those_from_accepted_to_canceling_the_terminal_ones_those_behind():
    _, *others = GoalStatus
    assert [each.name for each in others if each.is_active] == list(EXPECTED)[1:4]
    assert [each.name for each in others if each.is_terminal] == list(EXPECTED)[4:]
    assert not GoalStatus.UNKNOWN.is_active
    assert not GoalStatus.UNKNOWN.is_terminal


@pytest.mark.parametrize(
    ("status", "error"),
    [(GoalStatus.CANCELED, GoalCanceled), (GoalStatus.ABORTED, GoalAborted)],
)
def test_a_failed_goal_tells_its_reason_and_result(status, error):
    told: Any = failure(make_goal(status=status, reason="too far", result="half"))
    assert (type(told), told.reason, told.result) == (error, "too far", "half")


# --- which goals a cancel request means -----------------------------------------------------

NONE = 0


def goals_of_three_times() -> list[Goal]:
    """Goals 1, 2 and 3, accepted at the seconds 1, 2 and 3, held in another order."""
    first, second, third = (
        make_goal(number * SECOND, id=bytes([number]) * 16) for number in (1, 2, 3)
    )
    return [second, third, first]


@pytest.mark.parametrize(
    ("goal_id", "stamp", "meant"),
    [
        pytest.param(None, NONE, [1, 2, 3], id="neither-means-every-goal"),
        pytest.param(None, 2 * SECOND, [1, 2], id="stamp-means-at-or-before"),
        pytest.param(None, 2 * SECOND - 1, [1], id="stamp-just-before"),
        pytest.param(None, 1, [], id="stamp-before-all"),
        pytest.param(ID_2, NONE, [2], id="id-means-that-goal"),
        pytest.param(bytes([9]) * 16, NONE, [], id="unknown-id"),
        pytest.param(ID_3, 1 * SECOND, [1, 3], id="both-mean-the-union"),
        pytest.param(ID_1, 2 * SECOND, [1, 2], id="both-overlapping-list-each-once"),
        pytest.param(bytes([9]) * 16, 2 * SECOND, [1, 2], id="unknown-id-and-stamp"),
    ],
)
def test_a_cancel_request_means(goal_id, stamp, meant):
    chosen = select(goals_of_three_times(), goal_id, stamp)
    assert [goal.hex[:2] for goal in chosen] == [f"0{number}" for number in meant]


def test_an_id_does_not_mean_a_goal_of_the_time_zero():
    assert select([make_goal(0)], ID_1, NONE) == []


def test_goals_of_one_time_are_meant_in_the_order_in_which_they_are_held():
    goals = [make_goal(START) for _ in range(20)]
    assert select(goals, None, NONE) == goals


@pytest.mark.parametrize(
    ("held", "by_id", "asked", "let_go", "code"),
    [
        pytest.param(False, False, 0, 0, CancelCode.NONE, id="nobody-to-ask"),
        pytest.param(False, False, 3, 3, CancelCode.NONE, id="all-let-go"),
        pytest.param(False, False, 3, 1, CancelCode.NONE, id="one-let-go"),
        pytest.param(False, False, 3, 0, CancelCode.REJECTED, id="none-let-go"),
        pytest.param(True, True, 1, 1, CancelCode.NONE, id="id-let-go"),
        pytest.param(True, True, 1, 0, CancelCode.REJECTED, id="id-not-let-go"),
        pytest.param(False, True, 0, 0, CancelCode.UNKNOWN_GOAL_ID, id="id-not-held"),
        pytest.param(True, True, 0, 0, CancelCode.GOAL_TERMINATED, id="id-ended"),
        pytest.param(True, False, 0, 0, CancelCode.NONE, id="id-ended-with-stamp"),
    ],
)
def test_a_cancel_request_is_answered(held, by_id, asked, let_go, code):
    named = make_goal() if held else None
    assert cancel_code(named, by_id=by_id, asked=asked, let_go=let_go) is code


# --- how long a goal is held ----------------------------------------------------------------


def held(table: GoalTable, goal_id: bytes, seconds: float) -> bool:
    return table.find(goal_id, START + round(seconds * SECOND)) is not None


def ended_goal(table: GoalTable, seconds: float = 0, **facts) -> Goal:
    goal = make_goal(id=ID_1, **facts)
    table.add(goal)
    table.end(goal, START + round(seconds * SECOND))
    return goal


def test_a_result_is_kept_for_ten_seconds_from_the_end():
    table = GoalTable()
    ended_goal(table, 100)
    assert [held(table, ID_1, 100 + after) for after in (0, 9.999, 10)] == [True, True, False]


def test_the_table_says_when_the_next_goal_expires():
    table = GoalTable()
    assert table.next_expiry() is None
    ended_goal(table, 5)
    assert table.next_expiry() == START + 15 * SECOND
    for_ever = GoalTable(None)
    ended_goal(for_ever)
    assert for_ever.next_expiry() is None


def test_only_the_newest_ended_goals_are_kept_while_time_stands_still():
    table = GoalTable()
    goals = [make_goal() for _ in range(GoalTable.KEPT + 2)]
    for goal in goals:
        table.add(goal)
    for goal in goals:
        table.end(goal, START)
    assert list(table.held(START).values()) == goals[2:]


def test_a_goal_restored_late_expires_in_its_turn():
    table = GoalTable()
    ended_goal(table, 5)
    table.hold_ended(make_goal(id=ID_2, ended=START + SECOND))
    assert [held(table, ID_2, 10.9), held(table, ID_2, 11)] == [True, False]
    assert held(table, ID_1, 11)


class Retention(RuleBasedStateMachine):
    """The table beside the plainest model: a list of all goals ever, looked through each time."""

    keep_ns: int | None = 2 * SECOND

    def __init__(self) -> None:
        super().__init__()
        self.table = GoalTable(None if self.keep_ns is None else self.keep_ns / SECOND)
        self.now = START
        self.goals: list[Goal] = []

    def is_held(self, goal: Goal) -> bool:
        if not goal.ended or self.keep_ns is None:
            return True
        return self.now < goal.ended + self.keep_ns

    def holder(self, goal_id: bytes) -> Goal | None:
        """The one of that id that is held; two of them would be a mistake of the model."""
        found = [goal for goal in self.goals if goal.id == goal_id and self.is_held(goal)]
        assert len(found) < 2
        return found[0] if found else None

    @rule(half_seconds=st.integers(1, 6))
    def let_time_pass(self, half_seconds):
        self.now += half_seconds * SECOND // 2

    @rule(number=st.integers(1, 4))
    def accept_with_an_id(self, number):
        goal_id = bytes([number]) * 16
        goal = make_goal(self.now, id=goal_id)
        taken = self.holder(goal_id) is None
        assert self.table.add(goal) == taken
        if taken:
            self.goals.append(goal)

    @precondition(lambda self: self.goals)
    @rule(data=st.data())
    def end(self, data):
        goal = data.draw(st.sampled_from(self.goals))
        if not goal.ended:
            self.table.end(goal, self.now)
            goal.apply(GoalEvent.SUCCEED)

    @rule(number=st.integers(1, 4))
    def find(self, number):
        goal_id = bytes([number]) * 16
        assert self.table.find(goal_id, self.now) is self.holder(goal_id)

    @invariant()
    def the_active_goals_are_those_that_have_not_ended(self):
        assert self.table.active == [goal for goal in self.goals if not goal.ended]

    def teardown(self) -> None:
        """Everything ended and its time over: nothing is left."""
        for goal in self.goals:
            if not goal.ended:
                self.table.end(goal, self.now)
        if self.keep_ns is not None:
            self.table.expire(self.now + self.keep_ns)
            assert not self.table.held(0)


class RetentionForEver(Retention):
    keep_ns = None


class NoRetention(Retention):
    keep_ns = 0


TestRetention = Retention.TestCase
TestRetentionForEver = RetentionForEver.TestCase
TestNoRetention = NoRetention.TestCase
