"""Turns the frames of one client into effects by rosbridge's rules, without I/O.

A `Protocol` knows what a client has opened and under which ids, how much the client may open, and
which status messages the client wants. It uses no graph, no event loop and no clock. It returns
effects, which the caller must carry out in order.

- A client may subscribe to one topic several times, with different ids. These subscriptions share
  one subscription on the graph, with the smallest ``throttle_rate`` and the newest
  ``compression``.
- ``unsubscribe`` without an id ends all of the client's subscriptions to the topic. ``unadvertise``
  without an id ends all of the client's advertisements of the topic.
- Only clients that have sent ``set_level`` get ``status`` frames, because client libraries fail on
  operations that they do not expect.

Source: ``ROSBRIDGE_PROTOCOL.md`` of rosbridge_suite, version 2, and its ``capabilities/``.
"""

from __future__ import annotations

import math
from typing import Final, TypeAlias

import msgspec

from turtleact.web import operations
from turtleact.web.message_conversion import COMPRESSIONS, Compression, reply
from turtleact.web.operations import Id, parse

__all__ = [
    "Adjust",
    "Delivery",
    "Do",
    "Effect",
    "Open",
    "Protocol",
    "Reader",
    "Say",
    "Shut",
    "Writer",
]

LEVELS: Final = {"none": 0, "error": 1, "warning": 2, "info": 3}

LONGEST_QUEUE: Final = 1000
"""The maximum of ``queue_size``. Larger values are reduced to the maximum."""

LONGEST_INTERVAL: Final = 3600.0
"""The maximum of ``throttle_rate`` (s). Larger values are reduced to the maximum."""


class Delivery(msgspec.Struct, frozen=True):
    """How a client wants to get the messages of a topic.

    Attributes:
        interval: The minimum time between two messages (s).
        compression: How messages are encoded.
    """

    interval: float = 0.0
    compression: Compression = "none"


class Reader(msgspec.Struct, frozen=True):
    """A topic that a client subscribes to. ``key`` is the topic's name as the client spells it."""

    key: str
    type: str
    delivery: Delivery
    id: Id = None


class Writer(msgspec.Struct, frozen=True):
    """A topic that a client publishes to. ``key`` is the topic's name as the client spells it."""

    key: str
    type: str
    is_latched: bool
    depth: int
    id: Id = None


class Open(msgspec.Struct, frozen=True):
    """An effect: open a subscription or a publisher, or start to serve a service or an action."""

    what: Reader | Writer | operations.AdvertiseService | operations.AdvertiseAction


class Shut(msgspec.Struct, frozen=True):
    """An effect: close what `Open` has opened.

    Attributes:
        kind: ``reader``, ``writer``, ``service`` or ``action``.
        key: The name of the topic, service or action as the client spells it.
    """

    kind: str
    key: str


class Adjust(msgspec.Struct, frozen=True):
    """An effect: change how the client gets the messages of a topic that it subscribes to."""

    key: str
    delivery: Delivery


class Do(msgspec.Struct, frozen=True):
    """An effect: carry out an operation that neither opens nor closes anything."""

    operation: (
        operations.Publish
        | operations.CallService
        | operations.ServiceResponse
        | operations.SendActionGoal
        | operations.CancelActionGoal
        | operations.ActionFeedback
        | operations.ActionResult
    )


class Say(msgspec.Struct, frozen=True):
    """An effect: send a frame to the client."""

    frame: str


Effect: TypeAlias = Open | Shut | Adjust | Do | Say


class Protocol:
    """Keeps the state of one client, and applies rosbridge's rules to its frames.

    Args:
        most_opened: How many subscriptions, advertisements, services and actions the client may
            have open.

    Attributes:
        level: Which status messages the client wants: 0 for none, 1 for errors, 2 for errors and
            warnings, 3 for all.
    """

    def __init__(self, most_opened: int = 256) -> None:
        self.level = 0
        self._most_opened = most_opened
        self._opened = 0
        self._readers: dict[str, dict[Id, Delivery]] = {}
        self._writers: dict[str, set[Id]] = {}
        self._served: set[tuple[str, str]] = set()

    def receive(self, frame: str | bytes) -> list[Effect]:
        """Return the effects of a frame that the client has sent."""
        said = parse(frame)
        if isinstance(said, operations.Malformed):
            return self.complain(f"not understood: {said.problem}", said.id)
        match said:
            case operations.SetLevel():
                return self._set_level(said)
            case operations.Subscribe():
                return self._subscribe(said)
            case operations.Unsubscribe():
                return self._unsubscribe(said)
            case operations.Advertise():
                return self._advertise(said)
            case operations.Unadvertise():
                return self._unadvertise(said)
            case operations.Publish():
                return self._publish(said)
            case operations.AdvertiseService():
                return self._serve("service", said.service, said)
            case operations.AdvertiseAction():
                return self._serve("action", said.action, said)
            case operations.UnadvertiseService():
                return self._serve_no_more("service", said.service)
            case operations.UnadvertiseAction():
                return self._serve_no_more("action", said.action)
        return [Do(said)]

    def complain(self, problem: str, id: Id = None, *, level: str = "error") -> list[Effect]:
        """Return an effect that reports a problem, if the client wants messages of this level."""
        if self.level < LEVELS[level]:
            return []
        return [Say(reply("status", id, level=level, msg=problem))]

    def forget(self, kind: str, key: str) -> None:
        """Record that a subscription, publisher, service or action is closed or could not open."""
        if kind == "reader":
            self._opened -= len(self._readers.pop(key, ()))
        elif kind == "writer":
            self._opened -= len(self._writers.pop(key, ()))
        elif (kind, key) in self._served:
            self._served.remove((kind, key))
            self._opened -= 1

    def _set_level(self, said: operations.SetLevel) -> list[Effect]:
        level = LEVELS.get(said.level or "none")
        if level is None:
            # Otherwise the client would not hear of its mistake: it may not have asked for errors
            # yet.
            self.level = max(self.level, LEVELS["error"])
            return self.complain(f"no level '{said.level}': say {', '.join(LEVELS)}", said.id)
        self.level = level
        return []

    # topics

    def _subscribe(self, said: operations.Subscribe) -> list[Effect]:
        compression = said.compression or "none"
        if compression not in COMPRESSIONS:
            problem = f"no compression '{compression}': say {', '.join(COMPRESSIONS)}"
            return self.complain(problem, said.id)
        wishes = self._readers.get(said.topic)
        if (wishes is None or said.id not in wishes) and not self._may_open():
            return self._refuse(said.id)
        interval = min(_amount(said.throttle_rate) / 1000, LONGEST_INTERVAL)
        delivery = Delivery(interval, compression)
        if wishes is None:
            self._readers[said.topic] = {said.id: delivery}
            self._opened += 1
            return [Open(Reader(said.topic, said.type or "", delivery, said.id))]
        self._opened += said.id not in wishes
        wishes.pop(said.id, None)  # the newest stands last
        wishes[said.id] = delivery
        return [Adjust(said.topic, _merged(wishes))]

    def _unsubscribe(self, said: operations.Unsubscribe) -> list[Effect]:
        wishes = self._readers.get(said.topic)
        if wishes is None or (said.id is not None and said.id not in wishes):
            return self.complain(
                f"'{said.topic}' has no such subscription", said.id, level="warning"
            )
        if said.id is not None and len(wishes) > 1:
            del wishes[said.id]
            self._opened -= 1
            return [Adjust(said.topic, _merged(wishes))]
        self.forget("reader", said.topic)
        return [Shut("reader", said.topic)]

    def _advertise(self, said: operations.Advertise) -> list[Effect]:
        ids = self._writers.get(said.topic)
        if ids is not None and said.id in ids:
            return []
        if not self._may_open():
            return self._refuse(said.id)
        self._opened += 1
        if ids is not None:
            ids.add(said.id)
            return []
        self._writers[said.topic] = {said.id}
        depth = int(min(max(_amount(said.queue_size), 1), LONGEST_QUEUE))
        return [Open(Writer(said.topic, said.type, bool(said.latch), depth, said.id))]

    def _unadvertise(self, said: operations.Unadvertise) -> list[Effect]:
        ids = self._writers.get(said.topic)
        if ids is None or (said.id is not None and said.id not in ids):
            return self.complain(
                f"'{said.topic}' has no such advertisement", said.id, level="warning"
            )
        if said.id is not None and len(ids) > 1:
            ids.remove(said.id)
            self._opened -= 1
            return []
        self.forget("writer", said.topic)
        return [Shut("writer", said.topic)]

    def _publish(self, said: operations.Publish) -> list[Effect]:
        """Publish a message. If the topic is not advertised yet, advertise it without an id."""
        if said.topic in self._writers:
            return [Do(said)]
        if not self._may_open():
            return self._refuse(said.id)
        self._opened += 1
        self._writers[said.topic] = {None}
        writer = Writer(said.topic, said.type or "", bool(said.latch), 1, said.id)
        return [Open(writer), Do(said)]

    # services and actions

    def _serve(
        self,
        kind: str,
        name: str,
        said: operations.AdvertiseService | operations.AdvertiseAction,
    ) -> list[Effect]:
        if (kind, name) in self._served:
            # A client that has reloaded its page advertises again, perhaps with another type.
            return [Shut(kind, name), Open(said)]
        if not self._may_open():
            return self._refuse(said.id)
        self._served.add((kind, name))
        self._opened += 1
        return [Open(said)]

    def _serve_no_more(self, kind: str, name: str) -> list[Effect]:
        if (kind, name) not in self._served:
            return self.complain(f"{kind} '{name}' is not advertised", level="warning")
        self.forget(kind, name)
        return [Shut(kind, name)]

    def _may_open(self) -> bool:
        return self._opened < self._most_opened

    def _refuse(self, id: Id) -> list[Effect]:
        problem = f"{self._opened} subscriptions and advertisements are open: close some first"
        return self.complain(problem, id)


def _merged(wishes: dict[Id, Delivery]) -> Delivery:
    """Merge the settings of a client's subscriptions to one topic, given from old to new."""
    return Delivery(
        min(each.interval for each in wishes.values()),
        next(reversed(wishes.values())).compression,
    )


def _amount(number: float | None) -> float:
    """Return a number from a client, or 0 if the number is negative, NaN or None."""
    return 0.0 if number is None or math.isnan(number) else max(float(number), 0.0)
