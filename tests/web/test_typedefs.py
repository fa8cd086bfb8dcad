"""Interfaces as rosapi describes them."""

from __future__ import annotations

from typing import Any

from turtleact.interfaces.standard import UUID, GoalStatusMessage, Twist
from turtleact.web.name_lookup import action_class
from turtleact.web.rosapi import typedefs


def test_a_message_is_described_with_the_messages_in_it():
    assert typedefs(Twist) == [
        {
            "type": "geometry_msgs/Twist",
            "fieldnames": ["linear", "angular"],
            "fieldtypes": ["geometry_msgs/Vector3", "geometry_msgs/Vector3"],
            "fieldarraylen": [-1, -1],
            "examples": ["{}", "{}"],
            "constnames": [],
            "constvalues": [],
        },
        {
            "type": "geometry_msgs/Vector3",
            "fieldnames": ["x", "y", "z"],
            "fieldtypes": ["float64", "float64", "float64"],
            "fieldarraylen": [-1, -1, -1],
            "examples": ["0.0", "0.0", "0.0"],
            "constnames": [],
            "constvalues": [],
        },
    ]


def test_a_list_has_its_length_if_that_is_fixed():
    (described,) = typedefs(UUID)
    assert (described["fieldtypes"], described["fieldarraylen"]) == (["uint8"], [16])
    (described,) = typedefs(action_class("example_interfaces/Fibonacci").Result)
    assert (described["fieldarraylen"], described["examples"]) == ([0], ["[]"])


def test_constants_are_described():
    described: Any = typedefs(GoalStatusMessage)[0]
    assert (
        dict(zip(described["constnames"], described["constvalues"], strict=True))[
            "STATUS_EXECUTING"
        ]
        == "2"
    )
