"""Runs a web server for the length of an ``async with`` block, and decides who may connect.

The server is uvicorn, which needs asyncio or uvloop. Here, uvicorn leaves signals and logging to
the program. This module does not depend on the app that it serves.

- Other machines can connect only with a token (`token_for`).
- A web page of another site can open a WebSocket to any address. The browser sends that page's
  origin, and `Access` refuses the connection. Programs other than browsers send no origin, and may
  connect.
- By DNS rebinding, another site can make its own host name lead to this machine. Requests of that
  site's pages have this host name in the Host header, so `Access` refuses the requests. An IP
  address or a loopback name in the Host header is allowed, because neither can be rebound.

Source: uvicorn ``server.py`` and ``config.py``; RFC 6454 (origins); RFC 6455, section 10.2; RFC
9110, section 7.2 (Host).
"""

from __future__ import annotations

import errno
import hmac
import secrets
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from ipaddress import ip_address
from typing import Any, Final
from urllib.parse import urlsplit

import anyio
import msgspec
import uvicorn

from turtleact.errors import InvalidOption, TurtleactError
from turtleact.tasks import Background

__all__ = ["Access", "Config", "bound", "is_loopback", "serving", "token_for"]

PORT_ERRORS: Final = (errno.EADDRINUSE, errno.EACCES)
"""Errors that the user can avoid by choosing another port."""


class Config(uvicorn.Config):
    """uvicorn's configuration, without its logging and without headers that identify uvicorn.

    Args:
        app: The ASGI app.
        **settings: More settings of ``uvicorn.Config``.
    """

    def __init__(self, app: Callable[..., Awaitable[None]], **settings: Any) -> None:  # noqa: ANN401  # as uvicorn has them
        super().__init__(
            app,
            lifespan="off",
            log_config=None,
            log_level="error",  # its warnings tell of each request that it refuses
            access_log=False,
            proxy_headers=False,
            server_header=False,
            **settings,
        )


@contextmanager
def bound(host: str, port: int) -> Iterator[socket.socket]:
    """Open a socket that listens on a port, and close it at the end of the block.

    Args:
        host: The address or name to bind.
        port: The port, or 0 for any free one.

    Raises:
        InvalidOption: if the host or the port cannot be bound.
    """
    if not 0 <= port <= 65535:
        raise InvalidOption("port", f"{port} is not a port: give 0 to 65535")
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listener = socket.create_server((host, port), family=family, backlog=128)
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # or small frames take 40 ms
    except (OSError, UnicodeError) as error:
        is_port = isinstance(error, OSError) and error.errno in PORT_ERRORS
        text = (isinstance(error, OSError) and error.strerror) or str(error)
        reason, _, _ = text.partition(" (while ")  # the address once more
        problem = f"{host}:{port} cannot be bound: {reason}"
        hint = "; choose another, or 0 for any free one" if is_port else ""
        raise InvalidOption("port" if is_port else "host", problem + hint) from None
    with listener:
        yield listener


async def _nothing() -> None:
    """Do nothing."""


@asynccontextmanager
async def serving(
    config: uvicorn.Config,
    listener: socket.socket,
    close: Callable[[], Awaitable[None]] = _nothing,
    *,
    is_patient: bool = True,
) -> AsyncIterator[None]:
    """Run uvicorn for the length of a block. It already listens when the block begins.

    Args:
        config: The configuration of uvicorn.
        listener: The socket on which uvicorn listens.
        close: Called and awaited at the end of the block, while uvicorn still answers clients.
        is_patient: Whether uvicorn lets running requests finish at the end of the block, within the
            time that the configuration sets. If false, these requests are cancelled.

    Raises:
        TurtleactError: if uvicorn does not start.
    """
    server = _Server(config)
    running = Background(server.serve([listener]), "the web server")
    try:
        await server.ready.wait()
        if not server.started:
            raise TurtleactError("the web server has not started: its log says why")
        yield
    finally:
        # Shielded: a cancelled block must not leave clients without their last answers, or a
        # server without an owner. uvicorn itself limits how long requests may take.
        with anyio.CancelScope(shield=True):
            try:
                await close()
            finally:  # the server ends even if that has failed
                server.should_exit = True
                if is_patient:
                    await server.over.wait()
                await running.aclose()


def token_for(host: str, token: str | None) -> str:
    """Return the token that clients must send; empty if they need none.

    Args:
        host: The address or name on which the server listens.
        token: The token that the user has chosen, or None. For None, the result is empty if the
            host is a loopback host, and a new random token otherwise.

    Raises:
        InvalidOption: if the token is empty and other machines can connect.
    """
    if token is None:
        return "" if is_loopback(host) else secrets.token_urlsafe(16)
    if not token and not is_loopback(host):
        raise InvalidOption("token", f"must not be empty if other machines can connect ({host})")
    return token


def is_loopback(host: str) -> bool:
    """Whether a host is a loopback address, which only this machine can reach.

    >>> is_loopback("127.0.0.1"), is_loopback("localhost"), is_loopback("0.0.0.0")
    (True, True, False)
    """
    if host == "localhost" or host.endswith(".localhost"):
        return True
    return _is_address(host) and ip_address(host).is_loopback


def _is_address(host: str) -> bool:
    """Whether a host is an IP address rather than a name."""
    try:
        ip_address(host)
    except ValueError:
        return False
    return True


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

    def problem(self, *, host: str, origin: str | None, token: str = "") -> str:
        """Return why a request is refused, or an empty string if it is allowed.

        Args:
            host: The request's Host header.
            origin: The request's Origin header; None if it has none.
            token: The request's token; empty if it has none.
        """
        name = _name_of(f"//{host}")
        if not (_is_address(name) or is_loopback(name) or name in self.hosts):
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


def _name_of(url: str) -> str:
    """Return the host in a URL, in lower case; empty if the URL has none."""
    try:
        return (urlsplit(url).hostname or "").removesuffix(".")
    except ValueError:
        return ""


def _place_of(origin: str) -> str:
    """Return the host and port of an origin, in the form of a Host header."""
    return urlsplit(origin).netloc.lower()


class _Server(uvicorn.Server):
    """uvicorn's server; reports its start and its end, and leaves signals to the program."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.ready = anyio.Event()
        self.over = anyio.Event()

    async def serve(self, sockets: list[socket.socket] | None = None) -> None:
        """Serve until ``should_exit`` is true."""
        try:
            await super().serve(sockets)
        finally:
            self.ready.set()  # also if it has not started: nobody waits forever
            self.over.set()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen."""
        await super().startup(sockets)
        self.ready.set()

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Install no signal handlers, so that the program handles all signals itself."""
        yield
