"""What rclpy publishes about one goal with service introspection; run by the Python that has rclpy.

Prints one JSON object: for each service of the action, its events in order; and the type hashes of
the topics. Each event is its kind, its sequence number, and what it contains.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import rclpy
from rclpy.action import ActionClient, ActionServer
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.service_introspection import ServiceIntrospectionState
from test_msgs.action import Fibonacci

PATIENCE = 10.0
"""How long anything may take (s)."""

NO_PEER = 77
"""The exit status that says that rclpy does not find its own endpoints."""

EVENTS = 4
"""How many events each call has."""


def execute(handle: Any) -> Fibonacci.Result:
    """Count to one."""
    handle.succeed()
    return Fibonacci.Result(sequence=[1])


def main() -> int:
    """Send one goal with contents, and print the events."""
    rclpy.init()
    node = rclpy.create_node("lab")
    server = ActionServer(node, Fibonacci, "count", execute)
    client = ActionClient(node, Fibonacci, "count")
    qos = QoSProfile(depth=10)
    for end in (server, client):
        clock, state = node.get_clock(), ServiceIntrospectionState.CONTENTS
        end.configure_introspection(clock, qos, state)
    events: dict[str, list[Any]] = {"send_goal": [], "get_result": []}
    impl = Fibonacci.Impl
    services = {"send_goal": impl.SendGoalService, "get_result": impl.GetResultService}
    for name, service in services.items():
        topic = f"count/_action/{name}/_service_event"
        node.create_subscription(service.Event, topic, events[name].append, qos)
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def spin_until(condition: Any) -> bool:
        ends = time.monotonic() + PATIENCE
        while not condition() and time.monotonic() < ends:
            executor.spin_once(timeout_sec=0.05)
        return bool(condition())

    topics = [f"/count/_action/{name}/_service_event" for name in services]

    def all_are_found() -> bool:
        return all(node.count_publishers(each) == 2 for each in topics)

    if not (client.wait_for_server(PATIENCE) and spin_until(all_are_found)):
        return NO_PEER
    quiet = time.monotonic() + 0.5  # the ends find each other a little later
    spin_until(lambda: time.monotonic() > quiet)
    sent = client.send_goal_async(Fibonacci.Goal(order=1))
    spin_until(sent.done)
    asked = sent.result().get_result_async()
    spin_until(asked.done)
    spin_until(lambda: all(len(each) == EVENTS for each in events.values()))
    json.dump(
        {
            "events": {name: [said(each) for each in found] for name, found in events.items()},
            "hashes": {
                name: str(node.get_publishers_info_by_topic(topic)[0].topic_type_hash)
                for name, topic in zip(services, topics, strict=True)
            },
        },
        sys.stdout,
    )
    return 0


def said(event: Any) -> list[Any]:
    """An event, without what differs from run to run."""
    values = plain(event)
    for part in (*values["request"], *values["response"]):
        part.pop("goal_id", None)
        part.pop("stamp", None)
    info = values["info"]
    return [info["event_type"], info["sequence_number"], values["request"], values["response"]]


def plain(value: Any) -> Any:
    """A message as plain values."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bool | str):
        return value
    return [plain(each) for each in value] if hasattr(value, "__iter__") else int(value)


if __name__ == "__main__":
    sys.exit(main())
