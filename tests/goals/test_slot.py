"""Who may run: every policy times every situation, and a plain reference to compare with."""

from __future__ import annotations

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
)

from turtleact.errors import InvalidOption
from turtleact.goals.policies import Decision, Rules, Slot, Slots
from turtleact.goals.state import Goal

from ..lab import bare_goal

START, WAIT, REFUSE = Decision.START, Decision.WAIT, Decision.REJECT

PARALLEL = Rules()
TWO = Rules(max_active=2)
TWO_AND_ONE_WAITS = Rules(max_active=2, queue_limit=1)
REJECT = Rules("reject")
QUEUE = Rules("queue")
ONE_WAITS = Rules("queue", queue_limit=1)
PREEMPT = Rules("preempt")
EVERY = [PARALLEL, TWO, TWO_AND_ONE_WAITS, REJECT, QUEUE, ONE_WAITS, PREEMPT]


class Wish:
    """A claim with nothing behind it."""

    def __init__(self, name: str, action: str = "/count", parent: Wish | None = None) -> None:
        self.name = name
        self.action = action
        self.goal: Goal = bare_goal(parent=None if parent is None else parent.goal)

    def __repr__(self) -> str:
        return self.name

    @property
    def label(self) -> str:
        return f"goal {self.name} of {self.action}"


def slot_with(rules: Rules, *wishes: Wish) -> Slot[Wish]:
    slot: Slot[Wish] = Slot(rules)
    for wish in wishes:
        slot.enter(wish)
    return slot


def end(slot: Slot[Wish], wish: Wish) -> Wish | None:
    """What a server does at a goal's end."""
    wish.goal.ended = 1
    wish.goal.parent = None
    return slot.leave(wish.goal)


# --- the rules ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"policy": "fifo"},
            "policy: expected one of parallel, reject, queue, preempt, not 'fifo'",
        ),
        ({"policy": None}, "policy: expected one of .*, not None"),
        ({"policy": ["queue"]}, r"policy: expected one of .*, not \['queue'\]"),
        ({"max_active": 0}, "max_active: expected a whole number from 1, not 0"),
        ({"max_active": True}, "max_active: expected a whole number from 1, not True"),
        ({"max_active": 1.5}, r"max_active: expected a whole number from 1, not 1\.5"),
        ({"max_active": "2"}, "max_active: expected a whole number from 1, not '2'"),
        ({"policy": "queue", "queue_limit": -1}, "queue_limit: expected .* from 0, not -1"),
        ({"policy": "queue", "queue_limit": False}, "queue_limit: expected .* from 0, not False"),
        (
            {"policy": "queue", "max_active": 2},
            "max_active: only fits policy 'parallel', not 'queue'",
        ),
        ({"policy": "reject", "max_active": 1}, "max_active: only fits policy 'parallel'"),
        ({"policy": "preempt", "max_active": 1}, "max_active: only fits policy 'parallel'"),
        ({"queue_limit": 1}, "queue_limit: only fits policy 'queue', or max_active"),
        ({"policy": "reject", "queue_limit": 1}, "queue_limit: only fits policy 'queue'"),
        ({"policy": "preempt", "queue_limit": 1}, "queue_limit: only fits policy 'queue'"),
    ],
)
def test_rules_that_cannot_be_are_refused(options, message):
    option, _, problem = message.partition(": ")
    with pytest.raises(InvalidOption, match=f"^option '{option}': {problem}"):
        Rules(**options)


# --- every policy in every situation --------------------------------------------------------

# One row a situation; the columns are the rules, in the order of `EVERY`.
EXPECTED = {
    "free": (START, START, START, START, START, START, START),
    "one runs": (START, START, START, REFUSE, WAIT, WAIT, WAIT),
    "two run": (START, WAIT, WAIT, None, None, None, None),
    "one waits": (None, WAIT, REFUSE, None, WAIT, REFUSE, WAIT),
    "one has ended": (START, START, START, START, START, START, START),
    "child of another action": (START, START, START, START, START, START, START),
    "child of another action, one waits": (None, START, START, None, START, START, START),
    "child of the same action": (START, START, START, REFUSE, REFUSE, REFUSE, REFUSE),
    "child of the same action, two run": (START, WAIT, WAIT, None, None, None, None),
    "child of the same action, one waits": (None, WAIT, REFUSE, None, REFUSE, REFUSE, REFUSE),
    "grandchild of the same action": (START, START, START, REFUSE, REFUSE, REFUSE, REFUSE),
    "child of one that has ended": (START, START, START, START, START, START, START),
}


def in_situation(situation: str, rules: Rules) -> tuple[Slot[Wish], Wish]:
    """A slot, and the goal that is to enter it."""
    holder, other, waiting = Wish("holder"), Wish("other"), Wish("waiting")
    slot = slot_with(rules, holder)
    if "two run" in situation or ("one waits" in situation and rules.max_active):
        slot.enter(other)
    if "one waits" in situation:
        slot.enter(waiting)
    if situation == "free":
        slot = slot_with(rules)
    if "ended" in situation:
        end(slot, holder)
    if "another action" in situation:
        return slot, Wish("new", "/rotate", holder)
    if "grandchild" in situation:
        child = Wish("child", "/rotate", holder)
        slot.enter(child)
        return slot, Wish("new", "/count", child)
    return slot, Wish("new", parent=holder if "child" in situation else None)


TABLE = [
    pytest.param(situation, rules, admission, id=f"{situation}-{rules}")
    for situation, row in EXPECTED.items()
    for rules, admission in zip(EVERY, row, strict=True)
    if admission is not None  # None: the situation cannot be
]


@pytest.mark.parametrize(
    ("situation", "rules", "reason"),
    [
        ("one runs", REJECT, "busy with goal holder of /count"),
        ("one waits", ONE_WAITS, "the queue is full (1 waiting)"),
        ("one waits", TWO_AND_ONE_WAITS, "the queue is full (1 waiting)"),
        *(
            (
                f"{kind} of the same action",
                rules,
                "a deadlock: it would wait for its own parent, goal holder of /count",
            )
            for kind in ("child", "grandchild")
            for rules in (REJECT, QUEUE, PREEMPT)
        ),
    ],
)
def test_a_refusal_says_why(situation, rules, reason):
    slot, new = in_situation(situation, rules)
    assert slot.enter(new).reason == reason


# --- preempting -----------------------------------------------------------------------------


def test_a_child_that_goes_on_after_its_parent_gave_way_is_to_give_way_too():
    holder, new = Wish("holder"), Wish("new")
    child = Wish("child", "/rotate", holder)
    slot = slot_with(PREEMPT, holder, child, new)
    assert end(slot, holder) is None
    overdue = slot.overdue()
    assert overdue is not None
    assert (overdue.evicted, overdue.reason) == ((child,), "preempted by goal new of /count")
    assert end(slot, child) is new
    assert slot.overdue() is None


# --- against a plain reference --------------------------------------------------------------


class Family(list[Wish]):
    """Those that run in one place of the reference."""


class Comparison(RuleBasedStateMachine):
    """A slot beside lists; goals enter and end in any order, as children of any goal."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0
        self.running: list[Family] = []
        self.waiting: list[Wish] = []
        self.over: list[Wish] = []

    @initialize(rules=st.sampled_from(EVERY))
    def choose(self, rules: Rules) -> None:
        self.slot: Slot[Wish] = Slot(rules)
        alone = rules.policy != "parallel"
        self.places = 1 if alone else 10**6 if rules.max_active is None else rules.max_active

    @property
    def active(self) -> list[Wish]:
        return [wish for family in self.running for wish in family]

    def family_of(self, wish: Wish) -> Family:
        return next(family for family in self.running if wish in family)

    def ancestors(self, wish: Wish) -> list[Wish]:
        parents = [each for each in self.active if each.goal is wish.goal.parent]
        return parents + [far for near in parents for far in self.ancestors(near)]

    def expect(self, wish: Wish) -> Decision:
        ancestors = self.ancestors(wish)
        if ancestors and all(each.action != wish.action for each in ancestors):
            return START
        if len(self.running) < self.places:
            return START
        stuck = [self.family_of(p) for each in (wish, *self.waiting) for p in self.ancestors(each)]
        if ancestors and all(family in stuck for family in self.running):
            return REFUSE
        if self.slot.rules.policy == "reject":
            return REFUSE
        limit = self.slot.rules.queue_limit
        return REFUSE if limit is not None and len(self.waiting) >= limit else WAIT

    @rule(action=st.sampled_from("abc"), data=st.data())
    def enter(self, action: str, data: st.DataObject) -> None:
        senders = [None, *self.active, *self.over[-2:]]
        parent = data.draw(st.sampled_from(senders), label="parent")
        self.count += 1
        wish = Wish(str(self.count), action, parent)
        expected, ancestors = self.expect(wish), self.ancestors(wish)
        entry = self.slot.enter(wish)
        assert entry.decision is expected
        if expected is START:
            if all(each.action != action for each in ancestors) and ancestors:
                self.family_of(ancestors[0]).append(wish)
            else:
                self.running.append(Family([wish]))
        elif expected is WAIT:
            if self.slot.rules.policy == "preempt":
                families = [each for each in self.active if not self.ancestors(each)]
                assert list(entry.evicted) == self.waiting + families
                self.over += self.waiting
                self.waiting = []
            self.waiting.append(wish)

    @precondition(lambda self: self.active or self.waiting)
    @rule(data=st.data())
    def end_one(self, data: st.DataObject) -> None:
        self.end(data.draw(st.sampled_from([*self.active, *self.waiting]), label="goal"))

    @precondition(lambda self: self.over)
    @rule(data=st.data())
    def end_one_again(self, data: st.DataObject) -> None:
        assert self.slot.leave(data.draw(st.sampled_from(self.over), label="goal").goal) is None

    def end(self, wish: Wish) -> None:
        following = end(self.slot, wish)
        self.over.append(wish)
        if wish in self.waiting:
            self.waiting.remove(wish)
            assert following is None
            return
        family = self.family_of(wish)
        family.remove(wish)
        if family or not self.waiting:
            assert following is None
        else:
            assert following is self.waiting.pop(0)
            self.running.append(Family([following]))
        self.running = [family for family in self.running if family]

    @invariant()
    def the_same_goals_run(self) -> None:
        known = (*self.active, *self.waiting, *self.over)
        assert [each for each in known if self.slot.holds(each.goal)] == self.active
        assert len(self.running) <= self.places

    @invariant()
    def it_is_empty_when_none_runs_or_waits(self) -> None:
        assert self.slot.is_empty == (not self.active and not self.waiting)

    @invariant()
    def no_place_is_free_while_one_waits(self) -> None:
        assert not self.waiting or len(self.running) == self.places

    def teardown(self) -> None:
        """All come to their end, though each waits for those that it has sent: no deadlock."""
        while self.active:
            parents = [each.goal.parent for each in (*self.active, *self.waiting)]
            free = [each for each in self.active if each.goal not in parents]
            assert free, "all wait for each other"
            self.end(free[0])
        assert not self.waiting


TestComparison = Comparison.TestCase


# --- slots by name --------------------------------------------------------------------------


def test_servers_that_give_one_name_share_a_slot():
    slots = Slots[Wish]()
    shared = slots.find(QUEUE, "arm")
    assert slots.find(Rules("queue"), "arm") is shared
    assert slots.find(QUEUE, "base") is not shared
    assert slots.find(QUEUE, None) is not slots.find(QUEUE, None)
