"""What all connections of a bridge share: the node, and all that is opened on it for clients."""

from __future__ import annotations

from typing import Any, Final, TypeVar, cast

import msgspec

from turtleact.interfaces import Message
from turtleact.node import Node
from turtleact.services import ServiceClient, ServiceType
from turtleact.tasks import current_tasks
from turtleact.web.directory import Directory
from turtleact.web.feeds import Feeds
from turtleact.web.goals import Goals
from turtleact.web.operations import CallService
from turtleact.web.parameters import Parameters
from turtleact.web.pool import Pool
from turtleact.web.reading import read_message
from turtleact.web.rosapi import Rosapi
from turtleact.web.spelling import absolute
from turtleact.web.values import json_values

__all__ = ["Hub", "Limits"]

Req = TypeVar("Req", bound=Message)
Res = TypeVar("Res", bound=Message)

ANSWER: Final = 5.0
"""So long a node has to tell of its parameters (s)."""


class Limits(msgspec.Struct, frozen=True):
    """How much clients may ask for.

    Attributes:
        connections: How many may be connected.
        opened: Subscriptions, advertisements, services and actions of one client.
        calls: Service calls of one client that are under way.
        message_size: Longest message that a client may send (bytes).
    """

    connections: int = 100
    opened: int = 256
    calls: int = 256
    message_size: int = 10_000_000


class Hub:
    """What the connections share.

    Args:
        node: What is served.
        limits: How much clients may ask for.
        cancel_on_disconnect: Whether a client that goes takes its goals along.
    """

    def __init__(self, node: Node, limits: Limits, *, cancel_on_disconnect: bool) -> None:
        self.node = node
        self.limits = limits
        self.tasks = current_tasks()
        self.directory = Directory(node.transport)
        self.feeds = Feeds(node, self.directory)
        self.goals = Goals(node, cancel_on_disconnect=cancel_on_disconnect)
        self.rosapi = Rosapi(node, self.directory, Parameters(node, self._ask))
        self._clients: Pool[tuple[str, Any], ServiceClient[Message, Message]] = Pool(
            lambda key: node.service_client(key[1], key[0])
        )

    async def call(self, said: CallService) -> object:
        """Call a service, of rosapi or of the graph, and give the values of its response.

        Raises:
            TurtleactError: if there is no response.
        """
        values = await self.rosapi.call(said.service, said.args)
        if values is not None:
            return values
        name = absolute(said.service)
        service_type = self.directory.service_class(name, said.type or "")
        request = await read_message(service_type.Request, said.args, root="args")
        timeout = said.timeout if said.timeout is not None and said.timeout > 0 else None
        return json_values(
            await self._ask(
                name, cast("ServiceType[Message, Message]", service_type), request, timeout
            )
        )

    async def _ask(
        self,
        name: str,
        service_type: ServiceType[Req, Res],
        request: Req,
        timeout: float | None = ANSWER,
    ) -> Res:
        async with self._clients.use((name, service_type)) as client:
            return cast("Res", await client.call(request, timeout))

    async def aclose(self) -> None:
        """Close all that was opened."""
        await self.goals.aclose()
        await self._clients.aclose()
