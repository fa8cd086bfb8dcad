"""The transport inside one process: the common suite, and what is its own."""

from __future__ import annotations

import gc
from collections.abc import Callable
from contextlib import asynccontextmanager

import pytest

from turtleact.tasks.clock import VirtualClock, WallClock
from turtleact.transports import MemoryTransport, Transport
from turtleact.transports.base import RawFormat, Source

from ..lab import feedback, settle
from .conformance import (
    KINDS,
    LATCHED,
    SPEECH,
    Inbox,
    Peers,
    TransportConformance,
    of_kind,
    open_it,
    publisher,
    subscription,
)


class TestMemoryTransport(TransportConformance):
    @pytest.fixture
    def transport(self):
        @asynccontextmanager
        async def open_peers():
            transport: Transport = MemoryTransport()
            yield Peers(transport, transport, settle)

        return open_peers


async def test_a_message_is_handed_on_as_it_is_in_the_publishers_own_call():
    seen: list[object] = []
    transport, message = MemoryTransport(), feedback(1)
    transport.subscribe(subscription(), SPEECH, seen.append)
    transport.advertise(publisher(), SPEECH).publish(message)
    assert seen[0] is message


async def test_a_latched_message_is_there_when_subscribing_returns():
    seen: list[object] = []
    transport = MemoryTransport()
    transport.advertise(publisher(qos=LATCHED), SPEECH).publish(feedback(1))
    transport.subscribe(subscription(qos=LATCHED), SPEECH, seen.append)
    assert seen == [feedback(1)]


async def test_a_source_writes_bytes_if_all_its_readers_take_them():
    class Told(Source):
        def current(self) -> list[object]:
            return [feedback(1)]

        def written(self, encode: Callable[[object], bytes]) -> list[bytes]:
            return [b"written"]

        def readers_changed(self, *, has_readers: bool) -> None:
            """Do nothing."""

    seen: list[object] = []
    transport = MemoryTransport()
    publication = transport.advertise(publisher(), SPEECH, Told())
    transport.subscribe(subscription(), RawFormat(SPEECH.type_hash), seen.append)
    publication.refresh()
    assert seen == [b"written"]
    transport.subscribe(subscription(), SPEECH, Inbox().deliver).close()
    publication.refresh()
    assert seen == [b"written"] * 2
    transport.subscribe(subscription(), SPEECH, Inbox().deliver)
    publication.refresh()
    assert seen == [b"written", b"written", feedback(1)]


async def test_what_was_opened_and_closed_leaves_nothing_behind():
    transport = MemoryTransport()

    def open_and_close(numbers: range) -> int:
        """Open and close things of as many names, and count the objects that there are then."""
        for number in numbers:
            for opened in [open_it(transport, of_kind(kind, f"/it{number}")) for kind in KINDS]:
                opened.close()
            transport.enter(f"/lab{number}").close()
        gc.collect()
        return len(gc.get_objects())

    before = open_and_close(range(10))
    assert open_and_close(range(10, 1000)) - before < 100
    assert (transport.endpoints(), transport.nodes()) == ((), ())


def test_its_time_is_the_walls_unless_it_is_given_another():
    clock = VirtualClock()
    assert isinstance(MemoryTransport().clock, WallClock)
    assert MemoryTransport(clock).clock is clock
