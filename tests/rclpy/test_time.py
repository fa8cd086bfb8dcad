"""Clocks, timers, rates and the source of time."""

from __future__ import annotations

import threading
from functools import partial
from typing import Any

import pytest

from turtleact.rclpy.clock import Clock, ClockChange, JumpThreshold, ROSClock, TimeSource
from turtleact.rclpy.exceptions import (
    InvalidHandle,
    NotInitializedException,
    RCLError,
    ROSInterruptException,
)
from turtleact.rclpy.messages import interface_class
from turtleact.rclpy.parameter import Parameter
from turtleact.rclpy.time import ClockType, Duration, Time
from turtleact.rclpy.timer import TimerInfo

ClockMessage = interface_class("rosgraph_msgs/msg/Clock")
TimeMessage = interface_class("builtin_interfaces/msg/Time")
SECOND = 1_000_000_000
WRONG: Any = 1


def at(seconds: float, clock_type: ClockType = ClockType.ROS_TIME) -> Time:
    return Time(seconds=seconds, clock_type=clock_type)


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda: Clock(clock_type=WRONG), TypeError),
        (lambda: ROSClock().set_ros_time_override(WRONG), TypeError),
    ],
)
def test_what_cannot_be(make, error):
    with pytest.raises(error):
        make()


# --- clocks -------------------------------------------------------------------------------------


def test_a_clock_of_ros_time_is_a_ros_clock():
    assert isinstance(Clock(clock_type=ClockType.ROS_TIME), ROSClock)
    assert type(Clock()) is Clock
    assert Clock(clock_type=ClockType.STEADY_TIME).now() > at(0, ClockType.STEADY_TIME)
    assert "SYSTEM_TIME" in repr(Clock())


def test_a_told_clock_stands_until_it_is_told_and_jumps():
    clock = ROSClock()
    seen: list[Any] = []
    clock.set_ros_time_override(at(5))
    threshold = JumpThreshold(
        min_forward=Duration(seconds=2), min_backward=Duration(seconds=-2), on_clock_change=True
    )
    with clock.create_jump_callback(
        threshold, pre_callback=lambda: seen.append("pre"), post_callback=seen.append
    ):
        clock.activate(is_told=True)
        clock.activate(is_told=True)
        assert clock.ros_time_is_active
        assert seen[1].clock_change is ClockChange.ROS_TIME_ACTIVATED
        clock.set_ros_time_override(at(6))
        assert (clock.now(), len(seen)) == (at(6), 2)
        clock.set_ros_time_override(at(1))
        assert seen[3].delta == Duration(seconds=-5)
    clock.set_ros_time_override(at(100))
    assert len(seen) == 4


def test_a_jump_needs_a_callback():
    threshold = JumpThreshold(min_forward=Duration(seconds=1), min_backward=None)
    with pytest.raises(ValueError, match="callback"):
        ROSClock().create_jump_callback(threshold)
    for name in ("pre_callback", "post_callback"):
        with pytest.raises(ValueError, match=name):
            ROSClock().create_jump_callback(threshold, **{name: WRONG})


def test_a_sleep_ends_when_its_time_has_come_or_the_context_ends(context):
    clock = ROSClock()
    assert clock.sleep_for(Duration(nanoseconds=1000), context)
    clock.activate(is_told=True)
    woken: list[bool] = []
    sleeping = threading.Thread(target=lambda: woken.append(clock.sleep_until(at(5), context)))
    sleeping.start()
    clock.set_ros_time_override(at(5))
    sleeping.join(5)
    assert woken == [True]
    with pytest.raises(ValueError, match="type"):
        clock.sleep_until(Time(), context)
    sleeping = threading.Thread(target=lambda: woken.append(clock.sleep_until(at(9), context)))
    sleeping.start()
    context.shutdown()
    sleeping.join(5)
    assert woken == [True, False]
    with pytest.raises(NotInitializedException):
        clock.sleep_until(at(5), context)


def test_simulated_time_comes_from_a_topic(node, executor):
    node.set_parameters([Parameter("use_sim_time", value=True)])
    publisher = node.create_publisher(ClockMessage, "/clock", 1)
    publisher.publish(ClockMessage(clock=TimeMessage(sec=42)))
    executor.spin_once(timeout_sec=1)
    assert node.get_clock().now() == at(42)
    refused = node.set_parameters([Parameter("use_sim_time", value=1)])[0]
    assert not refused.successful
    node.set_parameters([Parameter("use_sim_time", value=False)])
    assert node.get_clock().now() > at(1000)


def test_a_time_source_follows_one_node_and_tells_new_clocks(node):
    source = TimeSource(node=node)
    assert not source.ros_time_is_active
    source.ros_time_is_active = True
    source.clock_callback(ClockMessage(clock=TimeMessage(sec=7)))
    clock = ROSClock()
    source.attach_clock(clock)
    assert clock.now() == at(7)
    source.attach_node(node)
    source.detach_node()
    with pytest.raises(ValueError, match="ROS_TIME"):
        source.attach_clock(Clock())
    with pytest.raises(TypeError):
        source.attach_node(WRONG)


# --- timers and rates ---------------------------------------------------------------------------


@pytest.fixture
def told(node):
    """The clock of the node, told by the test."""
    clock = ROSClock()
    clock.activate(is_told=True)
    return clock


def test_a_timer_keeps_its_phase_and_skips_what_it_missed(node, executor, told):
    seen: list[TimerInfo] = []

    def note(info: TimerInfo) -> None:
        seen.append(info)

    timer = node.create_timer(1.0, partial(note), clock=told)
    assert (timer.is_ready(), timer.time_until_next_call()) == (False, SECOND)
    told.set_ros_time_override(at(3.5))
    assert timer.is_ready()
    executor.spin_once(timeout_sec=0)
    executor.spin_once(timeout_sec=0)
    (info,) = seen
    assert (info.expected_call_time, info.actual_call_time) == (at(1), at(3.5))
    assert timer.time_until_next_call() == SECOND // 2
    assert timer.time_since_last_call() == 0


def test_a_timer_is_canceled_and_reset(node, executor, told):
    calls: list[int] = []
    timer = node.create_timer(1.0, lambda: calls.append(1), clock=told, autostart=False)
    assert timer.is_canceled()
    assert timer.time_until_next_call() is None
    told.set_ros_time_override(at(5))
    executor.spin_once(timeout_sec=0)
    timer.reset()
    timer.timer_period_ns = 2 * SECOND
    assert timer.timer_period_ns == 2 * SECOND
    told.set_ros_time_override(at(6))
    executor.spin_once(timeout_sec=0)
    assert calls == [1]
    with timer:
        assert timer.clock is told
    with pytest.raises(InvalidHandle):
        timer.is_ready()
    assert node.destroy_timer(timer)


def test_a_step_back_begins_a_new_period(node, executor, told):
    calls = []
    told.set_ros_time_override(at(100))
    timer = node.create_timer(1.0, lambda: calls.append(1), clock=told)
    told.set_ros_time_override(at(10))
    executor.spin_once(timeout_sec=0)
    assert (calls, timer.time_until_next_call()) == ([], SECOND)


def test_a_period_cannot_be_negative(node):
    with pytest.raises(RCLError, match="period"):
        node.create_timer(-1.0, lambda: None)
    for frequency in (0.0, -1.0):
        with pytest.raises(ValueError, match="frequency"):
            node.create_rate(frequency)


def test_a_rate_lets_a_thread_sleep_until_the_next_beat(node, executor):
    rate = node.create_rate(1000.0)
    beaten = threading.Thread(target=rate.sleep)
    beaten.start()
    while beaten.is_alive():
        executor.spin_once(timeout_sec=0.01)
    node.destroy_rate(rate)
    with pytest.raises(ROSInterruptException):
        rate.sleep()


def test_a_shutdown_wakes_a_rate(context, node):
    rate, raised = node.create_rate(0.001), []

    def sleep() -> None:
        try:
            rate.sleep()
        except ROSInterruptException as error:
            raised.append(error)

    sleeping = threading.Thread(target=sleep)
    sleeping.start()
    context.shutdown()
    sleeping.join(5)
    assert len(raised) == 1
