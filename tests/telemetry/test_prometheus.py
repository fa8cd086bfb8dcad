"""Measurements, read back by Prometheus's own client library and from OpenTelemetry's exporter."""

from __future__ import annotations

from typing import Any

import anyio
import pytest
from opentelemetry.exporter.otlp.proto.http.metric_exporter import OTLPMetricExporter
from opentelemetry.sdk.metrics import MeterProvider
from opentelemetry.sdk.metrics.export import PeriodicExportingMetricReader
from prometheus_client.parser import text_string_to_metric_families

import turtleact
from turtleact import GoalRejected
from turtleact.goals.observers import FeedbackLost
from turtleact.tasks.clock import VirtualClock
from turtleact.telemetry import GoalMetrics, instrument, measuring
from turtleact.transports import MemoryTransport

from ..lab import Count, Gate, bare_goal, count, goal, result
from .collector import collecting


def read(metrics: GoalMetrics) -> dict[str, float]:
    """All samples, by name and labels."""
    found = {}
    for family in text_string_to_metric_families(metrics.text()):
        for name, labels, value, *_ in family.samples:
            told = ",".join(f"{key}={labels[key]}" for key in sorted(labels))
            found[f"{name} {told}".strip()] = value
    return found


async def test_ended_goals_are_counted_by_status_with_their_durations():
    metrics = GoalMetrics()
    gate = Gate()
    async with turtleact.open_node("all") as node:
        metrics.watch(node)
        metrics.watch(node)  # does nothing
        node.action_server(Count, "count", count)
        node.action_server(Count, "wait", gate.wait)
        client = node.action_client(Count, "count")
        for _ in range(3):
            assert await client.send_goal(goal(1)) == result(0)
        async with node.action_client(Count, "wait").send_goal(goal()) as handle:
            await handle.cancel()
            await handle.outcome()
    found = read(metrics)
    assert found["ros_action_goals_total action=/count,status=succeeded"] == 3
    assert found["ros_action_goals_total action=/wait,status=canceled"] == 1
    name = "ros_action_duration_seconds"
    assert found[f"{name}_count action=/count,status=succeeded"] == 3
    assert found[f"{name}_bucket action=/count,le=+Inf,status=succeeded"] == 3
    assert 0 < found[f"{name}_sum action=/count,status=succeeded"] < 30
    assert found["ros_action_wait_seconds_count action=/count"] == 3


async def test_a_histogram_has_the_goals_up_to_each_bound():
    metrics = GoalMetrics()
    for seconds in (0.01, 0.02, 7.0, 9_999.0):
        metrics.ended("/count", "aborted", seconds)
    found = read(metrics)
    up_to = {
        bound: found[f"ros_action_duration_seconds_bucket action=/count,le={bound},status=aborted"]
        for bound in ("0.005", "0.01", "0.025", "5.0", "10.0", "1800.0", "+Inf")
    }
    assert list(up_to.values()) == [0, 1, 2, 2, 3, 3, 4]
    assert found["ros_action_duration_seconds_sum action=/count,status=aborted"] == pytest.approx(
        10_006.03
    )


async def test_goals_that_wait_and_run_are_counted_even_if_they_began_before():
    metrics = GoalMetrics()
    gate = Gate()
    async with turtleact.open_node("all") as node:
        node.action_server(Count, "count", gate.wait, policy="queue")
        client = node.action_client(Count, "count")
        async with client.send_goal(goal()) as first, client.send_goal(goal()) as second:
            metrics.watch(node)
            active = "ros_action_active action=/count,state="
            found = read(metrics)
            assert (found[f"{active}executing"], found[f"{active}accepted"]) == (1, 1)
            gate.opened.set()
            await first.result()
            await second.result()
        found = read(metrics)
    assert (found[f"{active}executing"], found[f"{active}accepted"]) == (0, 0)
    assert found["ros_action_goals_total action=/count,status=succeeded"] == 2
    assert found["ros_action_wait_seconds_count action=/count"] == 1


@pytest.mark.parametrize("why", ["the callback", "the slot"])
async def test_rejected_goals_are_counted(why):
    metrics = GoalMetrics()

    async def refuse(request: Any) -> turtleact.GoalResponse:
        return turtleact.GoalResponse.REJECT

    async with turtleact.open_node("all") as node:
        metrics.watch(node)
        options: Any = {"goal_callback": refuse} if why == "the callback" else {"policy": "reject"}
        node.action_server(Count, "count", Gate().wait, **options)
        client = node.action_client(Count, "count")
        if why == "the slot":
            async with client.send_goal(goal()):
                with pytest.raises(GoalRejected):
                    await client.send_goal(goal())
        else:
            with pytest.raises(GoalRejected):
                await client.send_goal(goal())
    assert read(metrics)["ros_action_goals_total action=/count,status=rejected"] == 1


async def test_times_are_those_of_the_graph():
    metrics = GoalMetrics()
    clock = VirtualClock()

    async def sleep(request: Any, handle: Any) -> Count.Result:
        await handle.node.clock.sleep(100.0)
        return result()

    async with (
        anyio.create_task_group() as group,
        turtleact.open_node("all", transport=MemoryTransport(clock)) as node,
    ):
        group.start_soon(clock.run)
        metrics.watch(node)
        node.action_server(Count, "count", sleep)
        await node.action_client(Count, "count").send_goal(goal())
        group.cancel_scope.cancel()
    assert read(metrics)["ros_action_duration_seconds_sum action=/count,status=succeeded"] == 100


async def test_opentelemetry_gets_the_same_measurements_and_no_goal_id(monkeypatch):
    monkeypatch.setattr(measuring, "INTERVAL", 0.001)
    with collecting() as collector:
        exporter = OTLPMetricExporter(f"{collector.url}/v1/metrics")
        reader = PeriodicExportingMetricReader(exporter, export_interval_millis=3_600_000)
        provider = MeterProvider([reader], shutdown_on_exit=False)
        async with turtleact.open_node("all") as node:
            instrument(node, meter_provider=provider)
            instrument(node, meter_provider=provider)
            gate = Gate()
            node.action_server(Count, "count", gate.wait, policy="reject")
            client = node.action_client(Count, "count")
            ids = [bytes([number]) * 16 for number in range(1, 4)]
            gate.opened.set()
            for each in ids:
                await client.send_goal(goal(1), goal_id=each)
            gate.opened = anyio.Event()
            async with client.send_goal(goal()):
                with pytest.raises(GoalRejected):
                    await client.send_goal(goal())
            client.observers.noted(bare_goal(), FeedbackLost(7))
            await anyio.sleep(0.01)
        await anyio.to_thread.run_sync(provider.shutdown)
    goals = collector.points("ros.action.goals")
    assert goals["/count", "succeeded"].as_int == 3
    assert goals["/count", "rejected"].as_int == 1
    assert collector.points("ros.action.duration")["/count", "succeeded"].count == 3
    assert collector.points("ros.action.wait")["/count",].count == 4
    assert collector.points("ros.action.active")["/count", "executing"].as_int == 0
    assert collector.points("ros.action.feedback.lost")["/count",].as_int == 7
    assert collector.points("turtleact.loop.lag")[()].count >= 1
    told = collector.metrics.SerializeToString()
    assert not any(each in told or each.hex().encode() in told for each in ids)
