"""Services and actions between rclpy and turtleact on one graph, and calls that nobody answers."""

from __future__ import annotations

import threading
from contextlib import asynccontextmanager
from typing import Any

import pytest

import turtleact
from turtleact.errors import InvalidMessage
from turtleact.interfaces import get_service
from turtleact.interfaces.standard import ExampleFibonacci
from turtleact.rclpy import toplevel as rclpy
from turtleact.rclpy.action import ActionClient, ActionServer
from turtleact.rclpy.context import PROCESS, Context
from turtleact.rclpy.exceptions import ROSInterruptException
from turtleact.rclpy.executors import SingleThreadedExecutor
from turtleact.rclpy.impl.entity import MutuallyExclusiveCallbackGroup
from turtleact.rclpy.messages import hash_of, interface_class
from turtleact.transports.base import Endpoint

from ..lab import free_endpoint

AddTwoInts = interface_class("example_interfaces/srv/AddTwoInts")
Fibonacci = interface_class("example_interfaces/action/Fibonacci")
Describe: Any = get_service("type_description_interfaces/srv/GetTypeDescription")
OurAddTwoInts: Any = get_service("example_interfaces/srv/AddTwoInts")


def add(request, response):
    response.sum = request.a + request.b
    return response


async def add_or_fail(request):
    if request.a < 0:
        raise ValueError("no negative numbers")
    return OurAddTwoInts.Response(sum=request.a + request.b)


async def fibonacci(goal):
    yield ExampleFibonacci.Feedback(sequence=[1])
    yield ExampleFibonacci.Result(sequence=[goal.order])


@pytest.fixture
def others(monkeypatch):
    """A node of turtleact on the graph of every context; call what it returns in its loop."""
    there: list[turtleact.Node] = []
    address = free_endpoint()

    @asynccontextmanager
    async def open_it(domain):
        async with (
            turtleact.open_zenoh([], listen=[address], mode="router", config={}) as far,
            turtleact.open_node("other", transport=far) as node,
        ):
            there.append(node)
            node.service(OurAddTwoInts, "add", add_or_fail)
            node.action_server(ExampleFibonacci, "fibonacci", fibonacci)
            async with turtleact.open_zenoh([address], config={}) as near:
                await near.explore()
                yield near

    monkeypatch.setattr(PROCESS, "open_transport", open_it)
    return there


def done(executor, future):
    executor.spin_until_future_complete(future, timeout_sec=5)
    return future.result()


def test_a_service_of_turtleact_answers_a_client_of_rclpy(others, node, executor):
    client = node.create_client(AddTwoInts, "add")
    assert client.wait_for_service(timeout_sec=5)
    assert done(executor, client.call_async(AddTwoInts.Request(a=2, b=3))).sum == 5


def test_a_request_that_fails_is_never_done_but_logged(others, node, executor, capsys):
    client = node.create_client(AddTwoInts, "add")
    assert client.wait_for_service(timeout_sec=5)
    future = client.call_async(AddTwoInts.Request(a=-1))
    assert done(executor, client.call_async(AddTwoInts.Request())).sum == 0
    assert not future.done()
    assert "/add sends no response" in capsys.readouterr().err


def test_a_server_of_turtleact_executes_a_goal_of_rclpy(others, node, executor):
    client = ActionClient(node, Fibonacci, "fibonacci")
    assert client.wait_for_server(timeout_sec=5)
    heard: list[Any] = []
    handle = done(executor, client.send_goal_async(Fibonacci.Goal(order=4), heard.append))
    response = done(executor, handle.get_result_async())
    assert (list(response.result.sequence), len(heard)) == ([4], 1)


def test_a_client_of_turtleact_uses_a_service_of_rclpy(others, node, executor):
    node.create_service(AddTwoInts, "sum", add)
    loop = node.connection.loop

    async def ask():
        client = others[0].service_client(OurAddTwoInts, "sum")
        await client.wait_for_service(timeout=5)
        return await client.call(OurAddTwoInts.Request(a=4, b=4), timeout=5)

    asked = loop.start(ask)
    while not asked.done():
        executor.spin_once(timeout_sec=0.01)
    assert asked.result().sum == 8


def test_a_node_describes_its_types_to_other_processes(others, node):
    node.create_client(AddTwoInts, "sum")

    async def ask():
        client = others[0].service_client(Describe, "/lab/get_type_description")
        await client.wait_for_service(timeout=5)
        return await client.call(
            Describe.Request(type_hash=hash_of("example_interfaces/srv/AddTwoInts"))
        )

    described = node.connection.loop.run(ask).type_description.type_description
    assert described.type_name == "example_interfaces/srv/AddTwoInts"


def test_a_node_describes_its_types_to_its_own_process(node, executor):
    describe = interface_class("type_description_interfaces/srv/GetTypeDescription")
    client = node.create_client(describe, "/lab/get_type_description")
    wanted = hash_of("type_description_interfaces/srv/GetTypeDescription")
    assert done(executor, client.call_async(describe.Request(type_hash=wanted))).successful


def test_a_client_of_turtleact_sends_a_goal_to_rclpy(others, node, executor):
    def execute(goal_handle):
        goal_handle.publish_feedback(Fibonacci.Feedback(sequence=[8]))
        goal_handle.succeed()
        return Fibonacci.Result(sequence=[9])

    ActionServer(node, Fibonacci, "count", execute)

    async def ask():
        client = others[0].action_client(ExampleFibonacci, "count")
        await client.wait_for_server(timeout=5)
        async with client.send_goal(ExampleFibonacci.Goal(order=1)) as goal:
            feedback = [list(each.sequence) async for each in goal]
            return feedback, list((await goal.result()).sequence)

    asked = node.connection.loop.start(ask)
    while not asked.done():
        executor.spin_once(timeout_sec=0.01)
    assert asked.result() == ([[8]], [9])


def test_a_call_that_nobody_answers_times_out(node):
    client = node.create_client(AddTwoInts, "nothing")
    with pytest.raises(TimeoutError):
        client.call(AddTwoInts.Request(), timeout_sec=0.01)
    assert not client.wait_for_service(timeout_sec=0.03)
    future = client.call_async(AddTwoInts.Request())
    number = 2  # the second request
    assert client.get_pending_request(number) is future
    client.remove_pending_request(future)
    with pytest.raises(KeyError):
        client.get_pending_request(number)


def test_a_request_of_another_class_is_refused(node):
    client = node.create_client(AddTwoInts, "add")
    with pytest.raises(TypeError, match=r"Expected .*AddTwoInts_Request"):
        client.call_async(AddTwoInts.Response())


def test_a_shutdown_ends_a_call(node, context, monkeypatch):
    monkeypatch.setattr("turtleact.rclpy.impl.entity.PATIENCE", 0.01)
    client = node.create_client(AddTwoInts, "nothing")
    threading.Timer(0.02, context.shutdown).start()
    with pytest.raises(ROSInterruptException):
        client.call(AddTwoInts.Request())


@pytest.mark.parametrize("is_held", [False, True])
def test_a_call_whose_answer_nobody_handles_says_why(node, context, monkeypatch, capsys, is_held):
    monkeypatch.setattr("turtleact.rclpy.impl.entity.PATIENCE", 0.01)
    monkeypatch.setattr("turtleact.rclpy.impl.entity.BLOCKED_AFTER", 0.02)
    server = rclpy.create_node("server", context=context)
    server.create_service(AddTwoInts, "add", add)
    group = MutuallyExclusiveCallbackGroup()
    client = node.create_client(AddTwoInts, "add", callback_group=group)
    if is_held:
        holder = node.create_guard_condition(print, callback_group=group)
        assert group.beginning_execution(holder)
    serving = SingleThreadedExecutor(context=context)
    serving.add_node(server)
    threading.Thread(target=serving.spin_once, daemon=True).start()
    with pytest.raises(TimeoutError):
        client.call(AddTwoInts.Request(), timeout_sec=0.2)
    said = capsys.readouterr().err
    why = "held by a guard condition" if is_held else "nobody spins the node"
    assert "call() of /add has waited" in said
    assert why in said


def test_a_request_that_cannot_be_read_is_refused_and_logged(node, executor, capsys):
    node.create_service(AddTwoInts, "add", add)
    caller = node.connection.join(Endpoint("client", "/add", AddTwoInts.type_name, "/lab"))
    called = node.connection.loop.start(lambda: caller.call(b"\0\1\0\0"))
    executor.spin_once(timeout_sec=5)
    assert isinstance(called.exception(5), InvalidMessage)
    assert "a request to /add cannot be read" in capsys.readouterr().err


def test_a_coroutine_may_answer_a_request(node, executor):
    async def add_later(request, response):
        return add(request, response)

    node.create_service(AddTwoInts, "add", add_later)
    client = node.create_client(AddTwoInts, "add")
    assert done(executor, client.call_async(AddTwoInts.Request(a=1, b=1))).sum == 2


def test_a_client_and_a_service_are_context_managers(node):
    with (
        node.create_service(AddTwoInts, "add", add) as service,
        node.create_client(AddTwoInts, "add") as client,
    ):
        assert client.service_is_ready()
    assert client.handle.is_destroyed
    assert service.handle.is_destroyed


def test_two_contexts_share_a_graph_until_both_are_shut_down(others):
    first, second = Context(), Context()
    first.init([])
    second.init([])
    assert first.connection is second.connection
    first.shutdown()
    node = rclpy.create_node("lab", context=second)
    assert node.wait_for_node("other", timeout=5)
    second.shutdown()
