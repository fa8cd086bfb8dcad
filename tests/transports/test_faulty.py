"""The suite of all transports, over a `FaultyTransport` that is given no faults."""

from __future__ import annotations

from contextlib import asynccontextmanager

import pytest

from turtleact.testing import FaultyTransport
from turtleact.transports import MemoryTransport, Transport

from ..lab import settle
from .conformance import Peers, TransportConformance


class TestFaultyTransport(TransportConformance):
    @pytest.fixture
    def transport(self):
        @asynccontextmanager
        async def open_peers():
            async with FaultyTransport(MemoryTransport()) as faulty:
                transport: Transport = faulty
                yield Peers(transport, transport, settle)

        return open_peers
