"""The page has a form for any action of the graph, because it learns the types."""

from __future__ import annotations

from typing import Any

import pytest

import turtleact
from turtleact.interfaces.standard import Fibonacci
from turtleact.transports import MemoryTransport
from turtleact.web import open_bridge
from turtleact.web.name_lookup import action_class, class_of_action
from turtleact.web.rosapi import typedefs

from ..lab import take_turns
from ..registry import isolated_registry
from ..robots import Robot, write_package


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with isolated_registry():
        yield


async def test_an_action_that_appears_later_gets_a_form(tmp_path):
    transport = MemoryTransport()
    async with turtleact.open_node("web", transport=transport) as node, open_bridge(node):
        await take_turns()
        robot = Robot(transport, write_package(tmp_path))
        with pytest.raises(turtleact.UnknownInterface):
            action_class("robot_msgs/Dig")
        robot.serve_action("/dig", "robot_msgs/action/Dig")
        for _ in range(10):
            await take_turns()
        fields = typedefs(action_class("robot_msgs/Dig").Goal)[0]["fieldnames"]
        assert fields == ["depth", "speed", "where", "tools"]


async def test_a_form_has_the_fields_that_the_robots_definition_has(tmp_path):
    changed = tmp_path / "action_tutorials_interfaces"
    (changed / "action").mkdir(parents=True)
    text = "int32 order\nstring why\n---\nint32[] sequence\n---\nint32[] partial_sequence\n"
    (changed / "action" / "Fibonacci.action").write_text(text)
    transport = MemoryTransport()
    type_name = Fibonacci.type_name
    async with turtleact.open_node("web", transport=transport) as node, open_bridge(node):
        Robot(transport, changed).serve_action("/theirs", type_name)
        for _ in range(10):
            await take_turns()
        theirs, ours = (class_of_action(node, name, type_name) for name in ("/theirs", "/ours"))
        goal: Any = theirs.Goal(why="so")
        assert goal.why == "so"
        assert ours is Fibonacci
