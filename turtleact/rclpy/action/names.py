"""Opens the endpoints of an action, with the right names, types and formats."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from turtleact.interfaces.cdr import HEADER, UNFIT, encoder
from turtleact.names import action_names
from turtleact.rclpy.impl.calls import CallEnd
from turtleact.rclpy.impl.connection import RequestHandler, Sender
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages.classes import interface_class, maker
from turtleact.rclpy.messages.codec import encode, hash_of
from turtleact.rclpy.qos import QoSProfile
from turtleact.rclpy.service_introspection import SwitchableEvents
from turtleact.rclpy.type_support import check_is_valid_action_type
from turtleact.transports.base import Closeable, Target

if TYPE_CHECKING:
    from turtleact.rclpy.clock import Clock
    from turtleact.rclpy.node import Node

__all__ = ["ActionKind", "goal_key"]

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
        self._info: Callable[..., Anything] = maker(interface_class("action_msgs/msg/GoalInfo"))
        self._time: Callable[..., Anything] = maker(interface_class("builtin_interfaces/msg/Time"))

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

    def serve(self, service: str, handler: RequestHandler) -> Closeable:
        """Open a server of one of the action's services."""
        name, type_name = getattr(self.names, service), self.service(service).type_name
        end = self._node.endpoint("service", name, type_name)
        return self._node.connection.serve(end, hash_of(type_name), handler)

    def has_built_in(self) -> bool:
        """Whether a built-in action has this name.

        A built-in action gives up its name when another server uses the same name.
        """
        nodes = {
            each.node
            for each in self._node.connection.endpoints(self.names.send_goal)
            if each.kind == "service"
        }
        if not nodes:
            return False
        from turtleact.node.conflicts import BUILT_INS_NODE  # slow to import

        return BUILT_INS_NODE in nodes

    def join(self, service: str) -> CallEnd:
        """Open a client of one of the action's services."""
        name = getattr(self.names, service)
        return self._node.join(name, self.service(service), _TARGETS[service])

    def advertise_feedback(self, qos: QoSProfile) -> Sender:
        """Open the publisher of the feedback topic."""
        type_name = self._feedback_type
        end = self._node.endpoint("publisher", self.names.feedback, type_name, qos)
        return self._node.connection.advertise(end, hash_of(type_name))

    def subscribe_feedback(self, qos: QoSProfile, deliver: Callable[[bytes], None]) -> Closeable:
        """Open a subscription to the feedback topic."""
        type_name = self._feedback_type
        end = self._node.endpoint("subscription", self.names.feedback, type_name, qos)
        return self._node.connection.subscribe(end, hash_of(type_name), deliver)

    def subscribe_status(self, qos: QoSProfile, deliver: Callable[[bytes], None]) -> Closeable:
        """Open a subscription to the status topic."""
        type_name = "action_msgs/msg/GoalStatusArray"
        end = self._node.endpoint("subscription", self.names.status, type_name, qos)
        return self._node.connection.subscribe(end, hash_of(type_name), deliver)

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
