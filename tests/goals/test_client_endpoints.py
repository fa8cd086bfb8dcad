"""What a client knows of the server that is to pause a goal."""

from __future__ import annotations

import pytest

from turtleact.errors import PauseRefused, ServerUnavailable
from turtleact.goals.client_endpoints import ClientEndpoints
from turtleact.interfaces import WireFormat, implied
from turtleact.names import action_names
from turtleact.transports import MemoryTransport, QoS
from turtleact.transports.base import Closeable, Endpoint, EndpointKind, Reply, ServiceHandler

from ..lab import Count, bare_goal

NAMES = action_names("/count")
SEND_GOAL = implied(Count).send_goal


def endpoint(kind: EndpointKind, name: str, type_name: str, qos: QoS | None = None) -> Endpoint:
    return Endpoint(kind, name, type_name, "/user", qos or QoS())


class Handler(ServiceHandler):
    """Answers requests, which these tests never send."""

    async def reply(self, request: object, caller: bytes) -> Reply:
        raise NotImplementedError


def serve(transport: MemoryTransport, number: int) -> Closeable:
    """A server of the action; its gid tells it from others."""
    described = Endpoint("service", NAMES.send_goal, SEND_GOAL.type_name, "/lab", gid=bytes(number))
    return transport.serve(described, WireFormat(SEND_GOAL), Handler())


def client(transport: MemoryTransport) -> ClientEndpoints:
    return ClientEndpoints(transport, endpoint, NAMES, Count)


@pytest.mark.parametrize(
    ("servers", "error", "text"),
    [
        (0, ServerUnavailable, "action '/count': the server is gone, so its goals cannot be "),
        (1, PauseRefused, "its server does not offer that"),
    ],
)
async def test_a_server_that_is_gone_is_told_from_one_that_cannot_pause(
    monkeypatch, servers, error, text
):
    monkeypatch.setattr("turtleact.goals.client_endpoints.OFFERED_WITHIN", 0.01)
    transport = MemoryTransport()
    for number in range(servers):
        serve(transport, number + 1)
    endpoints = client(transport)
    with pytest.raises(error, match=text):
        await endpoints.set_paused(bare_goal(), is_paused=True)
    endpoints.close()
