"""The call of a tool and the goal that it sends are one trace."""

from __future__ import annotations

from typing import Any

import pytest
from mcp import Client

from turtleact import open_node
from turtleact.interfaces.standard import Fibonacci
from turtleact.mcp import open_mcp
from turtleact.telemetry import instrument

from .collector import collecting, exporting_to

PARENT = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01"


@pytest.mark.parametrize("mode", ["auto", "legacy"])
async def test_a_goal_is_part_of_the_trace_of_its_call(mode):
    async def act(goal):
        return Fibonacci.Result(sequence=[goal.order])

    meta: Any = {"traceparent": PARENT}
    with collecting() as collector, exporting_to(collector) as provider:
        async with open_node("lab") as node:
            instrument(node, tracer_provider=provider)
            node.action_server(Fibonacci, "count", act)
            async with (
                open_mcp(node, actions=["/count"]) as server,
                Client(server.sdk, mode=mode) as client,
            ):
                await client.call_tool("count", {"order": 1}, meta=meta)
        provider.force_flush()
    sent, executed = collector.the("send_goal /count"), collector.the("execute /count")
    assert sent.trace_id.hex() == executed.trace_id.hex() == PARENT[3:35]
    assert sent.parent_span_id.hex() == PARENT[36:52]
    assert executed.parent_span_id == sent.span_id
