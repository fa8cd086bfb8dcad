"""Serves ``NODE/get_type_description``, which describes the types that a node uses.

Nodes of ROS 2 offer this service too. In turtleact, a node opens the service only when another
process looks for it. Until then, the service costs nothing.

Source: ``type_description_interfaces/srv/GetTypeDescription``; REP 2016.
"""

from __future__ import annotations

from typing import Any, Final

from turtleact.errors import TurtleactError
from turtleact.interfaces import WireFormat, get_interface
from turtleact.transports.base import Closeable, Endpoint, Lazy, Reply, Transport

__all__ = ["GET_TYPE_DESCRIPTION", "TYPE_HASH", "offer_descriptions", "offer_when_sought"]

GET_TYPE_DESCRIPTION: Final = "type_description_interfaces/srv/GetTypeDescription"

TYPE_HASH: Final = "RIHS01_69b9c19c1021405984cc60dbbb1edceb147a6538b411d812ba6afabeed962cd5"
"""The type hash of the service. It is a constant because computing it takes 10 ms."""


def offer_descriptions(transport: Transport, node: str) -> Closeable:
    """Offer ``get_type_description`` for the node with the fully qualified name ``node``."""
    name = _service_name(node)
    endpoint = Endpoint("service", name, GET_TYPE_DESCRIPTION, node, is_unlisted=True)
    return transport.serve(endpoint, _Format(), _Describer())


def offer_when_sought(transport: Transport, node: str) -> Closeable:
    """Offer a node's ``get_type_description`` once another process looks for the service.

    Programs in the same process do not need the service. So a transport that reaches no other
    process never offers the service.
    """
    if not isinstance(transport, Lazy):
        return _Nothing()
    return transport.open_when_sought(
        _service_name(node), lambda: offer_descriptions(transport, node)
    )


class _Nothing:
    """A placeholder for the type description service if the transport reaches no other process."""

    def close(self) -> None:
        """Do nothing."""


class _Format(WireFormat):
    """The wire format of the service. The service's classes are loaded at the first request."""

    type_hash: str = TYPE_HASH

    def __init__(self) -> None:
        super().__init__(lambda: get_interface(GET_TYPE_DESCRIPTION))


class _Describer:
    """Answers the requests of the service."""

    async def reply(self, request: object, caller: bytes) -> Reply:  # noqa: ARG002
        """Describe the type that a request names."""
        return Reply(_described(request))


def _service_name(node: str) -> str:
    return f"{node}/get_type_description"


def _described(request: Any) -> object:  # noqa: ANN401  # the classes are loaded on demand
    from turtleact.interfaces.type_hash import description, referenced, type_hash

    response = _made("srv/GetTypeDescription").Response
    try:
        found = get_interface(request.type_name)
    except TurtleactError as error:
        return response(failure_reason=str(error))
    if request.type_hash not in ("", type_hash(found)):
        return response(failure_reason=f"{request.type_name} has another hash here")
    others = referenced(found)
    return response(
        successful=True,
        type_description=_made("msg/TypeDescription")(
            type_description=_individual(description(found)),
            referenced_type_descriptions=[
                _individual(description(others[name])) for name in sorted(others)
            ],
        ),
    )


def _individual(said: Any) -> object:  # noqa: ANN401  # a dict, as it is hashed
    fields = [
        _made("msg/Field")(name=each["name"], type=_made("msg/FieldType")(**each["type"]))
        for each in said["fields"]
    ]
    return _made("msg/IndividualTypeDescription")(type_name=said["type_name"], fields=fields)


def _made(name: str) -> Any:  # noqa: ANN401  # a class
    return get_interface(f"type_description_interfaces/{name}")
