"""Sets up OpenTelemetry's SDK to send spans and measurements to a collector by OTLP over HTTP.

The address, the interval and all other settings come from OpenTelemetry's own environment
variables, such as ``OTEL_EXPORTER_OTLP_ENDPOINT``, ``OTEL_SERVICE_NAME``,
``OTEL_RESOURCE_ATTRIBUTES``, ``OTEL_TRACES_SAMPLER``, ``OTEL_BSP_MAX_QUEUE_SIZE`` and
``OTEL_METRIC_EXPORT_INTERVAL``. ``OTEL_TRACES_EXPORTER=none`` switches traces off, and
``OTEL_METRICS_EXPORTER=none`` switches metrics off.

The SDK sends everything in its own threads, so a slow or unreachable collector does not delay
goals. Spans that do not fit into the SDK's queue are dropped, and the SDK logs that.

Source: OpenTelemetry specification 1.45, "Environment Variable Specification".
"""

from __future__ import annotations

import logging
import os
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Final

import anyio
from opentelemetry import metrics, trace
from opentelemetry.exporter.otlp.proto.http.metric_exporter import OTLPMetricExporter
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.metrics import MeterProvider
from opentelemetry.sdk.metrics.export import PeriodicExportingMetricReader
from opentelemetry.sdk.resources import SERVICE_NAME, Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor

from turtleact.errors import TurtleactError
from turtleact.tasks import run_in_daemon

__all__ = ["FLUSH_WITHIN", "exporting"]

logger = logging.getLogger("turtleact.telemetry")

FLUSH_WITHIN: Final = 3.0
"""The time allowed at shutdown to send the last spans and measurements (s, event loop time)."""

EXPORTERS: Final = ("otlp", "none")


@asynccontextmanager
async def exporting(service: str) -> AsyncIterator[None]:
    """Export the traces and measurements of the process during an ``async with`` block.

    This sets the process's global providers, which is possible only once. At the end of the block,
    the remaining spans and measurements are sent. Whatever cannot be sent within `FLUSH_WITHIN`
    seconds is lost.

    Args:
        service: The name of the service, unless ``OTEL_SERVICE_NAME`` sets another name.

    Raises:
        TurtleactError: if an environment variable has a value that is not supported.
    """
    try:
        ends = _set_up(service)
    except (ValueError, RuntimeError) as error:
        raise TurtleactError(f"OpenTelemetry cannot be set up: {error}") from error
    try:
        yield
    finally:
        await _run_all(ends)


def _set_up(service: str) -> list[Callable[[], object]]:
    """Set OpenTelemetry's global providers of traces and metrics.

    Return the functions that shut the providers down.
    """
    resource = Resource.create()
    if str(resource.attributes[SERVICE_NAME]).startswith("unknown_service"):
        resource = resource.merge(Resource({SERVICE_NAME: service}))
    ends: list[Callable[[], object]] = []
    if _is_wanted("OTEL_TRACES_EXPORTER"):
        spans = TracerProvider(resource=resource, shutdown_on_exit=False)
        spans.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
        trace.set_tracer_provider(spans)
        ends.append(spans.shutdown)
    else:
        trace.set_tracer_provider(trace.NoOpTracerProvider())
    if _is_wanted("OTEL_METRICS_EXPORTER"):
        reader = PeriodicExportingMetricReader(OTLPMetricExporter())
        numbers = MeterProvider([reader], resource, shutdown_on_exit=False)
        metrics.set_meter_provider(numbers)
        ends.append(numbers.shutdown)
    else:
        metrics.set_meter_provider(metrics.NoOpMeterProvider())
    return ends


def _is_wanted(variable: str) -> bool:
    """Whether an environment variable selects OTLP, or is unset or empty.

    Raises:
        TurtleactError: if the variable selects neither ``otlp`` nor ``none``.
    """
    name = os.environ.get(variable) or "otlp"
    if name not in EXPORTERS:
        raise TurtleactError(f"{variable} is '{name}': turtleact knows {', '.join(EXPORTERS)}")
    return name == "otlp"


async def _run_all(ends: list[Callable[[], object]]) -> None:
    """Call functions in threads at the same time, and wait at most `FLUSH_WITHIN` seconds."""
    left = list(ends)

    async def run(end: Callable[[], object]) -> None:
        try:
            await run_in_daemon(end, "the end of an exporter")
        except Exception:
            logger.exception("an exporter has failed at the end")
        left.remove(end)

    with anyio.move_on_after(FLUSH_WITHIN, shield=True):
        async with anyio.create_task_group() as group:
            for end in ends:
                group.start_soon(run, end)
    if left:
        problem = "the last spans or measurements could not be sent within %g s, and are lost"
        logger.warning(problem, FLUSH_WITHIN)
