"""Clocks: system time, steady time, and ROS time, which a simulator may set on ``/clock``."""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple, Self

from turtleact.rclpy.exceptions import NotInitializedException
from turtleact.rclpy.impl.entity import Block, Handle
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages import interface_class
from turtleact.rclpy.parameter import Parameter
from turtleact.rclpy.qos import QoSProfile, ReliabilityPolicy
from turtleact.rclpy.time import ClockType, Duration, Time

if TYPE_CHECKING:
    from turtleact.rclpy.context import Context

__all__ = [
    "CLOCK_TOPIC",
    "USE_SIM_TIME_NAME",
    "Clock",
    "ClockChange",
    "ClockType",
    "JumpHandle",
    "JumpThreshold",
    "ROSClock",
    "TimeJump",
    "TimeSource",
]

CLOCK_TOPIC = "/clock"
USE_SIM_TIME_NAME = "use_sim_time"

LONGEST_SLEEP = 0.5
"""How long to sleep before checking again (s), because a signal may not interrupt the sleep."""


class ClockChange(IntEnum):
    """Tells whether, and how, a time jump has changed the source of ROS time."""

    ROS_TIME_NO_CHANGE = 1
    ROS_TIME_ACTIVATED = 2
    ROS_TIME_DEACTIVATED = 3
    SYSTEM_TIME_NO_CHANGE = 4


class TimeJump(NamedTuple):
    """A jump of a clock.

    Attributes:
        clock_change: Whether, and how, the source of the time has changed.
        delta: How far the clock has jumped; negative for a jump backward.
    """

    clock_change: ClockChange
    delta: Duration


class JumpThreshold:
    """Selects the time jumps for which a callback is called.

    Args:
        min_forward: The smallest forward jump to report. With None, no forward jump is reported.
        min_backward: The smallest backward jump to report, as a negative duration. With None, no
            backward jump is reported.
        on_clock_change: Whether to report when an external source starts or stops setting the time.

    Raises:
        ValueError: if ``min_forward`` is not above zero, if ``min_backward`` is not below zero, or
            if no jump would be reported.
    """

    def __init__(
        self,
        *,
        min_forward: Duration | None,
        min_backward: Duration | None,
        on_clock_change: bool = True,
    ) -> None:
        if min_forward is not None and min_forward.nanoseconds <= 0:
            raise ValueError("min_forward must be a positive non-zero duration")
        if min_backward is not None and min_backward.nanoseconds >= 0:
            raise ValueError("min_backward must be a negative non-zero duration")
        if min_forward is None and min_backward is None and not on_clock_change:
            raise ValueError("At least one kind of jump must be enabled")
        self.min_forward = min_forward
        self.min_backward = min_backward
        self.on_clock_change = on_clock_change

    def is_met_by(self, jump: TimeJump) -> bool:
        """Whether a callback is called for this jump."""
        if jump.clock_change is not ClockChange.ROS_TIME_NO_CHANGE:
            return self.on_clock_change
        forward = self.min_forward is not None and jump.delta >= self.min_forward
        backward = self.min_backward is not None and jump.delta <= self.min_backward
        return forward or backward


class JumpHandle(Block):
    """Calls callbacks when the time of a clock jumps, until `unregister` is called.

    As a context manager, it calls `unregister` at the end of the block.
    `Clock.create_jump_callback` makes a handle.
    """

    def __init__(
        self,
        handles: list[JumpHandle],
        threshold: JumpThreshold,
        pre_callback: Callable[[], object] | None,
        post_callback: Callable[[TimeJump], object] | None,
    ) -> None:
        self._handles = handles
        self.threshold = threshold
        self.pre_callback = pre_callback
        self.post_callback = post_callback
        handles.append(self)

    def unregister(self) -> None:
        """Stop calling the callbacks. A second call does nothing."""
        if self in self._handles:
            self._handles.remove(self)

    def _leave(self) -> None:
        self.unregister()


class Clock:
    """A clock. ``Clock(clock_type=ClockType.ROS_TIME)`` makes a `ROSClock`.

    Args:
        clock_type: The kind of clock.

    Attributes:
        is_told: Whether an external source, such as a simulator, sets the time.
        handle: Shows whether the clock may still be used.
    """

    def __new__(cls, *, clock_type: ClockType = ClockType.SYSTEM_TIME) -> Self:
        """Make a clock; ``Clock`` makes a `ROSClock` for ROS time."""
        made = ROSClock if clock_type is ClockType.ROS_TIME and cls is Clock else cls
        clock: Anything = super().__new__(made)
        return clock  # type: ignore[no-any-return]  # a subclass of cls

    def __init__(self, *, clock_type: ClockType = ClockType.SYSTEM_TIME) -> None:
        if not isinstance(clock_type, ClockType):
            raise TypeError("Clock type must be a ClockType enum")
        self.is_told = False
        self.handle = Handle()
        self._clock_type = clock_type
        self._told = 0
        self._jump_handles: list[JumpHandle] = []
        self._changed = threading.Condition()
        self._now = time.monotonic_ns if clock_type is ClockType.STEADY_TIME else time.time_ns

    @property
    def clock_type(self) -> ClockType:
        """The kind of clock."""
        return self._clock_type

    def __repr__(self) -> str:
        return f"Clock(clock_type={self.clock_type.name})"

    def now_ns(self) -> int:
        """Return the current time in nanoseconds; its origin depends on the kind of clock."""
        return self._told if self.is_told else self._now()

    def now(self) -> Time:
        """Return the current time."""
        return Time(nanoseconds=self.now_ns(), clock_type=self._clock_type)

    def create_jump_callback(
        self,
        threshold: JumpThreshold,
        *,
        pre_callback: Callable[[], object] | None = None,
        post_callback: Callable[[TimeJump], object] | None = None,
    ) -> JumpHandle:
        """Call callbacks when the time jumps. Return the handle that can unregister them.

        Args:
            threshold: The jumps for which the callbacks are called.
            pre_callback: Called without arguments before a jump.
            post_callback: Called after a jump, with the `TimeJump`.

        Raises:
            ValueError: if neither callback is given, or if one is not callable.
        """
        if pre_callback is None and post_callback is None:
            raise ValueError("One of pre_callback or post_callback must be callable")
        if post_callback is not None and not callable(post_callback):
            raise ValueError("post_callback must be callable if given")
        if pre_callback is not None and not callable(pre_callback):
            raise ValueError("pre_callback must be callable if given")
        return JumpHandle(self._jump_handles, threshold, pre_callback, post_callback)

    def sleep_until(self, until: Time, context: Context | None = None) -> bool:
        """Sleep until this clock shows the time ``until``, or until the context is shut down.

        Returns:
            True if the clock has reached the time; False if the context was shut down, or if the
            source of ROS time has changed.

        Raises:
            ValueError: if ``until`` is a time of another kind of clock.
            NotInitializedException: if the context is not initialised, or was shut down before.
        """
        from turtleact.rclpy.context import get_default_context

        context = get_default_context() if context is None else context
        if not context.ok():
            raise NotInitializedException
        if until.clock_type != self._clock_type:
            raise ValueError("until's clock type does not match this clock's type")
        was_told = self.is_told
        context.on_shutdown(self._wake)
        while context.ok() and self.is_told == was_told:
            left = until.nanoseconds - self.now_ns()
            if left <= 0:
                return True
            with self._changed:
                if self.now_ns() < until.nanoseconds and context.ok():
                    longest = LONGEST_SLEEP if was_told else min(left / 1e9, LONGEST_SLEEP)
                    self._changed.wait(longest)
        return False

    def sleep_for(self, rel_time: Duration, context: Context | None = None) -> bool:
        """Sleep for a duration that this clock measures; see `sleep_until`."""
        return self.sleep_until(self.now() + rel_time, context)

    def _wake(self) -> None:
        with self._changed:
            self._changed.notify_all()


class ROSClock(Clock):
    """A clock of ROS time, which an external source, such as a simulator, may set."""

    def __init__(self, *, clock_type: ClockType = ClockType.ROS_TIME) -> None:
        super().__init__(clock_type=clock_type)

    @property
    def ros_time_is_active(self) -> bool:
        """Whether an external source, such as a simulator, sets the time."""
        return self.is_told

    def activate(self, *, is_told: bool) -> None:
        """Choose whether an external source sets the time."""
        if is_told == self.is_told:
            return
        change = ClockChange.ROS_TIME_ACTIVATED if is_told else ClockChange.ROS_TIME_DEACTIVATED
        after = self._told if is_told else self._now()
        self._jump(change, after - self.now_ns(), is_told=is_told)

    def _set_ros_time_is_active(self, enabled: bool) -> None:
        """Choose whether an external source sets the time."""
        self.activate(is_told=enabled)

    def set_ros_time_override(self, time: Time) -> None:
        """Set the time that the clock shows while `ros_time_is_active`.

        Raises:
            TypeError: if ``time`` is not a `Time`.
        """
        if not isinstance(time, Time):
            raise TypeError(
                f"Time must be specified as rclpy.time.Time. Received type: {type(time)}"
            )
        if self.is_told:
            delta = time.nanoseconds - self._told
            self._jump(ClockChange.ROS_TIME_NO_CHANGE, delta, told=time.nanoseconds)
        else:
            self._told = time.nanoseconds

    def _jump(
        self, change: ClockChange, delta: int, *, is_told: bool = True, told: int | None = None
    ) -> None:
        """Change the time or its source, and call the callbacks before and after the change."""
        jump = TimeJump(change, Duration(nanoseconds=delta))
        met = [each for each in list(self._jump_handles) if each.threshold.is_met_by(jump)]
        for each in met:
            if each.pre_callback is not None:
                each.pre_callback()
        self.is_told = is_told
        if told is not None:
            self._told = told
        for each in met:
            if each.post_callback is not None:
                each.post_callback(jump)
        self._wake()


class TimeSource:
    """Sets clocks to the time on ``/clock`` while a node's parameter ``use_sim_time`` is true.

    Args:
        node: The node. If it is None, call `attach_node` later.
    """

    def __init__(self, *, node: Anything = None) -> None:
        self._clock_sub: Anything = None
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
        if enabled:
            self._subscribe()
        else:
            self._unsubscribe()

    def attach_node(self, node: Anything) -> None:
        """Follow the parameter ``use_sim_time`` of a node. Declare the parameter if necessary.

        Raises:
            TypeError: if the object is not a node.
        """
        if not hasattr(node, "declare_parameter"):
            raise TypeError("Node must be of type rclpy.node.Node")
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
        self._unsubscribe()
        self._node = None

    def attach_clock(self, clock: Clock) -> None:
        """Set a clock to the time of this source, now and whenever that time changes.

        Raises:
            ValueError: if the clock is not of the type ROS_TIME.
        """
        if not isinstance(clock, ROSClock):
            raise ValueError("Only clocks with type ROS_TIME can be attached.")
        if self._last_time_set is not None:
            clock.set_ros_time_override(self._last_time_set)
        clock.activate(is_told=self._ros_time_is_active)
        self._associated_clocks.append(clock)

    def clock_callback(self, msg: Anything) -> None:
        """Set the attached clocks to the time in a message of ``/clock``."""
        time = self._last_time_set = Time.from_msg(msg.clock)
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

    def _unsubscribe(self) -> None:
        node = self._get_node()
        if node is not None and self._clock_sub is not None:
            node.destroy_subscription(self._clock_sub)
        self._clock_sub = None

    def _on_parameter_event(self, parameters: list[Parameter]) -> Anything:
        result = interface_class("rcl_interfaces/msg/SetParametersResult")(successful=True)
        for parameter in parameters:
            if parameter.name == USE_SIM_TIME_NAME:
                result.successful = parameter.type_ is Parameter.Type.BOOL
                if result.successful:
                    self.ros_time_is_active = parameter.value
                else:
                    result.reason = f"{USE_SIM_TIME_NAME} parameter set to something besides a bool"
        return result
