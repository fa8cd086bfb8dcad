"""Who may come in: the Host, the Origin and the token of a request. Pure.

- A web page of another site can open a WebSocket to any address: its browser tells the page's
  origin, and it is refused. Programs tell none, and come in.
- By DNS rebinding such a page can make its own name mean this machine: then the Host is that name,
  and it is refused. Addresses and loopback names cannot be rebound.
- Whoever reaches the server from another machine has to know its token.

Source: RFC 6454 (origins); RFC 6455, section 10.2; RFC 9110, section 7.2 (Host).
"""

from __future__ import annotations

import hmac
from ipaddress import ip_address
from urllib.parse import urlsplit

import msgspec

__all__ = ["Access", "is_loopback"]


class Access(msgspec.Struct, frozen=True):
    """What a request must show.

    Attributes:
        hosts: Names that it may call this server by, besides addresses and loopback names.
        origins: Origins of pages it may come from, besides this server's own and loopback ones.
        token: What it must know; empty if nothing.
    """

    hosts: frozenset[str] = frozenset()
    origins: frozenset[str] = frozenset()
    token: str = ""

    def problem(self, *, host: str, origin: str | None, token: str) -> str:
        """Why a request is refused; empty if it is not.

        Args:
            host: Its Host header.
            origin: Its Origin header, if it has one.
            token: What it gives as the token.
        """
        name = _name_of(f"//{host}")
        if not (_is_address(name) or is_loopback(name) or name in self.hosts):
            return f"host '{host[:100]}' is not known here: allow it by 'hosts', or --allow-host"
        if origin is not None and not self._is_allowed(origin, host):
            named = f"pages of '{origin[:100]}' may not come in"
            return f"{named}: allow them by 'origins', or --allow-origin"
        if self.token and not hmac.compare_digest(token.encode(), self.token.encode()):
            return "the token is wrong: say it as ?token=… or as 'Authorization: Bearer …'"
        return ""

    def _is_allowed(self, origin: str, host: str) -> bool:
        if origin in self.origins:
            return True
        name = _name_of(origin)
        return name != "" and (is_loopback(name) or _place_of(origin) == host.lower())


def is_loopback(host: str) -> bool:
    """Whether a host is this machine and nothing else.

    >>> is_loopback("127.0.0.1"), is_loopback("localhost"), is_loopback("0.0.0.0")
    (True, True, False)
    """
    if host == "localhost" or host.endswith(".localhost"):
        return True
    return _is_address(host) and ip_address(host).is_loopback


def _is_address(host: str) -> bool:
    try:
        ip_address(host)
    except ValueError:
        return False
    return True


def _name_of(url: str) -> str:
    """The host in a URL, in lower case; empty if there is none."""
    try:
        return (urlsplit(url).hostname or "").removesuffix(".")
    except ValueError:
        return ""


def _place_of(origin: str) -> str:
    """Host and port of an origin, as its Host header would say them."""
    return urlsplit(origin).netloc.lower()
