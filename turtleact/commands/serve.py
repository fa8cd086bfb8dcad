"""The verb ``serve``."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import typer

from turtleact.commands import VERBS, completion
from turtleact.commands.app import SETTINGS, Verb, verb
from turtleact.commands.options import Plain, argument, flag, host_and_port, value, whole
from turtleact.commands.options import speed as speed_factor
from turtleact.commands.settings import (
    ConnectOptions,
    Fleet,
    Keeping,
    LogFormat,
    Page,
    Placing,
    Service,
    WrongOptions,
    endpoints,
    quoted,
)
from turtleact.errors import UsageError

__all__ = ["app"]

MOST_TURTLES = 10_000
"""The maximum number of turtles. A node could not publish the poses of more turtles in time."""

_NODE_NAME = re.compile("[A-Za-z][A-Za-z0-9_]*")
"""Matches valid node names, except hidden ones, which begin with an underscore."""

_PORT = re.compile(r"(.*:)?[0-9]+")

_WORLD_NODES = ("turtlesim", "turtle_actions", "world")

NOTHING_TO_RELOAD = "--reload is for your own actions: name a module or a file, such as lab.py"

GRAPH, WORLD, WEB, GOALS, WATCHING = "Graph", "World", "Web", "Goals", "Watching"
"""The headings under which the help of ``serve`` groups its options."""

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


Targets: TypeAlias = Annotated[
    list[str] | None,
    argument(
        "TARGET",
        "Your actions: a file such as lab.py or a module such as lab, with all actions in it; "
        "lab:NAME for one.",
        completion.targets,
    ),
]
NodeName: TypeAlias = Annotated[
    str | None,
    value(
        metavar="NAME",
        text="With --no-sim: the name of the node with your actions. If left out, the name of "
        "the first file or module.",
    ),
]
Param: TypeAlias = Annotated[
    list[str] | None,
    value(
        *("--param", "-p"),
        metavar="NAME:=VALUE",
        text="The initial value of a parameter of your modules.",
    ),
]
ParamsFile: TypeAlias = Annotated[
    list[Path] | None,
    value(metavar="FILE", text="A file with values of parameters, as 'param dump' prints it."),
]
Wait: TypeAlias = Annotated[
    bool, flag("--wait", text="If another node serves an action, wait until it is gone.")
]
Reload: TypeAlias = Annotated[
    bool, flag("--reload", text="Reload your actions when their files change.")
]
Headless: TypeAlias = Annotated[bool, flag("--headless", text="The same as --plain.")]
Listen: TypeAlias = Annotated[
    str | None,
    value(
        metavar="ENDPOINT",
        text="Where others connect, such as tcp/0.0.0.0:7447. Separate several with commas.",
        panel=GRAPH,
    ),
]
Insecure: TypeAlias = Annotated[
    bool,
    flag(
        "--insecure", text="Let in everybody who can reach the endpoints of --listen.", panel=GRAPH
    ),
]
Introspection: TypeAlias = Annotated[
    Literal["off", "metadata", "contents"],
    value(
        text="Publish the requests and responses of all actions and services, for action echo, "
        "service echo and bag record. With metadata, without their contents.",
        panel=GRAPH,
    ),
]
Otel: TypeAlias = Annotated[
    bool,
    flag(
        "--otel",
        text="Export traces and metrics by OpenTelemetry, as its environment variables say.",
        panel=WATCHING,
    ),
]
Metrics: TypeAlias = Annotated[
    str | None,
    value(metavar="[HOST:]PORT", text="Serve metrics for Prometheus at /metrics.", panel=WATCHING),
]
ServeLogFormat: TypeAlias = Annotated[
    LogFormat | None,
    value(
        text="Write log records from level INFO up, with the goal they belong to.", panel=WATCHING
    ),
]


def _keeping(
    *,
    journal: Annotated[
        Path | None, value(metavar="FILE", text="Keep the goals in this file.", panel=GOALS)
    ] = None,
    on_restart: Annotated[
        Literal["abort", "resume"] | None,
        value(
            text="What to do with unfinished goals in the journal: end them, or go on with "
            "them. By default, abort.",
            panel=GOALS,
        ),
    ] = None,
    abort_goals: Annotated[
        bool,
        flag(
            "--abort-goals",
            text="With --on-restart resume: end running goals at Ctrl-C, so that they go on only "
            "after a crash.",
            panel=GOALS,
        ),
    ] = False,
    max_starts: Annotated[
        int | None,
        value(
            metavar="N",
            parser=whole,
            text="With --on-restart resume: abort a goal that has crashed the server so often "
            "without feedback in between; 0 for no limit. By default, 3.",
            panel=GOALS,
        ),
    ] = None,
) -> Keeping | None:
    """Return how goals are kept; None without a journal."""
    if journal is None:
        if on_restart is not None or max_starts is not None or abort_goals:
            raise WrongOptions("--on-restart, --max-starts and --abort-goals need --journal")
        return None
    if on_restart != "resume" and (abort_goals or max_starts is not None):
        option = "--abort-goals" if abort_goals else "--max-starts"
        raise WrongOptions(f"{option} needs --on-restart resume: without it, no goal goes on")
    limit = 3 if max_starts is None else max_starts or None
    return Keeping(str(journal), on_restart or "abort", abort_goals, limit)


def _fleet(
    *,
    no_sim: Annotated[
        bool, flag("--no-sim", text="Serve no turtles and no built-in actions.", panel=WORLD)
    ] = False,
    speed: Annotated[
        float,
        value(
            metavar="FACTOR",
            parser=speed_factor,
            text="How fast time passes: 2 is twice as fast as real time; up to 100.",
            panel=WORLD,
        ),
    ] = 1.0,
    turtles: Annotated[
        int, value(metavar="N", min=1, max=MOST_TURTLES, text="How many turtles.", panel=WORLD)
    ] = 1,
    placing: Annotated[Placing, value(text="How they are placed.", panel=WORLD)] = "random",
    seed: Annotated[
        int, value(metavar="N", parser=whole, text="The seed of its random choices.", panel=WORLD)
    ] = 0,
    collide: Annotated[
        bool, flag("--collide", text="Turtles stop each other.", panel=WORLD)
    ] = False,
    paused: Annotated[
        bool,
        flag("--paused", text="Start with time stopped, until a client resumes it.", panel=WORLD),
    ] = False,
) -> Fleet | None:
    """Return the turtles of the world; None with ``--no-sim``."""
    fleet = Fleet(speed, turtles, placing, seed, collide, paused)
    if not no_sim:
        return fleet
    said = zip(Fleet._fields, fleet, Fleet(), strict=True)
    options = ", ".join(f"--{name}" for name, value, unasked in said if value != unasked)
    if options:
        raise WrongOptions(f"{options} and --no-sim exclude each other: there is no world")
    return None


def _page(
    *,
    web: Annotated[
        str | None,
        value(
            metavar="[HOST:]PORT",
            text="Serve a web page that shows the world, and rosbridge. Without a port, at 9090.",
            panel=WEB,
        ),
    ] = None,
    token: Annotated[
        str | None, value(metavar="TEXT", text="The secret that web clients must send.", panel=WEB)
    ] = None,
    allow_host: Annotated[
        str | None,
        value(
            metavar="NAME",
            text="A name of this machine that web clients may use, besides its addresses. "
            "Separate several with commas.",
            panel=WEB,
        ),
    ] = None,
    allow_origin: Annotated[
        str | None,
        value(
            metavar="ORIGIN",
            text="A site whose pages may connect, such as https://example.com. "
            "Separate several with commas.",
            panel=WEB,
        ),
    ] = None,
) -> Page | None:
    """Return where the page is served and for whom; None without a page."""
    hosts, origins = _listed(allow_host), _listed(allow_origin)
    if web is None:
        if token is not None or hosts or origins:
            raise WrongOptions("--token, --allow-host and --allow-origin need --web")
        return None
    for each in origins:
        if "://" not in each and each != "null":
            example = "takes an origin such as https://example.com"
            raise WrongOptions(f"--allow-origin {example}, not {quoted(each)}")
    return Page(*host_and_port("--web", web), token, hosts, origins)


@verb(
    app,
    cls=ServeVerb,
    knows=True,
    bundles={"keeping": _keeping, "fleet": _fleet, "page": _page},
    help=VERBS["serve"],
    epilog=_EXAMPLES,
)
def serve(
    reach: ConnectOptions,
    targets: Targets = None,
    *,
    plain: Plain = False,
    headless: Headless = False,
    wait: Wait = False,
    reload: Reload = False,
    node_name: NodeName = None,
    param: Param = None,
    params_file: ParamsFile = None,
    keeping: Keeping | None,
    fleet: Fleet | None,
    listen: Listen = None,
    insecure: Insecure = False,
    introspection: Introspection = "off",
    page: Page | None,
    otel: Otel = False,
    metrics: Metrics = None,
    log_format: ServeLogFormat = None,
) -> int:
    """``serve``."""
    at = endpoints("--listen", listen)
    if reload and not targets:
        raise WrongOptions(NOTHING_TO_RELOAD)
    if fleet is not None and node_name is not None:
        problem = "beside a world, your actions are on its node"
        raise WrongOptions(f"--node-name needs --no-sim: {problem}")
    from turtleact.commands.node_parameters import read_overrides
    from turtleact.commands.serving import run

    service = Service(
        tuple(targets or ()),
        at,
        reach,
        fleet,
        page,
        _access(reach, at, insecure=insecure),
        is_live=not (headless or plain),
        wait=wait,
        reload=reload,
        node_name=node_name or _node_name(targets if fleet is None else None),
        keeping=keeping,
        overrides=tuple(read_overrides([str(each) for each in params_file or ()], param or ())),
        introspection=introspection,
        otel=otel,
        metrics=None if metrics is None else host_and_port("--metrics", metrics),
        log_format=log_format,
    )
    return run(service)


def _node_name(targets: list[str] | None) -> str:
    """Return the name of the node with the user's actions: that of the first target's module.

    Beside a world, or if a node cannot have that name, it is ``turtleact``. A server without a
    world often runs beside a server with a world, and ROS 2 warns if two nodes have the same name.
    """
    from turtleact.commands.user_code import read_target

    module = read_target(targets[0]).module.rpartition(".")[2] if targets else ""
    is_fit = _NODE_NAME.fullmatch(module) and module not in _WORLD_NODES
    return module if is_fit else "turtleact"


def _access(where: ConnectOptions, listen: tuple[str, ...], *, insecure: bool) -> dict[str, object]:
    """Return the settings of Zenoh that control who may connect.

    Raises:
        UsageError: if the ``--config`` file has an error, or if anybody on the network could
            connect although ``insecure`` is False.
    """
    from turtleact.commands.access_config import is_loopback

    access = where.access()
    open_ones = [each for each in listen if not is_loopback(each)]
    if open_ones and not (insecure or access.keeps_strangers_out):
        raise UsageError(
            f"--listen {', '.join(open_ones)} lets in everybody who can reach this machine: say in "
            "a --config file who may connect, or give --insecure"
        )
    return access.settings()


def _listed(text: str | None) -> tuple[str, ...]:
    """Split hosts or origins at commas, and write each as browsers do."""
    return () if text is None else tuple(each.lower().rstrip("/") for each in text.split(","))
