"""Traces and measures a node's goals with `instrument`, using only OpenTelemetry's API.

The program decides where traces and metrics go: it sets up an SDK with exporters, or runs under
``opentelemetry-instrument``. Without an SDK, the API's calls do nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from anyio import sleep_forever

from turtleact.errors import TurtleactError
from turtleact.node import Node, check_open, resources_of
from turtleact.tasks import Background
from turtleact.telemetry.measuring import BOUNDS, measure, watch, watch_loop

if TYPE_CHECKING:
    from opentelemetry.metrics import Histogram, MeterProvider
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
    if resources.find(_Watching) is not None:
        return
    tracing, instruments = Tracing(node, tracer_provider), _Instruments(meter_provider)
    if not tracing.is_off:
        watch(node, tracing.add_server, tracing.add_client)
    if not instruments.are_off:
        measure(node, instruments)
    watching = sleep_forever() if instruments.are_off else watch_loop(instruments)
    resources.add(_Watching(watching, "measuring the event loop"), lambda: None)


class _Watching(Background):
    """The task that `instrument` starts for a node. Closing the node ends the task."""


class _Instruments:
    """Passes the measurements of `turtleact.telemetry.measuring` on to a meter of OpenTelemetry.

    Args:
        provider: Provides the meter; None for the program's global provider.

    Attributes:
        are_off: Whether the program has switched metrics off.
    """

    def __init__(self, provider: MeterProvider | None) -> None:
        from opentelemetry import metrics

        meter = metrics.get_meter("turtleact", meter_provider=provider)
        self.are_off = isinstance(meter, metrics.NoOpMeter)

        def histogram(name: str, about: str) -> Histogram:
            bounds = list(BOUNDS)
            return meter.create_histogram(
                name, "s", about, explicit_bucket_boundaries_advisory=bounds
            )

        self._goals = meter.create_counter("ros.action.goals", "{goal}", "Goals that have ended.")
        self._duration = histogram("ros.action.duration", "From a goal's acceptance to its end.")
        self._wait = histogram(
            "ros.action.wait", "From a goal's acceptance to the start of its body."
        )
        self._active = meter.create_up_down_counter(
            "ros.action.active", "{goal}", "Goals that have not ended, by state."
        )
        self._lost = meter.create_counter(
            "ros.action.feedback.lost", "{message}", "Feedback that has not reached a client."
        )
        self._lag = histogram("turtleact.loop.lag", "How late the event loop is.")

    def ended(self, action: str, status: str, seconds: float | None) -> None:
        """Count a goal that has ended."""
        attributes = {"action": action, "status": status}
        self._goals.add(1, attributes)
        if seconds is not None:
            self._duration.record(seconds, attributes)

    def waited(self, action: str, seconds: float) -> None:
        """Record the time from a goal's acceptance to the start of its body."""
        self._wait.record(seconds, {"action": action})

    def active_changed(self, action: str, state: str, change: int) -> None:
        """Add ``change`` to the number of goals in a state."""
        self._active.add(change, {"action": action, "state": state})

    def feedback_lost(self, action: str, count: int) -> None:
        """Count feedback messages that have not reached a client."""
        self._lost.add(count, {"action": action})

    def lagged(self, seconds: float) -> None:
        """Record how late the event loop was."""
        self._lag.record(seconds)
