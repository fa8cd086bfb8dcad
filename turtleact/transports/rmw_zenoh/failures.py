"""Errors as they travel: a kind and a text, of which a peer like us makes the error again. Pure."""

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

__all__ = ["error_said", "said"]


def said(error: TurtleactError) -> tuple[str, str]:
    """The kind of an error, and the text by which `error_said` makes it again."""
    if isinstance(error, InvalidMessage):
        return "InvalidMessage", shortened(str(error))
    if isinstance(error, ServerUnavailable):
        return "ServerUnavailable", shortened(error.problem)
    if isinstance(error, ServiceError):
        return "ServiceError", shortened(error.reason)
    return "ServiceError", summary(error)


def error_said(name: str, text: str, kind: str) -> TurtleactError:
    """What a server raised; an error of a peer of another kind is its own text."""
    if kind == "InvalidMessage":
        path, _, problem = text.partition(": ")
        return InvalidMessage(path, problem)
    if kind == "Timeout":
        return ServiceTimeout(name, PATIENCE)
    if kind == "ServerUnavailable":
        return ServerUnavailable(name, text, kind="service")
    return ServiceError(name, text)
