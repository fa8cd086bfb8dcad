"""Eight threads do random things to one node; nobody may wait for ever."""

from __future__ import annotations

import itertools
import random
import threading
import time
from typing import Any

import pytest

from turtleact.rclpy import toplevel as rclpy
from turtleact.rclpy.action import ActionClient, ActionServer, CancelResponse
from turtleact.rclpy.context import Context
from turtleact.rclpy.exceptions import InvalidHandle, NotInitializedException
from turtleact.rclpy.executors import MultiThreadedExecutor
from turtleact.rclpy.impl.entity import ReentrantCallbackGroup
from turtleact.rclpy.messages import interface_class
from turtleact.rclpy.parameter import Parameter

AddTwoInts = interface_class("example_interfaces/srv/AddTwoInts")
Fibonacci = interface_class("example_interfaces/action/Fibonacci")
String = interface_class("std_msgs/msg/String")

THREADS = 8
PATIENCE = 10.0
"""After so long, a thread is taken to be in a deadlock (s)."""

GONE = (InvalidHandle, NotInitializedException)
"""What a thread gets if the context was shut down in the meantime."""


def add(request, response):
    response.sum = request.a + request.b
    return response


def count(goal_handle):
    for number in range(goal_handle.request.order):
        goal_handle.publish_feedback(Fibonacci.Feedback(sequence=[number]))
        if goal_handle.is_cancel_requested:
            goal_handle.canceled()
            return Fibonacci.Result()
        time.sleep(0.0002)
    goal_handle.succeed()
    return Fibonacci.Result(sequence=[goal_handle.request.order])


class Stress:
    """One node that all threads use, and what they do to it."""

    def __init__(self, seed):
        self.seed = seed
        self.errors = []
        self.numbers = itertools.count()
        self.context = Context()
        self.context.init([])
        self.node = rclpy.create_node("stress", context=self.context)
        self.group: dict[str, Any] = {"callback_group": ReentrantCallbackGroup()}
        self.node.create_service(AddTwoInts, "add", add, **self.group)
        self.node.create_subscription(String, "chatter", lambda _: None, 10, **self.group)
        self.publisher = self.node.create_publisher(String, "chatter", 10)
        cancels: dict[str, Any] = {"cancel_callback": lambda _: CancelResponse.ACCEPT}
        ActionServer(self.node, Fibonacci, "count", count, **cancels, **self.group)
        self.client = self.node.create_client(AddTwoInts, "add", **self.group)
        self.actions = ActionClient(self.node, Fibonacci, "count", **self.group)
        self.executor = MultiThreadedExecutor(4, context=self.context)
        self.executor.add_node(self.node)
        self.acts = (
            *(self.publish, self.call, self.send_goal, self.cancel_goal, self.subscribe),
            *(self.tick, self.open_node, self.set_parameter),
        )

    def publish(self, chance):
        self.publisher.publish(String(data="x" * chance.randrange(100)))

    def call(self, chance):
        a, b = chance.randrange(1000), chance.randrange(1000)
        response = self.client.call(AddTwoInts.Request(a=a, b=b), timeout_sec=PATIENCE)
        assert response is None or response.sum == a + b

    def send_goal(self, chance, *, is_canceled=False):
        goal = Fibonacci.Goal(order=chance.randrange(5))
        handle = self.waited(self.actions.send_goal_async(goal, feedback_callback=lambda _: None))
        if handle is None:
            return
        canceling = handle.cancel_goal_async() if is_canceled else None
        self.waited(handle.get_result_async())
        if canceling is not None:
            self.waited(canceling)

    def cancel_goal(self, chance):
        self.send_goal(chance, is_canceled=True)

    def subscribe(self, chance):
        subscription = self.node.create_subscription(
            String, "chatter", lambda _: None, chance.randrange(1, 5), **self.group
        )
        self.publisher.publish(String())
        self.node.destroy_subscription(subscription)

    def tick(self, chance):
        timer = self.node.create_timer(0.0005, lambda: None, **self.group)
        time.sleep(chance.random() * 0.001)
        self.node.destroy_timer(timer)

    def open_node(self, chance):
        node = rclpy.create_node(f"other{next(self.numbers)}", context=self.context)
        self.executor.add_node(node)
        node.create_publisher(String, "chatter", 1).publish(String())
        if chance.random() < 0.5:
            self.executor.remove_node(node)
        node.destroy_node()

    def set_parameter(self, chance):
        name = f"p{next(self.numbers)}"
        self.node.declare_parameter(name, 1)
        self.node.set_parameters([Parameter(name, value=chance.randrange(10))])

    def waited(self, future):
        """The result; None once the context is shut down."""
        end = time.monotonic() + PATIENCE
        while not future.done() and self.context.ok():
            assert time.monotonic() < end, "a future has not become done"
            time.sleep(0.0002)
        return future.result()

    def work(self, number, acts):
        chance = random.Random(f"{self.seed} {number}")
        try:
            for _ in range(acts):
                if not self.context.ok():
                    return
                chance.choice(self.acts)(chance)
        except GONE as error:
            if self.context.ok():
                self.errors.append(error)
        except Exception as error:
            if self.context.ok():
                self.errors.append(error)

    def run(self, acts, *, stops_midway):
        """Let all threads act so many times, and return the names of those that do not end."""
        spinning = threading.Thread(target=self.executor.spin, name="spin", daemon=True)
        threads = [
            threading.Thread(target=self.work, args=(n, acts), name=f"thread {n}", daemon=True)
            for n in range(THREADS)
        ]
        for thread in (spinning, *threads):
            thread.start()
        if stops_midway:
            time.sleep(random.Random(self.seed).random() * 0.2)
            self.context.shutdown()
        for thread in threads:
            thread.join(2 * PATIENCE)
        self.context.try_shutdown()
        spinning.join(PATIENCE)
        return [each.name for each in (spinning, *threads) if each.is_alive()]


@pytest.mark.parametrize(("seed", "stops_midway"), [(1, False), (2, True), (3, True)])
def test_threads_that_do_anything_to_a_node_never_wait_for_ever(seed, stops_midway):
    before = set(threading.enumerate())
    stress = Stress(seed)
    assert stress.run(40, stops_midway=stops_midway) == []
    assert stress.errors == []
    left = [each for each in set(threading.enumerate()) - before if not each.daemon]
    for thread in left:  # those of the executor, which end by themselves
        thread.join(PATIENCE)
    assert [each.name for each in left if each.is_alive()] == []
