"""What a turtle may be told to keep to."""

from __future__ import annotations

import math
import re

import msgspec
import pytest

from turtleact.actions.steering import Limits
from turtleact.errors import InvalidMessage

from ...tables import together


@together
@pytest.mark.parametrize(
    "name", ["max_linear", "max_angular", "tolerance", "heading_tolerance", "dt"]
)
@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan])
def test_a_limit_must_be_finite_and_above_zero(name, value):
    with pytest.raises(
        InvalidMessage, match=f"^{name}: must be finite and above zero, not {value}$"
    ):
        Limits(**{name: value})


def test_a_tick_must_not_turn_more_than_a_quarter():
    with pytest.raises(InvalidMessage, match=re.escape("dt: a tick may turn pi/2 rad at most")):
        Limits(max_angular=10.0, dt=0.2)


@pytest.mark.parametrize("name", ["max_acceleration", "max_angular_acceleration"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_an_acceleration_must_be_above_zero(name, value):
    with pytest.raises(InvalidMessage, match=f"^{name}: must be above zero, not {value}$"):
        Limits(**{name: value})


@pytest.mark.parametrize("name", ["max_acceleration", "max_angular_acceleration"])
def test_a_turtle_is_eased_if_one_acceleration_is_limited(name):
    assert msgspec.structs.replace(Limits(), **{name: 3.0}).is_eased
    assert not Limits().is_eased
