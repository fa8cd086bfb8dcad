"""An ordinary rclpy program that measures the rclpy it imports; ``bench_rclpy`` runs it.

It prints one line of JSON.
"""

import json
import time
from collections.abc import Callable
from importlib import import_module
from typing import Any

BEGAN = time.perf_counter()

import rclpy  # noqa: E402  # the import is part of what is measured
from rclpy.action import ActionClient, ActionServer  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402

String = import_module("std_msgs.msg").String
try:
    Fibonacci = import_module("example_interfaces.action").Fibonacci
    AddTwoInts = import_module("example_interfaces.srv").AddTwoInts
except ImportError:  # the wheels have neither, but others with the same fields
    Fibonacci = import_module("test_msgs.action").Fibonacci
    AddTwoInts = import_module("test_msgs.srv").BasicTypes

IDLE = 2.0
"""How long an idle node spins (s)."""


def succeed(goal_handle: Any) -> Any:  # noqa: ANN401  # rclpy has no types
    goal_handle.succeed()
    return Fibonacci.Result()


def rate(act: Callable[[], object], times: int) -> float:
    """How many times per second a function can be called."""
    for _ in range(10):
        act()
    began = time.perf_counter()
    for _ in range(times):
        act()
    return times / (time.perf_counter() - began)


class Bench:
    """A node with both ends of a topic, a service and an action."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("bench")
        self.took = time.perf_counter() - BEGAN
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.heard = 0
        self.node.create_subscription(String, "ping", self.hear, 10)
        self.publisher = self.node.create_publisher(String, "ping", 10)
        self.node.create_service(AddTwoInts, "add", lambda _, response: response)
        self.client = self.node.create_client(AddTwoInts, "add")
        self.server = ActionServer(self.node, Fibonacci, "fibonacci", succeed)
        self.actions = ActionClient(self.node, Fibonacci, "fibonacci")
        assert self.client.wait_for_service(5)
        assert self.actions.wait_for_server(5)
        time.sleep(1)  # DDS joins the topic's ends in the background

    def hear(self, _: object) -> None:
        self.heard += 1

    def ping(self) -> None:
        before, end = self.heard, time.perf_counter() + 1
        self.publisher.publish(String(data="x" * 50))
        while self.heard == before and time.perf_counter() < end:
            self.executor.spin_once(timeout_sec=1)

    def call(self) -> None:
        self.wait(self.client.call_async(AddTwoInts.Request()))

    def send_goal(self) -> None:
        handle = self.wait(self.actions.send_goal_async(Fibonacci.Goal(order=1)))
        self.wait(handle.get_result_async())

    def wait(self, future: Any) -> Any:  # noqa: ANN401  # rclpy has no types
        self.executor.spin_until_future_complete(future, timeout_sec=5)
        return future.result()

    def look(self) -> None:
        self.executor.spin_once(timeout_sec=0)

    def log(self) -> None:
        self.node.get_logger().info("a line of the log")

    def idle(self) -> float:
        """The share of a core that an idle spin takes (%)."""
        used, end = time.process_time(), time.perf_counter() + IDLE
        while time.perf_counter() < end:
            self.executor.spin_once(timeout_sec=0.5)
        return (time.process_time() - used) / IDLE * 100


def main() -> None:
    rclpy.init()
    bench = Bench()
    measured = {
        "import, init and node (s)": bench.took,
        "pings a second": rate(bench.ping, 2000),
        "service calls a second": rate(bench.call, 1000),
        "goals a second": rate(bench.send_goal, 400),
        "idle spin_once(0) (us)": 1e6 / rate(bench.look, 1000),
        "log line (us)": 1e6 / rate(bench.log, 1000),
        "idle spin (% of a core)": bench.idle(),
    }
    print(json.dumps(measured), flush=True)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
