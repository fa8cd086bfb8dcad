"""Which graph a program joins."""

from __future__ import annotations

from contextlib import asynccontextmanager
from typing import Any

import anyio
import pytest

from turtleact.errors import TurtleactError
from turtleact.rclpy import context as opening
from turtleact.rclpy.face import SETTINGS, JoinOptions
from turtleact.transports import MemoryTransport

pytestmark = pytest.mark.loops("asyncio")


@pytest.fixture
def attempts(monkeypatch):
    """Stands for Zenoh: notes how it is opened, and fails as often as asked."""
    made: list[str] = []
    failures = [0]

    @asynccontextmanager
    async def open_zenoh(connect: Any = (), *, mode: str = "peer", **options: Any):
        made.append(mode)
        if len(made) <= failures[0]:
            raise TurtleactError("nobody there")
        yield MemoryTransport()

    async def sleep(_: float) -> None:
        made.append("pause")

    monkeypatch.setattr(opening, "open_zenoh", open_zenoh)
    monkeypatch.setattr(anyio, "sleep", sleep)
    monkeypatch.setattr(SETTINGS, "place", JoinOptions())
    return made, failures


@pytest.mark.parametrize(
    ("fails", "made"),
    [
        (0, ["peer"]),
        (1, ["peer", "router"]),
        (2, ["peer", "router", "pause", "peer"]),
    ],
)
async def test_a_program_becomes_the_router_if_there_is_none(attempts, fails, made):
    attempts[1][0] = fails
    async with opening.open_chosen(0):
        pass
    assert attempts[0] == made


@pytest.mark.parametrize("connect", [(), ("tcp/127.0.0.1:1",)])
async def test_a_program_gives_up_in_the_end_and_tries_a_given_endpoint_once(
    attempts, monkeypatch, connect
):
    monkeypatch.setattr(SETTINGS, "place", JoinOptions(connect))
    attempts[1][0] = 10**6
    with pytest.raises(TurtleactError, match="nobody there"):
        async with opening.open_chosen(0):
            pass
    assert attempts[0].count("peer") == (1 if connect else opening.ATTEMPTS - 1)
