"""Opens the endpoints of an action, with the right names, types and formats."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from turtleact.goals.state import Goal
from turtleact.goals.wire import write_states
from turtleact.interfaces.cdr import HEADER, UNFIT, encoder
from turtleact.names import action_names
from turtleact.rclpy.impl.connection import CallEnd, Close, RequestHandler, Sender
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages import check_is_valid_action_type, encode, interface_class
from turtleact.rclpy.qos import QoSProfile
from turtleact.rclpy.services import SwitchableEvents
from turtleact.transports.base import Source, Target

if TYPE_CHECKING:
    from turtleact.rclpy.clock import Clock
    from turtleact.rclpy.node import Node

__all__ = ["ActionKind", "StatusTopic", "goal_key"]

TYPES = {
    "send_goal": "SendGoalService",
    "cancel_goal": "CancelGoalService",
    "get_result": "GetResultService",
}
"""For each service of an action, the attribute of ``Impl`` that holds the service's class.

``Impl`` is an attribute of the action's class.
"""

# Both responses begin with a number, in the byte after the header: it says "unknown goal". A server
# that does not know a goal may answer before the right one; that answer does not count.
_TARGETS = {
    "send_goal": Target("one"),
    "cancel_goal": Target(counts=lambda reply: reply[4:5] != b"\x02"),
    "get_result": Target(counts=lambda reply: reply[4:5] != b"\x00"),
}


class ActionKind:
    """Opens the endpoints of one action on a node.

    Args:
        node: The node.
        action_type: The class of the action.
        name: The name of the action, relative or absolute.

    Attributes:
        names: The absolute names of the action and its endpoints.
    """

    def __init__(self, node: Node, action_type: Anything, name: str) -> None:
        check_is_valid_action_type(action_type)
        self._node = node
        self._type: Anything = action_type
        full = node.resolve_service_name(f"{name}/_action/send_goal")
        self.names = action_names(full.removesuffix("/_action/send_goal"))
        self._write: Callable[[object, bytes], bytes] = encoder(action_type.Feedback)
        self._info: Anything = interface_class("action_msgs/msg/GoalInfo")
        self._time: Anything = interface_class("builtin_interfaces/msg/Time")

    def service(self, service: str) -> Anything:
        """Return the class of ``send_goal``, ``cancel_goal`` or ``get_result``."""
        return getattr(self._type.Impl, TYPES[service])

    def goal_info(self, goal_id: Anything, clock: Clock | None = None) -> Anything:
        """Return a ``GoalInfo`` with this id and the time of ``clock``.

        Without a clock, the time is 0.
        """
        now = 0 if clock is None else clock.now_ns()
        return self._info(goal_id, self._time(*divmod(now, 1_000_000_000)))

    def events(self, service: str) -> SwitchableEvents:
        """Make a service's publisher of introspection events. The publisher is initially off."""
        name = getattr(self.names, service)
        return SwitchableEvents(self._node, name, self.service(service), is_client=False)

    def serve(self, service: str, handler: RequestHandler) -> Close:
        """Open a server of one of the action's services."""
        name, type_name = getattr(self.names, service), self.service(service).type_name
        end = self._node.endpoint("service", name, type_name)
        return self._node.connection.serve(end, handler)

    def join(self, service: str) -> CallEnd:
        """Open a client of one of the action's services."""
        name = getattr(self.names, service)
        return self._node.join(name, self.service(service), _TARGETS[service])

    def advertise_feedback(self, qos: QoSProfile) -> Sender:
        """Open the publisher of the feedback topic."""
        type_name = self._feedback_type
        end = self._node.endpoint("publisher", self.names.feedback, type_name, qos)
        return self._node.connection.advertise(end)

    def subscribe_feedback(self, qos: QoSProfile, deliver: Callable[[bytes], None]) -> Close:
        """Open a subscription to the feedback topic."""
        type_name = self._feedback_type
        end = self._node.endpoint("subscription", self.names.feedback, type_name, qos)
        return self._node.connection.subscribe(end, deliver)

    def subscribe_status(self, qos: QoSProfile, deliver: Callable[[bytes], None]) -> Close:
        """Open a subscription to the status topic."""
        type_name = "action_msgs/msg/GoalStatusArray"
        end = self._node.endpoint("subscription", self.names.status, type_name, qos)
        return self._node.connection.subscribe(end, deliver)

    def encode_feedback(self, goal_id: bytes, feedback: Anything) -> bytes:
        """Encode a feedback message.

        Raises:
            TypeError: if a value does not fit its type.
        """
        try:
            return self._write(feedback, HEADER + goal_id)
        except UNFIT:
            made: Anything = self._type.Impl.FeedbackMessage
            message = made(feedback=feedback)
            message.goal_id.uuid = list(goal_id)
            return encode(message, made)

    @property
    def _feedback_type(self) -> str:
        return f"{self._type.type_name}_FeedbackMessage"


def goal_key(goal_id: Anything) -> bytes:
    """Return the 16 bytes of a ``unique_identifier_msgs.msg.UUID``."""
    return bytes(goal_id.uuid)


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
        self._sender = node.connection.advertise(end, self)

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
        return (write_states([(goal.id, goal.stamp, goal.status) for goal in self._held()]),)

    def written(self, encode: Callable[[object], bytes]) -> Sequence[bytes]:
        """Return the message with the goals' states, encoded for readers in other processes."""
        return [encode(message) for message in self.current()]

    def readers_changed(self, *, has_readers: bool) -> None:
        """Do nothing, because the transport itself asks for the messages to send."""

    def close(self) -> None:
        """Close the topic."""
        self._sender.close()
