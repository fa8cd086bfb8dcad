"""The rules for goals: states, transitions, cancel requests, and how long results are kept.

- A goal is ACCEPTED, then EXECUTING. A client's cancel request makes the goal CANCELING. A goal
  ends once, as SUCCEEDED, CANCELED or ABORTED. Any other transition raises an error and changes
  nothing.
- A goal becomes CANCELED only after a client's cancel request. If a goal's body is cancelled for
  another reason, the goal becomes ABORTED.
- A cancel request names goals by id, by time, or by both (`select`).
- A goal that has ended is kept for ``result_timeout`` seconds. Then the goal is forgotten
  (`GoalTable`).

This module uses no clock, task or random number. The current time is passed in as ``now``, in
nanoseconds.

Source: the ROS 2 design article "Actions"; rcl_action ``goal_state_machine.c`` and
``action_server.c``; action_msgs/srv/CancelGoal.
"""

from __future__ import annotations

from bisect import insort
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextvars import ContextVar
from enum import IntEnum
from types import MappingProxyType
from typing import Any, Final, Protocol, TypeAlias

import msgspec

from turtleact.errors import GoalAborted, GoalCanceled, InvalidTransition, TurtleactError

__all__ = [
    "CURRENT_GOAL",
    "TRANSITIONS",
    "CancelCode",
    "CancelResponse",
    "Cancelable",
    "FeedbackLog",
    "Goal",
    "GoalEvent",
    "GoalRequest",
    "GoalResponse",
    "GoalStatus",
    "GoalTable",
    "OnFeedback",
    "Signal",
    "cancel_code",
    "failure",
    "select",
    "status_of",
]


class Signal(Protocol):
    """What this module needs of a `turtleact.tasks.Signal`."""

    def fire(self) -> None:
        """Wake every task that is waiting."""

    async def wait(self) -> None:
        """Wait until the signal fires the next time."""


class FeedbackLog:
    """The feedback messages of one goal, numbered from 0.

    Each reader remembers the number of the message that it reads next. Once the client that sent
    the goal has begun to read, it misses no message: unread messages are kept, and the goal's body
    waits if the client is far behind. Other readers get the messages that are still kept.

    Args:
        on_feedback: The sender's callback for feedback.
        is_kept: Whether to keep the messages, because a client may read them later.

    Attributes:
        on_feedback: The sender's callback for feedback, as passed to the constructor.
        is_kept: Whether messages are kept from now on.
        last: The newest message, which is always kept; None before the first.
        count: How many messages have been added, dropped ones included.
        history: The goal's states since its acceptance, without the final one. Each state comes
            with the number of feedback messages published before it.
        items: The messages still kept, oldest first.
        read: The number of the message that the goal's sender reads next; None while the sender
            does not read feedback.
        drained: The signal to fire when a waiting body may continue; None if no body waits.
        hurried: How many callers wait for the goal's end. While any caller waits for the end, the
            goal's body does not wait for readers.
    """

    KEPT: Final = 1024
    """How many of the newest messages are kept, even if nobody reads them."""

    BUDGET: Final = 1 << 20
    """How much feedback may be unread before the body waits (bytes, in a compact encoding)."""

    __slots__ = (
        "_weighed",
        "_weight",
        "count",
        "drained",
        "history",
        "hurried",
        "is_kept",
        "items",
        "last",
        "on_feedback",
        "read",
    )

    def __init__(
        self, on_feedback: Callable[[Any], object] | None = None, *, is_kept: bool = False
    ) -> None:
        self.on_feedback = on_feedback
        self.is_kept = is_kept
        self.last: Any = None
        self.count = 0
        self.history: tuple[tuple[Any, int], ...] = ()
        self.items: list[Any] = []
        self.read: int | None = None
        self.drained: Signal | None = None
        self.hurried = 0
        self._weighed = 0
        self._weight = 0

    @property
    def dropped(self) -> int:
        """The number of the message ``items[0]``: how many older messages are not kept."""
        return self.count - len(self.items)

    @property
    def is_full(self) -> bool:
        """Whether the goal's sender has so much unread feedback that the goal's body must wait."""
        if self.read is None or self.hurried:
            return False
        unread = self.count - self.read
        return unread >= self.KEPT or unread * self._weight >= self.BUDGET

    def relieve(self) -> None:
        """Let a waiting body continue, unless the log is full."""
        if self.drained is not None and not self.is_full:
            self.drained.fire()

    def append(self, message: object) -> None:
        """Add the newest message."""
        self.last = message
        self.count += 1
        if self.is_kept:
            self.items.append(message)
            if len(self.items) >= 2 * self.KEPT:
                self.trim()

    def weigh(self) -> None:
        """Update the estimated size of a message by measuring one of the newest messages.

        Measuring every message would take too long, so each call measures a different one of the
        newest. After a large message, the estimate falls slowly, because a body may alternate large
        and small messages.
        """
        if self.items:
            self._weighed += 1
            message = self.items[-1 - self._weighed % min(len(self.items), _NEWEST)]
            self._weight = max(len(_ENCODER.encode(message)), self._weight * 15 // 16)

    def trim(self) -> None:
        """Drop messages that need not be kept. If there are few (see `_NEEDLESS`), drop none."""
        needless = len(self.items) - self.KEPT
        if self.read is not None:
            needless = min(needless, self.read - self.dropped)
        if needless * _NEEDLESS >= len(self.items):
            del self.items[:needless]


_ENCODER = msgspec.msgpack.Encoder()

_NEWEST: Final = 16
"""Successive calls of `weigh` measure different messages among this many newest messages."""

_NEEDLESS: Final = 64
"""`trim` drops messages only if it can drop at least 1/64 of the kept messages."""


class GoalStatus(IntEnum):
    """The state of a goal. The values are those of action_msgs/msg/GoalStatus."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def is_active(self) -> bool:
        """Whether the goal has not ended yet."""
        return 1 <= self <= 3  # looking up the members' names would take twice as long

    @property
    def is_terminal(self) -> bool:
        """Whether the goal has ended."""
        return self >= 4


def status_of(number: int) -> GoalStatus:
    """Return the state with that number, or UNKNOWN if there is none."""
    return GoalStatus(number) if 0 <= number <= 6 else GoalStatus.UNKNOWN


class GoalEvent(IntEnum):
    """An event that changes the state of a goal."""

    EXECUTE = 1
    CANCEL_GOAL = 2
    SUCCEED = 3
    ABORT = 4
    CANCELED = 5


class GoalResponse(IntEnum):
    """A server's answer to a goal request. The values are those of rclpy."""

    REJECT = 1
    ACCEPT = 2


class CancelResponse(IntEnum):
    """A server's answer to a cancel request for one goal. The values are those of rclpy."""

    REJECT = 1
    ACCEPT = 2


class CancelCode(IntEnum):
    """The values of ``return_code`` in action_msgs/srv/CancelGoal."""

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


_CANCEL_GOAL: Final = GoalEvent.CANCEL_GOAL


class Cancelable(Protocol):
    """A running body that can be asked to stop."""

    def cancel(self) -> object:
        """Ask the body to stop. The body may take a while to stop."""


OnFeedback: TypeAlias = Callable[[object], object]


class GoalRequest(msgspec.Struct, eq=False):
    """A goal that a client wants to send.

    Attributes:
        message: The goal message.
        sender: An object that stands for the client. If the client goes away, the server uses this
            object to find the client's goals.
        goal_id: The 16 bytes of an id that the client, the user or an observer chose; None to let
            the server choose one.
        on_feedback: The user's callback for feedback.
        reattach: How long to wait for a server, both at first and after the server has gone away
            (s, event loop time).
    """

    message: object
    sender: object
    goal_id: bytes | None = None
    on_feedback: OnFeedback | None = None
    reattach: float = 0.0


class Goal(msgspec.Struct, eq=False):
    """One goal, as its server keeps it. A client in the same process uses the same object.

    Attributes:
        id: The 16 bytes of the goal's id.
        request: The goal message; None if somebody else sent the goal to another process.
        changed: The signal that fires at each change of the goal.
        stamp: When the server accepted the goal (ns since the epoch).
        status: The goal's state. Only `apply` changes it.
        log: The goal's feedback, and the states that it had.
        parent: The goal whose body sent this goal, if any.
        sender: The client that sent the goal.
        result: The partial result until the goal ends, then the result.
        reason: Why the goal was aborted, or will be aborted soon.
        body: What runs the goal's body; None when there is nothing that can be canceled.
        ended: When the goal ended (ns since the epoch); 0 before.
        is_ending: Whether the goal's end has been decided. The goal may end a little later, for
            example when a journal has stored the end.
        error: The exception that explains why the client lost contact with the goal, or None. If
            contact was lost, the goal's state is UNKNOWN.
    """

    id: bytes
    request: object
    changed: Signal
    stamp: int = 0
    status: GoalStatus = GoalStatus.ACCEPTED
    log: FeedbackLog = msgspec.field(default_factory=FeedbackLog)
    parent: Goal | None = None
    sender: object = None
    result: object = None
    reason: str = ""
    body: Cancelable | None = None
    ended: int = 0
    is_ending: bool = False
    error: TurtleactError | None = None

    @property
    def hex(self) -> str:
        """The id in hexadecimal, as ROS prints it."""
        return self.id.hex()

    def apply(self, event: GoalEvent) -> None:
        """Change the state and fire the signal.

        Raises:
            InvalidTransition: if the state does not allow the event. In that case, the state does
                not change.
        """
        status = TRANSITIONS.get((self.status, event))
        if status is None:
            raise InvalidTransition(self.status, event, self.hex)
        self.status = status
        if event <= _CANCEL_GOAL:  # the history leaves out final states
            self.log.history += ((status, self.log.count),)
        self.changed.fire()

    async def wait_for_end(self) -> None:
        """Wait until the goal has ended. Cancelling: safe, the goal continues."""
        while not self.ended:
            await self.changed.wait()


def failure(goal: Goal) -> TurtleactError:
    """Return the exception for callers that wait for a goal that was canceled, aborted or lost."""
    if goal.error is not None:
        return goal.error
    kind = GoalCanceled if goal.status is GoalStatus.CANCELED else GoalAborted
    return kind(goal.reason, goal.result)


def select(goals: Iterable[Goal], goal_id: bytes | None, stamp: int) -> list[Goal]:
    """Return the active goals that a cancel request selects, in the order of acceptance.

    A request without id and stamp selects every goal. A request with only a stamp selects every
    goal accepted at or before the stamp. A request with only an id selects the goal with this id. A
    request with an id and a stamp selects the goal with this id, and every goal accepted at or
    before the stamp.

    Args:
        goals: All goals that the server holds.
        goal_id: The id in the request (16 bytes), or None if the request has no id.
        stamp: The stamp in the request (ns since the epoch), or zero if the request has no stamp.

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
    """Return the ``return_code`` that answers a cancel request.

    Args:
        named: The goal with the requested id, if the server holds it.
        by_id: Whether the request had an id but no stamp.
        asked: How many goals `select` has returned for the request.
        let_go: How many of the goals from `select` are being canceled now.

    Source: action_msgs/srv/CancelGoal; rcl_action ``rcl_action_process_cancel_request``.
    """
    if asked:
        return CancelCode.NONE if let_go else CancelCode.REJECTED
    if not by_id:
        return CancelCode.NONE
    return CancelCode.UNKNOWN_GOAL_ID if named is None else CancelCode.GOAL_TERMINATED


CURRENT_GOAL: ContextVar[Goal | None] = ContextVar("CURRENT_GOAL", default=None)
"""The goal whose body is running. It becomes the parent of the goals that the body sends."""


class GoalTable:
    """The goals that a server holds: all active ones and those that ended recently.

    Args:
        result_timeout: How long to keep a goal after its end (s); None to keep it for ever.

    Attributes:
        keep_ns: How long a goal is kept after its end (ns); None for ever.
    """

    KEPT: Final = 1 << 14
    """With a ``result_timeout``, the most ended goals that are kept. Virtual time may stand still,
    so the timeout alone would not limit them."""

    def __init__(self, result_timeout: float | None = 10.0) -> None:
        self.keep_ns = None if result_timeout is None else round(result_timeout * 1e9)
        self._goals: dict[bytes, Goal] = {}  # in the order of acceptance
        self._active: dict[Goal, None] = {}
        self._ended: deque[Goal] = deque()  # in the order of their ends

    @property
    def active(self) -> list[Goal]:
        """The goals that have not ended, in the order of their acceptance."""
        return list(self._active)

    @property
    def is_idle(self) -> bool:
        """Whether all goals have ended."""
        return not self._active

    def add(self, goal: Goal) -> bool:
        """Add an accepted goal. If its id is taken, do nothing and return False."""
        if goal.id in self._goals:
            self.expire(goal.stamp)
            if goal.id in self._goals:
                return False
        self._goals[goal.id] = goal
        self._active[goal] = None
        return True

    def forget(self, goal: Goal) -> None:
        """Undo `add` for a goal that was not accepted after all."""
        del self._active[goal], self._goals[goal.id]

    def end(self, goal: Goal, now: int) -> None:
        """Record that a goal has ended.

        The goal's result is kept for ``result_timeout`` seconds after ``now``.
        """
        goal.ended = now
        self._active.pop(goal, None)
        if self.keep_ns is not None:
            self._ended.append(goal)
            self.expire(now)

    def find(self, goal_id: bytes, now: int) -> Goal | None:
        """Return the goal with that id, or None if it never existed or has expired."""
        self.expire(now)
        return self._goals.get(goal_id)

    def held(self, now: int) -> Mapping[bytes, Goal]:
        """All goals in the table by id, active or ended, in the order of their acceptance."""
        self.expire(now)
        return self._goals

    def next_expiry(self) -> int | None:
        """When the next goal expires (ns since the epoch); None if no goal has to expire."""
        if self.keep_ns is None or not self._ended:
            return None
        return self._ended[0].ended + self.keep_ns

    def expire(self, now: int) -> None:
        """Forget the goals that have expired."""
        ended, keep_ns = self._ended, self.keep_ns
        if keep_ns is None:
            return
        while ended and (ended[0].ended + keep_ns <= now or len(ended) > self.KEPT):
            del self._goals[ended.popleft().id]

    def hold_ended(self, goal: Goal) -> None:
        """Add a goal that ended in an earlier process. It expires like any other goal."""
        self._goals[goal.id] = goal
        insort(self._ended, goal, key=_by_end)


def _by_stamp(goal: Goal) -> int:
    return goal.stamp


def _by_end(goal: Goal) -> int:
    return goal.ended
