"""Keeps measurements of goals in memory, and writes them in Prometheus's format.

================================  =========  ======================  ==============================
metric                            kind       labels                  what it measures
================================  =========  ======================  ==============================
``ros_action_goals_total``        counter    ``action``, ``status``  goals that have ended
``ros_action_duration_seconds``   histogram  ``action``, ``status``  time from acceptance to end
``ros_action_wait_seconds``       histogram  ``action``              time from acceptance to body
``ros_action_active``             gauge      ``action``, ``state``   goals that have not ended
``ros_action_feedback_lost_total``  counter  ``action``              lost feedback messages
``turtleact_loop_lag_seconds``    histogram                          how late the event loop is
================================  =========  ======================  ==============================

Source: Prometheus, "Exposition formats", text format 0.0.4; "Metric and label naming".
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple, TypeAlias
from weakref import WeakSet

from turtleact.node import Node, check_open
from turtleact.telemetry.measuring import BOUNDS, measure, watch_loop

__all__ = ["GoalMetrics"]

Labels: TypeAlias = tuple[str, ...]
"""The values of the labels of a metric, in the order of their names."""


class _Metric(NamedTuple):
    """The name, kind, help text and labels of a metric.

    Attributes:
        name: The metric's name.
        kind: The metric's kind in Prometheus.
        about: What the metric measures, as a help text.
        labels: The names of the metric's labels.
    """

    name: str
    kind: str
    about: str
    labels: tuple[str, ...] = ()

    def head(self) -> Iterator[str]:
        """Yield the metric's ``HELP`` and ``TYPE`` lines."""
        yield f"# HELP {self.name} {self.about}"
        yield f"# TYPE {self.name} {self.kind}"

    def written(self, values: Labels, **more: str) -> str:
        """Return the labels of a sample as text.

        The label values are the names of actions and states, which need no escaping.
        """
        labels = {**dict(zip(self.labels, values, strict=True)), **more}
        return "{" + ",".join(f'{name}="{each}"' for name, each in labels.items()) + "}"


GOALS: Final = _Metric(
    "ros_action_goals_total", "counter", "Goals that have ended.", ("action", "status")
)
DURATION: Final = _Metric(
    "ros_action_duration_seconds",
    "histogram",
    "From a goal's acceptance to its end.",
    ("action", "status"),
)
WAIT: Final = _Metric(
    "ros_action_wait_seconds",
    "histogram",
    "From a goal's acceptance to the start of its body.",
    ("action",),
)
ACTIVE: Final = _Metric(
    "ros_action_active", "gauge", "Goals that have not ended.", ("action", "state")
)
LOST: Final = _Metric(
    "ros_action_feedback_lost_total",
    "counter",
    "Feedback that has not reached a client.",
    ("action",),
)
LAG: Final = _Metric("turtleact_loop_lag_seconds", "histogram", "How late the event loop is.")


class GoalMetrics:
    """Counts the goals of nodes, for Prometheus. This class needs no extra package.

    It has the methods of `turtleact.telemetry.measuring.Measurements`.

    >>> metrics = GoalMetrics()
    >>> for line in metrics.text().splitlines()[:2]:
    ...     print(line)
    # HELP ros_action_goals_total Goals that have ended.
    # TYPE ros_action_goals_total counter
    """

    def __init__(self) -> None:
        self._nodes = WeakSet[Node]()
        self._goals = Counter[Labels]()
        self._active = Counter[Labels]()
        self._lost = Counter[Labels]()
        self._durations = defaultdict[Labels, _Histogram](_Histogram)
        self._waits = defaultdict[Labels, _Histogram](_Histogram)
        self._lags: dict[Labels, _Histogram] = {(): _Histogram()}

    def watch(self, node: Node) -> None:
        """Count the goals that a node serves and sends, from now on.

        A second call for the same node does nothing.

        Raises:
            TurtleactError: if the node is closed, or the caller runs in another event loop.
        """
        check_open(node)
        if node not in self._nodes:
            self._nodes.add(node)
            measure(node, self)

    async def watch_loop(self) -> None:
        """Measure how late the event loop is, until cancelled."""
        await watch_loop(self)

    def ended(self, action: str, status: str, seconds: float | None) -> None:
        """Count a goal that has ended."""
        labels = action, status
        self._goals[labels] += 1
        if seconds is not None:
            self._durations[labels].add(seconds)

    def waited(self, action: str, seconds: float) -> None:
        """Record the time from a goal's acceptance to the start of its body."""
        self._waits[action,].add(seconds)

    def active_changed(self, action: str, state: str, change: int) -> None:
        """Add ``change`` to the number of goals in a state."""
        self._active[action, state] += change

    def feedback_lost(self, action: str, count: int) -> None:
        """Count feedback messages that have not reached a client."""
        self._lost[action,] += count

    def lagged(self, seconds: float) -> None:
        """Record how late the event loop was."""
        self._lags[()].add(seconds)

    def text(self) -> str:
        """Return all metrics in Prometheus's text format."""
        told = (
            _counts(GOALS, self._goals),
            _histograms(DURATION, self._durations),
            _histograms(WAIT, self._waits),
            _counts(ACTIVE, self._active),
            _counts(LOST, self._lost),
            _histograms(LAG, self._lags),
        )
        return "".join(f"{line}\n" for lines in told for line in lines)


class _Histogram:
    """Counts values in buckets, and adds the values up.

    Attributes:
        counts: How many values are in each bucket. `BOUNDS` has the upper bound of each bucket
            except the last. A value goes into the first bucket whose bound is not below the value.
            The last bucket counts the values above all bounds.
        sum: The sum of all values.
    """

    __slots__ = ("counts", "sum")

    def __init__(self) -> None:
        self.counts = [0] * (len(BOUNDS) + 1)
        self.sum = 0.0

    def add(self, value: float) -> None:
        """Count a value in its bucket, and add it to the sum."""
        self.counts[bisect_left(BOUNDS, value)] += 1
        self.sum += value


def _counts(metric: _Metric, counts: Counter[Labels]) -> Iterator[str]:
    yield from metric.head()
    for labels, count in sorted(counts.items()):
        yield f"{metric.name}{metric.written(labels)} {count}"


def _histograms(metric: _Metric, histograms: Mapping[Labels, _Histogram]) -> Iterator[str]:
    yield from metric.head()
    for labels, histogram in sorted(histograms.items()):
        count = 0
        for bound, more in zip((*BOUNDS, "+Inf"), histogram.counts, strict=True):
            count += more
            yield f"{metric.name}_bucket{metric.written(labels, le=str(bound))} {count}"
        yield f"{metric.name}_sum{metric.written(labels)} {histogram.sum!r}"
        yield f"{metric.name}_count{metric.written(labels)} {count}"
