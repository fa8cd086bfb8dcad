"""Measures goals, and gives goals traces of their own; neither needs OpenTelemetry.

`measure` counts how many goals end, how long they take and wait, and how much feedback is lost.

The measurements go to a `Measurements` object: the one in `turtleact.telemetry.prometheus` keeps
them, and the one in `turtleact.telemetry.instrumentation` passes them on to OpenTelemetry. The
times of goals are measured on the graph's clock. No measurement carries a goal id, because each id
would begin a new time series.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Final, Protocol

import anyio

from turtleact.goals.client import ActionClient
from turtleact.goals.observers import FeedbackLost, GoalObserver, Lost, News
from turtleact.goals.state import Goal, GoalStatus
from turtleact.node import ActionServer, Node, local_server_of, resources_of

__all__ = [
    "BOUNDS",
    "NEW_TRACES",
    "Measurements",
    "measure",
    "new_traces",
    "watch",
    "watch_loop",
]

BOUNDS: Final = (
    *(0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0),
    *(30.0, 60.0, 120.0, 300.0, 600.0, 1800.0),
)
"""The upper bounds of the histograms' buckets (s). Goals may take milliseconds or half an hour."""

INTERVAL: Final = 0.5
"""How often the lag of the event loop is measured (s)."""

NAMES: Final = tuple(status.name.lower() for status in GoalStatus)
"""The names of goal states in measurements. The index is the state's number."""

AnyServer = ActionServer[Any, Any, Any]
AnyClient = ActionClient[Any, Any, Any]


class Measurements(Protocol):
    """The interface of objects that receive measurements.

    The methods must not raise exceptions, and must not block.
    """

    def ended(self, action: str, status: str, seconds: float | None) -> None:
        """Called when a goal has ended, with the time since its acceptance (s).

        If the goal was rejected, ``seconds`` is None.
        """

    def waited(self, action: str, seconds: float) -> None:
        """Called when a body begins, with the time since its goal's acceptance (s)."""

    def active_changed(self, action: str, state: str, change: int) -> None:
        """Called when the number of goals in a state changes, except for final states.

        ``change`` is the new number minus the old one.
        """

    def feedback_lost(self, action: str, count: int) -> None:
        """Called when ``count`` feedback messages have not reached a client."""

    def lagged(self, seconds: float) -> None:
        """Called regularly with the number of seconds by which the event loop was late."""


def watch(
    node: Node,
    on_server: Callable[[AnyServer], object],
    on_client: Callable[[AnyClient], object],
) -> None:
    """Call ``on_server`` with each action server of a node, and ``on_client`` with each client.

    The functions are called now for servers and clients that are open, and later for each new one.
    """

    def told(thing: object) -> None:
        if isinstance(thing, ActionServer):
            on_server(thing)
        elif isinstance(thing, ActionClient):
            on_client(thing)

    resources_of(node).watch(told)


def measure(node: Node, measurements: Measurements) -> None:
    """Measure the goals of a node from now on."""
    watch(
        node,
        lambda server: local_server_of(server).observers.add(_ServerMeter(server, measurements)),
        lambda client: client.observers.add(_ClientMeter(client.name, measurements)),
    )


async def watch_loop(measurements: Measurements) -> None:
    """Measure how late the event loop is, every `INTERVAL` seconds, until cancelled."""
    while True:
        due = anyio.current_time() + INTERVAL
        await anyio.sleep_until(due)
        measurements.lagged(max(0.0, anyio.current_time() - due))


class _ServerMeter(GoalObserver):
    """Measures the goals of one server, including goals that are already running."""

    def __init__(self, server: AnyServer, measurements: Measurements) -> None:
        self._action = server.name
        self._now = server.node.clock.now
        self._measurements = measurements
        for goal in local_server_of(server).held().values():
            self._move(GoalStatus.UNKNOWN, goal.status)

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
        """Count the goal in its new state.

        When the goal starts, measure how long the goal waited for its body. When the goal ends,
        measure the time since its acceptance.
        """
        self._move(before, after)
        if after is GoalStatus.EXECUTING:
            self._measurements.waited(self._action, (self._now() - goal.stamp) / 1e9)
        elif after.is_terminal:
            seconds = (goal.ended - goal.stamp) / 1e9
            self._measurements.ended(self._action, NAMES[after], seconds)

    def noted(self, goal: Goal, news: News) -> None:  # noqa: ARG002
        """Count lost feedback.

        If the server stops before the goal's end, stop counting the goal as active.
        """
        if isinstance(news, Lost):
            self._move(news.before, GoalStatus.UNKNOWN)
        elif isinstance(news, FeedbackLost):
            self._measurements.feedback_lost(self._action, news.count)

    def goal_rejected(self, reason: str) -> None:  # noqa: ARG002
        """Count a goal that the server rejects."""
        self._measurements.ended(self._action, "rejected", None)

    def _move(self, before: GoalStatus, after: GoalStatus) -> None:
        if before.is_active:
            self._measurements.active_changed(self._action, NAMES[before], -1)
        if after.is_active:
            self._measurements.active_changed(self._action, NAMES[after], 1)


class _ClientMeter(GoalObserver):
    """Measures feedback that is lost on its way to a client. Only the client notices the loss."""

    def __init__(self, action: str, measurements: Measurements) -> None:
        self._action = action
        self._measurements = measurements

    def noted(self, goal: Goal, news: News) -> None:  # noqa: ARG002
        """Count lost feedback."""
        if isinstance(news, FeedbackLost):
            self._measurements.feedback_lost(self._action, news.count)


NEW_TRACES: ContextVar[bool] = ContextVar("NEW_TRACES", default=False)
"""Whether the goals that are sent now get traces of their own."""


@contextmanager
def new_traces() -> Iterator[None]:
    """Give each goal that is sent in a ``with`` block its own trace, linked to the current trace.

    Use this for goals that you detach. Without this block, the server's span is a child of the
    client's span, which suits a client that waits for the goal's end.
    """
    token = NEW_TRACES.set(True)
    try:
        yield
    finally:
        NEW_TRACES.reset(token)
