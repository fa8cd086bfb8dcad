"""``serve``, as Typer sees it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from turtleact.commands import VERBS
from turtleact.commands.verbs import completing
from turtleact.commands.verbs.arguments import (
    Interfaces,
    Job,
    Reach,
    endpoints,
    quoted,
    reach,
    speed_factor,
    whole,
)
from turtleact.commands.verbs.grouping import grouped
from turtleact.commands.verbs.reading import Verb
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts

__all__ = ["Fleet", "Page", "app", "serve"]

MOST_TURTLES = 10_000
"""A node cannot tell more of them in time."""

_Targets = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="TARGET",
        help="Your actions: module:object, or module for all in it.",
        autocompletion=completing.targets,
    ),
]
_Listen = Annotated[
    str | None,
    typer.Option(
        "--listen",
        metavar="ENDPOINT",
        help="Where others come in, such as tcp/0.0.0.0:7447; several with commas between.",
    ),
]
_Web = Annotated[
    str | None,
    typer.Option(
        "--web",
        metavar="[HOST:]PORT",
        help="A page to see it on, and rosbridge, such as 9090; needs turtleact[web].",
    ),
]
_Token = Annotated[
    str | None, typer.Option("--token", metavar="TEXT", help="What clients of --web must know.")
]
_Hosts = Annotated[
    str | None,
    typer.Option(
        "--allow-host",
        metavar="NAME",
        help="What clients of --web may call this machine, besides its addresses; several with "
        "commas between.",
    ),
]
_Origins = Annotated[
    str | None,
    typer.Option(
        "--allow-origin",
        metavar="ORIGIN",
        help="Whose pages may be clients of --web, such as https://example.com; several with "
        "commas between.",
    ),
]
_Insecure = Annotated[
    bool, typer.Option("--insecure", help="Let in whoever can reach the endpoints of --listen.")
]
_NoSim = Annotated[bool, typer.Option("--no-sim", help="No turtles and no built-in actions.")]
_Headless = Annotated[
    bool, typer.Option("--headless", help="Lines only, no dashboard; the same as --plain.")
]
_Plain = Annotated[bool, typer.Option("--plain", help="Lines only, even on a terminal.")]
_Speed = Annotated[str, typer.Option(metavar="FACTOR", help="How fast time passes in the world.")]
_Turtles = Annotated[str, typer.Option(metavar="N", help="How many turtles there are.")]
_Placing = Annotated[
    str, typer.Option("--placing", metavar="HOW", help="How they stand: random, grid or ring.")
]
_Seed = Annotated[str, typer.Option(metavar="NUMBER", help="What its random choices begin with.")]
_Collide = Annotated[bool, typer.Option("--collide", help="Turtles stop each other.")]
_Paused = Annotated[
    bool, typer.Option("--paused", help="Let time stand still until it is stepped or resumed.")
]

_EXAMPLES = """\b
Examples:
  turtleact serve
  turtleact serve lab:patrol robot.arm --no-sim
  turtleact serve --web 9090
  turtleact serve --listen tls/0.0.0.0:7447 --config serve.toml
"""

app = typer.Typer()


class Fleet(NamedTuple):
    """The turtles of a world, and its time.

    Attributes:
        speed: How fast time passes.
        turtles: How many there are.
        placing: How they are placed.
        seed: What random choices begin with.
        collide: Whether they stop each other.
        paused: Whether time stands still at first.
    """

    speed: float = 1.0
    turtles: int = 1
    placing: str = "random"
    seed: int = 0
    collide: bool = False
    paused: bool = False


class Page(NamedTuple):
    """Where the page and rosbridge are, and who may be their client.

    Attributes:
        host: The address or name to bind.
        port: The port; any free one if 0.
        token: What clients must know; None means as `turtleact.web.open_web` says.
        hosts: What clients may call this machine.
        origins: Whose pages may be clients.
    """

    host: str
    port: int
    token: str | None = None
    hosts: tuple[str, ...] = ()
    origins: tuple[str, ...] = ()


def _page(
    *,
    web: _Web = None,
    token: _Token = None,
    allow_host: _Hosts = None,
    allow_origin: _Origins = None,
) -> Page | None:
    hosts, origins = _listed(allow_host), _listed(allow_origin)
    if web is None and (token is not None or hosts or origins):
        raise UsageError("--token, --allow-host and --allow-origin are for --web: give that, too")
    for origin in origins:
        if "://" not in origin and origin != "null":
            raise UsageError(
                f"--allow-origin is an origin such as https://example.com, not {quoted(origin)}"
            )
    return None if web is None else Page(*_host_and_port(web), token, hosts, origins)


def _fleet(
    *,
    speed: _Speed = "1",
    turtles: _Turtles = "1",
    placing: _Placing = "random",
    seed: _Seed = "0",
    collide: _Collide = False,
    paused: _Paused = False,
) -> Fleet:
    from turtleact.sim.start_poses import PLACINGS

    if placing not in PLACINGS:
        raise UsageError(f"--placing is {' or '.join(PLACINGS)}, not {quoted(placing)}")
    count = whole("--turtles", turtles, least=1, most=MOST_TURTLES)
    factor = float(speed_factor(speed))
    first = whole("--seed", seed)
    return Fleet(factor, count, placing, first, collide=collide, paused=paused)


@app.command("serve", cls=Verb, help=VERBS["serve"], epilog=_EXAMPLES)
@grouped(where=reach, page=_page, fleet=_fleet)
def serve(
    targets: _Targets = None,
    *,
    listen: _Listen = None,
    where: Reach,
    page: Page | None,
    insecure: _Insecure = False,
    no_sim: _NoSim = False,
    headless: _Headless = False,
    plain: _Plain = False,
    fleet: Fleet,
    interfaces: Interfaces = None,
) -> Job:
    """``serve``."""
    at = endpoints("--listen", listen)
    if no_sim:
        _check_for_nothing_of_a_world(fleet)

    def job(interrupts: Interrupts) -> int:
        from turtleact.commands.interfaces import make_known
        from turtleact.commands.serve import Service, run

        make_known(interfaces)
        locks = where.locks()
        if not (insecure or locks.keeps_strangers_out):
            _check_loopback(at)
        service = Service(
            tuple(targets or ()),
            at,
            where,
            None if no_sim else fleet,
            page,
            locks.settings(),
            is_live=not (headless or plain),
        )
        return run(service, interrupts)

    return job


def _check_for_nothing_of_a_world(fleet: Fleet) -> None:
    said = zip(Fleet._fields, fleet, Fleet(), strict=True)
    options = ", ".join(f"--{name}" for name, value, unasked in said if value != unasked)
    if options:
        raise UsageError(f"{options} and --no-sim: without a world there is no such thing")


def _check_loopback(listen: tuple[str, ...]) -> None:
    from turtleact.commands.locks import is_loopback

    open_ones = [each for each in listen if not is_loopback(each)]
    if open_ones:
        raise UsageError(
            f"--listen {', '.join(open_ones)} lets in whoever can reach this machine: say in "
            "a --config file who may, or give --insecure"
        )


def _host_and_port(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    return host or "127.0.0.1", whole("the port of --web", port, most=65535)


def _listed(text: str | None) -> tuple[str, ...]:
    """Names with commas between, as browsers write them."""
    return () if text is None else tuple(each.lower().rstrip("/") for each in text.split(","))
