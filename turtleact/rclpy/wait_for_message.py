"""Waits for one message of a topic."""

from __future__ import annotations

from typing import TYPE_CHECKING

from turtleact.rclpy.executors import SingleThreadedExecutor
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.qos import QoSProfile
from turtleact.rclpy.task import Future

if TYPE_CHECKING:
    from turtleact.rclpy.node import Node

__all__ = ["wait_for_message"]


def wait_for_message(
    msg_type: Anything,
    node: Node,
    topic: str,
    *,
    qos_profile: QoSProfile | int = 1,
    time_to_wait: float = -1,
) -> tuple[bool, Anything]:
    """Wait for the next message of a topic, without running other callbacks of the node.

    Args:
        msg_type: The class of the message.
        node: The node.
        topic: The name of the topic.
        qos_profile: The quality of service, or a number; see `Node.create_publisher`.
        time_to_wait: How long to wait (s); -1 means for ever.

    Returns:
        A pair: whether a message has arrived, and the message, or None if no message has arrived.
    """
    from turtleact.rclpy.node import Node

    received = Future()
    # A node of its own, so that the caller's callbacks do not run here.
    helper = Node(
        f"_{node.get_name()}_wait",
        context=node.context,
        namespace=node.get_namespace(),
        use_global_arguments=False,
        enable_rosout=False,
        start_parameter_services=False,
    )
    full_name = node.resolve_topic_name(topic)
    try:
        helper.create_subscription(msg_type, full_name, received.set_result, qos_profile)
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(helper)
        timeout = None if time_to_wait < 0 else time_to_wait
        executor.spin_until_future_complete(received, timeout)
        executor.shutdown()
    finally:
        helper.destroy_node()
    return received.done(), received.result()
