"""Definitions as flat fields."""

from __future__ import annotations

from typing import Any

from turtleact.doctor.checks import fields_of
from turtleact.interfaces import implied, load_interface

from ..lab import Count


def test_lists_and_the_parts_of_services_are_in_the_path():
    assert fields_of(implied(Count).send_goal) == {
        "request.goal_id.uuid[]": "uint8[16]",
        "request.goal.upto": "int32",
        "response.accepted": "bool",
        "response.stamp.sec": "int32",
        "response.stamp.nanosec": "uint32",
    }


def test_bounds_belong_to_the_type():
    text = "string<=5 short\nstring[<=3] few\nint8[2] two\nwstring[] wide\n"
    mixed: Any = load_interface(text, type_name="lab_interfaces/msg/Mixed")
    assert fields_of(mixed) == {
        "short": "string<=5",
        "few[]": "string[<=3]",
        "two[]": "int8[2]",
        "wide[]": "wstring[]",
    }
