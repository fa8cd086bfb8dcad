"""Events of publishers and subscriptions, such as matches and missed deadlines.

The callback for an event gets an info object, such as a `QoSPublisherMatchedInfo`. An endpoint
without callbacks for events spends no time on events. Whenever the graph has changed, this module
reads the endpoints of the topic again. This module itself checks deadlines, and the liveliness of
publishers in this process, because transports enforce no time limits. Endpoints with an
incompatible quality of service are reported, but still exchange messages, as with rmw_zenoh. This
module never notices lost messages.

Source: rmw ``events_statuses`` for the fields of the info objects; `turtleact.graph.misfits`
decides which policies are incompatible.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from enum import IntEnum
from functools import partial
from typing import Final, Protocol, TypeAlias

import msgspec

from turtleact.rclpy.callback_groups import CallbackGroup
from turtleact.rclpy.executors import await_or_execute
from turtleact.rclpy.impl.connection import Connection
from turtleact.rclpy.impl.entity import NOTHING
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.qos import QoSPolicyKind
from turtleact.rclpy.waitable import Waitable
from turtleact.transports.base import Endpoint
from turtleact.transports.graph import Policy, misfits

__all__ = [
    "EventHandler",
    "IncompatibleTypeInfo",
    "PublisherEventCallbacks",
    "QoSLivelinessChangedInfo",
    "QoSLivelinessLostInfo",
    "QoSMessageLostInfo",
    "QoSOfferedDeadlineMissedInfo",
    "QoSOfferedIncompatibleQoSInfo",
    "QoSPublisherEventType",
    "QoSPublisherMatchedInfo",
    "QoSRequestedDeadlineMissedInfo",
    "QoSRequestedIncompatibleQoSInfo",
    "QoSSubscriptionEventType",
    "QoSSubscriptionMatchedInfo",
    "SubscriptionEventCallbacks",
    "UnsupportedEventTypeError",
]


KINDS: Final[dict[Policy, QoSPolicyKind]] = {
    "durability": QoSPolicyKind.DURABILITY,
    "deadline": QoSPolicyKind.DEADLINE,
    "liveliness": QoSPolicyKind.LIVELINESS,
    "lease": QoSPolicyKind.LIVELINESS,
    "reliability": QoSPolicyKind.RELIABILITY,
}


class UnsupportedEventTypeError(RuntimeError):
    """The middleware does not support this kind of event."""


class QoSPublisherEventType(IntEnum):
    """The events of a publisher."""

    RCL_PUBLISHER_OFFERED_DEADLINE_MISSED = 0
    RCL_PUBLISHER_LIVELINESS_LOST = 1
    RCL_PUBLISHER_OFFERED_INCOMPATIBLE_QOS = 2
    RCL_PUBLISHER_INCOMPATIBLE_TYPE = 3
    RCL_PUBLISHER_MATCHED = 4


class QoSSubscriptionEventType(IntEnum):
    """The events of a subscription."""

    RCL_SUBSCRIPTION_REQUESTED_DEADLINE_MISSED = 0
    RCL_SUBSCRIPTION_LIVELINESS_CHANGED = 1
    RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS = 2
    RCL_SUBSCRIPTION_MESSAGE_LOST = 3
    RCL_SUBSCRIPTION_INCOMPATIBLE_TYPE = 4
    RCL_SUBSCRIPTION_MATCHED = 5


class _Counted(msgspec.Struct, frozen=True, kw_only=True):
    """How often an event has happened.

    Attributes:
        total_count: How often the event has happened since the endpoint was opened.
        total_count_change: How often the event has happened since the last callback.
    """

    total_count: int = 0
    total_count_change: int = 0


class QoSOfferedDeadlineMissedInfo(_Counted, frozen=True):
    """Reports that the publisher did not publish a message before its deadline."""


class QoSRequestedDeadlineMissedInfo(_Counted, frozen=True):
    """Reports that the subscription got no message before its deadline."""


class QoSLivelinessLostInfo(_Counted, frozen=True):
    """Reports that the publisher did not assert its liveliness in time."""


class QoSMessageLostInfo(_Counted, frozen=True):
    """Reports that messages were lost.

    No callback receives such an object, because turtleact's rclpy never detects lost messages.
    """


class IncompatibleTypeInfo(_Counted, frozen=True):
    """Reports that endpoints at the other end of the topic have a different message type."""


class QoSRequestedIncompatibleQoSInfo(_Counted, frozen=True, kw_only=True):
    """Reports endpoints at the other end of the topic that have an incompatible quality of service.

    Attributes:
        last_policy_kind: The policy that makes the last of these endpoints incompatible.
    """

    last_policy_kind: QoSPolicyKind = QoSPolicyKind.INVALID


class QoSPublisherMatchedInfo(_Counted, frozen=True, kw_only=True):
    """Reports that endpoints at the other end of the topic have come or gone.

    Attributes:
        current_count: How many of these endpoints there are now.
        current_count_change: How much ``current_count`` has changed since the last callback.
    """

    current_count: int = 0
    current_count_change: int = 0


class QoSLivelinessChangedInfo(msgspec.Struct, frozen=True, kw_only=True):
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


QoSOfferedIncompatibleQoSInfo = QoSRequestedIncompatibleQoSInfo
QoSSubscriptionMatchedInfo = QoSPublisherMatchedInfo


class Event(Protocol):
    """Notices one kind of event.

    Any thread may call `noted`. Only one thread at a time calls the other methods.
    """

    def poll(self) -> object | None:
        """If an event has happened since the last call, return its info object; otherwise None."""

    def due_in(self) -> float | None:
        """Return the time until a time limit is exceeded (s); None if no limit applies."""

    def noted(self, *, is_message: bool) -> None:
        """Record a message, or an assertion of liveliness if ``is_message`` is false."""


class _Late(Event):
    """Notices when no message comes for longer than a limit.

    The limit does not apply before the first message.

    Args:
        limit: The longest time without a message (ns); None for no limit.
        info: The class of the info object.
        repeats: Whether to count each further period of ``limit`` without a message. If false, only
            the first period is counted, and an assertion of liveliness counts as a message.
    """

    def __init__(self, limit: int | None, info: type[_Counted], *, repeats: bool) -> None:
        self._limit = limit
        self._info = info
        self._repeats = repeats
        self._last: int | None = None
        self._total = 0

    def poll(self) -> object | None:
        last, now = self._last, time.monotonic_ns()
        if self._limit is None or last is None or now < last + self._limit:
            return None
        missed = (now - last) // self._limit if self._repeats else 1
        self._last = last + missed * self._limit if self._repeats else None
        self._total += missed
        return self._info(total_count=self._total, total_count_change=missed)

    def due_in(self) -> float | None:
        last = self._last
        if self._limit is None or last is None:
            return None
        return max(0.0, (last + self._limit - time.monotonic_ns()) / 1e9)

    def noted(self, *, is_message: bool) -> None:
        if is_message or not self._repeats:
            self._last = time.monotonic_ns()


Found: TypeAlias = "Counter[Endpoint]"
"""The endpoints at the other end of the topic.

The counter says how many endpoints share each description.
"""

Tell: TypeAlias = "Callable[[Found, Found, Found], object | None]"
"""Makes an event's info object from the endpoints that are present, new and gone."""


class _Seen(Event):
    """Detects endpoints at the other end of the topic that appear or disappear.

    Args:
        connection: The connection to the graph.
        own: The publisher or subscription that has the callbacks.
        wanted: A function that returns whether to watch an endpoint at the other end of the topic.
        tell: A function that returns the info object of the event, or None if there is no event.
    """

    def __init__(
        self,
        connection: Connection,
        own: Endpoint,
        wanted: Callable[[Endpoint], bool],
        tell: Tell,
    ) -> None:
        self._connection = connection
        self._own = own
        self._wanted = wanted
        self._tell = tell
        self._there: Found = Counter()
        self._seen = -1

    def poll(self) -> object | None:
        changes = self._connection.changes
        if changes == self._seen:
            return None
        self._seen = changes
        other = "subscription" if self._own.kind == "publisher" else "publisher"
        ends = self._connection.endpoints(self._own.name)
        now = Counter(each for each in ends if each.kind == other and self._wanted(each))
        before, self._there = self._there, now
        return None if now == before else self._tell(now, now - before, before - now)

    def due_in(self) -> None:
        """Return None: these events have no time limit, because only graph changes cause them."""

    def noted(self, *, is_message: bool) -> None:
        """Do nothing, because messages do not cause these events."""


class _Totals:
    """Makes the info objects of events, and counts the endpoints that have caused these events."""

    def __init__(self) -> None:
        self._total = 0

    def _counted(self, come: Found) -> dict[str, int]:
        self._total += come.total()
        return {"total_count": self._total, "total_count_change": come.total()}

    def matched(self, now: Found, come: Found, gone: Found) -> object:
        change = come.total() - gone.total()
        counts = {"current_count": now.total(), "current_count_change": change}
        return QoSPublisherMatchedInfo(**self._counted(come), **counts)

    def of_other_type(self, now: Found, come: Found, gone: Found) -> object | None:
        del now, gone
        return IncompatibleTypeInfo(**self._counted(come)) if come else None

    def incompatible(self, own: Endpoint, now: Found, come: Found, gone: Found) -> object | None:
        del now, gone
        # As in DDS, one endpoint counts once, by the first policy that does not fit.
        first = [next(misfits(own, each), None) for each in come.elements()]
        kinds = [KINDS[policy] for policy in first if policy is not None]
        if not kinds:
            return None
        self._total += len(kinds)
        return QoSRequestedIncompatibleQoSInfo(
            total_count=self._total, total_count_change=len(kinds), last_policy_kind=kinds[-1]
        )


def _alive(now: Found, come: Found, gone: Found) -> object:
    change = come.total() - gone.total()
    return QoSLivelinessChangedInfo(alive_count=now.total(), alive_count_change=change)


class EventHandler(Waitable):
    """Calls a callback for each event of one kind.

    Args:
        callback_group: Decides when the callback may run.
        callback: Called with the info object of each event.
        event: The source of the events.
        connection: Tells the handler when the graph has changed.
    """

    def __init__(
        self,
        callback_group: CallbackGroup,
        callback: Anything,
        event: Event,
        connection: Connection,
    ) -> None:
        super().__init__(callback_group)
        self.callback = callback
        self._event = event
        self._info: object | None = None
        self._connection = connection
        connection.watch(self.wake)

    def noted(self, *, is_message: bool = True) -> None:
        """Record a message, or an assertion of liveliness if ``is_message`` is false."""
        self._event.noted(is_message=is_message)
        self.wake()  # the executor sleeps until the next event that was due

    def is_ready_now(self) -> bool:
        """Whether an event has happened."""
        if self._handle.is_destroyed:
            return False
        if self._info is None:
            self._info = self._event.poll()
        return self._info is not None

    def due_in(self) -> float | None:
        """Return the time until a time limit is exceeded (s); None if no limit applies."""
        return None if self._handle.is_destroyed else self._event.due_in()

    def take(self) -> object:
        """Return the info object of the event, and forget it."""
        taken, self._info = self._info, None
        return NOTHING if taken is None else taken

    async def run(self, taken: object) -> None:
        """Call the callback with the info object."""
        await await_or_execute(self.callback, taken)

    def destroy(self) -> None:
        """Destroy the handler. A second call does nothing."""
        self._connection.unwatch(self.wake)
        super().destroy()


class _EventCallbacks:
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
        self, callback_group: CallbackGroup, connection: Connection, own: Endpoint
    ) -> list[EventHandler]:
        """Make an `EventHandler` for each callback.

        Args:
            callback_group: Decides when the callbacks may run.
            connection: The connection to the graph.
            own: The endpoint that has the events.
        """
        given = ((name, getattr(self, name)) for name in self.NAMES)
        return [
            EventHandler(callback_group, callback, _event(name, connection, own), connection)
            for name, callback in given
            if callback is not None
        ]


class PublisherEventCallbacks(_EventCallbacks):
    """Callbacks for a publisher's events. Each keyword argument is named after its event."""

    NAMES = ("deadline", "liveliness", "incompatible_qos", "incompatible_type", "matched")


class SubscriptionEventCallbacks(_EventCallbacks):
    """Callbacks for a subscription's events. Each keyword argument is named after its event."""

    NAMES = (*PublisherEventCallbacks.NAMES, "message_lost")


def _event(name: str, connection: Connection, own: Endpoint) -> Event:
    """Return the object that notices an endpoint's events of the kind ``name``."""
    is_publisher = own.kind == "publisher"
    totals = _Totals()
    if name == "deadline":
        info = QoSOfferedDeadlineMissedInfo if is_publisher else QoSRequestedDeadlineMissedInfo
        return _Late(own.times.deadline, info, repeats=True)
    if name == "message_lost":
        return _Late(None, QoSMessageLostInfo, repeats=True)
    if name == "liveliness" and is_publisher:
        is_manual = own.times.liveliness == "manual_by_topic"
        limit = own.times.lease if is_manual else None
        return _Late(limit, QoSLivelinessLostInfo, repeats=False)
    if name == "incompatible_type":
        return _Seen(connection, own, lambda each: not _fits(own, each), totals.of_other_type)
    tells: dict[str, Tell] = {
        "matched": totals.matched,
        "liveliness": _alive,
        "incompatible_qos": partial(totals.incompatible, own),
    }
    return _Seen(connection, own, lambda each: _fits(own, each), tells[name])


def _fits(own: Endpoint, other: Endpoint) -> bool:
    return own.type_name == other.type_name
