"""Nodes of rclpy and nodes of turtleact in one process, on one graph over Zenoh."""

import socket
import threading

import anyio
import pytest

import turtleact
from turtleact.rclpy import toplevel as rclpy
from turtleact.rclpy.context import Context
from turtleact.rclpy.face import SETTINGS, JoinOptions
from turtleact.transports import ZenohTransport

pytestmark = pytest.mark.loops("asyncio")


@pytest.fixture
def address(monkeypatch):
    """A free address, which rclpy connects to."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    monkeypatch.setattr(SETTINGS, "place", JoinOptions((address,)))
    return address


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
