"""``serve``, as Typer sees it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from turtleact.commands import VERBS
from turtleact.commands.verbs import completing
from turtleact.commands.verbs.arguments import (
    Config,
    Connect,
    Domain,
    Interfaces,
    Job,
    Verb,
    endpoints,
    quoted,
    reach,
    speed_factor,
    whole,
)
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts

__all__ = ["app", "serve"]

MOST_TURTLES = 10_000
"""A node cannot tell more of them in time."""

OF_A_WORLD = {
    "--speed": 1.0,
    "--turtles": 1,
    "--placing": "random",
    "--seed": 0,
    "--collide": False,
    "--paused": False,
}
"""What means nothing without a world, and its value if it is left out."""

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


@app.command("serve", cls=Verb, help=VERBS["serve"], epilog=_EXAMPLES)
def serve(
    targets: _Targets = None,
    *,
    listen: _Listen = None,
    connect: Connect = None,
    domain: Domain = None,
    config: Config = None,
    web: _Web = None,
    token: _Token = None,
    allow_host: _Hosts = None,
    allow_origin: _Origins = None,
    insecure: _Insecure = False,
    no_sim: _NoSim = False,
    headless: _Headless = False,
    plain: _Plain = False,
    speed: _Speed = "1",
    turtles: _Turtles = "1",
    placing: _Placing = "random",
    seed: _Seed = "0",
    collide: _Collide = False,
    paused: _Paused = False,
    interfaces: Interfaces = None,
) -> Job:
    """``serve``."""
    where = reach(connect, domain, config)
    at = endpoints("--listen", listen)
    page, token, hosts, origins = _page(web, token, allow_host, allow_origin)
    factor, count, placing, first = _fleet(speed, turtles, placing, seed)
    _check_world(factor, count, placing, first, collide, paused, is_there=not no_sim)

    def job(interrupts: Interrupts) -> int:
        from turtleact.commands.interfaces import make_known
        from turtleact.commands.serve import Service, run

        make_known(interfaces)
        locks = where.locks()
        if not (insecure or locks.keeps_strangers_out):
            _check_loopback(at)
        service = Service(
            tuple(targets or ()),
            listen=at,
            connect=where.connect,
            domain=where.domain,
            has_world=not no_sim,
            speed=factor,
            turtles=count,
            placing=placing,
            seed=first,
            collide=collide,
            paused=paused,
            config=locks.settings(),
            web=page,
            token=token,
            hosts=hosts,
            origins=origins,
            is_live=not (headless or plain),
        )
        return run(service, interrupts)

    return job


def _check_world(*asked: object, is_there: bool) -> None:
    """Refuse what is asked of a world where there is none: values in the order of `OF_A_WORLD`."""
    options = zip(OF_A_WORLD.items(), asked, strict=True)
    names = [name for (name, unasked), value in options if value != unasked]
    if names and not is_there:
        raise UsageError(f"{', '.join(names)} and --no-sim: without a world there is no such thing")


def _check_loopback(listen: tuple[str, ...]) -> None:
    from turtleact.commands.locks import is_loopback

    open_ones = [each for each in listen if not is_loopback(each)]
    if open_ones:
        raise UsageError(
            f"--listen {', '.join(open_ones)} lets in whoever can reach this machine: say in "
            "a --config file who may, or give --insecure"
        )


def _page(
    web: str | None, token: str | None, allow_host: str | None, allow_origin: str | None
) -> tuple[tuple[str, int] | None, str | None, tuple[str, ...], tuple[str, ...]]:
    """Where the page is, the token, and which hosts and origins are let in."""
    hosts, origins = _listed(allow_host), _listed(allow_origin)
    if web is None and (token is not None or hosts or origins):
        raise UsageError("--token, --allow-host and --allow-origin are for --web: give that, too")
    for origin in origins:
        if "://" not in origin and origin != "null":
            raise UsageError(
                f"--allow-origin is an origin such as https://example.com, not {quoted(origin)}"
            )
    return None if web is None else _host_and_port(web), token, hosts, origins


def _host_and_port(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    return host or "127.0.0.1", whole("the port of --web", port, most=65535)


def _listed(text: str | None) -> tuple[str, ...]:
    """Names with commas between, as browsers write them."""
    return () if text is None else tuple(each.lower().rstrip("/") for each in text.split(","))


def _fleet(speed: str, turtles: str, placing: str, seed: str) -> tuple[float, int, str, int]:
    from turtleact.sim.placing import PLACINGS

    if placing not in PLACINGS:
        raise UsageError(f"--placing is {' or '.join(PLACINGS)}, not {quoted(placing)}")
    count = whole("--turtles", turtles, least=1, most=MOST_TURTLES)
    return float(speed_factor(speed)), count, placing, whole("--seed", seed)
