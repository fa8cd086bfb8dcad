"""Declares the verb ``serve`` for Typer."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import typer

from turtleact.commands import VERBS, completion
from turtleact.commands.settings import (
    Fleet,
    Keeping,
    LogFormat,
    Override,
    Page,
    Placing,
    Reach,
    Service,
    Watched,
    endpoints,
    quoted,
)
from turtleact.commands.verbs import SETTINGS, Job, Verb
from turtleact.commands.verbs.options import (
    Config,
    Connect,
    Domain,
    Interfaces,
    Plain,
    folder,
    journal_in,
    reach,
    whole,
)
from turtleact.commands.verbs.options import speed as speed_factor
from turtleact.errors import UsageError

__all__ = ["app", "serve"]

MOST_TURTLES = 10_000
"""The maximum number of turtles. A node could not publish the poses of more turtles in time."""

_NODE_NAME = re.compile("[A-Za-z][A-Za-z0-9_]*")
"""Matches valid node names, except hidden ones, which begin with an underscore."""

_PORT = re.compile(r"(.*:)?[0-9]+")

_WORLD_NODES = ("turtlesim", "turtle_actions", "world")

NOTHING_TO_RELOAD = "--reload is for your own actions: name a module or a file, such as lab.py"

WORLD, WEB, GOALS, WATCHING = "World", "Web", "Goals", "Watching"
"""The headings under which the help of ``serve`` groups its options."""

Targets: TypeAlias = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="TARGET",
        help="Your actions: a file such as lab.py or a module such as lab, with all actions in it; "
        "lab:NAME for one.",
        autocompletion=completion.targets,
    ),
]
Listen: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--listen",
        metavar="ENDPOINT",
        help="Where others connect, such as tcp/0.0.0.0:7447. Separate several with commas.",
        rich_help_panel="Graph",
    ),
]
Insecure: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--insecure",
        help="Let in everybody who can reach the endpoints of --listen.",
        rich_help_panel="Graph",
    ),
]
Web: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--web",
        metavar="[HOST:]PORT",
        help="Serve a web page that shows the world, and rosbridge. Without a port, at 9090.",
        rich_help_panel=WEB,
    ),
]
Token: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--token",
        metavar="TEXT",
        help="The secret that web clients must send.",
        rich_help_panel=WEB,
    ),
]
Hosts: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--allow-host",
        metavar="NAME",
        help="A name of this machine that web clients may use, besides its addresses. "
        "Separate several with commas.",
        rich_help_panel=WEB,
    ),
]
Origins: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--allow-origin",
        metavar="ORIGIN",
        help="A site whose pages may connect, such as https://example.com. "
        "Separate several with commas.",
        rich_help_panel=WEB,
    ),
]
Headless: TypeAlias = Annotated[bool, typer.Option("--headless", help="The same as --plain.")]
Wait: TypeAlias = Annotated[
    bool,
    typer.Option("--wait", help="If another node serves an action, wait until it is gone."),
]
Reload: TypeAlias = Annotated[
    bool,
    typer.Option("--reload", help="Reload your actions when their files change."),
]
NodeName: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--node-name",
        metavar="NAME",
        help="With --no-sim: the name of the node with your actions. If left out, the name of the "
        "first file or module.",
    ),
]
Assignments: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--param",
        "-p",
        metavar="NAME:=VALUE",
        help="The initial value of a parameter of your modules.",
    ),
]
ParamsFiles: TypeAlias = Annotated[
    list[Path] | None,
    typer.Option(
        "--params-file",
        metavar="FILE",
        help="A file with values of parameters, as 'param dump' prints it.",
    ),
]
OnRestart: TypeAlias = Annotated[
    Literal["abort", "resume"] | None,
    typer.Option(
        "--on-restart",
        help="What to do with unfinished goals in the journal: end them, or go on with "
        "them. By default, abort.",
        rich_help_panel=GOALS,
    ),
]
AbortGoals: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--abort-goals",
        help="With --on-restart resume: end running goals at Ctrl-C, so that they go on only after "
        "a crash.",
        rich_help_panel=GOALS,
    ),
]
MaxStarts: TypeAlias = Annotated[
    int | None,
    typer.Option(
        "--max-starts",
        metavar="N",
        parser=whole,
        help="With --on-restart resume: abort a goal that has crashed the server so often without "
        "feedback in between; 0 for no limit. By default, 3.",
        rich_help_panel=GOALS,
    ),
]
Introspect: TypeAlias = Annotated[
    Literal["off", "metadata", "contents"],
    typer.Option(
        "--introspection",
        help="Publish the requests and responses of all actions and services, for action echo, "
        "service echo and bag record. With metadata, without their contents.",
        rich_help_panel="Graph",
    ),
]
Otel: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--otel",
        help="Export traces and metrics by OpenTelemetry, as its environment variables say.",
        rich_help_panel=WATCHING,
    ),
]
Metrics: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--metrics",
        metavar="[HOST:]PORT",
        help="Serve metrics for Prometheus at /metrics.",
        rich_help_panel=WATCHING,
    ),
]
LogAs: TypeAlias = Annotated[
    LogFormat | None,
    typer.Option(
        "--log-format",
        help="Write log records from level INFO up, with the goal they belong to.",
        rich_help_panel=WATCHING,
    ),
]
NoSim: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--no-sim", help="Serve no turtles and no built-in actions.", rich_help_panel=WORLD
    ),
]
Speed: TypeAlias = Annotated[
    float,
    typer.Option(
        metavar="FACTOR",
        parser=speed_factor,
        help="How fast time passes: 2 is twice as fast as real time; up to 100.",
        rich_help_panel=WORLD,
    ),
]
Turtles: TypeAlias = Annotated[
    int,
    typer.Option(
        metavar="N", min=1, max=MOST_TURTLES, help="How many turtles.", rich_help_panel=WORLD
    ),
]
HowPlaced: TypeAlias = Annotated[
    Placing, typer.Option("--placing", help="How they are placed.", rich_help_panel=WORLD)
]
Seed: TypeAlias = Annotated[
    int,
    typer.Option(
        metavar="N",
        parser=whole,
        help="The seed of its random choices.",
        rich_help_panel=WORLD,
    ),
]
Collide: TypeAlias = Annotated[
    bool, typer.Option("--collide", help="Turtles stop each other.", rich_help_panel=WORLD)
]
Paused: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--paused",
        help="Start with time stopped, until a client resumes it.",
        rich_help_panel=WORLD,
    ),
]

_EXAMPLES = """\
[bold]Examples[/]
  turtleact serve
  turtleact serve lab.py --reload
  turtleact serve lab:patrol robot.arm --no-sim
  turtleact serve --web
  turtleact serve lab.py --journal goals.db --on-restart resume
  turtleact serve --listen tls/0.0.0.0:7447 --config serve.toml
"""

WEB_PORT = "9090"
"""The port of ``--web`` without a port, which is also the default of rosbridge."""


class ServeVerb(Verb):
    """The verb ``serve``, whose option ``--web`` may stand without a port."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # as in `Verb`
        """Parse the arguments. A ``--web`` that no ``[HOST:]PORT`` follows gets `WEB_PORT`."""
        full = [
            f"--web={WEB_PORT}" if arg == "--web" and not _PORT.fullmatch(after) else arg
            for arg, after in zip(args, [*args[1:], ""], strict=False)
        ]
        return super().parse_args(ctx, full)


app = typer.Typer(**SETTINGS)


@app.command(cls=ServeVerb, help=VERBS["serve"], epilog=_EXAMPLES)
def serve(
    targets: Targets = None,
    *,
    plain: Plain = False,
    headless: Headless = False,
    interfaces: Interfaces = None,
    wait: Wait = False,
    reload: Reload = False,
    no_sim: NoSim = False,
    node_name: NodeName = None,
    param: Assignments = None,
    params_file: ParamsFiles = None,
    journal: Annotated[Path | None, journal_in(GOALS, "Keep the goals in this file.")] = None,
    on_restart: OnRestart = None,
    abort_goals: AbortGoals = False,
    max_starts: MaxStarts = None,
    speed: Speed = 1.0,
    turtles: Turtles = 1,
    placing: HowPlaced = "random",
    seed: Seed = 0,
    collide: Collide = False,
    paused: Paused = False,
    listen: Listen = None,
    insecure: Insecure = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
    web: Web = None,
    token: Token = None,
    allow_host: Hosts = None,
    allow_origin: Origins = None,
    introspection: Introspect = "off",
    otel: Otel = False,
    metrics: Metrics = None,
    log_format: LogAs = None,
) -> Job:
    """``serve``."""
    at, watched = endpoints("--listen", listen), _watched(metrics, log_format, otel=otel)
    fleet = Fleet(speed, turtles, placing, seed, collide=collide, paused=paused)
    _check_use(targets, fleet, node_name, no_sim=no_sim, reload=reload)
    keeping = _keeping(journal, on_restart, max_starts, abort_goals=abort_goals)
    page, where = _page(web, token, allow_host, allow_origin), reach(connect, domain, config)

    def service() -> Service:  # not before the job: this reads files and imports modules
        access = _access(where, at, insecure=insecure)
        return Service(
            *(tuple(targets or ()), at, where, None if no_sim else fleet, page, access),
            *(not (headless or plain), False, wait, reload),  # not only turtlesim
            node_name=node_name or _node_name(targets, no_sim=no_sim),
            keeping=keeping,
            overrides=_overrides(params_file, param),
            introspection=introspection,
            watched=watched,
        )

    return partial(_serve, folder(interfaces), service)


def _serve(known: str | None, service: Callable[[], Service]) -> int:
    from turtleact.commands.interfaces import make_known
    from turtleact.commands.serve import run

    make_known(known)
    return run(service())


def _overrides(files: list[Path] | None, assignments: list[str] | None) -> tuple[Override, ...]:
    """Read the initial values of parameters. Raises the errors of `read_overrides`."""
    from turtleact.commands.node_parameters import read_overrides

    return tuple(read_overrides([str(each) for each in files or ()], assignments or ()))


def _node_name(targets: list[str] | None, *, no_sim: bool) -> str:
    """Return the name of the node with the user's actions.

    Without a world, the node is named after the module of the first target. The module must
    have a valid node name that differs from the names of a world's nodes. In all other cases, the
    node is called ``turtleact``. A server without a world often runs beside a server with a world,
    and ROS 2 warns if two nodes have the same name.
    """
    from turtleact.commands.targets import read_target

    module = read_target(targets[0]).module.rpartition(".")[2] if no_sim and targets else ""
    is_fit = _NODE_NAME.fullmatch(module) and module not in _WORLD_NODES
    return module if is_fit else "turtleact"


def _access(where: Reach, listen: tuple[str, ...], *, insecure: bool) -> dict[str, object]:
    """Return the settings of Zenoh that control who may connect.

    Raises:
        UsageError: if the ``--config`` file has an error, or if anybody on the network could
            connect although ``insecure`` is False.
    """
    locks = where.locks()
    if not (insecure or locks.keeps_strangers_out):
        _check_loopback(listen)
    return locks.settings()


def _keeping(
    journal: Path | None,
    on_restart: Literal["abort", "resume"] | None,
    max_starts: int | None,
    *,
    abort_goals: bool,
) -> Keeping | None:
    if journal is None:
        if on_restart is not None or max_starts is not None or abort_goals:
            raise UsageError("--on-restart, --max-starts and --abort-goals need --journal")
        return None
    if on_restart != "resume" and (abort_goals or max_starts is not None):
        option = "--abort-goals" if abort_goals else "--max-starts"
        raise UsageError(f"{option} needs --on-restart resume: without it, no goal goes on")
    limit = 3 if max_starts is None else max_starts or None
    return Keeping(str(journal), on_restart or "abort", abort_goals, limit)


def _page(web: str | None, token: str | None, host: str | None, origin: str | None) -> Page | None:
    hosts, origins = _listed(host), _listed(origin)
    if web is None and (token is not None or hosts or origins):
        raise UsageError("--token, --allow-host and --allow-origin need --web")
    for each in origins:
        if "://" not in each and each != "null":
            raise UsageError(
                f"--allow-origin takes an origin such as https://example.com, not {quoted(each)}"
            )
    return None if web is None else Page(*_host_and_port("--web", web), token, hosts, origins)


def _watched(metrics: str | None, log_format: LogFormat | None, *, otel: bool) -> Watched:
    where = None if metrics is None else _host_and_port("--metrics", metrics)
    return Watched(otel, where, log_format)


def _check_use(
    targets: list[str] | None, fleet: Fleet, node_name: str | None, *, no_sim: bool, reload: bool
) -> None:
    if reload and not targets:
        raise UsageError(NOTHING_TO_RELOAD)
    if not no_sim and node_name is not None:
        raise UsageError("--node-name needs --no-sim: beside a world, your actions are on its node")
    if not no_sim:
        return
    said = zip(Fleet._fields, fleet, Fleet(), strict=True)
    options = ", ".join(f"--{name}" for name, value, unasked in said if value != unasked)
    if options:
        raise UsageError(f"{options} and --no-sim exclude each other: there is no world")


def _check_loopback(listen: tuple[str, ...]) -> None:
    from turtleact.commands.locks import is_loopback

    open_ones = [each for each in listen if not is_loopback(each)]
    if open_ones:
        raise UsageError(
            f"--listen {', '.join(open_ones)} lets in everybody who can reach this machine: say in "
            "a --config file who may connect, or give --insecure"
        )


def _host_and_port(option: str, text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not (port.isascii() and port.isdigit() and len(port) <= 5 and int(port) <= 65535):
        raise UsageError(f"the port of {option} is a whole number, 0 to 65535, not {quoted(port)}")
    return host or "127.0.0.1", int(port)


def _listed(text: str | None) -> tuple[str, ...]:
    """Split hosts or origins at commas, and write each as browsers do."""
    return () if text is None else tuple(each.lower().rstrip("/") for each in text.split(","))
