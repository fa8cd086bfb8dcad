"""Who may run: the goals of one action, or of several that share a place, and the rules for it.

The rules, in prose:

- ``parallel``: every goal starts. With ``max_active`` only so many run, the others wait in a queue.
- ``reject``: while one runs, a new goal is rejected.
- ``queue``: while one runs, new goals wait, first come first served.
- ``preempt``: the running goal is told to give way, and the new one waits until its clean-up has
  ended. Only one waits: a still newer one takes its place.
- A goal whose parent holds a place of the slot with another action runs in that very place, and
  the place is free again when both have ended.
- A goal that would have to wait for its own parent is rejected: a deadlock. So it is if all that
  run have sent one that waits here, and would wait for each other.

Pure: a `Slot` says what is to be done; whoever asked does it.

Source: nav2 ``SimpleActionServer`` for preempting with one pending goal.
"""

from __future__ import annotations

from enum import Enum
from typing import Generic, Literal, Protocol, TypeAlias, TypeVar, get_args
from weakref import WeakValueDictionary

import msgspec

from turtleact.errors import InvalidOption
from turtleact.goal import Goal

__all__ = ["Admission", "Claim", "Entry", "Policy", "Rules", "Slot", "Slots"]

Policy: TypeAlias = Literal["parallel", "reject", "queue", "preempt"]


class Rules(msgspec.Struct, frozen=True):
    """How goals share a place.

    Attributes:
        policy: What becomes of a new goal while another runs.
        max_active: How many may run at a time under ``parallel``, at least 1; None for any number.
        queue_limit: How many may wait, under ``queue`` or ``max_active``; None for any number.

    Raises:
        InvalidOption: if one of them is something else, or they do not go together.
    """

    policy: Policy = "parallel"
    max_active: int | None = None
    queue_limit: int | None = None

    def __post_init__(self) -> None:
        if self.policy not in get_args(Policy):
            words = ", ".join(get_args(Policy))
            raise InvalidOption("policy", f"expected one of {words}, not {self.policy!r}")
        _check_count("max_active", self.max_active, 1)
        _check_count("queue_limit", self.queue_limit, 0)
        if self.max_active is not None and self.policy != "parallel":
            raise InvalidOption("max_active", f"goes with policy 'parallel', not '{self.policy}'")
        if self.queue_limit is not None and not self.has_queue:
            raise InvalidOption("queue_limit", "goes with policy 'queue', or with max_active")

    def __str__(self) -> str:
        given = {name: getattr(self, name) for name in self.__struct_fields__}
        return ", ".join(f"{name}={value!r}" for name, value in given.items() if value is not None)

    @property
    def is_free(self) -> bool:
        """Whether goals never have to do with each other."""
        return self.policy == "parallel" and self.max_active is None

    @property
    def has_queue(self) -> bool:
        """Whether goals may wait for others to end by themselves."""
        return self.policy == "queue" or self.max_active is not None


class Claim(Protocol):
    """A goal's wish to run.

    Attributes:
        goal: The goal.
        action: The fully qualified name of its action.
    """

    goal: Goal
    action: str

    @property
    def label(self) -> str:
        """What to call the goal in a message."""


C = TypeVar("C", bound=Claim)

_Place: TypeAlias = dict[Goal, C]  # those that run in it: a goal, and its children


class Admission(Enum):
    """What a slot says to a new goal."""

    START = 1
    WAIT = 2
    REJECT = 3


class Entry(msgspec.Struct, Generic[C], frozen=True):
    """What is to be done with a new goal.

    Attributes:
        admission: Whether it starts, waits or is rejected.
        reason: Why it is rejected, or why others are ended for it.
        displaced: The goal that has waited so far and is to be ended now.
        evicted: The goals that run and are to be canceled now.
    """

    admission: Admission
    reason: str = ""
    displaced: C | None = None
    evicted: tuple[C, ...] = ()


class Slot(Generic[C]):
    """A place for goals, or several.

    Args:
        rules: How they share it.

    Attributes:
        rules: The same.
    """

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self._places: dict[Goal, _Place[C]] = {}  # of each goal that runs
        self._taken = 0
        self._waiting: dict[Goal, C] = {}

    @property
    def is_empty(self) -> bool:
        """Whether nothing runs or waits here."""
        return not (self._places or self._waiting or self._taken)

    def holds(self, goal: Goal) -> bool:
        """Whether a goal runs here, or is about to."""
        return goal in self._places

    def enter(self, claim: C) -> Entry[C]:
        """Let a new goal run, wait, or go."""
        kin = self._kin(claim.goal)
        rival = next((each for each in kin if each.action == claim.action), None)
        if kin and rival is None:
            self._settle(claim, self._places[kin[0].goal])
            return Entry(Admission.START)
        if self._has_room:
            self._taken += 1
            self._settle(claim, {})
            return Entry(Admission.START)
        if rival is not None and self._is_deadlock(claim):
            reason = f"a deadlock: it would wait for its own parent, {rival.label}"
            return Entry(Admission.REJECT, reason)
        if self.rules.policy == "preempt":
            return self._preempt(claim)
        if not self.rules.has_queue:
            holder = next(iter(next(iter(self._places.values())).values()))
            return Entry(Admission.REJECT, f"busy with {holder.label}")
        if self.rules.queue_limit is not None and len(self._waiting) >= self.rules.queue_limit:
            return Entry(Admission.REJECT, f"the queue is full, {len(self._waiting)} wait already")
        self._waiting[claim.goal] = claim
        return Entry(Admission.WAIT)

    def leave(self, goal: Goal) -> C | None:
        """Let go of a goal that has ended, running or waiting; answer the one to be started now."""
        self._waiting.pop(goal, None)
        place = self._places.pop(goal, None)
        if place is None:
            return None
        del place[goal]
        if place:  # a child of it still runs
            return None
        if not self._waiting:
            self._taken -= 1
            return None
        claim = self._waiting.pop(next(iter(self._waiting)))
        self._settle(claim, place)
        return claim

    def overdue(self) -> Entry[C] | None:
        """What holds up the goal that has preempted; None if nothing is to be done.

        To be asked whenever a goal has left: a detached child goes on when its parent gives way,
        and is to give way too.
        """
        if self.rules.policy != "preempt" or not self._waiting:
            return None
        return self._make_way(next(iter(self._waiting.values())))

    @property
    def _has_room(self) -> bool:
        if self.rules.policy == "parallel":
            return self.rules.max_active is None or self._taken < self.rules.max_active
        return not self._taken

    def _settle(self, claim: C, place: _Place[C]) -> None:
        place[claim.goal] = claim
        self._places[claim.goal] = place

    def _preempt(self, claim: C) -> Entry[C]:
        displaced = next(iter(self._waiting.values()), None)
        self._waiting = {claim.goal: claim}
        return self._make_way(claim, displaced)

    def _make_way(self, claim: C, displaced: C | None = None) -> Entry[C]:
        reason = f"preempted by {claim.label}"
        return Entry(Admission.WAIT, reason, displaced, self._families())

    def _families(self) -> tuple[C, ...]:
        """Those that run and have no parent here: a cancel flows down from them."""
        running = (place[goal] for goal, place in self._places.items())
        return tuple(claim for claim in running if not self._kin(claim.goal))

    def _is_deadlock(self, claim: C) -> bool:
        """Whether no place would come free: in each runs a parent of one that waits."""
        waiting = (claim, *self._waiting.values())
        parents = (parent.goal for each in waiting for parent in self._kin(each.goal))
        return len({id(self._places[parent]) for parent in parents}) == self._taken

    def _kin(self, goal: Goal) -> list[C]:
        """The parents of a goal that run here, the nearest first."""
        kin = []
        parent = goal.parent
        while parent is not None:
            if parent in self._places:
                kin.append(self._places[parent][parent])
            parent = parent.parent
        return kin


class Slots(Generic[C]):
    """Slots that several actions share, by name, each for as long as somebody uses it."""

    def __init__(self) -> None:
        self._named: WeakValueDictionary[str, Slot[C]] = WeakValueDictionary()

    def find(self, rules: Rules, name: str | None) -> Slot[C] | None:
        """The slot for goals under these rules; None if they need none.

        Args:
            rules: The rules.
            name: The slot's name; None for a slot that nobody shares.

        Raises:
            InvalidOption: if a shared one has other rules, or these need none.
        """
        if name is None:
            return None if rules.is_free else Slot(rules)
        if rules.is_free:
            raise InvalidOption("slot", "goes with another policy than 'parallel', or max_active")
        slot = self._named.setdefault(name, Slot(rules))
        if slot.rules != rules:
            raise InvalidOption("slot", f"'{name}' is shared under other rules: {slot.rules}")
        return slot


def _check_count(name: str, count: object, least: int) -> None:
    if count is None:
        return
    if not isinstance(count, int) or isinstance(count, bool) or count < least:
        raise InvalidOption(name, f"expected a whole number from {least}, not {count!r}")
