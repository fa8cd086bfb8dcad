"""rclpy in this process, on a graph that nobody else sees."""

from __future__ import annotations

import pytest

from turtleact.rclpy import toplevel as rclpy
from turtleact.rclpy.context import Context
from turtleact.rclpy.executors import SingleThreadedExecutor
from turtleact.rclpy.face import SETTINGS, JoinOptions


@pytest.fixture(autouse=True)
def _alone(monkeypatch):
    monkeypatch.setattr(SETTINGS, "place", JoinOptions(is_alone=True))


@pytest.fixture
def context():
    context = Context()
    context.init([])
    yield context
    context.try_shutdown()


@pytest.fixture
def node(context):
    return rclpy.create_node("lab", context=context)


@pytest.fixture
def executor(context, node):
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    yield executor
    executor.shutdown(0)
