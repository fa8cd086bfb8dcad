"""The events of one goal, beside those that rclpy's own client and server publish."""

from __future__ import annotations

from typing import Any

import turtleact
from turtleact.goals.service_server import EVENT_QOS
from turtleact.interfaces import Action, Message, implied, int32, to_dict, type_hash
from turtleact.interfaces.classes import event_message
from turtleact.names import event_topic

from .conftest import Ros


class Fibonacci(Action, type_name="test_msgs/action/Fibonacci"):
    """The action that rclpy's wheels have."""

    class Goal(Message):
        order: int32 = 0

    class Result(Message):
        sequence: list[int32] = []

    class Feedback(Message):
        sequence: list[int32] = []


async def execute(_: Fibonacci.Goal) -> Fibonacci.Result:
    return Fibonacci.Result(sequence=[1])


async def test_a_goal_is_published_as_by_rclpy(ros: Ros):
    theirs = ros.run("ros_introspection.py")
    kinds = implied(Fibonacci)
    services: dict[str, Any] = {"send_goal": kinds.send_goal, "get_result": kinds.get_result}
    async with turtleact.open_node("lab") as node:
        node.introspection = "contents"
        node.action_server(Fibonacci, "count", execute)
        topics = {name: event_topic(f"/count/_action/{name}") for name in services}
        readers = {
            name: node.subscription(event_message(service), topics[name], EVENT_QOS)
            for name, service in services.items()
        }
        await node.action_client(Fibonacci, "count").send_goal(Fibonacci.Goal(order=1))
        ours = {name: [said(each) for each in reader.drain()] for name, reader in readers.items()}
    assert ours == theirs["events"]
    hashes = {name: type_hash(event_message(service)) for name, service in services.items()}
    assert hashes == theirs["hashes"]


def said(event: Any) -> list[Any]:
    """An event as ``ros_introspection.py`` prints it."""
    values: Any = to_dict(event)
    for part in (*values["request"], *values["response"]):
        part.pop("goal_id", None)
        part.pop("stamp", None)
    info = values["info"]
    return [info["event_type"], info["sequence_number"], values["request"], values["response"]]
