"""Serves metrics over HTTP, for Prometheus.

If the server listens on a loopback address, the Host header of a request must be an IP address or a
loopback name. This rule prevents pages of other sites from reading the metrics through DNS
rebinding. If the server listens on any other address, everybody who can reach the port can read the
metrics.

Source: Prometheus, "Exposition formats", text format 0.0.4.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Final

from starlette.applications import Starlette
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from turtleact.http_server import bound, is_loopback, serving
from turtleact.web.access import Access, RefusalCounter
from turtleact.web.server import READ_AHEAD, Config, address_of

if TYPE_CHECKING:
    from starlette.requests import Request

__all__ = ["CONTENT_TYPE", "open_metrics"]

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"

FORBIDDEN: Final = (
    "only programs on this machine may read this; --metrics 0.0.0.0:PORT lets all in\n"
)

MOST_CONNECTIONS: Final = 256
"""The maximum number of open connections. Most programs may open 1,024 files."""

SPARE: Final = 64
"""How many connections may be open beyond `MOST_CONNECTIONS`.

Requests on these extra connections are answered with 503."""

REQUEST_WITHIN: Final = 2.0
"""How long a client may take to send its request, which is short (s)."""


@asynccontextmanager
async def open_metrics(text: Callable[[], str], host: str, port: int) -> AsyncIterator[str]:
    """Serve a text at ``/metrics`` until the ``async with`` block ends.

    The context manager yields the text's URL.

    Args:
        text: Called at each request. Returns all metrics as text.
        host: The address or name to bind.
        port: The port, 1 to 65535, or 0 for any free one.

    Raises:
        InvalidOption: if the host or the port cannot be bound.
    """
    access = Access(frozenset({host.lower()}))

    async def answer(request: Request) -> Response:
        if is_loopback(host):
            problem = access.problem(
                host=request.headers.get("host", ""),
                origin=request.headers.get("origin"),
                token="",
            )
            if problem:
                return PlainTextResponse(FORBIDDEN, 403)
        return Response(text(), media_type=CONTENT_TYPE)

    app = Starlette(routes=[Route("/metrics", answer)])
    with bound(host, port, read_ahead=READ_AHEAD) as listener:
        config = Config(app, RefusalCounter(), limit_concurrency=MOST_CONNECTIONS)
        config.request_within, config.spare = REQUEST_WITHIN, SPARE
        async with serving(config, listener):
            yield f"{address_of(host, listener.getsockname()[1])}metrics"
