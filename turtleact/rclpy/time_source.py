"""The source of ROS time: the system, or a simulator that publishes ``/clock``."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING

from turtleact.rclpy.clock import Clock, ROSClock
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages.classes import interface_class
from turtleact.rclpy.parameter import Parameter
from turtleact.rclpy.qos import QoSProfile, ReliabilityPolicy
from turtleact.rclpy.time import ClockType, Time

if TYPE_CHECKING:
    from turtleact.rclpy.subscription import Subscription

__all__ = ["CLOCK_TOPIC", "USE_SIM_TIME_NAME", "TimeSource"]

CLOCK_TOPIC = "/clock"
USE_SIM_TIME_NAME = "use_sim_time"


class TimeSource:
    """Sets clocks to the time on ``/clock`` while a node's parameter ``use_sim_time`` is true.

    Args:
        node: The node. If it is None, call `attach_node` later.
    """

    def __init__(self, *, node: Anything = None) -> None:
        self._clock_sub: Subscription | None = None
        self._node: weakref.ReferenceType[Anything] | None = None
        self._associated_clocks: list[ROSClock] = []
        self._last_time_set: Time | None = None
        self._ros_time_is_active = False
        if node is not None:
            self.attach_node(node)

    @property
    def ros_time_is_active(self) -> bool:
        """Whether the clocks follow ``/clock``."""
        return self._ros_time_is_active

    @ros_time_is_active.setter
    def ros_time_is_active(self, enabled: bool) -> None:
        if self._ros_time_is_active == enabled:
            return
        self._ros_time_is_active = enabled
        for clock in self._associated_clocks:
            clock.activate(is_told=enabled)
        node = self._get_node()
        if enabled:
            self._subscribe()
        elif node is not None and self._clock_sub is not None:
            node.destroy_subscription(self._clock_sub)
            self._clock_sub = None

    def attach_node(self, node: Anything) -> None:
        """Follow the parameter ``use_sim_time`` of a node. Declare the parameter if necessary.

        Raises:
            TypeError: if the object is not a node.
        """
        if not hasattr(node, "declare_parameter"):
            raise TypeError("Node must be of type rclpy.node.Node")
        if self._get_node() is not None:
            self.detach_node()
        self._node = weakref.ref(node)
        if not node.has_parameter(USE_SIM_TIME_NAME):
            node.declare_parameter(USE_SIM_TIME_NAME, False)
        parameter = node.get_parameter(USE_SIM_TIME_NAME)
        if parameter.type_ is Parameter.Type.BOOL:
            self.ros_time_is_active = parameter.value
        else:
            node.get_logger().error(
                f"Invalid type for parameter '{USE_SIM_TIME_NAME}' {parameter.type_!r} "
                "should be bool"
            )
        node.add_on_set_parameters_callback(self._on_parameter_event)

    def detach_node(self) -> None:
        """Forget the node, and close the subscription of ``/clock``."""
        node = self._get_node()
        if node is not None and self._clock_sub is not None:
            node.destroy_subscription(self._clock_sub)
        self._clock_sub, self._node = None, None

    def destroy(self) -> None:
        """Drop the references to the node and to the subscription of ``/clock``.

        The subscription stays open, because the node itself destroys it.
        """
        self._node = None
        self._clock_sub = None

    def attach_clock(self, clock: Clock) -> None:
        """Set a clock to the time of this source, now and whenever that time changes.

        Raises:
            ValueError: if the clock is not of the type ROS_TIME.
        """
        if clock.clock_type is not ClockType.ROS_TIME or not isinstance(clock, ROSClock):
            raise ValueError("Only clocks with type ROS_TIME can be attached.")
        if self._last_time_set is not None:
            clock.set_ros_time_override(self._last_time_set)
        clock.activate(is_told=self._ros_time_is_active)
        self._associated_clocks.append(clock)

    def clock_callback(self, msg: Anything) -> None:
        """Set the attached clocks to the time in a message of ``/clock``."""
        time = Time.from_msg(msg.clock)
        self._last_time_set = time
        for clock in self._associated_clocks:
            clock.set_ros_time_override(time)

    def _get_node(self) -> Anything:
        return None if self._node is None else self._node()

    def _subscribe(self) -> None:
        node = self._get_node()
        if node is not None and self._clock_sub is None:
            self._clock_sub = node.create_subscription(
                interface_class("rosgraph_msgs/msg/Clock"),
                CLOCK_TOPIC,
                self.clock_callback,
                QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT),
            )

    def _on_parameter_event(self, parameters: list[Parameter]) -> Anything:
        made: Anything = interface_class("rcl_interfaces/msg/SetParametersResult")
        for parameter in parameters:
            if parameter.name != USE_SIM_TIME_NAME:
                continue
            if parameter.type_ is not Parameter.Type.BOOL:
                return made(
                    successful=False,
                    reason=f"{USE_SIM_TIME_NAME} parameter set to something besides a bool",
                )
            self.ros_time_is_active = parameter.value
        return made(successful=True)
