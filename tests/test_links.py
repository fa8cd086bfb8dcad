"""How many requests the client of an action sends at once: what it knows of its server."""

from __future__ import annotations

from functools import partial
from typing import Any

import anyio
import pytest

from turtleact.client.links import Links
from turtleact.client.pace import AT_ONCE
from turtleact.goal_note import GoalNote
from turtleact.interfaces import WireFormat, implied
from turtleact.interfaces.standard import CancelGoal
from turtleact.names import action_names
from turtleact.transports import MemoryTransport, QoS
from turtleact.transports.base import Closeable, Endpoint, EndpointKind, Reply

from .lab import Count, goal, settle

NAMES = action_names("/count")
MANY = 3 * AT_ONCE
OURS, STRANGER = GoalNote().write(), ""


class Server:
    """Answers when it is told to, as one of our kind or as a stranger."""

    def __init__(self, transport: MemoryTransport, number: int = 0) -> None:
        self.under_way = 0
        self.note = STRANGER
        self._may_answer = anyio.Semaphore(0)
        kinds = (
            (NAMES.send_goal, f"{Count.type_name}_SendGoal"),
            (NAMES.cancel_goal, CancelGoal.type_name),
        )
        self._opened: list[Closeable] = [
            transport.serve(
                Endpoint("service", name, type_name, "/lab", gid=bytes([number])),
                WireFormat(CancelGoal),
                self,
            )
            for name, type_name in kinds
        ]

    async def reply(self, request: object, caller: bytes) -> Reply:
        self.under_way += 1
        await self._may_answer.acquire()
        self.under_way -= 1
        return Reply(request, self.note)

    def answer(self) -> None:
        self._may_answer.release()

    def close(self) -> None:
        for opened in self._opened:
            opened.close()


def endpoint(kind: EndpointKind, name: str, type_name: str, qos: QoS | None = None) -> Endpoint:
    return Endpoint(kind, name, type_name, "/user", qos or QoS())


def client(transport: MemoryTransport) -> Links:
    links = Links(transport, endpoint, NAMES, Count)
    links.open(lambda feedback: None, {})
    return links


async def send(links: Links) -> None:
    links.learn(await links.send(implied(Count).send_goal.Request(goal=goal())))


async def cancel(links: Links) -> None:
    await links.cancel(CancelGoal.Request())


def start(tasks: Any, links: Links, how: Any = send, times: int = MANY) -> None:
    for _ in range(times):
        tasks.start_soon(partial(how, links))


@pytest.mark.parametrize("how", [send, cancel])
async def test_a_server_of_which_nothing_is_known_is_sent_a_few_at_once(how):
    transport = MemoryTransport()
    server, links = Server(transport), client(transport)
    async with anyio.create_task_group() as tasks:
        start(tasks, links, how)
        await settle()
        assert server.under_way == AT_ONCE
        tasks.cancel_scope.cancel()


@pytest.mark.parametrize("how", [send, cancel])
async def test_one_that_shows_to_be_of_our_kind_is_sent_all_that_wait(how):
    transport = MemoryTransport()
    server, links = Server(transport), client(transport)
    server.note = OURS
    async with anyio.create_task_group() as tasks:
        start(tasks, links, send, 1)
        await settle()
        start(tasks, links, how)
        await settle()
        server.answer()
        await settle()
        assert server.under_way == MANY
        assert links.is_of_our_kind
        start(tasks, links, how)
        await settle()
        assert server.under_way == 2 * MANY
        tasks.cancel_scope.cancel()


@pytest.mark.parametrize("how", [send, cancel])
async def test_one_that_has_come_in_the_place_of_ours_is_sent_a_few_at_once(how):
    transport = MemoryTransport()
    ours, links = Server(transport, 1), client(transport)
    ours.note = OURS
    async with anyio.create_task_group() as tasks:
        ours.answer()
        await send(links)
        ours.close()
        stranger = Server(transport, 2)
        start(tasks, links, how)
        await settle()
        assert stranger.under_way == AT_ONCE
        assert not links.is_of_our_kind
        tasks.cancel_scope.cancel()


async def test_one_of_ours_is_still_so_after_changes_elsewhere_on_the_graph():
    transport = MemoryTransport()
    server, links = Server(transport), client(transport)
    server.note = OURS
    server.answer()
    await send(links)
    transport.enter("/new")
    assert links.is_of_our_kind
    other = Server(transport, 1)
    assert not links.is_of_our_kind
    other.close()
    assert links.is_of_our_kind


async def test_one_that_answers_as_a_stranger_is_sent_a_few_at_once_from_then_on():
    transport = MemoryTransport()
    server, links = Server(transport), client(transport)
    async with anyio.create_task_group() as tasks:
        for note in (OURS, STRANGER):
            server.note = note
            server.answer()
            await send(links)
        start(tasks, links)
        await settle()
        assert server.under_way == AT_ONCE
        tasks.cancel_scope.cancel()
