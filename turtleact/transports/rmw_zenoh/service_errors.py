"""Encodes a service's error as a text and a kind, which names the exception's class.

Servers encode errors and clients decode them. Zenoh itself sends an error if a call takes too long.

>>> text, kind = encode_error(ServiceError("/add", "too many: at most 3"))
>>> decode_error("/add", text, kind)
ServiceError('/add', 'too many: at most 3')
"""

from __future__ import annotations

from turtleact.errors import (
    InvalidMessage,
    ServerUnavailable,
    ServiceError,
    ServiceTimeout,
    TurtleactError,
)
from turtleact.summaries import shortened, summary
from turtleact.transports.rmw_zenoh.config import PATIENCE

__all__ = ["decode_error", "encode_error"]


def encode_error(error: TurtleactError) -> tuple[str, str]:
    """Encode an error as the text and the kind from which `decode_error` restores the error."""
    if isinstance(error, InvalidMessage):
        return shortened(str(error)), "InvalidMessage"
    if isinstance(error, ServerUnavailable):
        return shortened(error.problem), "ServerUnavailable"
    if isinstance(error, ServiceError):
        return shortened(error.reason), "ServiceError"
    return summary(error), "ServiceError"


def decode_error(name: str, text: str, kind: str) -> TurtleactError:
    """Restore an error of the service ``name`` from the text and the kind.

    An error from a program other than turtleact becomes a `ServiceError` with the same text.
    """
    if kind == "InvalidMessage":
        path, _, problem = text.partition(": ")
        return InvalidMessage(path, problem)
    if kind == "Timeout":
        return ServiceTimeout(name, PATIENCE)
    if kind == "ServerUnavailable":
        return ServerUnavailable(name, text, kind="service")
    return ServiceError(name, text)
