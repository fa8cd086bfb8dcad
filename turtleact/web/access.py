"""Checks the Host, Origin and token of each request, and logs refused connections.

- A web page of another site can open a WebSocket to any address. The browser sends that page's
  origin, and the server refuses the connection. Programs other than browsers send no origin, and
  may connect.
- By DNS rebinding, another site can make its own host name lead to this machine. Requests of that
  site's pages have this host name in the Host header, so the server refuses the requests. An IP
  address or a loopback name in the Host header is allowed, because neither can be rebound.
- If the server has a token, clients must send it.

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

__all__ = ["TELL_EVERY", "Access", "RefusalCounter"]

logger = logging.getLogger("turtleact.web")

TELL_EVERY: Final = 10.0
"""The shortest time between two log lines about refused connections (s)."""


class Access(msgspec.Struct, frozen=True):
    """The rules that decide whether a request is allowed.

    Attributes:
        hosts: The names that a Host header may have, besides IP addresses and loopback names.
        origins: The origins of pages that may connect, besides the server's own origin and those of
            loopback hosts.
        token: The token that a request must have; empty if none is needed.
    """

    hosts: frozenset[str] = frozenset()
    origins: frozenset[str] = frozenset()
    token: str = ""

    def problem(self, *, host: str, origin: str | None, token: str) -> str:
        """Return why a request is refused, or an empty string if it is allowed.

        Args:
            host: The request's Host header.
            origin: The request's Origin header; None if it has none.
            token: The request's token; empty if it has none.
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


class RefusalCounter:
    """Counts and logs refused connections, with at most one line every `TELL_EVERY` seconds.

    Anybody who can reach the port can cause refusals. If each refusal were logged, refusals could
    fill the log.
    """

    def __init__(self) -> None:
        self._count = 0
        self._reason = ""
        self._told_at = -math.inf

    def note(self, reason: str, now: float) -> None:
        """Count a refused connection. Log the count, but only once in `TELL_EVERY` seconds.

        Args:
            reason: Why the connection was refused.
            now: The time of any monotonic clock (s).
        """
        self._count += 1
        self._reason = reason
        if now - self._told_at >= TELL_EVERY:
            self._told_at = now
            self.tell()

    def tell(self) -> None:
        """Log how many connections have been refused since the last log line, if any."""
        if self._count == 1:
            logger.warning("a web connection was refused: %s", self._reason)
        elif self._count:
            logger.warning(
                "%d web connections were refused, the last one: %s", self._count, self._reason
            )
        self._count = 0


def _name_of(url: str) -> str:
    """Return the host in a URL, in lower case; empty if the URL has none."""
    try:
        return (urlsplit(url).hostname or "").removesuffix(".")
    except ValueError:
        return ""


def _place_of(origin: str) -> str:
    """Return the host and port of an origin, in the form of a Host header."""
    return urlsplit(origin).netloc.lower()
