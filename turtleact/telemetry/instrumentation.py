"""Traces and measures a node's goals with `instrument`, using only OpenTelemetry's API.

The program decides where traces and metrics go: it sets up an SDK with exporters, or runs under
``opentelemetry-instrument``. Without an SDK, the API's calls do nothing.
"""

from __future__ import annotations

from collections.abc import Coroutine
from typing import TYPE_CHECKING

from anyio import sleep_forever

from turtleact.errors import TurtleactError
from turtleact.node import Node, check_open, resources_of
from turtleact.tasks import Background
from turtleact.telemetry.measuring import measure, watch, watch_loop

if TYPE_CHECKING:
    from opentelemetry.metrics import MeterProvider
    from opentelemetry.trace import TracerProvider

__all__ = ["instrument"]


def instrument(
    node: Node,
    *,
    tracer_provider: TracerProvider | None = None,
    meter_provider: MeterProvider | None = None,
) -> None:
    """Trace and measure the goals that a node serves and sends, from now on.

    Goals that are already under way are measured, but not traced. A second call for the same node
    does nothing.

    Args:
        node: The node.
        tracer_provider: The provider that gets the spans. If left out, it is the program's global
            provider.
        meter_provider: The provider that gets the measurements. If left out, it is the program's
            global provider.

    Raises:
        TurtleactError: if OpenTelemetry's API is not installed, the node is closed, or the caller
            runs in another event loop.
    """
    try:
        from turtleact.telemetry.instruments import Instruments
        from turtleact.telemetry.tracing import Tracing
    except ModuleNotFoundError as missing:
        if (missing.name or "").partition(".")[0] != "opentelemetry":
            raise
        raise TurtleactError(
            "turtleact.telemetry.instrument needs the extra otel: "
            "pip install 'opentelemetry-api>=1.30,<2'"
        ) from missing
    resources = resources_of(node)
    check_open(node)
    if resources.find(_Instrumentation) is not None:
        return
    tracing, instruments = Tracing(node, tracer_provider), Instruments(meter_provider)
    if not tracing.is_off:
        watch(node, tracing.add_server, tracing.add_client)
    if not instruments.are_off:
        measure(node, instruments)
    watching = sleep_forever() if instruments.are_off else watch_loop(instruments)
    resources.add(_Instrumentation(watching), _Nothing())


class _Instrumentation:
    """The task that `instrument` starts for a node. Closing the node ends the task."""

    def __init__(self, watching: Coroutine[object, object, None]) -> None:
        self._watching = Background(watching, "measuring the event loop")

    async def aclose(self) -> None:
        """Stop measuring the event loop."""
        await self._watching.aclose()


class _Nothing:
    """A placeholder for the transport object that an `_Instrumentation` does not have.

    A node closes each of its objects together with an object of the transport.
    """

    def close(self) -> None:
        """Do nothing."""
