"""Nodes of rclpy and nodes of turtleact in one process, on one graph over Zenoh."""

import socket
import threading

import anyio
import pytest

import turtleact
from turtleact.interfaces.standard import ExampleFibonacci
from turtleact.rclpy import toplevel as rclpy
from turtleact.rclpy.action import ActionServer
from turtleact.rclpy.context import Context
from turtleact.rclpy.face import SETTINGS, JoinOptions
from turtleact.rclpy.messages import interface_class
from turtleact.transports import ZenohTransport

pytestmark = pytest.mark.loops("asyncio")

Fibonacci = interface_class("example_interfaces/action/Fibonacci")


@pytest.fixture
def address(monkeypatch):
    """A free address, which rclpy connects to."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    monkeypatch.setattr(SETTINGS, "place", JoinOptions((address,)))
    return address


async def fibonacci(goal):
    yield ExampleFibonacci.Feedback(sequence=[goal.order])
    yield ExampleFibonacci.Result(sequence=[goal.order, goal.order])


def serve_fibonacci():
    """What an rclpy program with a server of its own does."""
    context = Context()
    context.init([])
    try:
        node = rclpy.create_node("guest", context=context)
        ActionServer(node, Fibonacci, "fibonacci", lambda handle: Fibonacci.Result()).destroy()
        ActionServer(node, Fibonacci, "other", lambda handle: Fibonacci.Result()).destroy()
    finally:
        context.shutdown()


async def test_a_server_says_that_a_built_in_action_makes_way_for_it(address, capfd):
    async with (
        turtleact.open_zenoh([], listen=[address], mode="router", config={}) as graph,
        turtleact.open_node("turtle_actions", transport=graph) as node,
    ):
        node.action_server(ExampleFibonacci, "fibonacci", fibonacci, on_conflict="withdraw")
        await graph.flush()
        await anyio.to_thread.run_sync(serve_fibonacci)
    told = [line for line in "".join(capfd.readouterr()).splitlines() if "guest" in line]
    assert [line.partition("]: ")[2] for line in told] == [
        "/fibonacci: the built-in action makes way for this one"
    ]


async def test_a_node_does_not_wait_until_the_graph_is_explored(address, monkeypatch):
    made = threading.Event()
    explore = ZenohTransport.explore

    async def explore_later(self):
        while not made.is_set():
            await anyio.sleep(0.001)
        await explore(self)

    def look():
        context = Context()
        context.init([])
        try:
            node = rclpy.create_node("guest", context=context)
            made.set()
            return node.get_node_names()
        finally:
            context.shutdown()

    async with (
        turtleact.open_zenoh([], listen=[address], mode="router", config={}) as graph,
        turtleact.open_node("server", transport=graph),
    ):
        await graph.flush()
        monkeypatch.setattr(ZenohTransport, "explore", explore_later)
        assert sorted(await anyio.to_thread.run_sync(look)) == ["guest", "server"]
