"""The SDK that ``serve --otel`` sets up."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from typing import Any

import pytest
from opentelemetry import metrics, trace

import turtleact
from turtleact import TurtleactError
from turtleact.node import local_server_of
from turtleact.telemetry import exporting as exporting_module
from turtleact.telemetry import instrument
from turtleact.telemetry.exporting import exporting

from ..lab import Count, count, goal, result
from .collector import collecting


@pytest.fixture
def providers(monkeypatch) -> dict[str, Any]:
    """The global providers as they are set: a process can set them only once."""
    known: dict[str, Any] = {}
    monkeypatch.setattr(trace, "set_tracer_provider", lambda it: known.update(traces=it))
    monkeypatch.setattr(metrics, "set_meter_provider", lambda it: known.update(metrics=it))
    return known


async def run_goals(providers: dict[str, Any], count_of_goals: int = 1) -> None:
    async with turtleact.open_node("lab") as node:
        traces, numbers = providers.get("traces"), providers.get("metrics")
        instrument(node, tracer_provider=traces, meter_provider=numbers)
        node.action_server(Count, "count", count)
        client = node.action_client(Count, "count")
        for _ in range(count_of_goals):
            assert await client.send_goal(goal(1)) == result(0)


@pytest.mark.parametrize(
    ("variable", "value", "name"),
    [
        ("OTEL_SERVICE_NAME", "", "lab"),
        ("OTEL_SERVICE_NAME", "robot 7", "robot 7"),
        ("OTEL_RESOURCE_ATTRIBUTES", "service.name=robot 8", "robot 8"),
    ],
)
async def test_all_is_sent_by_the_end_of_the_block(monkeypatch, providers, variable, value, name):
    monkeypatch.setenv(variable, value)
    with collecting() as collector:
        monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", collector.url)
        async with exporting("lab"):
            await run_goals(providers)
    assert [each.name for each in collector.spans] == ["execute /count", "send_goal /count"]
    assert collector.points("ros.action.goals")["/count", "succeeded"].as_int == 1
    assert collector.resources[0]["service.name"] == name


async def test_either_exporter_can_be_left_out(monkeypatch, providers):
    monkeypatch.setenv("OTEL_METRICS_EXPORTER", "none")
    monkeypatch.setenv("OTEL_TRACES_EXPORTER", "none")
    async with exporting("lab"), turtleact.open_node("lab") as node:
        traces, numbers = providers["traces"], providers["metrics"]
        instrument(node, tracer_provider=traces, meter_provider=numbers)
        server = node.action_server(Count, "count", count)
        assert not local_server_of(server).observers.are_any
        assert not node.action_client(Count, "count").observers.wanted


@pytest.mark.parametrize(
    ("variable", "value", "problem"),
    [
        ("OTEL_TRACES_EXPORTER", "zipkin", "OTEL_TRACES_EXPORTER is 'zipkin': turtleact knows"),
        ("OTEL_BSP_SCHEDULE_DELAY", "-4", "OpenTelemetry cannot be set up: schedule_delay"),
        (
            "OTEL_PYTHON_EXPORTER_OTLP_HTTP_TRACES_CREDENTIAL_PROVIDER",
            "none",
            "OpenTelemetry cannot be set up: Requested component 'none' not found",
        ),
    ],
)
async def test_a_value_that_is_not_supported_is_named(
    monkeypatch, providers, variable, value, problem
):
    monkeypatch.setenv(variable, value)
    with pytest.raises(TurtleactError, match=problem):
        async with exporting("lab"):
            pytest.fail("it was supported")


@pytest.fixture
def silent() -> Iterator[str]:
    """A collector that takes connections and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"


async def test_a_collector_that_never_answers_delays_no_goal_and_the_end_only_a_little(
    monkeypatch, providers, silent, caplog
):
    monkeypatch.setattr(exporting_module, "FLUSH_WITHIN", 0.05)
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", silent)
    monkeypatch.setenv("OTEL_BSP_MAX_QUEUE_SIZE", "16")
    monkeypatch.setenv("OTEL_BSP_MAX_EXPORT_BATCH_SIZE", "8")
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_TIMEOUT", "1")
    began = time.monotonic()
    async with exporting("lab"):
        await run_goals(providers, 100)
    assert time.monotonic() - began < 5
    assert "could not be sent within 0.05 s, and are lost" in caplog.text
