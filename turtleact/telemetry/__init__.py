"""Traces, measures and logs goals, with OpenTelemetry, Prometheus and ``logging``.

Everything here watches goals as an observer of servers and clients (`turtleact.observers`). A
program that does not import this module pays nothing for it. `instrument` needs the extra ``otel``;
`GoalMetrics`, `GoalFilter` and `JsonFormatter` need nothing.

Source: OpenTelemetry's semantic conventions 1.44, "RPC" and "Recording errors"; W3C Trace Context.
"""

from turtleact.telemetry.instrumentation import instrument
from turtleact.telemetry.linking import new_traces
from turtleact.telemetry.logs import GoalFilter, JsonFormatter, TextFormatter
from turtleact.telemetry.prometheus import GoalMetrics

__all__ = [
    "GoalFilter",
    "GoalMetrics",
    "JsonFormatter",
    "TextFormatter",
    "instrument",
    "new_traces",
]
