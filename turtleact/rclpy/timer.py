"""Timers and rates.

A timer that is late calls its function once, however many calls were missed. Later calls follow the
original schedule. A timer with a simulated clock becomes due only when somebody sets the time of
the clock, for example with a message on ``/clock``.
"""

from __future__ import annotations

import inspect
import threading
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from turtleact.rclpy.clock import Clock, JumpThreshold
from turtleact.rclpy.duration import Duration
from turtleact.rclpy.exceptions import InvalidHandle, RCLError, ROSInterruptException
from turtleact.rclpy.impl.entity import NOTHING, Entity
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.time import ClockType, Time

if TYPE_CHECKING:
    from turtleact.rclpy.callback_groups import CallbackGroup
    from turtleact.rclpy.context import Context

__all__ = ["Rate", "Timer", "TimerInfo"]


class TimerInfo:
    """When a timer's callback was due, and when it was called.

    Args:
        expected_call_time: When the call was due (ns since the start of the clock).
        actual_call_time: When the call was made (ns since the start of the clock).
        clock_type: The kind of clock that both times belong to.
    """

    def __init__(
        self,
        *,
        expected_call_time: int = 0,
        actual_call_time: int = 0,
        clock_type: ClockType = ClockType.SYSTEM_TIME,
    ) -> None:
        self.expected_call_time = Time(nanoseconds=expected_call_time, clock_type=clock_type)
        self.actual_call_time = Time(nanoseconds=actual_call_time, clock_type=clock_type)


class Timer(Entity):
    """Calls a function periodically. `Node.create_timer` makes a timer.

    Args:
        callback: The function to call. A parameter that is annotated with `TimerInfo` gets the
            `TimerInfo` of the call.
        callback_group: Decides when the callback may run.
        timer_period_ns: The time between two calls (ns).
        clock: The clock to follow.
        context: Ignored.
        autostart: Whether the timer starts at once. Otherwise `reset` starts it.

    Raises:
        RCLError: if the period is negative.
    """

    def __init__(
        self,
        callback: Anything,
        callback_group: CallbackGroup,
        timer_period_ns: int,
        clock: Clock,
        *,
        context: Context | None = None,  # noqa: ARG002  # the node's context
        autostart: bool = True,
        wake: Callable[[], object] | None = None,
    ) -> None:
        if timer_period_ns < 0:
            raise RCLError(f"Failed to create timer: invalid period {timer_period_ns} ns")
        self._clock = clock
        self._period = timer_period_ns
        self._last_call = clock.now_ns()
        self._next_call = self._last_call + timer_period_ns
        self._is_canceled = not autostart
        self._lock = threading.Lock()
        self.callback = callback
        # A timer of simulated time must be looked at when that time changes.
        threshold = JumpThreshold(
            min_forward=Duration(nanoseconds=1),
            min_backward=Duration(nanoseconds=-1),
            on_clock_change=True,
        )
        self._jump = clock.create_jump_callback(threshold, post_callback=self._jumped)
        super().__init__(callback_group, close=self._jump.unregister, wake=wake)

    def _jumped(self, jump: Anything) -> None:
        # A change of the source, or a step back, begins a new period.
        now = self._clock.now_ns()
        if jump.clock_change != 1 or now < self._last_call:
            self._last_call = now
            self._next_call = now + self._period
        self.wake()

    @property
    def clock(self) -> Clock:
        """The clock that the timer follows."""
        return self._clock

    @property
    def timer_period_ns(self) -> int:
        """The time between two calls (ns)."""
        with self.handle:
            return self._period

    @timer_period_ns.setter
    def timer_period_ns(self, value: float) -> None:
        with self.handle:
            self._period = int(value)
        self.wake()

    def is_ready(self) -> bool:
        """Whether the timer is due."""
        with self.handle:
            return not self._is_canceled and self._next_call <= self._clock.now_ns()

    def is_canceled(self) -> bool:
        """Whether the timer is stopped: it was canceled, or was not started yet."""
        with self.handle:
            return self._is_canceled

    def cancel(self) -> None:
        """Stop calling the function until `reset` is called."""
        with self.handle:
            self._is_canceled = True

    def reset(self) -> None:
        """Start a new period now. A timer that was canceled runs again."""
        with self.handle:
            self._next_call = self._clock.now_ns() + self._period
            self._is_canceled = False
        self.wake()

    def time_since_last_call(self) -> int:
        """Return how long ago the last call was (ns)."""
        with self.handle:
            return self._clock.now_ns() - self._last_call

    def time_until_next_call(self) -> int | None:
        """Return the time until the next call (ns): negative if late, None if canceled."""
        with self.handle:
            return None if self._is_canceled else self._next_call - self._clock.now_ns()

    # for executors

    def is_ready_now(self) -> bool:
        """Whether the timer is due; False after `destroy`."""
        if self._is_canceled or self._handle.is_destroyed:
            return False
        return self._next_call <= self._clock.now_ns()

    def due_in(self) -> float | None:
        """The time until the timer is due (s); None if it is canceled or its clock is simulated."""
        if self._is_canceled or self._handle.is_destroyed or self._clock.is_told:
            return None
        return max(0.0, (self._next_call - self._clock.now_ns()) / 1e9)

    def take(self) -> Anything:
        """Plan the next call, and return the `TimerInfo` of the call that is due now."""
        with self._lock:  # two threads that spin must not call it twice for one beat
            if not self.is_ready_now():
                return NOTHING
            now = self._clock.now_ns()
            expected, self._last_call = self._next_call, now
            self._next_call = expected + self._period
            if self._next_call <= now:  # late: keep the phase, and skip what was missed
                missed = (now - expected) // self._period if self._period else 0
                self._next_call = expected + (missed + 1) * self._period if self._period else now
        return TimerInfo(
            expected_call_time=expected, actual_call_time=now, clock_type=self._clock.clock_type
        )

    async def run(self, taken: TimerInfo) -> None:
        """Call the timer's function."""
        wants_info = _info_parameter(self.callback)
        result = self.callback(**{wants_info: taken}) if wants_info else self.callback()
        if inspect.iscoroutine(result):
            await result

    def describe(self) -> str:
        """Return a description of this entity for a diagnostic message."""
        return f"the timer of {self._period / 1e9:g} s"


def _info_parameter(callback: Anything) -> str:
    """Return the name of the parameter that is annotated with `TimerInfo`; "" if there is none."""
    while isinstance(callback, partial):
        callback = callback.func
    annotations = getattr(callback, "__annotations__", None)
    if not annotations:
        return ""
    return next(
        (
            name
            for name, given in annotations.items()
            if name != "return" and (given is TimerInfo or str(given).endswith("TimerInfo"))
        ),
        "",
    )


class Rate:
    """Lets a thread sleep until the next call of a timer. `Node.create_rate` makes a rate.

    While a thread sleeps, another thread must spin the node.

    Args:
        timer: The timer. The rate replaces the timer's callback.
        context: The context. Its shutdown wakes all threads that sleep.
    """

    def __init__(self, timer: Timer, *, context: Context) -> None:
        self._timer = timer
        self._beat = threading.Condition()
        self._beats = 0
        self._is_shutdown = False
        self._is_destroyed = False
        timer.callback = self._tick
        context.on_shutdown(self._shut_down)

    @property
    def timer(self) -> Timer:
        """The timer that wakes the sleeping threads."""
        return self._timer

    def _tick(self) -> None:
        with self._beat:
            self._beats += 1
            self._beat.notify_all()

    def _shut_down(self) -> None:
        with self._beat:
            self._is_shutdown = True
            self._beat.notify_all()

    def destroy(self) -> None:
        """Destroy the rate and its timer.

        In threads that sleep, `sleep` raises ROSInterruptException.
        """
        with self._beat:
            self._is_destroyed = True
            self._beat.notify_all()
        self._timer.destroy()

    def _check(self) -> None:
        if self._is_shutdown:
            raise ROSInterruptException
        if self._is_destroyed:
            raise ROSInterruptException("the rate was destroyed")
        if self._timer.handle.is_destroyed:
            raise InvalidHandle("cannot use Destroyable because destruction was requested")

    def sleep(self) -> None:
        """Sleep until the next call of the timer.

        Raises:
            ROSInterruptException: if the context is shut down, or the rate is destroyed.
        """
        with self._beat:
            self._check()
            before = self._beats
            while self._beats == before:
                self._beat.wait(0.5)  # a limit, because a signal cannot interrupt a lock everywhere
                self._check()
