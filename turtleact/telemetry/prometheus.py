"""Measurements of goals, kept in memory and written as Prometheus reads them.

================================  =========  ======================  ==============================
metric                            kind       labels                  what it counts
================================  =========  ======================  ==============================
``ros_action_goals_total``        counter    ``action``, ``status``  goals that have ended
``ros_action_duration_seconds``   histogram  ``action``, ``status``  from acceptance to the end
``ros_action_wait_seconds``       histogram  ``action``              from acceptance to the body
``ros_action_active``             gauge      ``action``, ``state``   goals that have not ended
``ros_action_feedback_lost_total``  counter  ``action``              feedback that has not arrived
``turtleact_loop_lag_seconds``    histogram                          how late the event loop is
================================  =========  ======================  ==============================

Source: Prometheus, "Exposition formats", text format 0.0.4; "Metric and label naming".
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator
from typing import TypeAlias

from turtleact.node import Node
from turtleact.telemetry.measuring import BOUNDS, measure

__all__ = ["GoalMetrics"]

Labels: TypeAlias = tuple[tuple[str, str], ...]


class GoalMetrics:
    """Counts the goals of nodes. Needs no other package.

    >>> metrics = GoalMetrics()
    >>> metrics.ended("/patrol", "succeeded", 0.2)
    >>> for line in metrics.text().splitlines()[:3]:
    ...     print(line)
    # HELP ros_action_goals_total Goals that have ended.
    # TYPE ros_action_goals_total counter
    ros_action_goals_total{action="/patrol",status="succeeded"} 1
    """

    def __init__(self) -> None:
        self._goals = Counter[Labels]()
        self._active = Counter[Labels]()
        self._lost = Counter[Labels]()
        self._durations: dict[Labels, _Histogram] = {}
        self._waits: dict[Labels, _Histogram] = {}
        self._lags: dict[Labels, _Histogram] = {(): _Histogram()}

    def watch(self, node: Node) -> None:
        """Count the goals that a node serves and sends, from now on."""
        measure(node, self)

    def text(self) -> str:
        """All metrics in Prometheus's text format."""
        told = (
            _counts("ros_action_goals_total", "counter", "Goals that have ended.", self._goals),
            _histograms(
                "ros_action_duration_seconds",
                "From a goal's acceptance to its end.",
                self._durations,
            ),
            _histograms(
                "ros_action_wait_seconds",
                "From a goal's acceptance to the start of its body.",
                self._waits,
            ),
            _counts("ros_action_active", "gauge", "Goals that have not ended.", self._active),
            _counts(
                "ros_action_feedback_lost_total",
                "counter",
                "Feedback that has not reached a client.",
                self._lost,
            ),
            _histograms("turtleact_loop_lag_seconds", "How late the event loop is.", self._lags),
        )
        return "".join(f"{line}\n" for lines in told for line in lines)

    # called by what measures

    def ended(self, action: str, status: str, seconds: float | None) -> None:
        """Count a goal that has ended."""
        labels = ("action", action), ("status", status)
        self._goals[labels] += 1
        if seconds is not None:
            self._durations.setdefault(labels, _Histogram()).add(seconds)

    def waited(self, action: str, seconds: float) -> None:
        """Record how long a goal has waited."""
        self._waits.setdefault((("action", action),), _Histogram()).add(seconds)

    def active_changed(self, action: str, state: str, change: int) -> None:
        """Count goals that have entered or left a state."""
        self._active[("action", action), ("state", state)] += change

    def feedback_lost(self, action: str, count: int) -> None:
        """Count lost feedback."""
        self._lost[(("action", action),)] += count

    def lagged(self, seconds: float) -> None:
        """Record how late the event loop was."""
        self._lags[()].add(seconds)


class _Histogram:
    """How many values are at most as large as each bound.

    Attributes:
        counts: How many values fell between a bound and the one before; the last are above all.
        sum: The sum of all values.
    """

    __slots__ = ("counts", "sum")

    def __init__(self) -> None:
        self.counts = [0] * (len(BOUNDS) + 1)
        self.sum = 0.0

    def add(self, value: float) -> None:
        """Add a value."""
        self.counts[bisect_left(BOUNDS, value)] += 1
        self.sum += value


def _counts(name: str, kind: str, about: str, counts: Counter[Labels]) -> Iterator[str]:
    yield f"# HELP {name} {about}"
    yield f"# TYPE {name} {kind}"
    for labels, count in sorted(counts.items()):
        yield f"{name}{_written(labels)} {count}"


def _histograms(name: str, about: str, histograms: dict[Labels, _Histogram]) -> Iterator[str]:
    yield f"# HELP {name} {about}"
    yield f"# TYPE {name} histogram"
    for labels, histogram in sorted(histograms.items()):
        count = 0
        for bound, more in zip((*BOUNDS, "+Inf"), histogram.counts, strict=True):
            count += more
            yield f"{name}_bucket{_written((*labels, ('le', str(bound))))} {count}"
        yield f"{name}_sum{_written(labels)} {histogram.sum!r}"
        yield f"{name}_count{_written(labels)} {count}"


def _written(labels: Labels) -> str:
    # Names of actions and states have no character that would need escaping.
    return "{" + ",".join(f'{name}="{value}"' for name, value in labels) + "}" if labels else ""
