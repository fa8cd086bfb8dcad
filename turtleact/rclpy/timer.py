"""Timers and rates.

A timer that is late calls its function once, however many calls were missed. Later calls follow the
original schedule. A timer with a simulated clock becomes due only when somebody sets the time of
the clock, for example with a message on ``/clock``.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from turtleact.rclpy.clock import Clock, ClockChange, JumpThreshold, TimeJump
from turtleact.rclpy.exceptions import RCLError, ROSInterruptException
from turtleact.rclpy.impl.entity import NOTHING, CallbackGroup, Entity, await_or_execute
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.time import ClockType, Duration, Time

if TYPE_CHECKING:
    from turtleact.rclpy.context import Context

__all__ = ["Rate", "Timer", "TimerInfo"]


class TimerInfo(NamedTuple):
    """When a timer's callback was due, and when it was called."""

    expected_call_time: Time
    actual_call_time: Time


class Timer(Entity):
    """Calls a function periodically. `Node.create_timer` makes a timer.

    Args:
        callback: The function to call. A parameter that is annotated with `TimerInfo` gets the
            `TimerInfo` of the call.
        callback_group: Decides when the callback may run.
        timer_period_ns: The time between two calls (ns).
        clock: The clock to follow.
        autostart: Whether the timer starts at once. Otherwise `reset` starts it.
        wake: Called when the timer may be due earlier than before.

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
        autostart: bool = True,
        wake: Callable[[], object] | None = None,
    ) -> None:
        if timer_period_ns < 0:
            raise RCLError(f"Failed to create timer: invalid period {timer_period_ns} ns")
        self.callback = callback
        self.clock = clock
        self._period = timer_period_ns
        self._last_call = clock.now_ns()
        self._next_call = self._last_call + timer_period_ns
        self._is_canceled = not autostart
        self._lock = threading.Lock()
        # A timer of simulated time must be looked at when that time changes.
        step = Duration(nanoseconds=1)
        threshold = JumpThreshold(min_forward=step, min_backward=step * -1)
        jump = clock.create_jump_callback(threshold, post_callback=self._jumped)
        super().__init__(callback_group, close=jump.unregister, wake=wake)

    def _jumped(self, jump: TimeJump) -> None:
        # A change of the source, or a step back, begins a new period.
        now = self.clock.now_ns()
        if jump.clock_change is not ClockChange.ROS_TIME_NO_CHANGE or now < self._last_call:
            self._last_call = now
            self._next_call = now + self._period
        self.wake()

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
            return self.is_ready_now()

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
            self._next_call = self.clock.now_ns() + self._period
            self._is_canceled = False
        self.wake()

    def time_since_last_call(self) -> int:
        """Return how long ago the last call was (ns)."""
        with self.handle:
            return self.clock.now_ns() - self._last_call

    def time_until_next_call(self) -> int | None:
        """Return the time until the next call (ns): negative if late, None if canceled."""
        with self.handle:
            return None if self._is_canceled else self._next_call - self.clock.now_ns()

    # for executors

    def is_ready_now(self) -> bool:
        """Whether the timer is due; False after `destroy`."""
        if self._is_canceled or self.handle.is_destroyed:
            return False
        return self._next_call <= self.clock.now_ns()

    def due_in(self) -> float | None:
        """The time until the timer is due (s); None if it is canceled or its clock is simulated."""
        if self._is_canceled or self.handle.is_destroyed or self.clock.is_told:
            return None
        return max(0.0, (self._next_call - self.clock.now_ns()) / 1e9)

    def take(self) -> Anything:
        """Plan the next call, and return the `TimerInfo` of the call that is due now."""
        with self._lock:  # two threads that spin must not call it twice for one beat
            if not self.is_ready_now():
                return NOTHING
            now = self.clock.now_ns()
            expected, self._last_call = self._next_call, now
            # A late timer keeps its phase, and skips what it has missed.
            missed = (now - expected) // self._period if self._period else 0
            self._next_call = expected + (missed + 1) * self._period if self._period else now
        kind = self.clock.clock_type
        return TimerInfo(_time(expected, kind), _time(now, kind))

    async def run(self, taken: TimerInfo) -> None:
        """Call the timer's function."""
        parameter = _info_parameter(self.callback)
        callback = partial(self.callback, **{parameter: taken}) if parameter else self.callback
        await await_or_execute(callback)

    def describe(self) -> str:
        """Return a description of this entity for a diagnostic message."""
        return f"the timer of {self._period / 1e9:g} s"


def _time(nanoseconds: int, kind: ClockType) -> Time:
    return Time(nanoseconds=nanoseconds, clock_type=kind)


def _info_parameter(callback: Anything) -> str:
    """Return the name of the parameter that is annotated with `TimerInfo`; "" if there is none."""
    while isinstance(callback, partial):
        callback = callback.func
    annotations = getattr(callback, "__annotations__", {})
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
        self.timer = timer
        self._beat = threading.Condition()
        self._beats = 0
        self._end = ""
        timer.callback = self._tick
        context.on_shutdown(self._shut_down)

    def _tick(self) -> None:
        with self._beat:
            self._beats += 1
            self._beat.notify_all()

    def _shut_down(self) -> None:
        self._stop("the context was shut down")

    def destroy(self) -> None:
        """Destroy the rate and its timer.

        In threads that sleep, `sleep` raises ROSInterruptException.
        """
        self._stop("the rate was destroyed")
        self.timer.destroy()

    def _stop(self, reason: str) -> None:
        with self._beat:
            self._end = reason
            self._beat.notify_all()

    def _check(self) -> None:
        if self._end:
            raise ROSInterruptException(self._end)
        self.timer.handle.check()

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
