"""The verb ``mcp``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from turtleact.commands import VERBS
from turtleact.commands.settings import WrongOptions
from turtleact.commands.verbs import SETTINGS, verb
from turtleact.commands.verbs.options import Embedded, flag, host_and_port, only_one, value

if TYPE_CHECKING:
    from turtleact.commands.settings import Reach

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
    value(
        "--actions",
        metavar="NAMES",
        text="The actions to offer, such as /patrol,/go_to.",
        panel=OFFER,
    ),
]
Services: TypeAlias = Annotated[
    str | None,
    value(
        "--services",
        metavar="NAMES",
        text="The services to offer, such as /spawn,/clear.",
        panel=OFFER,
    ),
]
Topics: TypeAlias = Annotated[
    str | None,
    value(
        "--topics",
        metavar="NAMES",
        text="The topics that may be read, such as /turtle1/pose.",
        panel=OFFER,
    ),
]
Http: TypeAlias = Annotated[
    str | None,
    value(
        "--http",
        metavar="[HOST:]PORT",
        text="Serve over HTTP instead of stdin and stdout.",
        panel=HTTP,
    ),
]
Token: TypeAlias = Annotated[
    str | None,
    value(
        "--token",
        metavar="TEXT",
        text="The secret that clients must send over HTTP.",
        panel=HTTP,
    ),
]


@verb(app, knows=True, help=VERBS["mcp"], epilog=_EXAMPLES)
def mcp(
    reach: Reach,
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
            "--allow-host",
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
    everything = all or (read_only and actions is None)
    from turtleact.commands.mcp import Order, run

    order = Order(
        None if embedded else reach,
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


def _names(text: str | None) -> tuple[str, ...]:
    return () if text is None else tuple(each.strip() for each in text.split(",") if each.strip())
