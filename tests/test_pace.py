"""How many requests are sent before the first is answered."""

from __future__ import annotations

from functools import partial
from typing import Any

import anyio

from turtleact.client.pace import AT_ONCE, Pace
from turtleact.transports.base import Reply

from .lab import running, settle


class Service:
    """Notes what it is sent, and answers when it is told to."""

    def __init__(self) -> None:
        self.sent: list[object] = []
        self.answered = anyio.Semaphore(0)

    async def call(self, request: object) -> Reply:
        self.sent.append(request)
        await self.answered.acquire()
        return Reply(request)


def start(tasks: Any, pace: Pace, service: Any, *requests: int) -> None:
    for request in requests:
        tasks.start_soon(partial(pace.call, service, request))


async def test_the_next_is_sent_once_one_is_answered():
    pace, service = Pace(), Service()
    async with anyio.create_task_group() as tasks:
        start(tasks, pace, service, *range(AT_ONCE + 2))
        await settle()
        assert len(service.sent) == AT_ONCE
        service.answered.release()
        await settle()
        assert len(service.sent) == AT_ONCE + 1
        tasks.cancel_scope.cancel()


async def test_who_gives_up_its_turn_is_not_sent():
    pace, service = Pace(), Service()
    caller: Any = service
    async with anyio.create_task_group() as tasks:
        start(tasks, pace, service, *range(AT_ONCE))
        await settle()
        async with running(lambda: pace.call(caller, "given up")) as waiting:
            await settle()
            waiting.scope.cancel()
        start(tasks, pace, service, AT_ONCE)
        service.answered.release()
        await settle()
        assert sorted(service.sent, key=str) == list(range(AT_ONCE + 1))
        tasks.cancel_scope.cancel()


async def test_all_that_wait_are_sent_to_a_server_that_drops_nothing():
    pace, service = Pace(), Service()
    async with anyio.create_task_group() as tasks:
        start(tasks, pace, service, *range(3 * AT_ONCE))
        await settle()
        pace.send_all()
        await settle()
        assert len(service.sent) == 3 * AT_ONCE
        tasks.cancel_scope.cancel()


async def test_those_that_come_after_all_were_sent_wait_their_turn_again():
    pace, service = Pace(), Service()
    async with anyio.create_task_group() as tasks:
        start(tasks, pace, service, *range(AT_ONCE + 1))
        await settle()
        pace.send_all()
        start(tasks, pace, service, *range(AT_ONCE))
        await settle()
        assert len(service.sent) == AT_ONCE + 1
        service.answered.release()
        await settle()
        assert len(service.sent) == AT_ONCE + 1
        service.answered.release()
        await settle()
        assert len(service.sent) == AT_ONCE + 2
        tasks.cancel_scope.cancel()
