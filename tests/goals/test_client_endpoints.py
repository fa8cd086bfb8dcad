"""How many requests a client sends before one is answered, and what it knows of its server."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Any

import anyio
import pytest

from turtleact.errors import PauseRefused, ServerUnavailable
from turtleact.goals.client_endpoints import AT_ONCE, ClientEndpoints, RequestLimiter
from turtleact.goals.wire import GoalMetadata
from turtleact.interfaces import WireFormat, implied
from turtleact.names import action_names
from turtleact.transports import MemoryTransport, QoS
from turtleact.transports.base import Closeable, Endpoint, EndpointKind, Reply, ServiceHandler

from ..lab import ON_ASYNCIO, Count, bare_goal, running, settle

NAMES = action_names("/count")
SEND_GOAL = implied(Count).send_goal
OURS, STRANGER = Reply(None, GoalMetadata().write()), Reply(None)


class Service:
    """Notes what it is sent, and answers when it is told to."""

    def __init__(self) -> None:
        self.sent: list[object] = []
        self.answered = anyio.Semaphore(0)

    async def call(self, request: object, note: str = "") -> Reply:
        self.sent.append(request)
        await self.answered.acquire()
        return Reply(request)


def start(tasks: Any, limiter: RequestLimiter, service: Any, *requests: int) -> None:
    for request in requests:
        tasks.start_soon(partial(limiter.call, service, request))


async def test_the_next_is_sent_once_one_is_answered():
    limiter, service = RequestLimiter(), Service()
    async with anyio.create_task_group() as tasks:
        start(tasks, limiter, service, *range(AT_ONCE + 2))
        await settle()
        assert len(service.sent) == AT_ONCE
        service.answered.release()
        await settle()
        assert len(service.sent) == AT_ONCE + 1
        tasks.cancel_scope.cancel()


async def test_who_gives_up_its_turn_is_not_sent():
    limiter, service = RequestLimiter(), Service()
    caller: Any = service
    async with anyio.create_task_group() as tasks:
        start(tasks, limiter, service, *range(AT_ONCE))
        await settle()
        async with running(lambda: limiter.call(caller, "given up")) as waiting:
            await settle()
            waiting.scope.cancel()
        start(tasks, limiter, service, AT_ONCE)
        service.answered.release()
        await settle()
        assert sorted(service.sent, key=str) == list(range(AT_ONCE + 1))
        tasks.cancel_scope.cancel()


@ON_ASYNCIO
async def test_a_turn_that_comes_with_a_cancellation_goes_to_the_next():
    limiter, service = RequestLimiter(), Service()
    caller: Any = service
    async with anyio.create_task_group() as tasks:
        start(tasks, limiter, service, *range(AT_ONCE))
        await settle()
        given_up = asyncio.create_task(limiter.call(caller, "given up"))
        await settle()
        start(tasks, limiter, service, AT_ONCE)
        await settle()
        limiter.admit_all()  # it has its turn now, and has not heard of it
        given_up.cancel()
        await settle()
        assert given_up.cancelled()
        assert service.sent == list(range(AT_ONCE + 1))
        for _ in range(2):  # the first two are over, so there is room for one
            service.answered.release()
        await settle()
        start(tasks, limiter, service, AT_ONCE + 1)
        await settle()
        assert service.sent == list(range(AT_ONCE + 2))
        tasks.cancel_scope.cancel()


async def test_all_that_wait_are_sent_to_a_server_that_drops_nothing():
    limiter, service = RequestLimiter(), Service()
    async with anyio.create_task_group() as tasks:
        start(tasks, limiter, service, *range(3 * AT_ONCE))
        await settle()
        limiter.admit_all()
        await settle()
        assert len(service.sent) == 3 * AT_ONCE
        tasks.cancel_scope.cancel()


async def test_those_that_come_after_all_were_sent_wait_their_turn_again():
    limiter, service = RequestLimiter(), Service()
    async with anyio.create_task_group() as tasks:
        start(tasks, limiter, service, *range(AT_ONCE + 1))
        await settle()
        limiter.admit_all()
        start(tasks, limiter, service, *range(AT_ONCE))
        await settle()
        assert len(service.sent) == AT_ONCE + 1
        for answered in (1, 2):
            service.answered.release()
            await settle()
            assert len(service.sent) == AT_ONCE + answered
        tasks.cancel_scope.cancel()


# --- what is known of the server ----------------------------------------------------------------


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
