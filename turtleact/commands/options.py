"""Declares the options and arguments that several verbs share, and parses their values.

`flag`, `value` and `argument` declare one option or argument each. The functions in `BUNDLES` each
stand for several options, from which they make one value.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from turtleact.commands import completion
from turtleact.commands.settings import (
    ConnectOptions,
    Durability,
    Owner,
    Policies,
    Reliability,
    WrongOptions,
    quoted,
)

if TYPE_CHECKING:
    from turtleact.commands.message_text import Style
    from turtleact.transports.graph import Kind

__all__ = [
    "BUNDLES",
    "TYPE_NAME",
    "Embedded",
    "Interfaces",
    "Json",
    "Plain",
    "ShowTypes",
    "argument",
    "bag_seconds",
    "count_of",
    "factor",
    "flag",
    "folder",
    "hertz",
    "host_and_port",
    "in_seconds",
    "message_of",
    "name_of",
    "only_one",
    "or_max",
    "ros_domain",
    "seconds",
    "span",
    "speed",
    "stdin_of",
    "type_and_text",
    "type_of",
    "value",
    "whole",
]

TAKEN = "What is taken"
"""The heading of the options that select what a bag takes."""

GRAPH = "Graph"
"""The heading of the options that select a graph."""

QOS = "Quality of service"
"""The heading of the options for quality of service."""

MOST_DOMAIN = 232
"""The highest domain; source: the ROS 2 article "The ROS_DOMAIN_ID"."""

_SPAN = re.compile(r"(?P<number>[0-9]{1,9}(?:\.[0-9]{1,9})?) *(?P<unit>s|min|h|d)")
UNITS = {"s": 1, "min": 60, "h": 3600, "d": 86400}

TYPE_NAME = re.compile(r"[A-Za-z]\w*(/\w+)+")
"""The pattern of the name of a type, such as ``std_msgs/msg/String``."""

PROFILES: Final = {
    "action_status_default": Policies("reliable", "transient_local", 1),
    "best_available": Policies(),
    "default": Policies("reliable", "volatile", 10),
    "parameter_events": Policies("reliable", "volatile", 1000),
    "parameters": Policies("reliable", "volatile", 1000),
    "sensor_data": Policies("best_effort", "volatile", 5),
    "services_default": Policies("reliable", "volatile", 10),
    "system_default": Policies(),
}
"""The profiles of quality of service by name. Source: rmw ``qos_profiles.h``."""


# The functions of this section return what Typer's own functions return, of which Typer says `Any`.


def flag(*names: str, text: str, panel: str | None = None, hidden: bool = False) -> Any:  # noqa: ANN401
    """Declare an option without a value."""
    return typer.Option(*names, help=text, rich_help_panel=panel, hidden=hidden)


def value(
    *names: str,
    metavar: str | None = None,
    text: str,
    panel: str | None = None,
    parser: Callable[..., Any] | None = None,
    **more: Any,  # noqa: ANN401
) -> Any:  # noqa: ANN401
    """Declare an option with a value. ``more`` are other arguments of `typer.Option`."""
    return typer.Option(
        *names, metavar=metavar, help=text, rich_help_panel=panel, parser=parser, **more
    )


def argument(metavar: str, text: str, known: Callable[..., Any] | None = None) -> Any:  # noqa: ANN401
    """Declare an argument. For the Tab key, ``known`` returns its possible values."""
    return typer.Argument(metavar=metavar, help=text, autocompletion=known)


def in_seconds(*names: str, text: str, panel: str | None = None) -> Any:  # noqa: ANN401
    """Declare an option that takes a number of seconds, 0 or more."""
    return value(*names, metavar="SECONDS", text=text, panel=panel, parser=seconds)


def count_of(name: str) -> Any:  # noqa: ANN401
    """Declare the switch that makes a verb print only a count."""
    return flag(name, "-c", text="Print only how many there are.")


def stdin_of(what: str) -> Any:  # noqa: ANN401
    """Declare the switch that makes a verb read a message from stdin."""
    return flag("--stdin", text=f"Read the {what} from stdin.")


def name_of(what: str, example: str, known: Callable[..., Any], metavar: str = "NAME") -> Any:  # noqa: ANN401
    """Declare the argument that names something on the graph."""
    return argument(metavar, f"The {what}, such as {example}.", known)


def message_of(what: str, metavar: str = "VALUES") -> Any:  # noqa: ANN401
    """Declare the argument that takes a message."""
    text = f"The {what}, as YAML or JSON. If left out, {{}}."
    return argument(metavar, text, completion.messages)


def type_of(kind: Kind, *, is_asked: bool = False) -> Any:  # noqa: ANN401
    """Declare the argument TYPE. If ``is_asked``, a missing type is looked up on the graph."""
    text = f"The type, pkg/{completion.SUFFIXES[kind]}/Name."
    asked = " If left out, the graph is asked." if is_asked else ""
    known = completion.types(kind, of_name=is_asked)
    return argument("TYPE", text + asked, known)


# options


Interfaces = Annotated[
    Path | None,
    value(
        "--interfaces", metavar="DIR", text="A folder with more interfaces: PACKAGE/KIND/NAME.EXT."
    ),
]
Plain = Annotated[bool, flag("--plain", text="Print plain lines, even on a terminal.")]
Json = Annotated[bool, flag("--json", text="Print one JSON object per line.")]
ShowTypes = Annotated[bool, flag("--show-types", "-t", text="Print the types too.")]
Embedded = Annotated[bool, flag("--embedded", text="Start a world in this process.")]


def _whole(problem: str, most: int) -> Callable[[str | int], int]:
    """Return a parser of whole numbers. The error for other texts ends with ``problem``.

    This makes parsers for ``typer.Option(parser=...)``, as `_number` does. Typer also passes the
    default of an option to its parser, and a default may be a number.
    """

    def parse(given: str | int) -> int:
        text = str(given)
        if not (re.fullmatch("[0-9]{1,18}", text) and int(text) <= most):
            raise typer.BadParameter(f"{quoted(text)} {problem}")
        return int(text)

    return parse


ros_domain = _whole(f"is not a ROS domain, 0 to {MOST_DOMAIN}", MOST_DOMAIN)
# A number of so many digits fits 64 bits.
whole = _whole("is not a whole number, 0 or more, of 18 digits at most", 10**18)


def _reach(
    connect: Annotated[
        str | None,
        value(
            "--connect",
            metavar="ENDPOINT",
            text="Where the graph is, such as tcp/127.0.0.1:7447. Separate several with commas.",
            panel=GRAPH,
        ),
    ] = None,
    domain: Annotated[
        int,
        value(
            "--domain",
            metavar="N",
            text="The ROS domain of the graph, 0 to 232.",
            panel=GRAPH,
            parser=ros_domain,
            envvar="ROS_DOMAIN_ID",
            show_envvar=True,
        ),
    ] = 0,
    config: Annotated[
        Path | None,
        value(
            "--config",
            metavar="FILE",
            text="A TOML file with certificates and passwords.",
            panel=GRAPH,
        ),
    ] = None,
    no_learn: Annotated[
        bool, flag("--no-learn", text="Ask no node to describe its types.", panel=GRAPH)
    ] = False,
    _daemon: Annotated[bool, flag("--no-daemon", text="There is none.", hidden=True)] = False,
    _spin_time: Annotated[str, value("--spin-time", text="As for ros2.", hidden=True)] = "",
) -> ConnectOptions:
    """Return the graph that these options select. Raises the errors of `ConnectOptions.of`.

    The last two options are for scripts of ``ros2``, which has a daemon.
    """
    reach = ConnectOptions.of(connect, domain, None if config is None else str(config))
    return reach._replace(learns=not no_learn)


def _style(
    *,
    csv: Annotated[
        bool, flag("--csv", text="Print all values on one line, separated by commas.")
    ] = False,
    flow: Annotated[
        bool, flag("--flow-style", text="Print each message on one line, in braces.")
    ] = False,
    full_length: Annotated[
        bool, flag("--full-length", "-f", text="Print long lists and strings in full.")
    ] = False,
    truncate_length: Annotated[
        int,
        value(
            *("--truncate-length", "-l"),
            metavar="N",
            text="Cut lists and strings that are longer.",
            min=0,
        ),
    ] = 128,
    no_arr: Annotated[
        bool, flag("--no-arr", text="Print the length and type of lists only.")
    ] = False,
    no_str: Annotated[bool, flag("--no-str", text="Print the length of strings only.")] = False,
) -> Style:
    """Return the format in which messages are printed.

    Raises:
        WrongOptions: if both ``csv`` and ``flow`` are set.
    """
    from turtleact.commands.message_text import Style

    only_one("how messages are printed", csv=csv, flow_style=flow)
    longest = None if full_length else truncate_length
    return Style(csv=csv, flow=flow, longest=longest, arrays=not no_arr, strings=not no_str)


def profile(given: str) -> Policies:
    """Parse the name of a profile of quality of service."""
    if given not in PROFILES:
        problem = f"is not one of {', '.join(map(repr, PROFILES))}"
        raise typer.BadParameter(f"{quoted(given)} {problem}")
    return PROFILES[given]


policy = partial(value, panel=QOS)


def _policies(
    known: Annotated[
        Policies | None,
        policy(
            "--qos-profile",
            metavar="NAME",
            text="A set of policies, such as sensor_data. The options below change single ones.",
            parser=profile,
            autocompletion=completion.words(*PROFILES),
        ),
    ] = None,
    reliability: Annotated[
        Reliability | None,
        policy("--qos-reliability", metavar="POLICY", text="reliable or best_effort."),
    ] = None,
    durability: Annotated[
        Durability | None,
        policy("--qos-durability", metavar="POLICY", text="volatile or transient_local."),
    ] = None,
    depth: Annotated[
        int | None, policy("--qos-depth", metavar="N", text="How many messages to keep.", min=1)
    ] = None,
) -> Policies:
    """Return the requested quality of service. An option for one policy overrides the profile."""
    known = known or Policies()
    return Policies(
        reliability or known.reliability, durability or known.durability, depth or known.depth
    )


def _owner(
    node_name: Annotated[str, name_of("node", "/turtlesim", completion.nodes, "NODE")],
    *,
    hidden: Annotated[bool, flag("--include-hidden-nodes", text="Include hidden nodes.")] = False,
    timeout: Annotated[float, in_seconds("--timeout", text="How long to wait for the node.")] = 1.0,
) -> Owner:
    """Return the node that has parameters."""
    return Owner(node_name, hidden, timeout)


def several(name: str, text: str, names: Callable[..., Any] | None = None) -> Any:  # noqa: ANN401
    """Declare an option that takes several names; see `turtleact.commands.app.ManyVerb`."""
    return value(name, metavar="NAME...", text=text, panel=TAKEN, autocompletion=names)


Left = Annotated[
    str,
    value(
        *("--exclude-regex", "-x"),
        metavar="EXPR",
        text="Leave out everything whose name this regular expression finds.",
        panel=TAKEN,
    ),
]


def _taken(
    topics: Annotated[
        list[str] | None, several("--topics", "These topics.", completion.topics)
    ] = None,
    services: Annotated[list[str] | None, several("--services", "These services.")] = None,
    actions: Annotated[
        list[str] | None, several("--actions", "These actions.", completion.actions)
    ] = None,
    regex: Annotated[
        str,
        value(
            *("--regex", "-e"),
            metavar="EXPR",
            text="Everything whose name this regular expression finds.",
            panel=TAKEN,
        ),
    ] = "",
    exclude_regex: Left = "",
    exclude_topics: Annotated[
        list[str] | None, several("--exclude-topics", "Leave these out.", completion.topics)
    ] = None,
    exclude_services: Annotated[
        list[str] | None, several("--exclude-services", "Leave these out.")
    ] = None,
    exclude_actions: Annotated[
        list[str] | None, several("--exclude-actions", "Leave these out.", completion.actions)
    ] = None,
) -> dict[str, Any]:
    """Return what a bag takes, as arguments of `turtleact.recording.Selection`."""
    return {
        "topics": topics or [],
        "services": services or [],
        "actions": actions or [],
        "regex": regex,
        "exclude": [
            *(exclude_topics or ()),
            *(exclude_services or ()),
            *(exclude_actions or ()),
        ],
        "exclude_regex": exclude_regex,
    }


BUNDLES: Final[dict[str, Callable[..., Any]]] = {
    "style": _style,
    "policies": _policies,
    "reach": _reach,
    "node": _reach,
    "taken": _taken,
    "owner": _owner,
}
"""The parameters of verbs that stand for several options, and what makes their values."""


def folder(interfaces: Path | None) -> str | None:
    """The value of ``--interfaces`` as text; None if the option is not given."""
    return None if interfaces is None else str(interfaces)


def host_and_port(option: str, text: str) -> tuple[str, int]:
    """Parse ``[HOST:]PORT``. Without a host, the address is that of this machine.

    Raises:
        WrongOptions: if the port is not a whole number from 0 to 65535.
    """
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not (port.isascii() and port.isdigit() and len(port) <= 5 and int(port) <= 65535):
        problem = f"is a whole number, 0 to 65535, not {quoted(port)}"
        raise WrongOptions(f"the port of {option} {problem}")
    return host or "127.0.0.1", int(port)


def type_and_text(
    type_name: str | None, text: str | None, what: str
) -> tuple[str | None, str | None]:
    """Return the type and the text of a message.

    A single argument is the type if it has the form of a type, and the text otherwise.

    Args:
        type_name: The first argument; None if it is missing.
        text: The second argument; None if it is missing.
        what: What the error calls the message, such as "goal".

    Raises:
        WrongOptions: if both arguments are given, and the first is not a type.
    """
    if type_name is None or TYPE_NAME.fullmatch(type_name):
        return type_name, text
    if text is None:
        return None, type_name
    raise WrongOptions(
        f"'{type_name}' is not a type such as pkg/kind/Name; if it belongs to the {what}, write "
        f"the {what} as one argument in quotes"
    )


def only_one(what: str, **given: bool) -> None:
    """Raise an error if more than one of several options is given.

    Args:
        what: What the options specify, in the words of the error text.
        **given: Whether each option was given, by its name: ``goal_file`` is ``--goal-file``.

    Raises:
        WrongOptions: if more than one option was given.
    """
    if sum(given.values()) > 1:
        *names, last = (name if name.isupper() else f"--{name.replace('_', '-')}" for name in given)
        ways = f"{', '.join(names)} and {last}"
        raise WrongOptions(f"{what} is given twice: give one of {ways}")


def _number(problem: str, is_fit: Callable[[float], bool]) -> Callable[[str | float], float]:
    """Return a parser of finite numbers. The error for other texts ends with ``problem``."""

    def parse(given: str | float) -> float:
        try:
            value = float(given)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and is_fit(value)):
            raise typer.BadParameter(f"{quoted(str(given))} {problem}")
        return value

    return parse


seconds = _number("is not a number of seconds, 0 or more", lambda value: value >= 0)
hertz = _number("is not a rate in Hz above zero", lambda value: value > 0)
# The limits of the next two are `recording.storage.LONGEST` and `tasks.clock.FASTEST`, which --help
# has no time to import.
bag_seconds = _number(
    "is not a number of seconds, 0 to 1,000,000,000", lambda value: 0 <= value <= 1e9
)
factor = _number("is not a factor above 0", lambda value: value > 0)
speed = _number("is not a factor above 0 and at most 100", lambda value: 0 < value <= 100)


def span(given: str | float) -> float:
    """Parse a length of time such as ``90s``, ``30min``, ``1.5h`` or ``7d``, in seconds.

    Raises:
        typer.BadParameter: if the text is not a length of time.
    """
    found = _SPAN.fullmatch(str(given))
    if found is None:
        problem = "is not a time such as 90s, 30min, 12h or 7d"
        raise typer.BadParameter(f"{quoted(str(given))} {problem}")
    return float(found["number"]) * UNITS[found["unit"]]


def or_max(parse: Callable[[str], float]) -> Callable[[str], float | str]:
    """Return a parser that also takes the word ``max``, which means no limit."""

    def parse_either(given: str) -> float | str:
        try:
            return given if given == "max" else parse(given)
        except typer.BadParameter as error:
            raise typer.BadParameter(f"{error.message}, or max") from None

    return parse_either
