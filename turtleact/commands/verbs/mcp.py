"""Declares the verb ``mcp`` for Typer."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import typer

from turtleact.commands import VERBS
from turtleact.commands.settings import quoted
from turtleact.commands.verbs import SETTINGS, Job, Verb
from turtleact.commands.verbs.options import (
    Config,
    Connect,
    Domain,
    Interfaces,
    folder,
    only_one,
    reach,
)
from turtleact.errors import UsageError

__all__ = ["app"]

OFFER = "What the model may use"
HTTP = "HTTP"

Actions: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--actions",
        metavar="NAMES",
        help="The actions to offer, such as /patrol,/go_to.",
        rich_help_panel=OFFER,
    ),
]
All: TypeAlias = Annotated[
    bool,
    typer.Option("--all", help="Offer all actions and all topics.", rich_help_panel=OFFER),
]
Services: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--services",
        metavar="NAMES",
        help="The services to offer, such as /spawn,/clear.",
        rich_help_panel=OFFER,
    ),
]
Topics: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--topics",
        metavar="NAMES",
        help="The topics that may be read, such as /turtle1/pose.",
        rich_help_panel=OFFER,
    ),
]
ReadOnly: TypeAlias = Annotated[
    bool,
    typer.Option("--read-only", help="Offer only what changes nothing.", rich_help_panel=OFFER),
]
Confirm: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--confirm",
        help="Ask the user before each goal and each service call.",
        rich_help_panel=OFFER,
    ),
]
Http: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--http",
        metavar="[HOST:]PORT",
        help="Serve over HTTP instead of stdin and stdout.",
        rich_help_panel=HTTP,
    ),
]
Token: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--token",
        metavar="TEXT",
        help="The secret that clients must send over HTTP.",
        rich_help_panel=HTTP,
    ),
]
Hosts: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--allow-host",
        metavar="NAMES",
        help="Names and addresses of this machine that clients may use over HTTP.",
        rich_help_panel=HTTP,
    ),
]
Embedded: TypeAlias = Annotated[
    bool, typer.Option("--embedded", help="Start a world in this process.")
]

_EXAMPLES = """\
[bold]Examples[/]
  turtleact mcp --actions /patrol,/go_to
  turtleact mcp --all --confirm
  turtleact mcp --all --read-only --http 8000
"""

app = typer.Typer(**SETTINGS)


@app.command(cls=Verb, help=VERBS["mcp"], epilog=_EXAMPLES)
def mcp(
    *,
    actions: Actions = None,
    all: All = False,
    services: Services = None,
    topics: Topics = None,
    read_only: ReadOnly = False,
    confirm: Confirm = False,
    http: Http = None,
    token: Token = None,
    allow_host: Hosts = None,
    embedded: Embedded = False,
    interfaces: Interfaces = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """``mcp``."""
    only_one("what to offer", all=all, actions=actions is not None)
    only_one("what to offer", all=all, topics=topics is not None)
    only_one("the graph", embedded=embedded, connect=connect is not None)
    if read_only and services:
        raise UsageError("--read-only and --services exclude each other: a call may change things")
    if http is None and (token is not None or allow_host is not None):
        raise UsageError("--token and --allow-host need --http")
    where = None if embedded else reach(connect, domain, config)
    address = None if http is None else _address(http)
    everything = all or (read_only and actions is None)

    def job() -> int:
        from turtleact.commands.interfaces import make_known
        from turtleact.commands.mcp import Order, run

        make_known(folder(interfaces))
        order = Order(
            where,
            None if everything else _names(actions),
            _names(services),
            None if all else _names(topics),
            address,
            token,
            _names(allow_host),
            read_only=read_only,
            confirm=confirm,
        )
        return run(order)

    return job


def _names(text: str | None) -> tuple[str, ...]:
    return () if text is None else tuple(each.strip() for each in text.split(",") if each.strip())


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not (port.isascii() and port.isdigit() and len(port) <= 5 and int(port) <= 65535):
        raise UsageError(f"the port of --http is a whole number, 0 to 65535, not {quoted(port)}")
    return host or "127.0.0.1", int(port)
