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
    Override,
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

WORLD, WEB, GOALS, WATCHING = "World", "Web", "Goals", "Watching"
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


MaxStarts: TypeAlias = Annotated[
    int | None,
    value(
        metavar="N",
        parser=whole,
        text="With --on-restart resume: abort a goal that has crashed the server so often "
        "without feedback in between; 0 for no limit. By default, 3.",
        panel=GOALS,
    ),
]
AllowHost: TypeAlias = Annotated[
    str | None,
    value(
        metavar="NAME",
        text="A name of this machine that web clients may use, besides its addresses. "
        "Separate several with commas.",
        panel=WEB,
    ),
]
AllowOrigin: TypeAlias = Annotated[
    str | None,
    value(
        metavar="ORIGIN",
        text="A site whose pages may connect, such as https://example.com. "
        "Separate several with commas.",
        panel=WEB,
    ),
]
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
OnRestart: TypeAlias = Annotated[
    Literal["abort", "resume"] | None,
    value(
        text="What to do with unfinished goals in the journal: end them, or go on with "
        "them. By default, abort.",
        panel=GOALS,
    ),
]
AbortGoals: TypeAlias = Annotated[
    bool,
    flag(
        "--abort-goals",
        text="With --on-restart resume: end running goals at Ctrl-C, so that they go on only "
        "after a crash.",
        panel=GOALS,
    ),
]
Speed: TypeAlias = Annotated[
    float,
    value(
        metavar="FACTOR",
        parser=speed_factor,
        text="How fast time passes: 2 is twice as fast as real time; up to 100.",
        panel=WORLD,
    ),
]
Seed: TypeAlias = Annotated[
    int, value(metavar="N", parser=whole, text="The seed of its random choices.", panel=WORLD)
]
Listen: TypeAlias = Annotated[
    str | None,
    value(
        metavar="ENDPOINT",
        text="Where others connect, such as tcp/0.0.0.0:7447. Separate several with commas.",
        panel="Graph",
    ),
]
Web: TypeAlias = Annotated[
    str | None,
    value(
        metavar="[HOST:]PORT",
        text="Serve a web page that shows the world, and rosbridge. Without a port, at 9090.",
        panel=WEB,
    ),
]
Token: TypeAlias = Annotated[
    str | None,
    value(metavar="TEXT", text="The secret that web clients must send.", panel=WEB),
]
Introspection: TypeAlias = Annotated[
    Literal["off", "metadata", "contents"],
    value(
        text="Publish the requests and responses of all actions and services, for action echo, "
        "service echo and bag record. With metadata, without their contents.",
        panel="Graph",
    ),
]
Metrics: TypeAlias = Annotated[
    str | None,
    value(metavar="[HOST:]PORT", text="Serve metrics for Prometheus at /metrics.", panel=WATCHING),
]
ParamsFile: TypeAlias = Annotated[
    list[Path] | None,
    value(metavar="FILE", text="A file with values of parameters, as 'param dump' prints it."),
]
Paused: TypeAlias = Annotated[
    bool, flag("--paused", text="Start with time stopped, until a client resumes it.", panel=WORLD)
]
Insecure: TypeAlias = Annotated[
    bool,
    flag(
        "--insecure",
        text="Let in everybody who can reach the endpoints of --listen.",
        panel="Graph",
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
ServeLogFormat: TypeAlias = Annotated[
    LogFormat | None,
    value(
        text="Write log records from level INFO up, with the goal they belong to.", panel=WATCHING
    ),
]
Journal: TypeAlias = Annotated[
    Path | None,
    value(metavar="FILE", text="Keep the goals in this file.", panel=GOALS),
]
Wait: TypeAlias = Annotated[
    bool, flag("--wait", text="If another node serves an action, wait until it is gone.")
]
Reload: TypeAlias = Annotated[
    bool, flag("--reload", text="Reload your actions when their files change.")
]
NoSim: TypeAlias = Annotated[
    bool, flag("--no-sim", text="Serve no turtles and no built-in actions.", panel=WORLD)
]
Turtles: TypeAlias = Annotated[
    int, value(metavar="N", min=1, max=MOST_TURTLES, text="How many turtles.", panel=WORLD)
]
ServePlacing: TypeAlias = Annotated[Placing, value(text="How they are placed.", panel=WORLD)]
Collide: TypeAlias = Annotated[
    bool, flag("--collide", text="Turtles stop each other.", panel=WORLD)
]


@verb(app, cls=ServeVerb, knows=True, help=VERBS["serve"], epilog=_EXAMPLES)
def serve(
    reach: ConnectOptions,
    targets: Targets = None,
    *,
    plain: Plain = False,
    headless: Annotated[bool, flag("--headless", text="The same as --plain.")] = False,
    wait: Wait = False,
    reload: Reload = False,
    no_sim: NoSim = False,
    node_name: NodeName = None,
    param: Param = None,
    params_file: ParamsFile = None,
    journal: Journal = None,
    on_restart: OnRestart = None,
    abort_goals: AbortGoals = False,
    max_starts: MaxStarts = None,
    speed: Speed = 1.0,
    turtles: Turtles = 1,
    placing: ServePlacing = "random",
    seed: Seed = 0,
    collide: Collide = False,
    paused: Paused = False,
    listen: Listen = None,
    insecure: Insecure = False,
    web: Web = None,
    token: Token = None,
    allow_host: AllowHost = None,
    allow_origin: AllowOrigin = None,
    introspection: Introspection = "off",
    otel: Otel = False,
    metrics: Metrics = None,
    log_format: ServeLogFormat = None,
) -> int:
    """``serve``."""
    at = endpoints("--listen", listen)
    fleet = Fleet(speed, turtles, placing, seed, collide=collide, paused=paused)
    _check_use(targets, fleet, node_name, no_sim=no_sim, reload=reload)
    keeping = _keeping(journal, on_restart, max_starts, abort_goals=abort_goals)
    page = _page(web, token, allow_host, allow_origin)
    from turtleact.commands.serving import run

    service = Service(
        tuple(targets or ()),
        at,
        reach,
        None if no_sim else fleet,
        page,
        _access(reach, at, insecure=insecure),
        is_live=not (headless or plain),
        wait=wait,
        reload=reload,
        node_name=node_name or _node_name(targets, no_sim=no_sim),
        keeping=keeping,
        overrides=_overrides(params_file, param),
        introspection=introspection,
        otel=otel,
        metrics=None if metrics is None else host_and_port("--metrics", metrics),
        log_format=log_format,
    )
    return run(service)


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
    from turtleact.commands.user_modules import read_target

    module = read_target(targets[0]).module.rpartition(".")[2] if no_sim and targets else ""
    is_fit = _NODE_NAME.fullmatch(module) and module not in _WORLD_NODES
    return module if is_fit else "turtleact"


def _access(where: ConnectOptions, listen: tuple[str, ...], *, insecure: bool) -> dict[str, object]:
    """Return the settings of Zenoh that control who may connect.

    Raises:
        UsageError: if the ``--config`` file has an error, or if anybody on the network could
            connect although ``insecure`` is False.
    """
    access = where.access()
    if not (insecure or access.keeps_strangers_out):
        _check_loopback(listen)
    return access.settings()


def _keeping(
    journal: Path | None,
    on_restart: Literal["abort", "resume"] | None,
    max_starts: int | None,
    *,
    abort_goals: bool,
) -> Keeping | None:
    if journal is None:
        if on_restart is not None or max_starts is not None or abort_goals:
            raise WrongOptions("--on-restart, --max-starts and --abort-goals need --journal")
        return None
    if on_restart != "resume" and (abort_goals or max_starts is not None):
        option = "--abort-goals" if abort_goals else "--max-starts"
        raise WrongOptions(f"{option} needs --on-restart resume: without it, no goal goes on")
    limit = 3 if max_starts is None else max_starts or None
    return Keeping(str(journal), on_restart or "abort", abort_goals, limit)


def _page(web: str | None, token: str | None, host: str | None, origin: str | None) -> Page | None:
    hosts, origins = _listed(host), _listed(origin)
    if web is None and (token is not None or hosts or origins):
        raise WrongOptions("--token, --allow-host and --allow-origin need --web")
    for each in origins:
        if "://" not in each and each != "null":
            raise WrongOptions(
                f"--allow-origin takes an origin such as https://example.com, not {quoted(each)}"
            )
    return None if web is None else Page(*host_and_port("--web", web), token, hosts, origins)


def _check_use(
    targets: list[str] | None, fleet: Fleet, node_name: str | None, *, no_sim: bool, reload: bool
) -> None:
    if reload and not targets:
        raise WrongOptions(NOTHING_TO_RELOAD)
    if not no_sim and node_name is not None:
        raise WrongOptions(
            "--node-name needs --no-sim: beside a world, your actions are on its node"
        )
    if not no_sim:
        return
    said = zip(Fleet._fields, fleet, Fleet(), strict=True)
    options = ", ".join(f"--{name}" for name, value, unasked in said if value != unasked)
    if options:
        raise WrongOptions(f"{options} and --no-sim exclude each other: there is no world")


def _check_loopback(listen: tuple[str, ...]) -> None:
    from turtleact.commands.access_config import is_loopback

    open_ones = [each for each in listen if not is_loopback(each)]
    if open_ones:
        raise UsageError(
            f"--listen {', '.join(open_ones)} lets in everybody who can reach this machine: say in "
            "a --config file who may connect, or give --insecure"
        )


def _listed(text: str | None) -> tuple[str, ...]:
    """Split hosts or origins at commas, and write each as browsers do."""
    return () if text is None else tuple(each.lower().rstrip("/") for each in text.split(","))
