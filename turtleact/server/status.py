"""The status of all goals that a server holds, as messages and as the bytes of one.

Source: rcl_action ``rcl_action_get_goal_status_array``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from turtleact.goal import Goal
from turtleact.goal_states import pack_state, write_states
from turtleact.interfaces import SECOND
from turtleact.interfaces.standard import GoalStatusArray, GoalStatusMessage
from turtleact.server.action_server import ActionServer
from turtleact.transports.base import Publication

__all__ = ["StatusSource"]


class StatusSource:
    """The source of an action's status topic.

    Of a goal that changes, only this is noted; what is told of it is made when that is sent, once
    for all changes until then.

    Args:
        server: The server.

    Attributes:
        publication: The topic's sending end, to be set once that is open.
    """

    publication: Publication

    def __init__(self, server: ActionServer[Any, Any, Any]) -> None:
        self._server = server
        self._changed: dict[Goal, None] | None = None  # in order; None if all is to be written
        self._entries: dict[bytes, bytes] = {}  # in the order of their acceptance
        self._is_stale = False  # since it was written last

    def current(self) -> Sequence[object]:
        """All goals that the server holds."""
        statuses = [
            GoalStatusMessage(self._server.info(goal), int(goal.status))
            for goal in self._server.held()
        ]
        return (GoalStatusArray(statuses),)

    def written(self, _encode: Callable[[object], bytes]) -> Sequence[bytes]:
        """The same as bytes."""
        changed, entries = self._changed, self._entries
        for goal in self._server.held() if changed is None else changed:
            goal_id = self._server.name_goal(goal)
            entries[goal_id] = pack_state(goal_id, (*divmod(goal.stamp, SECOND), goal.status))
        self._changed, self._is_stale = {}, False
        held = self._server.held_ids()
        if len(entries) > len(held):  # each goal held has one
            entries = self._entries = {key: each for key, each in entries.items() if key in held}
        return (write_states(entries.values()),)

    def readers_changed(self, *, has_readers: bool) -> None:
        """Publish while somebody reads."""
        self._changed, self._entries, self._is_stale = None, {}, False
        self._server.execution.board = self if has_readers else None

    @property
    def shows_each(self) -> bool:
        """Whether somebody in this process reads: there, each change is a message."""
        return self.publication.has_near_readers

    def note(self, goal: Goal) -> None:
        """Tell of a goal, which has changed."""
        if goal.id is None:  # or it would be forgotten at its end
            self._server.name_goal(goal)
        if self._changed is not None:  # or it would be kept for nobody
            self._changed[goal] = None
        if not self._is_stale or self.shows_each:
            self._is_stale = True
            self.publication.refresh()
