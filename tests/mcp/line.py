"""Servers and clients for the tests: a node with a few actions, and the SDK's client of it."""

from __future__ import annotations

import itertools
from contextlib import asynccontextmanager
from typing import Any

import anyio
from mcp import Client

from turtleact import Abort, GoalResponse, Node, Reject, open_node
from turtleact.interfaces.standard import Fibonacci
from turtleact.mcp import open_mcp

FOREVER = 999
"""The order with which the action counts until it is canceled."""

MODES = ("auto", "legacy")
"""The newest version of the protocol, and the older ones."""


class Lab:
    """The bodies of some actions, and what happened to them."""

    def __init__(self) -> None:
        self.started = anyio.Event()
        self.ended: list[str] = []

    async def count(self, goal):
        """Count to the order; -1 aborts, and 0 runs until it is canceled."""
        if goal.order < 0:
            raise Abort("the arm is stuck at joint 3")
        self.started.set()
        try:
            if goal.order == 0:
                await anyio.sleep_forever()
            for number in itertools.count() if goal.order == FOREVER else range(goal.order):
                yield Fibonacci.Feedback([number])
                await anyio.sleep(0)
        except anyio.get_cancelled_exc_class():
            self.ended.append("cancelled")
            raise
        yield Fibonacci.Result(list(range(goal.order)))


def accept(goal):
    """Reject large goals."""
    if goal.order > 1000:
        raise Reject("the order is more than 1000")
    return GoalResponse.ACCEPT


@asynccontextmanager
async def open_lab(**offer):
    """A lab, its node, and a server that offers its action."""
    lab = Lab()
    async with open_node("lab") as node:
        serve(node, lab)
        async with open_mcp(node, **({"actions": ["/count"]} | offer)) as server:
            yield lab, node, server


def serve(node: Node, lab: Lab, name: str = "/count"):
    """Serve the action."""
    return node.action_server(Fibonacci, name, lab.count, goal_callback=accept)


def client_of(server: Any, mode: str = "auto", **options: Any) -> Any:
    """A client in memory; tests know what is in the replies to it."""
    return Client(server.sdk, mode=mode, **options)


@asynccontextmanager
async def connect(mode="auto", *, client=None, **offer):
    """A lab, and a client of its server."""
    async with (
        open_lab(**offer) as (lab, _, server),
        client_of(server, mode, **(client or {})) as connected,
    ):
        yield lab, connected


def text_of(reply) -> str:
    """The first text of a reply."""
    return str(reply.content[0].text)
