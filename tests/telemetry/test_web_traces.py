"""Traces that pass through rosbridge, both ways."""

from __future__ import annotations

from turtleact.telemetry import instrument

from ..lab import Count, count
from ..web.line import bridged, line
from .collector import collecting, exporting_to

PARENT = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01"
GOAL = {"action": "/count", "action_type": "lab_interfaces/action/Count", "args": {"upto": 1}}


async def test_the_goal_of_a_web_client_is_part_of_its_trace():
    with collecting() as collector, exporting_to(collector) as provider:
        async with bridged() as (node, bridge), line(bridge) as client:
            instrument(node, tracer_provider=provider)
            node.action_server(Count, "count", count)
            client.say("send_action_goal", id="1", traceparent=PARENT, tracestate="lab=1", **GOAL)
            await client.hear()
            client.say("send_action_goal", id="2", **GOAL)
            assert (await client.hear())["result"]
        provider.force_flush()
    sent, other = collector.named("send_goal /count")
    executed, *_ = collector.named("execute /count")
    assert (sent.trace_id.hex(), sent.parent_span_id.hex()) == (PARENT[3:35], PARENT[36:52])
    assert (executed.trace_id, executed.parent_span_id) == (sent.trace_id, sent.span_id)
    assert executed.trace_state == "lab=1"
    assert other.parent_span_id == b""


async def test_a_client_that_serves_an_action_gets_the_span_of_the_goal():
    with collecting() as collector, exporting_to(collector) as provider:
        async with bridged() as (node, bridge), line(bridge) as client:
            client.say("advertise_action", action="/count", type=GOAL["action_type"])
            await client.hears_nothing()
            instrument(node, tracer_provider=provider)
            sending = node.action_client(Count, "count").send_goal(Count.Goal(1))
            async with sending as handle:
                asked = await client.hear()
                values: dict[str, object] = {"counted": []}
                about = {"id": asked["id"], "action": "/count", "values": values}
                client.say("action_result", status=4, result=True, **about)
                await handle.result()
        provider.force_flush()
    executed = collector.the("execute /count")
    ids = f"00-{executed.trace_id.hex()}-{executed.span_id.hex()}-0"
    assert asked["traceparent"].startswith(ids)
