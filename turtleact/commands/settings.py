"""Defines the options of a command line as structs.

The verbs fill these structs in, and the modules that do the work read them. This module imports
only modules that load quickly, because every verb imports this module first.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

from turtleact.commands.output import printable
from turtleact.errors import InvalidOption, TurtleactError, UsageError

if TYPE_CHECKING:
    from turtleact.commands.access_config import AccessConfig
    from turtleact.goals.records import OnRestart
    from turtleact.goals.service_server import Introspection
    from turtleact.transports import QoS

__all__ = [
    "ConnectOptions",
    "Durability",
    "Fleet",
    "Keeping",
    "LogFormat",
    "Override",
    "Owner",
    "Page",
    "Placing",
    "Policies",
    "Reliability",
    "Service",
    "WrongOptions",
    "endpoints",
    "naming",
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


class WrongOptions(UsageError):
    """Options or arguments of a verb do not fit each other, or cannot be understood."""


class ConnectOptions(NamedTuple):
    """The graph that a verb uses.

    Attributes:
        connect: The endpoints to connect to. If it is empty, the verb looks for the router of this
            machine.
        domain: The ROS domain of the graph, 0 to 232.
        config: The file with certificates and passwords, if there is one.
        learns: Whether nodes are asked to describe types that are not known here.
    """

    connect: tuple[str, ...]
    domain: int
    config: str | None = None
    learns: bool = True

    @classmethod
    def of(cls, connect: str | None, domain: int, config: str | None) -> ConnectOptions:
        """Return the graph that these command-line options select.

        Raises:
            WrongOptions: if ``connect`` is not a list of endpoints.
        """
        return cls(endpoints("--connect", connect), domain, config)

    def access(self) -> AccessConfig:
        """Return the contents of the ``--config`` file. Without a file, the contents are empty.

        Raises:
            UsageError: if the file cannot be read, or has an invalid value.
        """
        from turtleact.commands.access_config import AccessConfig, read_access_config

        return AccessConfig() if self.config is None else read_access_config(self.config)


class Owner(NamedTuple):
    """The node that has the parameters which a verb reads or sets.

    Attributes:
        name: The name of the node, with or without its leading slash.
        hidden: Whether to find the node even if it is hidden.
        timeout: How long to wait until the node appears (s, by the clock of the graph).
    """

    name: str
    hidden: bool = True
    timeout: float = 0.0


class Fleet(NamedTuple):
    """The turtles of a world, and the settings of its clock.

    Attributes:
        speed: Simulated seconds per wall-clock second.
        turtles: How many turtles there are.
        placing: How the turtles are placed at the start.
        seed: The seed of all random choices.
        collide: Whether turtles block each other.
        paused: Whether the world starts paused.
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
        path: The path of the journal's file.
        on_restart: What to do with goals that an earlier process has left unfinished.
        abort_goals: Whether running goals are aborted when the server is stopped by a signal. If
            not, they stay in the journal, and ``on_restart`` applies to them.
        max_starts: If the server has crashed this many times since a goal's newest feedback, the
            goal is aborted; None for no limit.
    """

    path: str
    on_restart: OnRestart = "abort"
    abort_goals: bool = False
    max_starts: int | None = 3

    @property
    def resumes(self) -> bool:
        """Whether running goals go on after the server has been stopped and started again."""
        return self.on_restart == "resume" and not self.abort_goals


class Page(NamedTuple):
    """Where the web page and rosbridge are served, and who may connect.

    Attributes:
        host: The address or host name at which to listen.
        port: The port at which to listen; 0 for any free port.
        token: The secret that clients must send; None for the default of `open_web`.
        hosts: More host names that clients may use for this machine.
        origins: The origins (``https://example.com``) of other web pages that may connect.
    """

    host: str
    port: int
    token: str | None = None
    hosts: tuple[str, ...] = ()
    origins: tuple[str, ...] = ()


class Override(NamedTuple):
    """The initial value of one parameter, from the command line or a file.

    Attributes:
        node: The name of the node, with or without its leading slash; ``/**`` for any node.
        name: The name of the parameter.
        value: The initial value.
    """

    node: str
    name: str
    value: object


class Service(NamedTuple):
    """What ``serve`` serves, and at which endpoints.

    Attributes:
        targets: The user's modules, files and objects, in the syntax of
            `turtleact.commands.user_code`.
        listen: The endpoints at which to listen as a router. Without any endpoints, here or in
            ``reach``, the server becomes the router of this machine. If the machine already has a
            router, the server becomes a peer of that router instead.
        reach: The endpoints to connect to, and the domain.
        fleet: The turtles of the world; None for no world and no built-in actions.
        page: Where to serve the web page and rosbridge; None to serve neither.
        config: The settings of Zenoh, such as those for access control: a mapping from paths to
            values, as for `open_zenoh`.
        is_live: Whether to show a dashboard if stdout is a terminal.
        turtlesim_only: Whether the world serves only what turtlesim serves, and no built-in
            actions.
        wait: Whether to wait while another node serves one of the actions, or another process uses
            the journal. Without ``wait``, `serve` fails if an action is already served or
            the journal is in use.
        reload: Whether to reload the user's actions when their files change.
        node_name: The name of the node that serves the actions, if there is no world.
        keeping: How to keep a journal of the goals; None for no journal.
        overrides: The initial values of parameters.
        introspection: What all actions and services of the process publish for introspection.
        otel: Whether traces and metrics are exported through OpenTelemetry.
        metrics: The host and port at which metrics are served; None for no metrics.
        log_format: The format of log records; None to leave Python's logging as it is.
    """

    targets: tuple[str, ...]
    listen: tuple[str, ...]
    reach: ConnectOptions
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
    otel: bool = False
    metrics: tuple[str, int] | None = None
    log_format: LogFormat | None = None


class Policies(NamedTuple):
    """The quality of service that the user asked for.

    For a policy that is None, each verb uses its own default.

    Attributes:
        reliability: As in `turtleact.QoS`.
        durability: As in `turtleact.QoS`.
        depth: As in `turtleact.QoS`, at least 1.
    """

    reliability: Reliability | None = None
    durability: Durability | None = None
    depth: int | None = None

    def qos(self, *, durability: Durability = "volatile", depth: int = 10) -> QoS:
        """Return the quality of service. The arguments replace policies that are None."""
        from turtleact.transports import QoS

        return QoS(
            depth=self.depth or depth,
            durability=self.durability or durability,
            reliability=self.reliability or "reliable",
        )


@contextmanager
def naming(option: str) -> Iterator[None]:
    """Let the error of a server that cannot be opened name the option to correct."""
    try:
        yield
    except InvalidOption as error:
        if error.name == "token":
            raise UsageError(f"--token: {error.problem}") from None
        raise TurtleactError(f"{option}: {error.problem}") from None


def endpoints(option: str, text: str | None) -> tuple[str, ...]:
    """Split the value of an option into endpoints, which are separated by commas.

    Raises:
        WrongOptions: if a part of the value is not an endpoint.
    """
    found = () if text is None else tuple(text.split(","))
    for each in found:
        if not (_ENDPOINT.fullmatch(each) and _is_reachable(each)):
            example = "tcp/[::1]:7447" if each.count(":") > 1 else "tcp/127.0.0.1:7447"
            raise WrongOptions(f"{option} takes an endpoint such as {example}, not {quoted(each)}")
    return found


def _is_reachable(endpoint: str) -> bool:
    """Whether an endpoint has a host and a valid port. True if its protocol needs neither."""
    found = _WITH_PORT.fullmatch(endpoint)
    if found is None:
        return True
    address = _ADDRESS.fullmatch(found["address"])
    return address is not None and 0 < int(address["port"]) < 65536


def quoted(text: str) -> str:
    """Quote a text that the user typed, and shorten it if it is long."""
    shown = text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}…"
    return f"'{printable(shown)}'"
