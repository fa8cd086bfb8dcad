"""Passes the measurements of `turtleact.telemetry.measuring` on to OpenTelemetry's instruments."""

from __future__ import annotations

from opentelemetry import metrics

from turtleact.telemetry.measuring import BOUNDS

__all__ = ["Instruments"]


class Instruments:
    """Passes measurements on to a meter of OpenTelemetry.

    Args:
        provider: Provides the meter; None for the program's global provider.

    Attributes:
        are_off: Whether the program has switched metrics off.
    """

    def __init__(self, provider: metrics.MeterProvider | None) -> None:
        meter = metrics.get_meter("turtleact", meter_provider=provider)
        self.are_off = isinstance(meter, metrics.NoOpMeter)
        bounds = list(BOUNDS)
        self._goals = meter.create_counter("ros.action.goals", "{goal}", "Goals that have ended.")
        self._duration = meter.create_histogram(
            "ros.action.duration",
            "s",
            "From a goal's acceptance to its end.",
            explicit_bucket_boundaries_advisory=bounds,
        )
        self._wait = meter.create_histogram(
            "ros.action.wait",
            "s",
            "From a goal's acceptance to the start of its body.",
            explicit_bucket_boundaries_advisory=bounds,
        )
        self._active = meter.create_up_down_counter(
            "ros.action.active", "{goal}", "Goals that have not ended, by state."
        )
        self._lost = meter.create_counter(
            "ros.action.feedback.lost", "{message}", "Feedback that has not reached a client."
        )
        self._lag = meter.create_histogram(
            "turtleact.loop.lag",
            "s",
            "How late the event loop is.",
            explicit_bucket_boundaries_advisory=bounds,
        )

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
