"""Traces, measures and logs goals, with OpenTelemetry, Prometheus and ``logging``.

Goals are traced and measured by observers of their servers and clients
(`turtleact.goals.observers`). A program that does not import this package pays nothing for it.
`instrument` needs the extra ``otel``; `GoalMetrics`, `GoalFilter` and `JsonFormatter` need no
extra.

Source: OpenTelemetry's semantic conventions 1.44, "RPC" and "Recording errors"; W3C Trace Context.
"""

from turtleact.telemetry.instrumentation import instrument
from turtleact.telemetry.logs import GoalFilter, JsonFormatter, TextFormatter
from turtleact.telemetry.measuring import new_traces
from turtleact.telemetry.prometheus import GoalMetrics

__all__ = [
    "GoalFilter",
    "GoalMetrics",
    "JsonFormatter",
    "TextFormatter",
    "instrument",
    "new_traces",
]
