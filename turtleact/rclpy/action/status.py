"""The status topic of an action: the states of all goals that its server holds.

A status message contains the states of all goals, so the message may be long. The message is
therefore made only when the transport sends it, and several changes in quick succession become one
message.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from turtleact.goals.state import Goal
from turtleact.goals.wire import pack_state, write_states
from turtleact.rclpy.action.names import ActionKind
from turtleact.rclpy.messages.codec import hash_of
from turtleact.rclpy.qos import QoSProfile
from turtleact.transports.base import Source

if TYPE_CHECKING:
    from turtleact.rclpy.node import Node

__all__ = ["StatusTopic"]

TYPE = "action_msgs/msg/GoalStatusArray"

PER_GOAL = 5e-6
"""How long to delay a status message, for each goal in the message (s)."""


class StatusTopic(Source):
    """Publishes the states of a server's goals.

    Args:
        node: The node.
        kind: The action.
        qos: The quality of service of the topic.
        held: A function that returns the goals that the server holds.
    """

    def __init__(
        self, node: Node, kind: ActionKind, qos: QoSProfile, held: Callable[[], list[Goal]]
    ) -> None:
        self._held = held
        self._lock = threading.Lock()
        self._is_due = False
        end = node.endpoint("publisher", kind.names.status, TYPE, qos)
        self._sender = node.connection.advertise(end, hash_of(TYPE), self)

    def publish(self) -> None:
        """Publish the goals' states after a short delay. Any thread may call this."""
        with self._lock:
            if self._is_due:
                return
            self._is_due = True
        self._sender.refresh_soon(len(self._held()) * PER_GOAL, self._begin)

    def _begin(self) -> None:
        with self._lock:
            self._is_due = False

    def current(self) -> Sequence[object]:
        """Return the encoded message with the goals' states."""
        packed = [
            pack_state(goal.id, (*divmod(goal.stamp, 1_000_000_000), goal.status))
            for goal in self._held()
        ]
        return (write_states(packed),)

    def written(self, encode: Callable[[object], bytes]) -> Sequence[bytes]:
        """Return the message with the goals' states, encoded for readers in other processes."""
        return [encode(message) for message in self.current()]

    def readers_changed(self, *, has_readers: bool) -> None:
        """Do nothing, because the transport itself asks for the messages to send."""

    def close(self) -> None:
        """Close the topic."""
        self._sender.close()
