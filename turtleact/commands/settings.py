"""The options of a command line, as data.

The verbs fill these structs in, and the modules that do the work read them. This module imports
nothing heavy, because every verb needs it before the work begins.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

from turtleact.commands.output import printable
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from turtleact.commands.locks import Locks
    from turtleact.goal_journal import OnRestart
    from turtleact.introspection import Introspection
    from turtleact.transports import QoS

__all__ = [
    "Durability",
    "Fleet",
    "Keeping",
    "LogFormat",
    "Override",
    "Page",
    "Place",
    "Placing",
    "Policies",
    "Reach",
    "Reliability",
    "Service",
    "Watched",
    "endpoints",
    "quoted",
]

Durability: TypeAlias = Literal["volatile", "transient_local"]
Reliability: TypeAlias = Literal["reliable", "best_effort"]
Placing: TypeAlias = Literal["random", "grid", "ring"]
LogFormat: TypeAlias = Literal["text", "json"]

LONGEST_SHOWN = 60
"""An error repeats at most this many characters of an argument."""

_WITH_PORT = re.compile(r"(tcp|udp|tls|quic|ws)/(?P<address>.*)")
_ADDRESS = re.compile(r"(\[[0-9A-Fa-f:.]+(%\w+)?\]|[^\s/:\[\]]+):(?P<port>[0-9]{1,9})")
"""A host and its port. An IPv6 address is in brackets."""
_ENDPOINT = re.compile(r"[a-z][a-z0-9-]*/\S+")


class Reach(NamedTuple):
    """The graph that a verb uses.

    Attributes:
        connect: The endpoints to connect to. If there are none, the verb looks for a graph itself.
        domain: The ROS domain of the graph, 0 to 232.
        config: The file with certificates and passwords, if there is one.
    """

    connect: tuple[str, ...]
    domain: int
    config: str | None = None

    @classmethod
    def of(cls, connect: str | None, domain: int, config: str | None) -> Reach:
        """The graph that the options select.

        Raises:
            UsageError: if ``connect`` is not a list of endpoints.
        """
        return cls(endpoints("--connect", connect), domain, config)

    def locks(self) -> Locks:
        """Read the ``--config`` file.

        Raises:
            UsageError: if the file cannot be read, or has an invalid value.
        """
        from turtleact.commands.locks import Locks, read_locks

        return Locks() if self.config is None else read_locks(self.config)


class Place(NamedTuple):
    """The place to which a goal is sent.

    Attributes:
        speed: The speed of the embedded world.
        seed: The seed of the embedded world.
        reach: Where to look for a server first. With None, only the embedded world is used.
        interfaces: A folder with more interfaces.
        options: ``reach`` and ``interfaces`` as options for the command line of another verb, with
            a space before each option.
    """

    speed: float | str = 1.0
    seed: int = 0
    reach: Reach | None = None
    interfaces: str | None = None
    options: str = ""


class Fleet(NamedTuple):
    """The turtles of a world, and the settings of its time.

    Attributes:
        speed: How fast time passes.
        turtles: How many turtles there are.
        placing: How they are placed.
        seed: The seed of all random choices.
        collide: Whether turtles stop each other.
        paused: Whether time stands still at first.
    """

    speed: float = 1.0
    turtles: int = 1
    placing: Placing = "random"
    seed: int = 0
    collide: bool = False
    paused: bool = False


class Keeping(NamedTuple):
    """How goals are kept in a journal.

    Attributes:
        path: The file.
        on_restart: What to do with goals that an earlier process has left unfinished.
        abort_goals: Whether a clean stop ends goals that would go on after a crash.
        max_starts: A goal is aborted after this many crashes without feedback; None for no limit.
    """

    path: str
    on_restart: OnRestart = "abort"
    abort_goals: bool = False
    max_starts: int | None = 3

    @property
    def resumes(self) -> bool:
        """Whether goals go on after a clean stop."""
        return self.on_restart == "resume" and not self.abort_goals


class Page(NamedTuple):
    """Where the page and rosbridge are served, and who may connect.

    Attributes:
        host: The address or name to bind.
        port: The port. 0 means any free port.
        token: The secret that clients must send; None for the default of `open_web`.
        hosts: More names that clients may use for this machine.
        origins: The origins of pages that may connect.
    """

    host: str
    port: int
    token: str | None = None
    hosts: tuple[str, ...] = ()
    origins: tuple[str, ...] = ()


class Watched(NamedTuple):
    """How other programs can watch the goals of a server.

    Attributes:
        otel: Whether traces and metrics are exported through OpenTelemetry.
        metrics: The host and port at which metrics are served; None for no metrics.
        log_format: The format of log records; None leaves logging alone.
    """

    otel: bool = False
    metrics: tuple[str, int] | None = None
    log_format: LogFormat | None = None


class Override(NamedTuple):
    """The first value of one parameter.

    Attributes:
        node: The name of the node, with or without its slash; ``/**`` for any node.
        name: The name of the parameter.
        value: The first value.
    """

    node: str
    name: str
    value: object


class Service(NamedTuple):
    """What ``serve`` serves, and at which endpoints.

    Attributes:
        targets: The user's actions, as `turtleact.commands.targets` reads them.
        listen: The endpoints to listen at, as a router. If there are none, and none to connect to,
            the server is the router of this machine, or a peer of that router.
        reach: The endpoints to connect to, and the domain.
        fleet: The turtles; None for no world and no built-in actions.
        page: The page and rosbridge; None for neither.
        config: Paths and values of Zenoh's configuration, such as those for access control.
        is_live: Whether a terminal shows a dashboard.
        turtlesim_only: Whether the world serves only what turtlesim serves, and no built-in
            actions.
        wait: Whether to wait until no other node serves an action, instead of refusing to serve it.
        reload: Whether to reload the user's actions when their files change.
        node_name: The name of the node that serves the actions, if there is no world.
        keeping: The journal of the goals; None for no journal.
        overrides: The first values of parameters.
        introspection: What all actions and services of the process publish for introspection.
        watched: How other programs can watch the goals.
    """

    targets: tuple[str, ...]
    listen: tuple[str, ...]
    reach: Reach
    fleet: Fleet | None
    page: Page | None
    config: dict[str, object]
    is_live: bool
    turtlesim_only: bool = False
    wait: bool = False
    reload: bool = False
    node_name: str = "turtleact"
    keeping: Keeping | None = None
    overrides: tuple[Override, ...] = ()
    introspection: Introspection = "off"
    watched: Watched = Watched()


class Policies(NamedTuple):
    """The requested quality of service. None leaves a policy to the verb.

    Attributes:
        reliability: As in `turtleact.QoS`.
        durability: As in `turtleact.QoS`.
        depth: As in `turtleact.QoS`, at least 1.
    """

    reliability: Reliability | None = None
    durability: Durability | None = None
    depth: int | None = None

    def qos(self, *, durability: Durability = "volatile", depth: int = 10) -> QoS:
        """The quality of service, with these defaults."""
        from turtleact.transports import QoS

        return QoS(
            depth=self.depth or depth,
            durability=self.durability or durability,
            reliability=self.reliability or "reliable",
        )


def endpoints(option: str, text: str | None) -> tuple[str, ...]:
    """The endpoints that an option names, separated by commas.

    Raises:
        UsageError: if a part is not an endpoint.
    """
    found = () if text is None else tuple(text.split(","))
    for each in found:
        if not (_ENDPOINT.fullmatch(each) and _is_reachable(each)):
            example = "tcp/[::1]:7447" if each.count(":") > 1 else "tcp/127.0.0.1:7447"
            raise UsageError(f"{option} takes an endpoint such as {example}, not {quoted(each)}")
    return found


def _is_reachable(endpoint: str) -> bool:
    """Whether an endpoint has a host and a port, if its protocol needs them."""
    found = _WITH_PORT.fullmatch(endpoint)
    if found is None:
        return True
    address = _ADDRESS.fullmatch(found["address"])
    return address is not None and 0 < int(address["port"]) < 65536


def quoted(text: str) -> str:
    """Quote a text of the user, and shorten it if it is long."""
    shown = text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}…"
    return f"'{printable(shown)}'"
