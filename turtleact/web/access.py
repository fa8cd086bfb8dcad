"""Decides who may connect, by the Host, Origin and token of a request; logs refusals.

- A web page of another site can open a WebSocket to any address. The browser sends that page's
  origin, and the server refuses the connection. Programs send no origin, and may connect.
- By DNS rebinding, a page of another site can make its own name lead to this machine. Then the Host
  is that name, and the server refuses the connection. IP addresses and loopback names cannot be
  rebound.
- Clients on other machines must know the token.

Source: RFC 6454 (origins); RFC 6455, section 10.2; RFC 9110, section 7.2 (Host).
"""

from __future__ import annotations

import hmac
import logging
import math
from typing import Final
from urllib.parse import urlsplit

import msgspec

from turtleact.http_server import is_address, is_loopback

__all__ = ["TELL_EVERY", "Access", "Refusals"]

logger = logging.getLogger("turtleact.web")

TELL_EVERY: Final = 10.0
"""Refused connections are logged at most once in this time (s)."""


class Access(msgspec.Struct, frozen=True):
    """The rules for requests.

    Attributes:
        hosts: Host names that a request may use, besides IP addresses and loopback names.
        origins: The origins of pages that may connect, besides this server's own origin and those
            of the loopback.
        token: The token that a request must have; empty if none is needed.
    """

    hosts: frozenset[str] = frozenset()
    origins: frozenset[str] = frozenset()
    token: str = ""

    def problem(self, *, host: str, origin: str | None, token: str) -> str:
        """Why a request is refused; empty if it is allowed.

        Args:
            host: Its Host header.
            origin: Its Origin header, if it has one.
            token: The token of the request; empty if it has none.
        """
        name = _name_of(f"//{host}")
        if not (is_address(name) or is_loopback(name) or name in self.hosts):
            return f"host '{host[:100]}' is not allowed here: allow it with 'hosts' or --allow-host"
        if origin is not None and not self._is_allowed(origin, host):
            named = f"pages of '{origin[:100]}' may not connect"
            return f"{named}: allow them with 'origins' or --allow-origin"
        # Compared in constant time: how long it takes must not tell how much of a guess was right.
        if self.token and not hmac.compare_digest(token.encode(), self.token.encode()):
            return (
                "the token is missing or wrong: send it as ?token=… or as 'Authorization: Bearer …'"
            )
        return ""

    def _is_allowed(self, origin: str, host: str) -> bool:
        if origin in self.origins:
            return True
        name = _name_of(origin)
        return name != "" and (is_loopback(name) or _place_of(origin) == host.lower())


class Refusals:
    """Logs refused connections: the first at once, later ones as a count.

    Anybody who can reach the port can cause refusals, so not every refusal may write a line.
    """

    def __init__(self) -> None:
        self._count = 0
        self._reason = ""
        self._told_at = -math.inf

    def note(self, reason: str, now: float) -> None:
        """Note a refused connection.

        Args:
            reason: Why it was refused.
            now: The time (s) of any clock that never goes back.
        """
        self._count += 1
        self._reason = reason
        if now - self._told_at >= TELL_EVERY:
            self._told_at = now
            self.tell()

    def tell(self) -> None:
        """Log the connections that were refused since the last line, if there are any."""
        if self._count == 1:
            logger.warning("a web connection was refused: %s", self._reason)
        elif self._count:
            logger.warning(
                "%d web connections were refused, the last one: %s", self._count, self._reason
            )
        self._count = 0


def _name_of(url: str) -> str:
    """The host in a URL, in lower case; empty if there is none."""
    try:
        return (urlsplit(url).hostname or "").removesuffix(".")
    except ValueError:
        return ""


def _place_of(origin: str) -> str:
    """The host and port of an origin, as a Host header would name them."""
    return urlsplit(origin).netloc.lower()
