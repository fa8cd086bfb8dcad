"""Events of publishers and subscriptions, such as matches and missed deadlines.

The callback for an event gets an info object, such as a `QoSPublisherMatchedInfo`. An endpoint
without callbacks for events spends no time on events. Whenever the graph has changed, this module
reads the endpoints of the topic again. This module itself checks deadlines, and the liveliness of
publishers in this process, because transports enforce no time limits. Endpoints with an
incompatible quality of service are reported, but still exchange messages, as with rmw_zenoh. This
module never notices lost messages.

Source: rmw ``events_statuses`` for the fields of the info objects. Which policies are incompatible
is decided by `turtleact.transports.graph.misfits`.
"""

from __future__ import annotations

import time
from collections import Counter
from typing import Final, NamedTuple

from turtleact.rclpy.impl.connection import Connection
from turtleact.rclpy.impl.entity import NOTHING, CallbackGroup, Waitable, await_or_execute
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.qos import QoSPolicyKind
from turtleact.transports.base import Endpoint
from turtleact.transports.graph import Policy, misfits

__all__ = [
    "EventCallbacks",
    "EventHandler",
    "IncompatibleTypeInfo",
    "PublisherEventCallbacks",
    "QoSLivelinessChangedInfo",
    "QoSLivelinessLostInfo",
    "QoSMessageLostInfo",
    "QoSOfferedDeadlineMissedInfo",
    "QoSOfferedIncompatibleQoSInfo",
    "QoSPublisherMatchedInfo",
    "QoSRequestedDeadlineMissedInfo",
    "QoSRequestedIncompatibleQoSInfo",
    "QoSSubscriptionMatchedInfo",
    "SubscriptionEventCallbacks",
]

KINDS: Final[dict[Policy, QoSPolicyKind]] = {
    "durability": QoSPolicyKind.DURABILITY,
    "deadline": QoSPolicyKind.DEADLINE,
    "liveliness": QoSPolicyKind.LIVELINESS,
    "lease": QoSPolicyKind.LIVELINESS,
    "reliability": QoSPolicyKind.RELIABILITY,
}


class QoSOfferedDeadlineMissedInfo(NamedTuple):
    """Reports an event, such as a deadline without a message.

    Attributes:
        total_count: How often the event has happened since the endpoint was opened.
        total_count_change: How often the event has happened since the last callback.
    """

    total_count: int = 0
    total_count_change: int = 0


class QoSRequestedIncompatibleQoSInfo(NamedTuple):
    """Reports endpoints at the other end of the topic that have an incompatible quality of service.

    Attributes:
        total_count: As in `QoSOfferedDeadlineMissedInfo`.
        total_count_change: As in `QoSOfferedDeadlineMissedInfo`.
        last_policy_kind: The policy that makes the last of these endpoints incompatible.
    """

    total_count: int = 0
    total_count_change: int = 0
    last_policy_kind: QoSPolicyKind = QoSPolicyKind.INVALID


class QoSPublisherMatchedInfo(NamedTuple):
    """Reports that endpoints at the other end of the topic have come or gone.

    Attributes:
        total_count: How many have come since the endpoint was opened.
        total_count_change: How many have come since the last callback.
        current_count: How many of these endpoints there are now.
        current_count_change: How much ``current_count`` has changed since the last callback.
    """

    total_count: int = 0
    total_count_change: int = 0
    current_count: int = 0
    current_count_change: int = 0


class QoSLivelinessChangedInfo(NamedTuple):
    """Reports that publishers of the topic have come or gone.

    Attributes:
        alive_count: How many publishers are alive.
        not_alive_count: Always 0, because a publisher counts as alive until it leaves the graph.
        alive_count_change: How much ``alive_count`` has changed since the last callback.
        not_alive_count_change: Always 0.
    """

    alive_count: int = 0
    not_alive_count: int = 0
    alive_count_change: int = 0
    not_alive_count_change: int = 0


QoSRequestedDeadlineMissedInfo = QoSOfferedDeadlineMissedInfo
QoSLivelinessLostInfo = QoSOfferedDeadlineMissedInfo
QoSMessageLostInfo = QoSOfferedDeadlineMissedInfo
IncompatibleTypeInfo = QoSOfferedDeadlineMissedInfo
QoSOfferedIncompatibleQoSInfo = QoSRequestedIncompatibleQoSInfo
QoSSubscriptionMatchedInfo = QoSPublisherMatchedInfo


class EventHandler(Waitable):
    """Calls a callback for each event of one kind.

    Args:
        callback_group: Decides when the callback may run.
        callback: Called with the info object of each event.
        node: The node of the endpoint.
        own: The endpoint that has the events.
        name: The kind of event.
    """

    def __init__(
        self,
        callback_group: CallbackGroup,
        callback: Anything,
        node: Anything,
        own: Endpoint,
        name: str,
    ) -> None:
        self.callback = callback
        self._connection: Connection = node.connection
        self._own = own
        self._name = name
        self._info: object | None = None
        close = self._connection.watch(node.wake_executor)
        super().__init__(callback_group, close=close, wake=node.wake_executor)

    def _poll(self) -> object | None:
        """If an event has happened since the last call, return its info object; otherwise None."""

    def noted(self, *, is_message: bool = True) -> None:  # noqa: ARG002  # for the class below
        """Record a message, or an assertion of liveliness if ``is_message`` is false."""
        self.wake()  # the executor sleeps until the next event that was due

    def is_ready_now(self) -> bool:
        """Whether an event has happened."""
        if self.handle.is_destroyed:
            return False
        if self._info is None:
            self._info = self._poll()
        return self._info is not None

    def take(self) -> object:
        """Return the info object of the event, and forget it."""
        taken, self._info = self._info, None
        return NOTHING if taken is None else taken

    async def run(self, taken: object) -> None:
        """Call the callback with the info object."""
        await await_or_execute(self.callback, taken)


class _Late(EventHandler):
    """Notices when no message comes for longer than a limit.

    The limit does not apply before the first message. Deadlines count each further period without a
    message. Liveliness counts only the first one, and an assertion of liveliness is as good as a
    message.
    """

    def __init__(self, *given: Anything) -> None:
        super().__init__(*given)
        self._repeats = self._name == "deadline"
        times = self._own.times
        is_manual = times.liveliness == "manual_by_topic"
        self._limit = times.deadline if self._repeats else times.lease if is_manual else None
        self._last: int | None = None
        self._total = 0

    def _poll(self) -> object | None:
        last, now = self._last, time.monotonic_ns()
        if self._limit is None or last is None or now < last + self._limit:
            return None
        missed = (now - last) // self._limit if self._repeats else 1
        self._last = last + missed * self._limit if self._repeats else None
        self._total += missed
        return QoSOfferedDeadlineMissedInfo(self._total, missed)

    def due_in(self) -> float | None:
        """Return the time until a time limit is exceeded (s); None if no limit applies."""
        last = self._last
        if self._limit is None or last is None or self.handle.is_destroyed:
            return None
        return max(0.0, (last + self._limit - time.monotonic_ns()) / 1e9)

    def noted(self, *, is_message: bool = True) -> None:
        """Record a message, or an assertion of liveliness if ``is_message`` is false."""
        if is_message or not self._repeats:
            self._last = time.monotonic_ns()
        super().noted(is_message=is_message)


class _Seen(EventHandler):
    """Notices endpoints at the other end of the topic that appear or disappear."""

    def __init__(self, *given: Anything) -> None:
        super().__init__(*given)
        self._there: Counter[Endpoint] = Counter()
        self._changes = -1
        self._total = 0

    def _poll(self) -> object | None:
        changes = self._connection.changes
        if changes == self._changes:
            return None
        self._changes = changes
        other = "subscription" if self._own.kind == "publisher" else "publisher"
        wants_same_type = self._name != "incompatible_type"
        before = self._there
        now = self._there = Counter(
            each
            for each in self._connection.endpoints(self._own.name)
            if each.kind == other and (each.type_name == self._own.type_name) == wants_same_type
        )
        return None if now == before else self._tell(now.total(), now - before, before - now)

    def _tell(self, now: int, come: Counter[Endpoint], gone: Counter[Endpoint]) -> object | None:
        """Return the info object for endpoints that have come or gone; ``now`` are there."""
        if self._name == "liveliness":
            return QoSLivelinessChangedInfo(now, 0, come.total() - gone.total(), 0)
        if self._name == "incompatible_qos":
            return self._tell_misfits(come)
        added = come.total()
        self._total += added
        if self._name == "matched":
            return QoSPublisherMatchedInfo(self._total, added, now, added - gone.total())
        return IncompatibleTypeInfo(self._total, added) if added else None

    def _tell_misfits(self, come: Counter[Endpoint]) -> object | None:
        # As in DDS, one endpoint counts once, by the first policy that does not fit.
        first = [next(misfits(self._own, each), None) for each in come.elements()]
        kinds = [KINDS[policy] for policy in first if policy is not None]
        self._total += len(kinds)
        if not kinds:
            return None
        return QoSRequestedIncompatibleQoSInfo(self._total, len(kinds), kinds[-1])


class EventCallbacks:
    """The callbacks for the events of an endpoint.

    Args:
        use_default_callbacks: Ignored, because there are no default callbacks.
        **callbacks: The callbacks. Each keyword is the name of an event.

    Raises:
        TypeError: if a keyword is not the name of an event.
    """

    NAMES: tuple[str, ...]

    def __init__(self, *, use_default_callbacks: bool = True, **callbacks: Anything) -> None:
        self.use_default_callbacks = use_default_callbacks
        if unknown := callbacks.keys() - set(self.NAMES):
            raise TypeError(f"unexpected keyword arguments: {', '.join(sorted(unknown))}")
        for name in self.NAMES:
            setattr(self, name, callbacks.get(name))

    def create_event_handlers(
        self, callback_group: CallbackGroup, node: Anything, own: Endpoint
    ) -> list[EventHandler]:
        """Make an `EventHandler` for each callback.

        Args:
            callback_group: Decides when the callbacks may run.
            node: The node of the endpoint.
            own: The endpoint that has the events.
        """
        given = ((name, getattr(self, name)) for name in self.NAMES)
        return [
            _kind(name, own)(callback_group, callback, node, own, name)
            for name, callback in given
            if callback is not None
        ]


class PublisherEventCallbacks(EventCallbacks):
    """Callbacks for a publisher's events. Each keyword argument is named after its event."""

    NAMES = ("deadline", "liveliness", "incompatible_qos", "incompatible_type", "matched")


class SubscriptionEventCallbacks(EventCallbacks):
    """Callbacks for a subscription's events. Each keyword argument is named after its event."""

    NAMES = (*PublisherEventCallbacks.NAMES, "message_lost")


def _kind(name: str, own: Endpoint) -> type[EventHandler]:
    """Return the class of the handlers for one kind of event of an endpoint."""
    if name == "message_lost":
        return EventHandler
    is_own = name == "liveliness" and own.kind == "publisher"
    return _Late if name == "deadline" or is_own else _Seen
