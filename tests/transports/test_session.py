"""A graph that is asked once."""

from __future__ import annotations

import anyio.to_thread

from turtleact import open_node
from turtleact.interfaces.standard import Twist
from turtleact.transports import open_zenoh
from turtleact.transports.rmw_zenoh.session import census


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


async def test_a_graph_of_hundreds_of_endpoints_is_told(address):
    async with (
        open_zenoh([], listen=[address], domain=7) as here,
        open_node("robot", transport=here) as node,
    ):
        for number in range(300):
            node.publisher(Twist, f"/topic{number}")
        await here.flush()
        with anyio.fail_after(15):
            graph = await anyio.to_thread.run_sync(census, [address], 7, abandon_on_cancel=True)
        assert len(graph.endpoints()) == 300
