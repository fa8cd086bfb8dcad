"""Who else is on the graph: what the liveliness tokens of other sessions say. Pure."""

from __future__ import annotations

from turtleact.transports.base import Endpoint
from turtleact.transports.rmw_zenoh.keys import Token, parse_token

__all__ = ["Graph"]


class Graph:
    """The nodes and endpoints of all other sessions, in the order of their coming.

    Args:
        zid: The id of our own session, whose tokens do not count.
    """

    def __init__(self, zid: str) -> None:
        self._zid = zid
        self._tokens: dict[str, Token] = {}
        self._by_name: dict[str, dict[str, Endpoint]] = {}  # token to endpoint

    def add(self, key: str) -> Token | None:
        """Note a token; answers what it says, if it is news."""
        token = None if key in self._tokens else parse_token(key)
        if token is None or token.zid == self._zid:
            return None
        self._tokens[key] = token
        if token.endpoint is not None:
            self._by_name.setdefault(token.endpoint.name, {})[key] = token.endpoint
        return token

    def remove(self, key: str) -> Token | None:
        """Forget a token; answers what it said, if it was known."""
        token = self._tokens.pop(key, None)
        if token is not None and token.endpoint is not None:
            namesakes = self._by_name[token.endpoint.name]
            del namesakes[key]
            if not namesakes:
                del self._by_name[token.endpoint.name]
        return token

    def endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """The endpoints, or those of a name."""
        if name:
            return tuple(self._by_name.get(name, {}).values())
        return tuple(
            token.endpoint for token in self._tokens.values() if token.endpoint is not None
        )

    def nodes(self) -> tuple[str, ...]:
        """The fully qualified names of the nodes."""
        return tuple(token.node for token in self._tokens.values() if token.endpoint is None)
