"""turtlesim's controller of rotate_absolute, against its own code and figures."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.sim.kinematics import DT, wrap
from turtleact.sim.turtle import Rotation

PI = 3.14159265
angles = st.floats(-PI, PI, exclude_max=True)


def normalize(angle):
    """``normalizeAngle`` of turtle.cpp."""
    return angle - 2.0 * PI * math.floor((angle + PI) / (2.0 * PI))


def run(target, theta=0.0, ticks=1000):
    """Turns until it is there; what was remaining in each tick, and the last delta."""
    rotation, remaining = Rotation(target, theta), []
    for _ in range(ticks):
        omega = rotation.tick(theta)
        remaining.append(rotation.remaining)
        if omega is None:
            break
        theta = wrap(theta + omega * DT)
    return remaining, rotation.delta, theta


@given(st.floats(-20.0, 20.0, width=32), angles, angles)
def test_a_tick_is_that_of_the_real_one(target, start, theta):
    rotation = Rotation(target, start)
    omega = rotation.tick(theta)
    wanted, now = normalize(target), float(np.float32(theta))
    assert rotation.remaining == pytest.approx(normalize(wanted - now), abs=1e-6)
    assert rotation.delta == pytest.approx(normalize(float(np.float32(start - theta))), abs=1e-6)
    if abs(normalize(now - wanted)) < 0.02:
        assert omega is None
    else:
        assert omega == (-1.0 if normalize(wanted - now) < 0.0 else 1.0)


def test_a_quarter_turn_takes_97_ticks_and_98_looks():
    remaining, delta, _ = run(1.57)
    assert (len(remaining), delta) == (98, float(np.float32(-1.552)))
    assert remaining[0] == float(np.float32(1.57))


def test_exactly_opposite_turns_right():
    remaining, delta, theta = run(math.pi)
    assert remaining[0] < 0.0
    assert delta == pytest.approx(3.136, abs=1e-6)
    assert theta < 0.0


@given(st.floats(-1e6, 1e6, width=32), angles)
def test_every_turn_ends_close_to_its_target(target, start):
    remaining, _, _ = run(target, start)
    assert len(remaining) < 200
    assert abs(remaining[-1]) < 0.02
