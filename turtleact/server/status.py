"""The status of all goals that a server holds, as messages and as the bytes of one.

Source: rcl_action ``rcl_action_get_goal_status_array``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from turtleact.goal import GoalStatus
from turtleact.goal_states import pack_state, write_states
from turtleact.interfaces.standard import GoalStatusArray, GoalStatusMessage, Time
from turtleact.server.action_server import ActionServer
from turtleact.server.goal_handle import ServerGoalHandle
from turtleact.transports.base import Publication

__all__ = ["StatusSource"]


class StatusSource:
    """The source of an action's status topic.

    Args:
        server: The server.
    """

    publication: Publication

    def __init__(self, server: ActionServer[Any, Any, Any]) -> None:
        self._server = server
        self._is_watching = False
        self._entries: dict[bytes, bytes] = {}

    def current(self) -> Sequence[object]:
        """All goals that the server holds."""
        statuses = [
            GoalStatusMessage(self._server.info(goal), int(goal.status))
            for goal in self._server.held()
        ]
        return (GoalStatusArray(statuses),)

    def written(self, _encode: Callable[[object], bytes]) -> Sequence[bytes]:
        """The same as bytes."""
        held = self._server.held_ids()
        entries = self._entries = {key: each for key, each in self._entries.items() if key in held}
        return (write_states(entries.values()),)

    def readers_changed(self, *, has_readers: bool) -> None:
        """Publish while somebody reads."""
        if has_readers and not self._is_watching:
            self._entries.clear()
            for goal in self._server.held():
                info = self._server.info(goal)
                self._note(info.goal_id.uuid, info.stamp, goal.status)
            self._server.hooks.add(self._publish)
        elif self._is_watching and not has_readers:
            self._server.hooks.remove(self._publish)
        self._is_watching = has_readers

    def _publish(
        self, goal: ServerGoalHandle[Any, Any, Any], _before: GoalStatus, after: GoalStatus
    ) -> None:
        self._note(goal.goal_id, goal.stamp, after)
        self.publication.refresh()

    def _note(self, goal_id: bytes, stamp: Time, status: GoalStatus) -> None:
        self._entries[goal_id] = pack_state(goal_id, (stamp.sec, stamp.nanosec, status))
