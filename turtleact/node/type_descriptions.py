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
from typing import TYPE_CHECKING, Any, Final

from turtleact.interfaces import Message, WireFormat, fields, get_interface, interface_text
from turtleact.interfaces.loading import authored_text, known_classes
from turtleact.transports.base import Closeable, Endpoint, Reply, ServiceHandler, Transport

if TYPE_CHECKING:
    from turtleact.interfaces.types import Interface

__all__ = ["GET_TYPE_DESCRIPTION", "SERVICE", "TYPE_HASH", "describe", "offer_descriptions"]

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
        return Reply(describe(found, has_sources=request.include_type_sources))

    def _find(self, wanted: str) -> Interface | None:
        """Return the class with this hash that the node uses; None if there is none."""
        from turtleact.interfaces.type_hash import type_hash

        for name in self._candidates(wanted):
            for found in known_classes(name):  # none, if messages are passed on as bytes
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


def describe(found: Interface, *, has_sources: bool) -> Any:  # noqa: ANN401  # as below
    """Return the answer that describes a class, with the texts of all its types if asked for."""
    from turtleact.interfaces.type_hash import referenced

    others = referenced(found)
    types = [found, *(others[name] for name in sorted(others))]
    described = [_individual(each) for each in types]
    return _made("srv/GetTypeDescription").Response(
        successful=True,
        type_description=_made("msg/TypeDescription")(described[0], described[1:]),
        type_sources=[_source(each) for each in types] if has_sources else [],
    )


def _individual(cls: Interface) -> object:
    from turtleact.interfaces.type_hash import description

    said: Any = description(cls)
    own = fields(cls) if issubclass(cls, Message) else ()
    defaults = {each.name: str(each.default) for each in own if each.default is not None}
    rows = [
        _made("msg/Field")(
            each["name"], _made("msg/FieldType")(**each["type"]), defaults.get(each["name"], "")
        )
        for each in said["fields"]
    ]
    return _made("msg/IndividualTypeDescription")(cls.type_name, rows)


def _source(cls: Interface) -> object:
    name = cls.type_name
    _package, kind, last = name.split("/")
    if "_" in last:  # no name in an interface file has one
        return _made("msg/TypeSource")(name, "implicit", "")
    return _made("msg/TypeSource")(name, kind, authored_text(cls) or interface_text(cls))


def _made(name: str) -> Any:  # noqa: ANN401  # a class
    return get_interface(f"type_description_interfaces/{name}")
