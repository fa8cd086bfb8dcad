"""Policies: decide which goals may run at the same time, and what happens to the others.

A `Slot` has one or more places, and a goal needs a place to run. Several actions can share one
slot. Each slot follows one of these policies:

- ``parallel``: every goal starts at once. With ``max_active``, at most that many goals run at a
  time, and the others wait in a queue.
- ``reject``: while a goal runs, a new goal is rejected.
- ``queue``: while a goal runs, new goals wait in a queue. They start in the order in which they
  came.
- ``preempt``: a new goal cancels the running goal, and waits until that goal's clean-up has ended.
  At most one goal waits at a time. A new goal replaces the waiting goal.

If the body of one goal sends another goal, the first goal is the parent, and the second is its
child. Two more rules concern children:

- If the parent belongs to another action and runs in the same slot, the child starts at once and
  shares the parent's place. The place becomes free when both goals have ended.
- If a child would have to wait for the end of its own parent, the child is rejected, because each
  of the two would wait for the other.
- If the child would have to wait and would thereby block the slot, the child is rejected. A slot is
  blocked if every place holds an ancestor of a waiting goal, because no place can become free.

A `Slot` only decides what happens to goals. Its caller starts, cancels and rejects the goals.

Source: nav2 ``SimpleActionServer`` for preempting with one pending goal.
"""

from __future__ import annotations

from enum import Enum
from typing import Generic, Literal, Protocol, TypeAlias, TypeVar, get_args
from weakref import WeakValueDictionary

import msgspec

from turtleact.errors import InvalidOption
from turtleact.goals.state import Goal

__all__ = ["Decision", "Policy", "Request", "Rules", "Slot", "Slots", "Verdict"]

Policy: TypeAlias = Literal["parallel", "reject", "queue", "preempt"]


class Rules(msgspec.Struct, frozen=True):
    """How goals share a slot.

    Attributes:
        policy: What happens to a new goal while another runs.
        max_active: How many goals may run at a time under ``parallel``, at least 1; None for no
            limit.
        queue_limit: How many goals may wait, under ``queue`` or with ``max_active``; None for no
            limit.

    Raises:
        InvalidOption: if an option has a wrong value or does not fit the policy.
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
            raise InvalidOption("max_active", f"only fits policy 'parallel', not '{self.policy}'")
        if self.queue_limit is not None and not self.has_queue:
            raise InvalidOption("queue_limit", "only fits policy 'queue', or max_active")

    def __str__(self) -> str:
        given = {name: getattr(self, name) for name in self.__struct_fields__}
        return ", ".join(f"{name}={value!r}" for name, value in given.items() if value is not None)

    @property
    def is_free(self) -> bool:
        """Whether every goal may start at once, no matter which other goals run."""
        return self.policy == "parallel" and self.max_active is None

    @property
    def has_queue(self) -> bool:
        """Whether new goals may wait in a queue until running goals end."""
        return self.policy == "queue" or self.max_active is not None


class Request(Protocol):
    """A goal that asks to run in a slot.

    Attributes:
        goal: The goal.
        action: The fully qualified name of the goal's action.
    """

    goal: Goal
    action: str

    @property
    def label(self) -> str:
        """The goal's name in error messages and reasons."""


C = TypeVar("C", bound=Request)

_Place: TypeAlias = dict[Goal, C]  # the goals that run in one place: a goal and its children


class Decision(Enum):
    """A slot's answer to a new goal."""

    START = 1
    WAIT = 2
    REJECT = 3


class Verdict(msgspec.Struct, Generic[C], frozen=True):
    """The answer to a new goal: what the server must do with the goal and with other goals.

    Attributes:
        decision: Whether the goal starts, waits or is rejected.
        reason: Why the new goal is rejected, or why other goals must end.
        evicted: The goals that must make way: first the waiting goal that the new goal replaces,
            then the running goals.
    """

    decision: Decision
    reason: str = ""
    evicted: tuple[C, ...] = ()


class Slot(Generic[C]):
    """Decides which goals of one or several actions may run at the same time.

    Args:
        rules: How goals share the slot.

    Attributes:
        rules: How goals share the slot, as passed to the constructor.
    """

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self._places: dict[Goal, _Place[C]] = {}  # the place of each running goal
        self._taken = 0
        self._waiting: dict[Goal, C] = {}

    @property
    def is_empty(self) -> bool:
        """Whether no goal runs or waits in this slot."""
        return not (self._places or self._waiting or self._taken)

    def holds(self, goal: Goal) -> bool:
        """Whether this goal runs in the slot, or is about to start in it."""
        return goal in self._places

    def enter(self, request: C) -> Verdict[C]:
        """Decide whether a new goal starts, waits or is rejected."""
        kin = self._kin(request.goal)
        rival = next((each for each in kin if each.action == request.action), None)
        if kin and rival is None:
            self._settle(request, self._places[kin[0].goal])
            return Verdict(Decision.START)
        if self._has_room:
            self._taken += 1
            self._settle(request, {})
            return Verdict(Decision.START)
        if rival is not None and self._is_deadlock(request):
            reason = f"a deadlock: it would wait for its own parent, {rival.label}"
            return Verdict(Decision.REJECT, reason)
        if self.rules.policy == "preempt":
            return self._preempt(request)
        if not self.rules.has_queue:
            holder = next(iter(next(iter(self._places.values())).values()))
            return Verdict(Decision.REJECT, f"busy with {holder.label}")
        if self.rules.queue_limit is not None and len(self._waiting) >= self.rules.queue_limit:
            return Verdict(Decision.REJECT, f"the queue is full ({len(self._waiting)} waiting)")
        self._waiting[request.goal] = request
        return Verdict(Decision.WAIT)

    def leave(self, goal: Goal) -> C | None:
        """Remove a goal that has ended; return the waiting goal that must start now, if any."""
        self._waiting.pop(goal, None)
        place = self._places.pop(goal, None)
        if place is None:
            return None
        del place[goal]
        if place:  # its parent or a child still runs
            return None
        if not self._waiting:
            self._taken -= 1
            return None
        request = self._waiting.pop(next(iter(self._waiting)))
        self._settle(request, place)
        return request

    def overdue(self) -> Verdict[C] | None:
        """Return the running goals to cancel so that the waiting goal can start.

        Return None if no goal waits, or if the policy is not ``preempt``. Call this method after
        each `leave`. A goal that has ended may have detached a child. If this child still runs, the
        child must be canceled now.
        """
        if self.rules.policy != "preempt" or not self._waiting:
            return None
        return self._make_way(next(iter(self._waiting.values())))

    @property
    def _has_room(self) -> bool:
        if self.rules.policy == "parallel":
            return self.rules.max_active is None or self._taken < self.rules.max_active
        return not self._taken

    def _settle(self, request: C, place: _Place[C]) -> None:
        place[request.goal] = request
        self._places[request.goal] = place

    def _preempt(self, request: C) -> Verdict[C]:
        displaced = tuple(self._waiting.values())
        self._waiting = {request.goal: request}
        return self._make_way(request, displaced)

    def _make_way(self, request: C, displaced: tuple[C, ...] = ()) -> Verdict[C]:
        reason = f"preempted by {request.label}"
        return Verdict(Decision.WAIT, reason, displaced + self._families())

    def _families(self) -> tuple[C, ...]:
        """Return the running goals that have no parent in this slot.

        Canceling these goals also cancels their children.
        """
        running = (place[goal] for goal, place in self._places.items())
        return tuple(request for request in running if not self._kin(request.goal))

    def _is_deadlock(self, request: C) -> bool:
        """Whether the slot would be blocked if this goal waited.

        In a blocked slot, each place is taken by a parent (or grandparent, and so on) of a waiting
        goal. No place can become free, because the waiting goals and their parents wait for each
        other.
        """
        waiting = (request, *self._waiting.values())
        parents = (parent.goal for each in waiting for parent in self._kin(each.goal))
        return len({id(self._places[parent]) for parent in parents}) == self._taken

    def _kin(self, goal: Goal) -> list[C]:
        """Return the goal's ancestors that run in this slot, from its parent upwards."""
        kin = []
        parent = goal.parent
        while parent is not None:
            if parent in self._places:
                kin.append(self._places[parent][parent])
            parent = parent.parent
        return kin


class Slots(Generic[C]):
    """Finds the slot with a given name, so that several actions can share the slot.

    A slot exists as long as an action uses the slot.
    """

    def __init__(self) -> None:
        self._named: WeakValueDictionary[str, Slot[C]] = WeakValueDictionary()

    def find(self, rules: Rules, name: str | None) -> Slot[C] | None:
        """Return a slot with these rules; None if the rules let every goal start at once.

        Args:
            rules: How the goals share the slot.
            name: The name of a slot that several actions share; None for a new slot that is not
                shared.

        Raises:
            InvalidOption: if the slot of this name has other rules, or if a name is given but the
                rules need no slot.
        """
        if name is None:
            return None if rules.is_free else Slot(rules)
        if rules.is_free:
            raise InvalidOption("slot", "needs a policy other than 'parallel', or max_active")
        slot = self._named.setdefault(name, Slot(rules))
        if slot.rules != rules:
            raise InvalidOption("slot", f"'{name}' is already used with other rules: {slot.rules}")
        return slot


def _check_count(name: str, count: object, least: int) -> None:
    if count is None:
        return
    if not isinstance(count, int) or isinstance(count, bool) or count < least:
        raise InvalidOption(name, f"expected a whole number from {least}, not {count!r}")
