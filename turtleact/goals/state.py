"""The rules for goals: states, transitions, cancel requests, and how long results are kept.

- A goal is ACCEPTED, then EXECUTING. A client's cancel request makes the goal CANCELING. A goal
  ends once, as SUCCEEDED, CANCELED or ABORTED. Any other transition raises an error and changes
  nothing.
- A goal becomes CANCELED only after a client's cancel request. If a goal's body is cancelled for
  another reason, the goal becomes ABORTED.
- A cancel request names goals by id, by time, or by both (`select`).
- A goal that has ended is kept for ``result_timeout`` seconds, and longer while a caller waits for
  its result. Then the goal is forgotten (`GoalTable`).

This module uses no clock, task or random number. The current time is passed in as ``now``, in
nanoseconds.

Source: the ROS 2 design article "Actions"; rcl_action ``goal_state_machine.c`` and
``action_server.c``; action_msgs/srv/CancelGoal.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterable, Mapping
from contextvars import ContextVar
from enum import IntEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeAlias

import msgspec

from turtleact.errors import GoalAborted, GoalCanceled, InvalidTransition, TurtleactError
from turtleact.goals.feedback import FeedbackLog, Listener

if TYPE_CHECKING:
    from turtleact.interfaces import Message

__all__ = [
    "CURRENT_GOAL",
    "TRANSITIONS",
    "CancelCode",
    "CancelResponse",
    "Cancelable",
    "Goal",
    "GoalEvent",
    "GoalOrder",
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
    return _BY_NUMBER.get(number, GoalStatus.UNKNOWN)


_BY_NUMBER: Final = {int(status): status for status in GoalStatus}


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

#: The same table by number, ``[status][event]``: enum members are slow as dictionary keys.
_NEXT: Final = tuple(
    (None, *(TRANSITIONS.get((status, event)) for event in GoalEvent)) for status in GoalStatus
)


def transition(status: GoalStatus, event: GoalEvent) -> GoalStatus:
    """Return the state that ``event`` leads to from ``status``.

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
    """A running body that can be asked to stop."""

    def cancel(self) -> object:
        """Ask the body to stop. The body may take a while to stop."""


OnFeedback: TypeAlias = Callable[[object], object]


class GoalOrder(msgspec.Struct, eq=False):
    """A goal that a client wants to send.

    Attributes:
        request: The goal message.
        sender: An object that stands for the client. If the client goes away, the server uses this
            object to find the client's goals.
        cancel_timeout: How long a cancelled caller waits for the goal to end (s, event loop time).
        goal_id: The 16 bytes of an id that the user or an observer chose; None to let the server or
            client choose one.
        on_feedback: The user's callback for feedback.
        reattach: How long to wait for a server, both at first and after the server has gone away
            (s, event loop time).
    """

    request: object
    sender: object
    cancel_timeout: float
    goal_id: bytes | None = None
    on_feedback: OnFeedback | None = None
    reattach: float = 0.0


class Goal(msgspec.Struct, eq=False):
    """One goal, as its server keeps it. A client in the same process uses the same object.

    Attributes:
        request: The goal message.
        stamp: When the server accepted the goal (ns since the epoch).
        status: The goal's state. Only `apply` changes it.
        history: The goal's states since its acceptance, without the final one. Each state comes
            with the number of feedback messages published before it.
        id: The 16 bytes of the goal's id; None until the id is first needed.
        on_feedback: The sender's callback for feedback.
        is_streamed: Whether the goal's feedback must be kept, because a client may read it later.
        parent: The goal whose body sent this goal, if any.
        sender: The client that sent the goal.
        feedback: The feedback messages that are kept for readers. None until a message is kept or a
            reader starts.
        last_feedback: The newest feedback message, which is always kept.
        result: The partial result until the goal ends, then the result.
        reason: Why the goal was aborted, or will be aborted soon.
        listener: The object whose ``fire`` method wakes the tasks that wait for a change of the
            goal.
        end_callbacks: Functions to call when the goal has ended, after observers have been
            called. These functions must not raise exceptions.
        body: The running body; None when there is no body that can be canceled.
        ended: When the goal ended (ns since the epoch); 0 before.
        is_decided: Whether the goal's end has been decided. With a journal, the goal ends a little
            later, when the journal has stored the end.
        resumed: The goal's progress in an earlier process, a `Resumed`; None if the goal began in
            this process.
        is_paused: Whether the goal is paused: the goal's body waits until the goal is resumed.
        is_paused_by_parent: Whether the goal is paused only because its parent is paused.
        hold: The object that asks the goal's body to pause; see `turtleact.goals.pausing`.
        paused_ns: The total length of the goal's earlier pauses (ns), by the server's clock.
        children: The active goals that this goal's body has sent, each with an object that can
            pause it.
        waiters: How many callers wait for the goal's result. While any caller waits, the server
            does not forget the ended goal.
        published: How many feedback messages of the goal were published on the feedback topic.
        is_asked_for: Whether a client in another process has asked for the goal's result.
        error: The exception that explains why the client lost contact with the goal, or None. If
            contact was lost, the goal's state is UNKNOWN.
        runner: The object that runs the goal's body; None before the body begins.
    """

    request: object
    stamp: int
    status: GoalStatus = GoalStatus.ACCEPTED
    history: tuple[tuple[GoalStatus, int], ...] = ()
    id: bytes | None = None
    on_feedback: OnFeedback | None = None
    is_streamed: bool = False
    parent: Goal | None = None
    sender: object = None
    feedback: FeedbackLog | None = None
    last_feedback: Message | None = None
    result: object = None
    reason: str = ""
    listener: Listener | None = None
    end_callbacks: tuple[Callable[[], object], ...] = ()
    body: Cancelable | None = None
    ended: int = 0
    is_decided: bool = False
    resumed: object = None
    is_paused: bool = False
    is_paused_by_parent: bool = False
    hold: object = None
    paused_ns: int = 0
    children: dict[Goal, Any] | None = None
    waiters: int = 0
    published: int = 0
    is_asked_for: bool = False
    error: TurtleactError | None = None
    runner: object = None

    @property
    def hex(self) -> str:
        """The id in hexadecimal, as ROS prints it; empty while the goal has no id."""
        return self.id.hex() if self.id else ""

    @property
    def suffix(self) -> str:
        """The end of a log line: the goal's id in parentheses; empty while the goal has no id."""
        return f" (goal {self.hex})" if self.id else ""

    def enter_parent(self, parent: Goal, pauses: object) -> None:
        """Become a child of the parent goal; ``pauses`` is the object that can pause this goal."""
        if parent.children is None:
            parent.children = {}
        parent.children[self] = pauses

    def leave_parent(self) -> None:
        """Remove this goal from its parent's children, so that the parent can forget it."""
        if self.parent is not None and self.parent.children is not None:
            self.parent.children.pop(self, None)
        self.parent = None

    def apply(self, event: GoalEvent) -> None:
        """Change the state and fire the listener.

        Raises:
            InvalidTransition: if the state does not allow the event. In that case, the state does
                not change.
        """
        status = _NEXT[self.status][event]
        if status is None:
            raise InvalidTransition(self.status, event, self.hex)
        self.status = status
        if event <= _CANCEL_GOAL:  # the history leaves out final states
            count = 0 if self.feedback is None else self.feedback.count
            self.history = (*self.history, (status, count))
        if self.listener is not None:
            self.listener.fire()


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

    A goal without an id is forgotten as soon as it ends, because no client can ask for its result.

    Args:
        result_timeout: How long to keep a goal after its end (s); None to keep it for ever.
    """

    def __init__(self, result_timeout: float | None = 10.0) -> None:
        self._keep_ns = None if result_timeout is None else round(result_timeout * 1e9)
        self._active: dict[Goal, None] = {}
        self._named: dict[bytes, Goal] = {}
        self._expiries: list[tuple[int, bytes]] = []
        self._pinned: set[Goal] = set()  # expired, but kept while somebody waits for them

    @property
    def active(self) -> list[Goal]:
        """The goals that have not ended, in the order of their acceptance."""
        return list(self._active)

    def add(self, goal: Goal) -> bool:
        """Add an accepted goal. If its id is taken, do nothing and return False."""
        if goal.id is not None:
            if goal.id in self._named:
                self.expire(goal.stamp)
            if goal.id in self._named:
                return False
            self._named[goal.id] = goal
        self._active[goal] = None
        return True

    def forget(self, goal: Goal) -> None:
        """Undo `add` for a goal that was not accepted after all."""
        self._active.pop(goal, None)
        if goal.id is not None:
            del self._named[goal.id]

    def name(self, goal: Goal, goal_id: bytes, now: int) -> bytes:
        """Give a goal this id, unless the goal has an id already, and return the goal's id."""
        if goal.id is None:
            goal.id = goal_id
            self._named[goal_id] = goal
            if goal.ended:
                self._schedule(goal)
                self.expire(now)
        return goal.id

    def end(self, goal: Goal, now: int) -> None:
        """Record that a goal has ended.

        The goal's result is kept for ``result_timeout`` seconds after ``now``.
        """
        goal.ended = now
        self._active.pop(goal, None)
        if goal.id is not None:
            self._schedule(goal)
        if self._expiries:
            self.expire(now)

    def find(self, goal_id: bytes, now: int) -> Goal | None:
        """Return the goal with that id, or None if it never existed or has expired."""
        self.expire(now)
        return self._named.get(goal_id)

    def ids(self, now: int) -> Collection[bytes]:
        """The ids of all goals in the table. Goals without an id are left out."""
        self.expire(now)
        return self._named.keys()

    def held(self, now: int) -> list[Goal]:
        """All goals in the table, active or ended, in the order of their acceptance."""
        self.expire(now)
        return sorted(dict.fromkeys([*self._named.values(), *self._active]), key=_by_stamp)

    def expire(self, now: int) -> None:
        """Forget the goals that have expired, except those whose results somebody waits for."""
        expiries = self._expiries
        while expiries and expiries[0][0] <= now:
            goal = self._named[heapq.heappop(expiries)[1]]
            self._pinned.add(goal)
            if not goal.waiters:
                self.unpin(goal)

    def hold_ended(self, goal: Goal) -> None:
        """Add a goal that ended in an earlier process. It expires like any other goal."""
        if goal.id is not None:
            self._named[goal.id] = goal
            self._schedule(goal)

    def unpin(self, goal: Goal) -> None:
        """Forget a goal if it has expired. Call this when nobody waits for the goal's result."""
        if goal in self._pinned and goal.id is not None:
            self._pinned.remove(goal)
            del self._named[goal.id]

    def _schedule(self, goal: Goal) -> None:
        if self._keep_ns is not None and goal.id is not None:
            heapq.heappush(self._expiries, (goal.ended + self._keep_ns, goal.id))


def _by_stamp(goal: Goal) -> int:
    return goal.stamp
