"""Many threads use one node at the same time; nobody may wait for ever."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from turtleact.rclpy import toplevel as rclpy
from turtleact.rclpy.action import ActionClient, ActionServer, CancelResponse
from turtleact.rclpy.executors import MultiThreadedExecutor
from turtleact.rclpy.impl.entity import ReentrantCallbackGroup
from turtleact.rclpy.messages import interface_class

AddTwoInts = interface_class("example_interfaces/srv/AddTwoInts")
Fibonacci = interface_class("example_interfaces/action/Fibonacci")
String = interface_class("std_msgs/msg/String")

THREADS = 6
ROUNDS = 8
PATIENCE = 20.0
"""After so long, a thread is taken to be in a deadlock (s)."""


def add(request, response):
    response.sum = request.a + request.b
    return response


def count(goal_handle):
    for number in range(goal_handle.request.order):
        goal_handle.publish_feedback(Fibonacci.Feedback(sequence=[number]))
        if goal_handle.is_cancel_requested:
            goal_handle.canceled()
            return Fibonacci.Result()
    goal_handle.succeed()
    return Fibonacci.Result(sequence=[goal_handle.request.order])


class Users:
    """Threads that publish, call, send and cancel goals, and open and close what a node has."""

    def __init__(self, context):
        group: dict[str, Any] = {"callback_group": ReentrantCallbackGroup()}
        node = rclpy.create_node("stress", context=context)
        node.create_service(AddTwoInts, "add", add, **group)
        cancels: dict[str, Any] = {"cancel_callback": lambda _: CancelResponse.ACCEPT}
        ActionServer(node, Fibonacci, "count", count, **cancels, **group)
        self.group, self.node, self.context = group, node, context
        self.publisher = node.create_publisher(String, "chatter", 10)
        self.client = node.create_client(AddTwoInts, "add", **group)
        self.actions = ActionClient(node, Fibonacci, "count", **group)
        self.errors: list[BaseException] = []
        self.halfway = threading.Barrier(THREADS + 1)

    def one_round(self, number, executor):
        heard = self.node.create_subscription(String, "chatter", lambda _: None, 2, **self.group)
        timer = self.node.create_timer(0.0005, lambda: None, **self.group)
        self.publisher.publish(String(data="x" * number))
        assert self.client.call(AddTwoInts.Request(a=number, b=1), PATIENCE).sum == number + 1
        ended = self.actions.send_goal(Fibonacci.Goal(order=number))
        assert list(ended.result.sequence) == [number]
        self.cancel_a_goal()
        other = rclpy.create_node(f"other{number}", context=self.context)
        executor.add_node(other)
        other.destroy_node()
        self.node.destroy_timer(timer)
        self.node.destroy_subscription(heard)

    def cancel_a_goal(self):
        answered = threading.Event()
        sent = self.actions.send_goal_async(Fibonacci.Goal(order=3), lambda _: None)
        sent.add_done_callback(lambda _: answered.set())
        while self.context.ok() and not answered.wait(0.05):
            pass
        sent.result().cancel_goal()
        sent.result().get_result()

    def work(self, number, executor):
        try:
            for each in range(ROUNDS):
                if each == ROUNDS // 2:
                    self.halfway.wait(PATIENCE)
                self.one_round(number, executor)
        except Exception as error:
            if self.context.ok():
                self.errors.append(error)


@pytest.mark.parametrize("stops_midway", [False, True])
def test_threads_that_use_one_node_never_wait_for_ever(context, stops_midway):
    before = set(threading.enumerate())
    users = Users(context)
    executor = MultiThreadedExecutor(4, context=context)
    executor.add_node(users.node)
    threads = [
        threading.Thread(target=users.work, args=(number, executor), daemon=True)
        for number in range(THREADS)
    ]
    spinning = threading.Thread(target=executor.spin, daemon=True)
    for thread in (spinning, *threads):
        thread.start()
    users.halfway.wait(PATIENCE)
    if stops_midway:
        context.shutdown()
    for thread in threads:
        thread.join(PATIENCE)
    context.try_shutdown()
    spinning.join(PATIENCE)
    pool = [each for each in set(threading.enumerate()) - before if not each.daemon]
    for thread in pool:  # those of the executor, which end by themselves
        thread.join(PATIENCE)
    assert users.errors == []
    assert not any(each.is_alive() for each in (spinning, *threads, *pool))
