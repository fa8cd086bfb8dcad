"""What servers and clients of actions share: names, types and the topic of states."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from turtleact.goals.client_endpoints import TARGETS
from turtleact.goals.state import Goal
from turtleact.goals.wire import write_states
from turtleact.interfaces import SECOND
from turtleact.names import action_names
from turtleact.rclpy.impl.connection import CallEnd, Close, Respond, ServiceEnd
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages import check_is_valid_action_type, interface_class
from turtleact.rclpy.qos import QoSProfile
from turtleact.transports.base import Endpoint, EndpointKind, Source

if TYPE_CHECKING:
    from turtleact.rclpy.clock import Clock
    from turtleact.rclpy.node import Node

__all__ = ["FEEDBACK_QOS", "STATUS", "ActionKind", "StatusTopic", "goal_key"]

TYPES = {
    "send_goal": "SendGoalService",
    "cancel_goal": "CancelGoalService",
    "get_result": "GetResultService",
}
"""For each service of an action, the attribute of ``Impl`` that holds the service's class.

``Impl`` is an attribute of the action's class.
"""

STATUS = "action_msgs/msg/GoalStatusArray"
"""The type of the topic of states."""

FEEDBACK_QOS = QoSProfile(depth=10)


class ActionKind:
    """The names and types of one action on a node.

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
        self.feedback_type = f"{action_type.type_name}_FeedbackMessage"

    def service(self, service: str) -> Anything:
        """Return the class of ``send_goal``, ``cancel_goal`` or ``get_result``."""
        return getattr(self._type.Impl, TYPES[service])

    def goal_info(self, goal_id: Anything, clock: Clock | None = None) -> Anything:
        """Return a ``GoalInfo`` with this id and the time of ``clock``.

        Without a clock, the time is 0.
        """
        now = 0 if clock is None else clock.now_ns()
        stamp = interface_class("builtin_interfaces/msg/Time")(*divmod(now, SECOND))
        return interface_class("action_msgs/msg/GoalInfo")(goal_id, stamp)

    def serve(self, service: str, take: Callable[[bytes, Respond], None]) -> ServiceEnd:
        """Open a server of one of the action's services."""
        return ServiceEnd(self._node.connection, self._endpoint("service", service), take)

    def join(self, service: str) -> CallEnd:
        """Open a client of one of the action's services."""
        end = self._endpoint("client", service)
        return CallEnd(self._node.connection, end, TARGETS[service])

    def subscribe(
        self, name: str, type_name: str, qos: QoSProfile, deliver: Callable[[bytes], None]
    ) -> Close:
        """Open a subscription to one of the action's topics."""
        end = self._node.endpoint("subscription", name, type_name, qos)
        return self._node.connection.subscribe(end, deliver)

    def _endpoint(self, kind: EndpointKind, service: str) -> Endpoint:
        name: str = getattr(self.names, service)
        return self._node.endpoint(kind, name, self.service(service).type_name)


def goal_key(goal_id: Anything) -> bytes:
    """Return the 16 bytes of a ``unique_identifier_msgs.msg.UUID``."""
    return bytes(goal_id.uuid)


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
        self._loop = node.connection.loop
        self._held = held
        self._lock = threading.Lock()
        self._is_due = False
        self._sender = node.advertise(kind.names.status, STATUS, qos, self)

    def publish(self) -> None:
        """Publish the goals' states after a short delay. Any thread may call this."""
        with self._lock:
            if self._is_due:
                return
            self._is_due = True
        self._loop.post_later(len(self._held()) * PER_GOAL, self._refresh)

    def _refresh(self) -> None:
        with self._lock:
            self._is_due = False
        self._sender.refresh()

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
