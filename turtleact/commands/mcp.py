"""The verb ``mcp``, which offers a graph to language models until the client leaves."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, aclosing, asynccontextmanager
from functools import partial
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import anyio
import typer

from turtleact.commands import VERBS
from turtleact.commands.app import SETTINGS, verb
from turtleact.commands.options import Embedded, flag, host_and_port, only_one, value
from turtleact.commands.output import note, say
from turtleact.commands.settings import WrongOptions, naming
from turtleact.errors import TurtleactError, UsageError

if TYPE_CHECKING:
    from turtleact.commands.settings import ConnectOptions
    from turtleact.mcp import McpServer
    from turtleact.node import Node

__all__ = ["app"]

OFFER = "What the model may use"
HTTP = "HTTP"

_EXAMPLES = """\
[bold]Examples[/]
  turtleact mcp --actions /patrol,/go_to
  turtleact mcp --all --confirm
  turtleact mcp --all --read-only --http 8000
"""

app = typer.Typer(**SETTINGS)


Actions: TypeAlias = Annotated[
    str | None,
    value(metavar="NAMES", text="The actions to offer, such as /patrol,/go_to.", panel=OFFER),
]
Services: TypeAlias = Annotated[
    str | None,
    value(metavar="NAMES", text="The services to offer, such as /spawn,/clear.", panel=OFFER),
]
Topics: TypeAlias = Annotated[
    str | None,
    value(metavar="NAMES", text="The topics that may be read, such as /turtle1/pose.", panel=OFFER),
]
Http: TypeAlias = Annotated[
    str | None,
    value(metavar="[HOST:]PORT", text="Serve over HTTP instead of stdin and stdout.", panel=HTTP),
]
Token: TypeAlias = Annotated[
    str | None,
    value(metavar="TEXT", text="The secret that clients must send over HTTP.", panel=HTTP),
]


@verb(app, knows=True, help=VERBS["mcp"], epilog=_EXAMPLES)
def mcp(
    reach: ConnectOptions,
    *,
    actions: Actions = None,
    all: Annotated[
        bool, flag("--all", text="Offer all actions and all topics.", panel=OFFER)
    ] = False,
    services: Services = None,
    topics: Topics = None,
    read_only: Annotated[
        bool, flag("--read-only", text="Offer only what changes nothing.", panel=OFFER)
    ] = False,
    confirm: Annotated[
        bool,
        flag("--confirm", text="Ask the user before each goal and each service call.", panel=OFFER),
    ] = False,
    http: Http = None,
    token: Token = None,
    allow_host: Annotated[
        str | None,
        value(
            metavar="NAMES",
            text="Names and addresses of this machine that clients may use over HTTP.",
            panel=HTTP,
        ),
    ] = None,
    embedded: Embedded = False,
) -> int:
    """``mcp``."""
    only_one("what to offer", all=all, actions=actions is not None)
    only_one("what to offer", all=all, topics=topics is not None)
    only_one("the graph", embedded=embedded, connect=bool(reach.connect))
    if read_only and services:
        raise WrongOptions(
            "--read-only and --services exclude each other: a call may change things"
        )
    if http is None and (token is not None or allow_host is not None):
        raise WrongOptions("--token and --allow-host need --http")
    address = None if http is None else host_and_port("--http", http)
    offered = {
        "actions": "all" if all or (read_only and actions is None) else _names(actions),
        "services": _names(services),
        "topics": "all" if all else _names(topics),
        "read_only": read_only,
        "confirm": confirm,
    }
    return _run(None if embedded else reach, offered, address, token, _names(allow_host))


def _run(
    reach: ConnectOptions | None,
    offered: dict[str, Any],
    address: tuple[str, int] | None,
    token: str | None,
    hosts: tuple[str, ...],
) -> int:
    """Serve until the client leaves or a signal comes, and return the exit status.

    Args:
        reach: The graph to offer; None for an embedded world.
        offered: What to offer, as arguments of `turtleact.mcp.open_mcp`.
        address: The host and port of HTTP; None for stdin and stdout.
        token: The token that HTTP clients must send; None for the default of `open_http`.
        hosts: Host names that HTTP clients may use for this machine.

    Raises:
        UsageError: if there is nothing to offer. The message lists the existing actions.
        TurtleactError: if the MCP SDK is not installed, or no graph can be reached.
    """
    from turtleact.commands import graph
    from turtleact.commands.interrupts import Interrupts

    is_empty = not any(offered[each] for each in ("actions", "services", "topics"))
    if not is_empty and find_spec("mcp") is None:
        problem = "turtleact mcp needs one more package: pip install 'mcp>=2.3,<3'"
        raise TurtleactError(problem)

    async def serve(node: Node) -> int:
        if is_empty:
            raise UsageError(await _what_there_is(node))
        if address is None and sys.stdin.isatty():
            note("waiting for an MCP client on stdin; a client starts this command. Ctrl-C ends it")
        async with _open_server(node, offered) as server:
            if address is not None:
                await _serve_http(server, address, token, hosts)
            else:
                from turtleact.mcp.serving import serve_stdio

                await serve_stdio(server)
        return 0

    enter = partial(graph.enter_graph, name="turtleact_mcp_{}")
    world = lambda _: graph.embedded_world()  # noqa: E731
    opened = graph.open_or_embed(reach, "nodes", _is_enough, world, enter)
    return Interrupts().run(graph.use(opened, serve))


def _names(text: str | None) -> tuple[str, ...]:
    return () if text is None else tuple(each.strip() for each in text.split(",") if each.strip())


@asynccontextmanager
async def _open_server(node: Node, offered: dict[str, Any]) -> AsyncIterator[McpServer]:
    """Open a server, and warn about actions that nobody serves yet."""
    from turtleact.mcp import open_mcp
    from turtleact.tasks import Background

    named = () if offered["actions"] == "all" else offered["actions"]
    async with open_mcp(node, **offered) as server:
        warning = Background(_warn_of_missing(node, named), "looking for actions")
        async with aclosing(warning):
            yield server


async def _serve_http(
    server: McpServer, address: tuple[str, int], token: str | None, hosts: tuple[str, ...]
) -> None:
    from turtleact.mcp.serving import open_http

    opened = open_http(server, *address, token=token, hosts=hosts)
    async with AsyncExitStack() as stack:
        with naming("--http"):
            at = await stack.enter_async_context(opened)
        say(f"ready at {at.url}\n")
        if at.token and token is None:
            say(f"clients must send 'Authorization: Bearer {at.token}'\n")
        await anyio.sleep_forever()


async def _what_there_is(node: Node) -> str:
    """Return the error message for a command line that names no actions to offer."""
    from turtleact.transports.base import find_server

    await find_server(node.transport, lambda: node.graph().actions or None)
    seen = ", ".join(node.graph().actions) or "none"
    return f"name what to offer: --actions NAME,… or --all; the actions here are: {seen}"


async def _warn_of_missing(node: Node, actions: tuple[str, ...]) -> None:
    """Warn about actions that nobody serves yet. Their tools appear once the actions are served."""
    from turtleact.names import resolve_name
    from turtleact.transports.base import find_server

    names = {resolve_name(each) for each in actions}
    await find_server(node.transport, lambda: names <= node.graph().actions.keys() or None)
    missing = sorted(names - node.graph().actions.keys())
    if missing:
        note(f"nobody serves {', '.join(missing)} yet: the tool appears when a server does")


async def _is_enough(_: Node) -> bool:
    """Any graph will do, because actions may appear later."""
    return True
