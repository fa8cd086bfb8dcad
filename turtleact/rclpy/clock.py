"""Clocks: system time, steady time, and ROS time, which an external source may set."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from enum import IntEnum
from typing import TYPE_CHECKING, Self

from turtleact.rclpy.duration import Duration
from turtleact.rclpy.exceptions import NotInitializedException
from turtleact.rclpy.impl.entity import Block, Handle
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.time import ClockType, Time

if TYPE_CHECKING:
    from turtleact.rclpy.context import Context

__all__ = [
    "Clock",
    "ClockChange",
    "ClockType",
    "JumpHandle",
    "JumpThreshold",
    "ROSClock",
    "TimeJump",
]


class ClockChange(IntEnum):
    """Tells whether, and how, a time jump has changed the source of ROS time."""

    ROS_TIME_NO_CHANGE = 1
    ROS_TIME_ACTIVATED = 2
    ROS_TIME_DEACTIVATED = 3
    SYSTEM_TIME_NO_CHANGE = 4


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
        if jump.clock_change in (
            ClockChange.ROS_TIME_ACTIVATED,
            ClockChange.ROS_TIME_DEACTIVATED,
        ):
            return self.on_clock_change
        forward = self.min_forward is not None and jump.delta >= self.min_forward
        backward = self.min_backward is not None and jump.delta <= self.min_backward
        return forward or backward


class TimeJump:
    """A jump of a clock.

    Args:
        clock_change: Whether, and how, the source of the time has changed.
        delta: How far the clock has jumped; negative for a jump backward.
    """

    def __init__(self, clock_change: ClockChange, delta: Duration) -> None:
        self._clock_change = clock_change
        self._delta = delta

    @property
    def clock_change(self) -> ClockChange:
        """Whether, and how, the source of the time has changed."""
        return self._clock_change

    @property
    def delta(self) -> Duration:
        """How far the clock has jumped; negative for a jump backward."""
        return self._delta


class JumpHandle(Block):
    """Calls callbacks when the time of a clock jumps, until `unregister` is called.

    As a context manager, it calls `unregister` at the end of the block.

    Args:
        clock: The clock.
        threshold: The jumps for which the callbacks are called.
        pre_callback: Called without arguments before a jump.
        post_callback: Called after a jump, with the `TimeJump`.

    Raises:
        ValueError: if neither callback is given.
    """

    def __init__(
        self,
        *,
        clock: Clock,
        threshold: JumpThreshold,
        pre_callback: Callable[[], object] | None,
        post_callback: Callable[[TimeJump], object] | None,
    ) -> None:
        if pre_callback is None and post_callback is None:
            raise ValueError("One of pre_callback or post_callback must be callable")
        self._clock: Clock | None = clock
        self.threshold = threshold
        self.pre_callback = pre_callback
        self.post_callback = post_callback
        clock.add_jump_handle(self)

    def unregister(self) -> None:
        """Stop calling the callbacks. A second call does nothing."""
        if self._clock is not None:
            self._clock.remove_jump_handle(self)
            self._clock = None

    def _leave(self) -> None:
        self.unregister()


class Clock:
    """A clock. ``Clock(clock_type=ClockType.ROS_TIME)`` makes a `ROSClock`.

    Args:
        clock_type: The kind of clock.
    """

    _clock_type: ClockType
    _now: Callable[[], int]
    _handle: Handle
    _jump_handles: list[JumpHandle]
    _changed: threading.Condition

    def __new__(cls, *, clock_type: ClockType = ClockType.SYSTEM_TIME) -> Self:
        """Make a clock; ``Clock`` makes a `ROSClock` for ROS time."""
        if not isinstance(clock_type, ClockType):
            raise TypeError("Clock type must be a ClockType enum")
        made = ROSClock if clock_type is ClockType.ROS_TIME and cls is Clock else cls
        self: Anything = super().__new__(made)
        self._clock_type = clock_type
        self._handle = Handle()
        self._jump_handles = []
        self._changed = threading.Condition()
        self._now = time.monotonic_ns if clock_type is ClockType.STEADY_TIME else time.time_ns
        made_clock: Self = self
        return made_clock

    def __init__(self, *, clock_type: ClockType = ClockType.SYSTEM_TIME) -> None:
        """Do nothing, because `__new__` has made the clock."""

    @property
    def clock_type(self) -> ClockType:
        """The kind of clock."""
        return self._clock_type

    @property
    def handle(self) -> Handle:
        """The handle of this clock. It shows whether the clock may still be used."""
        return self._handle

    @property
    def is_told(self) -> bool:
        """Whether an external source, such as a simulator, sets the time."""
        return False

    def __repr__(self) -> str:
        return f"Clock(clock_type={self.clock_type.name})"

    def now_ns(self) -> int:
        """Return the current time in nanoseconds; its origin depends on the kind of clock."""
        return self._now()

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

        Raises:
            ValueError: if neither callback is given, or if one is not callable.
        """
        if post_callback is not None and not callable(post_callback):
            raise ValueError("post_callback must be callable if given")
        if pre_callback is not None and not callable(pre_callback):
            raise ValueError("pre_callback must be callable if given")
        return JumpHandle(
            clock=self, threshold=threshold, pre_callback=pre_callback, post_callback=post_callback
        )

    def add_jump_handle(self, handle: JumpHandle) -> None:
        """From now on, call the callbacks of a handle when the time jumps."""
        self._jump_handles.append(handle)

    def remove_jump_handle(self, handle: JumpHandle) -> None:
        """Stop calling the callbacks of a handle."""
        if handle in self._jump_handles:
            self._jump_handles.remove(handle)

    def sleep_until(self, until: Time, context: Context | None = None) -> bool:
        """Sleep until this clock shows the time ``until``, or until the context is shut down.

        Returns:
            True if the clock has reached the time; False if the context was shut down, or if the
            source of ROS time has changed.

        Raises:
            ValueError: if ``until`` is a time of another kind of clock.
            NotInitializedException: if the context is not initialised, or was shut down before.
        """
        from turtleact.rclpy.utilities import get_default_context

        context = get_default_context() if context is None else context
        if not context.ok():
            raise NotInitializedException
        if until.clock_type != self._clock_type:
            raise ValueError("until's clock type does not match this clock's type")
        woken = self._changed
        was_told = self.is_told
        context.on_shutdown(self._wake)
        while context.ok() and self.is_told == was_told:
            left = until.nanoseconds - self.now_ns()
            if left <= 0:
                return True
            with woken:
                if self.now_ns() < until.nanoseconds and context.ok():
                    woken.wait(_LONGEST if was_told else min(left / 1e9, _LONGEST))
        return False

    def sleep_for(self, rel_time: Duration, context: Context | None = None) -> bool:
        """Sleep for a duration that this clock measures; see `sleep_until`."""
        return self.sleep_until(self.now() + rel_time, context)

    def _wake(self) -> None:
        with self._changed:
            self._changed.notify_all()


_LONGEST = 0.5
"""How long to sleep before checking again (s), because a signal may not interrupt the sleep."""


class ROSClock(Clock):
    """A clock of ROS time, which an external source, such as a simulator, may set."""

    _told = 0
    _is_told = False

    def __new__(cls, *, clock_type: ClockType = ClockType.ROS_TIME) -> Self:
        """Make a clock of ROS time."""
        return super().__new__(cls, clock_type=clock_type)

    def __init__(self, *, clock_type: ClockType = ClockType.ROS_TIME) -> None:
        """Do nothing, because `__new__` has made the clock."""

    @property
    def ros_time_is_active(self) -> bool:
        """Whether an external source, such as a simulator, sets the time."""
        return self._is_told

    @property
    def is_told(self) -> bool:
        """Whether an external source, such as a simulator, sets the time."""
        return self._is_told

    def now_ns(self) -> int:
        """Return the current time in nanoseconds; its origin depends on the kind of clock."""
        return self._told if self._is_told else time.time_ns()

    def _set_ros_time_is_active(self, enabled: bool) -> None:
        """Choose whether an external source sets the time."""
        self.activate(is_told=enabled)

    def activate(self, *, is_told: bool) -> None:
        """Choose whether an external source sets the time."""
        if is_told == self._is_told:
            return
        before = self.now_ns()
        change = ClockChange.ROS_TIME_ACTIVATED if is_told else ClockChange.ROS_TIME_DEACTIVATED
        after = self._told if is_told else time.time_ns()

        def turn() -> None:
            self._is_told = is_told

        self._jump(TimeJump(change, Duration(nanoseconds=after - before)), turn)

    def set_ros_time_override(self, time: Time) -> None:
        """Set the time that the clock shows while `ros_time_is_active`.

        Raises:
            TypeError: if ``time`` is not a `Time`.
        """
        if not isinstance(time, Time):
            raise TypeError(
                f"Time must be specified as rclpy.time.Time. Received type: {type(time)}"
            )
        delta = time.nanoseconds - self._told

        def turn() -> None:
            self._told = time.nanoseconds

        if self._is_told:
            self._jump(TimeJump(ClockChange.ROS_TIME_NO_CHANGE, Duration(nanoseconds=delta)), turn)
        else:
            turn()

    def _jump(self, jump: TimeJump, turn: Callable[[], None]) -> None:
        met = [each for each in list(self._jump_handles) if each.threshold.is_met_by(jump)]
        for each in met:
            if each.pre_callback is not None:
                each.pre_callback()
        turn()
        for each in met:
            if each.post_callback is not None:
                each.post_callback(jump)
        self._wake()
