"""Speeds that change no faster than they may."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.actions.steering.limits import ramp, ramp_time, stopping_speed

lengths = st.floats(0.0, 100.0)
accelerations = st.floats(0.01, 1000.0)
ticks = st.floats(0.001, 0.5)


@given(st.floats(-10, 10), st.floats(-10, 10), st.floats(0.0, 5.0))
def test_a_ramp_comes_as_near_as_it_may(wanted, now, most):
    speed = ramp(wanted, now, most)
    assert abs(speed - now) <= most * (1 + 1e-12) + 1e-12
    assert speed == wanted or abs(wanted - now) >= most


def test_a_ramp_to_rest_ends_at_exactly_zero():
    speed = 0.1
    for _ in range(4):
        speed = ramp(0.0, speed, 0.03)
    assert speed == 0.0


@given(lengths, accelerations, ticks)
def test_from_the_stopping_speed_it_is_possible_to_stop_in_the_room(room, acceleration, dt):
    speed, left = stopping_speed(room, acceleration, dt), room
    while speed > 0.0:
        left -= speed * dt
        speed = max(0.0, speed - acceleration * dt)
    assert left >= -1e-9 * max(1.0, room)


@given(st.floats(0.01, 10.0), st.floats(0.1, 20.0))
def test_whoever_keeps_to_the_stopping_speed_arrives(room, acceleration):
    dt, left, steps = 0.016, room, 0
    while left > 1e-6:
        left -= stopping_speed(left, acceleration, dt) * dt
        steps += 1
        assert steps * dt <= 2.0 * math.sqrt(2.0 * room / acceleration) + 10 * dt


@given(lengths, st.floats(0.1, 10.0), accelerations)
def test_the_ramp_time_is_that_of_ticks_made_small(length, speed, acceleration):
    dt, now, left, time = 1e-3 * (1.0 + length / speed), 0.0, length, 0.0
    while left > 0.0:
        now = ramp(speed, now, acceleration * dt)
        left -= now * dt
        time += dt
    assert ramp_time(length, speed, acceleration) == pytest.approx(time, rel=0.05, abs=3 * dt)


@pytest.mark.parametrize("acceleration", [0.5, math.inf])
def test_no_way_takes_no_time(acceleration):
    assert ramp_time(0.0, 2.0, acceleration) == 0.0
    assert stopping_speed(0.0, acceleration, 0.016) == 0.0
