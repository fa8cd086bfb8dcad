"""Who is on the graph, asked once."""

from __future__ import annotations

import anyio.to_thread
import pytest

from turtleact import open_node
from turtleact.errors import TurtleactError
from turtleact.interfaces.standard import Twist
from turtleact.transports import open_zenoh
from turtleact.transports.rmw_zenoh.census import census


async def test_all_that_is_there_is_told_and_nobody_sees_who_asks(address):
    async with (
        open_zenoh([], listen=[address], domain=7) as here,
        open_node("robot", transport=here) as node,
    ):
        node.publisher(Twist, "/at")
        await here.flush()
        graph = await anyio.to_thread.run_sync(census, [address], 7)
        assert graph.nodes() == ("/robot",)
        assert [(each.kind, each.name) for each in graph.endpoints()] == [("publisher", "/at")]
        assert here.nodes() == ("/robot",)
        other = await anyio.to_thread.run_sync(census, [address], 8)
        assert other.nodes() == ()


def test_a_graph_that_is_not_there_is_told(address):
    with pytest.raises(TurtleactError, match="no ROS 2 graph in reach: nobody at unixsock"):
        census([address], 0)
