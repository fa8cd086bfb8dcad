"""Serves ``NODE/get_type_description``, which describes the types that a node uses.

As in ROS 2, a type is looked up by its hash alone, among the types of the node's topics, services
and actions. The answer also holds the text of each interface, with its comments and constants. A
type that ROS 2 derives, such as ``Fibonacci_Goal``, has no text.

A node opens the service only when another process looks for it. Until then, it costs nothing.

Source: ``type_description_interfaces/srv/GetTypeDescription``; rcl ``node_type_cache.c`` and
``type_description_service``; REP 2016.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, Final

from turtleact.errors import TurtleactError
from turtleact.interfaces import WireFormat, get_interface, interface_source
from turtleact.transports.base import Closeable, Endpoint, Reply, ServiceHandler, Transport

__all__ = ["GET_TYPE_DESCRIPTION", "SERVICE", "TYPE_HASH", "offer_descriptions"]

GET_TYPE_DESCRIPTION: Final = "type_description_interfaces/srv/GetTypeDescription"

SERVICE: Final = "get_type_description"
"""The name of the service, after the node's name."""

TYPE_HASH: Final = "RIHS01_69b9c19c1021405984cc60dbbb1edceb147a6538b411d812ba6afabeed962cd5"
"""The type hash of the service. It is a constant because computing it takes 10 ms."""

_HASH: Final = re.compile("RIHS01_[0-9a-f]{64}")

_SEND_GOAL: Final = "_SendGoal"
"""The suffix of an action's service type; without it, the name of the action remains."""


def offer_descriptions(transport: Transport, node: str) -> Closeable:
    """Offer ``get_type_description`` for the node with the fully qualified name ``node``."""
    name = f"{node}/{SERVICE}"
    endpoint = Endpoint("service", name, GET_TYPE_DESCRIPTION, node, is_unlisted=True)
    return transport.serve(endpoint, _Format(), _Describer(transport, node))


class _Format(WireFormat):
    """The wire format of the service. The service's classes are loaded at the first request."""

    type_hash: str = TYPE_HASH

    def __init__(self) -> None:
        super().__init__(lambda: get_interface(GET_TYPE_DESCRIPTION))


class _Describer(ServiceHandler):
    """Answers the requests of the service for one node."""

    def __init__(self, transport: Transport, node: str) -> None:
        self._transport = transport
        self._node = node

    async def reply(self, request: Any, caller: bytes) -> Reply:  # noqa: ANN401, ARG002  # as below
        """Describe the type with the hash in the request."""
        response = _made("srv/GetTypeDescription").Response
        if not _HASH.fullmatch(request.type_hash):
            return Reply(response(failure_reason="Failed to parse type hash"))
        found = self._find(request.type_hash)
        if found is None:
            return Reply(response(failure_reason="Type not currently in use by this node"))
        return Reply(_described(found, has_sources=request.include_type_sources))

    def _find(self, wanted: str) -> Any:  # noqa: ANN401  # a class, loaded on demand
        """Return the class with this hash that the node uses; None if there is none."""
        from turtleact.interfaces.type_hash import type_hash

        for name in self._candidates(wanted):
            try:
                found = get_interface(name)
            except TurtleactError:  # the node passes messages on without knowing their class
                continue
            if type_hash(found) == wanted:
                return found
        return None

    def _candidates(self, wanted: str) -> Iterator[str]:
        """Return the names of types that may have this hash.

        An endpoint says the hash of its type. The hash of an action is the only one that no
        endpoint has.
        """
        own = [each for each in self._transport.local_endpoints() if each.node == self._node]
        yield from dict.fromkeys(each.type_name for each in own if each.type_hash in ("", wanted))
        yield from dict.fromkeys(
            each.type_name.removesuffix(_SEND_GOAL)
            for each in own
            if each.type_name.endswith(_SEND_GOAL)
        )


def _described(found: Any, *, has_sources: bool) -> object:  # noqa: ANN401  # a class
    from turtleact.interfaces.type_hash import description, referenced

    others = referenced(found)
    types = [found, *(others[name] for name in sorted(others))]
    described = [_individual(description(each)) for each in types]
    return _made("srv/GetTypeDescription").Response(
        successful=True,
        type_description=_made("msg/TypeDescription")(described[0], described[1:]),
        type_sources=[_source(each.type_name) for each in types] if has_sources else [],
    )


def _individual(said: Any) -> object:  # noqa: ANN401  # a dict, as it is hashed
    fields = [
        _made("msg/Field")(name=each["name"], type=_made("msg/FieldType")(**each["type"]))
        for each in said["fields"]
    ]
    return _made("msg/IndividualTypeDescription")(type_name=said["type_name"], fields=fields)


def _source(name: str) -> object:
    _package, kind, last = name.split("/")
    if "_" in last:  # no name in an interface file has one
        return _made("msg/TypeSource")(name, "implicit", "")
    return _made("msg/TypeSource")(name, kind, interface_source(name))


def _made(name: str) -> Any:  # noqa: ANN401  # a class
    return get_interface(f"type_description_interfaces/{name}")
