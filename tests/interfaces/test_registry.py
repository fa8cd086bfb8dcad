from __future__ import annotations

from typing import Any

from turtleact.interfaces.registry import Registry
from turtleact.interfaces.types import Message, MessageMeta, definition, int32, int64


def declare(kind: object) -> Any:
    body = {"__annotations__": {"x": kind}}
    return MessageMeta("Sample", (Message,), body, type_name="example_msgs/msg/Sample")


def test_an_unknown_name_gives_none():
    assert Registry().get("example_msgs/msg/Sample") is None


def test_the_first_of_equal_classes_stays():
    registry, first, second = Registry(), declare(int32), declare(int32)
    registry.add(first, definition(first))
    assert registry.add(second, definition(second)) is first


def test_another_definition_takes_the_name_over():
    registry, first, second = Registry(), declare(int32), declare(int64)
    registry.add(first, definition(first))
    registry.add(second, definition(second))
    assert registry.get("example_msgs/msg/Sample") is second


def test_forgetting_drops_the_implied_types_too():
    registry, sample = Registry(), declare(int32)
    definitions = definition(sample)
    registry._known = {
        "example_msgs/msg/Sample": (sample, definitions),
        "example_msgs/msg/Sample_Part": (sample, definitions),
        "example_msgs/msg/SampleTwo": (sample, definitions),
    }
    registry.forget("example_msgs/msg/Sample")
    assert registry.names() == ["example_msgs/msg/SampleTwo"]
