"""What may happen to a goal: its states, who is canceled, how long a result is kept.

The rules, in prose:

- A goal is ACCEPTED, then EXECUTING; a client's cancel makes it CANCELING; it ends SUCCEEDED,
  CANCELED or ABORTED, once. Every other step is illegal, raises, and changes nothing.
- Only a client's cancel leads to CANCELED; what the server decides by itself ends ABORTED.
- A cancel request names goals by id, by time, or by both (`select`).
- A goal that ended is kept for ``result_timeout`` seconds from its end, longer while somebody
  waits for it, and is then forgotten (`GoalTable`).

Pure: no clock, no task, no random number. Time enters as ``now`` in nanoseconds.

Source: the ROS 2 design article "Actions"; rcl_action ``goal_state_machine.c`` and
``action_server.c``; action_msgs/srv/CancelGoal.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterable, Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Protocol, TypeAlias

import msgspec

from turtleact.errors import GoalAborted, GoalCanceled, InvalidTransition, TurtleactError
from turtleact.feedback import FeedbackLog, Listener

if TYPE_CHECKING:
    from turtleact.interfaces import Message

__all__ = [
    "TRANSITIONS",
    "CancelCode",
    "CancelResponse",
    "Cancelable",
    "Goal",
    "GoalEvent",
    "GoalResponse",
    "GoalStatus",
    "GoalTable",
    "OnFeedback",
    "cancel_code",
    "failure",
    "select",
    "status_of",
    "transition",
]


class GoalStatus(IntEnum):
    """The state of a goal; the values are those of action_msgs/msg/GoalStatus."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def is_active(self) -> bool:
        """Whether the goal still has an end before it."""
        return 1 <= self <= 3  # numbers: looking the names up would take twice as long

    @property
    def is_terminal(self) -> bool:
        """Whether the goal has ended."""
        return self >= GoalStatus.SUCCEEDED


def status_of(number: int) -> GoalStatus:
    """The state of that number; UNKNOWN for one that is none."""
    try:
        return GoalStatus(number)
    except ValueError:
        return GoalStatus.UNKNOWN


class GoalEvent(IntEnum):
    """What can happen to a goal."""

    EXECUTE = 1
    CANCEL_GOAL = 2
    SUCCEED = 3
    ABORT = 4
    CANCELED = 5


class GoalResponse(IntEnum):
    """A server's answer to a goal request; the values are rclpy's."""

    REJECT = 1
    ACCEPT = 2


class CancelResponse(IntEnum):
    """A server's answer to a cancel request for one goal; the values are rclpy's."""

    REJECT = 1
    ACCEPT = 2


class CancelCode(IntEnum):
    """``return_code`` of action_msgs/srv/CancelGoal."""

    NONE = 0
    REJECTED = 1
    UNKNOWN_GOAL_ID = 2
    GOAL_TERMINATED = 3


TRANSITIONS: Final[Mapping[tuple[GoalStatus, GoalEvent], GoalStatus]] = MappingProxyType(
    {
        (GoalStatus.ACCEPTED, GoalEvent.EXECUTE): GoalStatus.EXECUTING,
        (GoalStatus.ACCEPTED, GoalEvent.CANCEL_GOAL): GoalStatus.CANCELING,
        (GoalStatus.EXECUTING, GoalEvent.CANCEL_GOAL): GoalStatus.CANCELING,
        (GoalStatus.EXECUTING, GoalEvent.SUCCEED): GoalStatus.SUCCEEDED,
        (GoalStatus.EXECUTING, GoalEvent.ABORT): GoalStatus.ABORTED,
        (GoalStatus.CANCELING, GoalEvent.SUCCEED): GoalStatus.SUCCEEDED,
        (GoalStatus.CANCELING, GoalEvent.ABORT): GoalStatus.ABORTED,
        (GoalStatus.CANCELING, GoalEvent.CANCELED): GoalStatus.CANCELED,
    }
)


#: The same by number, ``[status][event]``: members of an enum are slow keys.
_NEXT: Final = tuple(
    (None, *(TRANSITIONS.get((status, event)) for event in GoalEvent)) for status in GoalStatus
)


def transition(status: GoalStatus, event: GoalEvent) -> GoalStatus:
    """The state that ``event`` leads to from ``status``.

    Raises:
        InvalidTransition: if the event is not allowed in that state.

    >>> transition(GoalStatus.EXECUTING, GoalEvent.SUCCEED).name
    'SUCCEEDED'
    """
    try:
        return TRANSITIONS[status, event]
    except KeyError:
        raise InvalidTransition(status, event) from None


class Cancelable(Protocol):
    """Something running that can be asked to stop."""

    def cancel(self) -> object:
        """Ask it; it may still take its time."""


OnFeedback: TypeAlias = Callable[[object], object]


class Goal(msgspec.Struct, eq=False):
    """One goal, as the server holds it; a client in the same process reads the same object.

    Attributes:
        request: The goal message.
        stamp: When it was accepted (ns since the epoch).
        status: Its state. One that starts at once is made EXECUTING; then `apply` changes it.
        history: The states that it has entered since its acceptance, but for the last one, each
            with the number of feedback messages that went before.
        id: Its 16 bytes, or None as long as nobody has asked for them.
        on_feedback: The sender's callback for feedback.
        is_streamed: Whether feedback is to be kept for a reader.
        feedback: The feedback that is kept; made with the first message, or the first reader.
        last_feedback: The newest message, kept whether anybody reads or not; as long as nobody here
            can look at it, it may be the bytes that were sent.
        result: The result message once it has ended, before that the partial one.
        reason: Why it was, or is about to be, aborted.
        listener: Whom to tell of each change.
        body: What runs for it, while it can be canceled.
        ended: When it ended (ns since the epoch); 0 before.
        waiters: How many wait for its result; the table keeps it as long as there are any.
        parent: The goal whose body has sent it, if one has.
        sender: The client that has sent it.
        published: How many of its feedback messages went out to the feedback topic.
        is_asked_for: Whether a client elsewhere has asked for its result.
        error: Why nothing more will be heard of it; its state is UNKNOWN then.
    """

    request: object
    stamp: int
    status: GoalStatus = GoalStatus.ACCEPTED
    history: tuple[tuple[GoalStatus, int], ...] = ()
    id: bytes | None = None
    on_feedback: OnFeedback | None = None
    is_streamed: bool = False
    feedback: FeedbackLog | None = None
    last_feedback: Message | bytes | None = None
    result: object = None
    reason: str = ""
    listener: Listener | None = None
    body: Cancelable | None = None
    ended: int = 0
    waiters: int = 0
    parent: Goal | None = None
    sender: object = None
    published: int = 0
    is_asked_for: bool = False
    error: TurtleactError | None = None

    @property
    def hex(self) -> str:
        """The id as ROS prints it, or words that say it has none yet."""
        return self.id.hex() if self.id else "(no id)"

    def apply(self, event: GoalEvent) -> None:
        """Change the state, and tell the listener.

        Raises:
            InvalidTransition: if the event is not allowed now; nothing has changed.
        """
        status = _NEXT[self.status][event]
        if status is None:
            raise InvalidTransition(self.status, event, self.hex)
        self.status = status
        if event <= GoalEvent.CANCEL_GOAL:  # the last state is told by the status itself
            count = 0 if self.feedback is None else self.feedback.count
            self.history = (*self.history, (status, count))
        if self.listener is not None:
            self.listener.fire()


def failure(goal: Goal) -> TurtleactError:
    """What a goal that ended without success tells the one who waits for it."""
    if goal.error is not None:
        return goal.error
    kind = GoalCanceled if goal.status is GoalStatus.CANCELED else GoalAborted
    return kind(goal.reason, goal.result)


def select(goals: Iterable[Goal], goal_id: bytes | None, stamp: int) -> list[Goal]:
    """The active goals that a cancel request means, in the order of their acceptance.

    No id and no stamp mean every goal; a stamp means every goal accepted at or before it; an id
    means that goal; both mean the union.

    Args:
        goals: All that the server holds.
        goal_id: 16 bytes; None means no id.
        stamp: In ns since the epoch; zero means no stamp.

    Source: action_msgs/srv/CancelGoal.
    """
    everything = goal_id is None and not stamp
    chosen = [
        goal
        for goal in goals
        if goal.status.is_active
        and (
            everything
            or (stamp and goal.stamp <= stamp)
            or (goal_id is not None and goal.id == goal_id)
        )
    ]
    return sorted(chosen, key=_by_stamp)


def cancel_code(named: Goal | None, *, by_id: bool, asked: int, let_go: int) -> CancelCode:
    """The ``return_code`` that answers a cancel request.

    Args:
        named: The goal of the request's id, if it is held.
        by_id: Whether the request gave an id and no stamp.
        asked: How many goals `select` found.
        let_go: How many of these are being canceled now.

    Source: action_msgs/srv/CancelGoal; rcl_action ``rcl_action_process_cancel_request``.
    """
    if asked:
        return CancelCode.NONE if let_go else CancelCode.REJECTED
    if not by_id:
        return CancelCode.NONE
    return CancelCode.UNKNOWN_GOAL_ID if named is None else CancelCode.GOAL_TERMINATED


class GoalTable:
    """The goals that a server holds: all active ones, and those that ended not long ago.

    A goal whose id nobody has asked for cannot be named by anybody, so it is forgotten at its end.

    Args:
        result_timeout: How long a goal is kept after its end (s); None keeps it for ever.
    """

    def __init__(self, result_timeout: float | None = 10.0) -> None:
        self._keep_ns = None if result_timeout is None else round(result_timeout * 1e9)
        self._active: dict[Goal, None] = {}
        self._named: dict[bytes, Goal] = {}
        self._expiries: list[tuple[int, bytes]] = []
        self._pinned: set[Goal] = set()  # their time is over, but somebody waits

    @property
    def active(self) -> list[Goal]:
        """The goals that have not ended, in the order of their acceptance."""
        return list(self._active)

    def add(self, goal: Goal) -> bool:
        """Take up an accepted goal; False, and nothing done, if its id is still held."""
        if goal.id is not None:
            if goal.id in self._named:
                self.expire(goal.stamp)
            if goal.id in self._named:
                return False
            self._named[goal.id] = goal
        self._active[goal] = None
        return True

    def forget(self, goal: Goal) -> None:
        """Take back what `add` has done: the goal is not accepted after all."""
        self._active.pop(goal, None)
        if goal.id is not None:
            del self._named[goal.id]

    def name(self, goal: Goal, goal_id: bytes, now: int) -> bytes:
        """Give a goal its id, unless it has one, so that it can be found; answer the id."""
        if goal.id is None:
            goal.id = goal_id
            self._named[goal_id] = goal
            if goal.ended:
                self._schedule(goal)
                self.expire(now)
        return goal.id

    def end(self, goal: Goal, now: int) -> None:
        """Note that a goal has ended; its result is kept ``result_timeout`` from ``now``."""
        goal.ended = now
        self._active.pop(goal, None)
        if goal.id is not None:
            self._schedule(goal)
        if self._expiries:
            self.expire(now)

    def find(self, goal_id: bytes, now: int) -> Goal | None:
        """The goal of that id, or None if it was never held or has expired."""
        self.expire(now)
        return self._named.get(goal_id)

    def ids(self, now: int) -> Collection[bytes]:
        """The ids of all goals held that have one."""
        self.expire(now)
        return self._named.keys()

    def held(self, now: int) -> list[Goal]:
        """All goals held: the active ones, and those whose result is kept, by their acceptance."""
        self.expire(now)
        return sorted(dict.fromkeys([*self._named.values(), *self._active]), key=_by_stamp)

    def expire(self, now: int) -> None:
        """Forget the goals whose time is over and for which nobody waits."""
        expiries = self._expiries
        while expiries and expiries[0][0] <= now:
            goal = self._named[heapq.heappop(expiries)[1]]
            self._pinned.add(goal)
            if not goal.waiters:
                self.unpin(goal)

    def unpin(self, goal: Goal) -> None:
        """Note that nobody waits for a goal any more: it is forgotten if its time is over."""
        if goal in self._pinned and goal.id is not None:
            self._pinned.remove(goal)
            del self._named[goal.id]

    def _schedule(self, goal: Goal) -> None:
        if self._keep_ns is not None and goal.id is not None:
            heapq.heappush(self._expiries, (goal.ended + self._keep_ns, goal.id))


def _by_stamp(goal: Goal) -> int:
    return goal.stamp
