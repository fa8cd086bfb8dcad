"""Lets the goals of a server wait for a place in a slot.

`turtleact.goals.policies` decides which goals may run. This module starts, cancels and rejects the
goals as the slot decides.
"""

from __future__ import annotations

from contextvars import Context, copy_context

from turtleact.errors import GoalRejected
from turtleact.goals.policies import Decision, Slot
from turtleact.goals.server import LocalActionServer
from turtleact.goals.state import Goal, GoalEvent, GoalStatus

__all__ = ["PlaceRequest", "SlotUser"]


class PlaceRequest:
    """A goal's request for a place in a slot. The server cancels a waiting goal with `cancel`.

    Attributes:
        goal: The goal.
        action: The fully qualified name of the goal's action.
        context: The sender's context, in which the body will run.
    """

    __slots__ = ("_user", "action", "context", "goal")

    def __init__(self, user: SlotUser, goal: Goal) -> None:
        self._user = user
        self.goal = goal
        self.action = user.server.name
        self.context: Context = copy_context()

    @property
    def label(self) -> str:
        """The goal's name, as in "busy with <name>"."""
        return f"goal {self.goal.hex} of {self.action}"

    def start(self) -> None:
        """Start the goal when its turn has come, unless the goal has ended meanwhile."""
        self._user.start(self)

    def cancel(self) -> None:
        """End the goal, which has not yet got a place in the slot."""
        self._user.drop(self.goal)

    def evict(self, reason: str) -> None:
        """Cancel the goal for ``reason``: end it if it still waits, otherwise cancel its body."""
        self._user.server.evict(self.goal, reason)


class SlotUser:
    """Gives the goals of one server places in a slot.

    Args:
        server: The server.
        slot: The slot, which several servers may share.

    Attributes:
        server: The server, as passed to the constructor.
    """

    def __init__(self, server: LocalActionServer, slot: Slot[PlaceRequest]) -> None:
        self.server = server
        self._slot = server.slot = slot
        self._begin, server.begin = server.begin, self.begin
        self._retire, server.retire = server.retire, self.retire
        self._is_closed = False
        self._aclose, server.aclose = server.aclose, self.aclose

    def begin(self, goal: Goal) -> None:
        """Request a place for a goal: the goal starts, waits or is rejected."""
        request = PlaceRequest(self, goal)
        verdict = self._slot.enter(request)
        if verdict.decision is Decision.REJECT:
            self.server.table.forget(goal)
            raise GoalRejected(verdict.reason)
        if verdict.decision is Decision.START:
            self._begin(goal)
            return
        goal.body = request
        self.server.show(goal)
        if goal.is_ending:  # an observer has cancelled it
            return
        for each in (verdict.displaced, *verdict.evicted):
            if each is not None:
                each.evict(verdict.reason)

    def start(self, request: PlaceRequest) -> None:
        """Start a goal that has waited for its place."""
        if request.goal.body is request and not self._is_closed:
            request.goal.body = None
            self.server.start(request.goal, request.context)

    def drop(self, goal: Goal) -> None:
        """End a goal that waits for its place."""
        canceled = goal.status is GoalStatus.CANCELING
        if goal.status is GoalStatus.ACCEPTED:
            self.server.move(goal, GoalEvent.EXECUTE)
        event = GoalEvent.CANCELED if canceled else GoalEvent.ABORT
        self.server.end(goal, event, None, "" if canceled else goal.reason)

    def retire(self, goal: Goal) -> None:
        """Let a goal go, and start the goal that gets its place."""
        self._retire(goal)
        if self._is_closed:  # no goal gets a place any more
            return
        following, overdue = self._slot.leave(goal), self._slot.overdue()
        if overdue is not None:
            for each in overdue.evicted:
                each.evict(overdue.reason)
        # The next goal gets the place before observers hear of the end, but starts only later: it
        # must not run inside the step of the body that has just ended.
        if following is not None:
            self.server.tasks.call_soon(following.start)

    async def aclose(self) -> None:
        """Close the server, and give no places from then on."""
        await self._aclose()
        self._is_closed = True
