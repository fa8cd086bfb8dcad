"""What the page shows of a message is bounded, and JSON can write it."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from turtleact.interfaces import Message, array, bool_, float64, int64, string, uint8
from turtleact.interfaces.standard import Point, Twist, Vector3
from turtleact.web.page_values import (
    LONGEST_TEXT,
    MOST_ITEMS,
    MOST_PLOTTED,
    excerpt,
    numbers_in,
)


class Mixed(Message, type_name="lab_interfaces/msg/Mixed"):
    text: string = ""
    big: int64 = 0
    flag: bool_ = False
    inner: Twist = Twist()
    places: list[Point] = []
    key: array[list[uint8], 3] = [0, 0, 0]
    from_: float64 = 0.0


def array_of(*numbers: int) -> Any:
    """A uint8 array as the codec gives it."""
    return bytes(numbers)


def plain(message: Message) -> dict[str, Any]:
    values: Any = excerpt(message)
    return dict(values)


@pytest.mark.parametrize(
    ("message", "name", "shown"),
    [
        (Mixed(text="a"), "text", "a"),
        (Mixed(text="ab" * LONGEST_TEXT), "text", f"{'ab' * (LONGEST_TEXT // 2)}… 1000 more"),
        (Mixed(big=2**53), "big", 2**53),
        (Mixed(big=-(2**60)), "big", str(-(2**60))),
        (Mixed(flag=True), "flag", True),
        (Mixed(places=[Point(1.0)]), "places", [{"x": 1.0, "y": 0.0, "z": 0.0}]),
        (Mixed(key=array_of(1, 2, 3)), "key", [1, 2, 3]),
        (Mixed(from_=2.0), "from", 2.0),
    ],
)
def test_a_value_is_shown(message, name, shown):
    assert plain(message)[name] == shown


def test_a_long_list_is_cut_and_says_so():
    class Long(Message, type_name="lab_interfaces/msg/Long"):
        numbers: list[float64] = []

    many: Any
    for many in ([0.0] * 10_000, np.zeros(10_000)):
        shown = plain(Long(many))["numbers"]
        assert len(shown) == MOST_ITEMS + 1
        assert shown[-1] == f"… {10_000 - MOST_ITEMS} more"
        assert msgspec.json.encode(shown)


def test_numbers_are_those_outside_of_lists_the_outermost_first():
    twist = Twist(linear=Vector3(1.0, 2.0, 3.0))
    found = dict(numbers_in(Mixed(big=7, inner=twist, from_=0.5)))
    assert list(found.items())[:3] == [("big", 7), ("from", 0.5), ("inner.linear.x", 1.0)]
    assert len(found) == MOST_PLOTTED
