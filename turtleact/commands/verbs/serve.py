"""``serve`` and ``run``, as Typer sees them."""

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
from turtleact.sim.placing import PLACINGS

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts

__all__ = ["app"]

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
        help="What clients of --web may call this machine, besides its addresses.",
    ),
]
_Origins = Annotated[
    str | None,
    typer.Option(
        "--allow-origin",
        metavar="ORIGIN",
        help="Whose pages may be clients of --web, such as https://example.com.",
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
_Paused = Annotated[
    bool, typer.Option("--paused", help="Let time stand still until it is stepped or resumed.")
]

_RosArguments = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="--ros-args ...", help="Of turtle_teleop_key: -r FROM:=TO, -p NAME:=VALUE."
    ),
]

_FIBONACCI = "turtleact.actions.fibonacci"

_PROGRAMS = (
    ("turtlesim", "turtlesim_node"),
    ("turtlesim", "turtle_teleop_key"),
    ("action_tutorials_py", "fibonacci_action_server"),
    ("action_tutorials_cpp", "fibonacci_action_server"),
    ("examples_rclpy_minimal_action_server", "server"),
    ("examples_rclcpp_minimal_action_server", "action_server_member_functions"),
)
"""The programs of ROS 2 that have their like here; those of other packages serve Fibonacci."""

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
    paused: _Paused = False,
    interfaces: Interfaces = None,
) -> Job:
    """``serve``."""
    where = reach(connect, domain, config)
    at = endpoints("--listen", listen)
    hosts, origins = _listed(allow_host), _listed(allow_origin)
    page = None if web is None else _host_and_port(web)
    if page is None and (token is not None or hosts or origins):
        raise UsageError("--token, --allow-host and --allow-origin are for --web: give that, too")
    for origin in origins:
        if "://" not in origin and origin != "null":
            raise UsageError(
                f"--allow-origin is an origin such as https://example.com, not {quoted(origin)}"
            )
    factor = float(speed_factor(speed))
    if placing not in PLACINGS:
        raise UsageError(f"--placing is {', '.join(PLACINGS)}, not {quoted(placing)}")
    count, first = whole("--turtles", turtles, least=1, most=MOST_TURTLES), whole("--seed", seed)

    def job(interrupts: Interrupts) -> int:
        from turtleact.commands.interfaces import make_known
        from turtleact.commands.locks import is_loopback
        from turtleact.commands.serve import Service, run

        make_known(interfaces)
        locks = where.locks()
        open_ones = [each for each in at if not is_loopback(each)]
        if open_ones and not insecure and not locks.keeps_strangers_out:
            raise UsageError(
                f"--listen {', '.join(open_ones)} lets in whoever can reach this machine: say in "
                "a --config file who may, or give --insecure"
            )
        service = Service(
            tuple(targets or ()),
            at,
            where.connect,
            where.domain,
            not no_sim,
            factor,
            count,
            placing,
            first,
            paused,
            locks.settings(),
            page,
            token,
            not (headless or plain),
            hosts,
            origins,
        )
        return run(service, interrupts)

    return job


@app.command("run", cls=Verb, help=VERBS["run"], context_settings={"ignore_unknown_options": True})
def run(
    package: Annotated[
        str,
        typer.Argument(
            metavar="PACKAGE",
            help="turtlesim or action_tutorials_py.",
            autocompletion=completing.words(*dict.fromkeys(package for package, _ in _PROGRAMS)),
        ),
    ],
    executable: Annotated[
        str,
        typer.Argument(
            metavar="EXECUTABLE",
            help="turtlesim_node, turtle_teleop_key or fibonacci_action_server.",
            autocompletion=completing.words(*(name for _, name in _PROGRAMS)),
        ),
    ],
    arguments: _RosArguments = None,
    *,
    domain: Domain = None,
) -> Job:
    """``run``: the programs of ROS 2 that have their like here."""
    if (package, executable) not in _PROGRAMS:
        known = ", ".join(f"'{package} {executable}'" for package, executable in _PROGRAMS)
        raise UsageError(
            f"'{package} {executable}' is not there: turtleact runs {known}; your own actions are "
            "for 'turtleact serve module:object'"
        )
    if executable == "turtle_teleop_key":
        from turtleact.commands.verbs.teleop import turtle_teleop_key

        return turtle_teleop_key(arguments or (), domain)
    if arguments:
        raise UsageError(
            f"{quoted(' '.join(arguments))} is not taken: names stay as they are, and parameters "
            "are for 'turtleact param set' and 'load', once it runs"
        )
    if package != "turtlesim":
        return serve([_FIBONACCI], no_sim=True, domain=domain)
    return serve(domain=domain)


def _host_and_port(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    return host or "127.0.0.1", whole("the port of --web", port, most=65535)


def _listed(text: str | None) -> tuple[str, ...]:
    """Names with commas between, as browsers write them."""
    return () if text is None else tuple(each.lower().rstrip("/") for each in text.split(","))
