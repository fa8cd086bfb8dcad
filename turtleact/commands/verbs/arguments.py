"""Arguments: the options that verbs share, and what arguments mean, which all come as text."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from turtleact.commands.interrupts import Interrupts
from turtleact.commands.verbs import completing
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from turtleact.commands.graph_names import Kind
    from turtleact.commands.locks import Locks

__all__ = [
    "Config",
    "Connect",
    "Domain",
    "Interfaces",
    "Job",
    "Reach",
    "endpoints",
    "message_of",
    "number",
    "only_one",
    "quoted",
    "reach",
    "speed_factor",
    "type_and_text",
    "type_of",
    "whole",
]

Job = Callable[[Interrupts], int]
"""Runs a verb and gives the exit status."""

_TYPE_NAME = re.compile(r"[A-Za-z]\w*(/\w+)+")
_PORT = re.compile(r"(tcp|udp|tls|quic|ws)/(.*:(?P<port>[0-9]{1,9})|.*)")
_ENDPOINT = re.compile(r"[a-z][a-z0-9]*/\S+")

MOST_DIGITS = 18
"""A whole number has no more, so that it fits 64 bits."""

MOST_DOMAIN = 232
"""The highest domain; source: the ROS 2 article "The ROS_DOMAIN_ID"."""

LONGEST_SHOWN = 60
"""So many characters of an argument are repeated in an error."""

Connect = Annotated[
    str | None,
    typer.Option(
        "--connect",
        metavar="ENDPOINT",
        help="Where the graph is, such as tcp/127.0.0.1:7447; several with commas between.",
    ),
]
Domain = Annotated[
    str | None,
    typer.Option("--domain", metavar="N", help="The graph's domain; ROS_DOMAIN_ID if left out."),
]
Interfaces = Annotated[
    str | None,
    typer.Option(
        "--interfaces", metavar="DIR", help="A folder with interfaces: PACKAGE/KIND/NAME.EXT."
    ),
]
Config = Annotated[
    str | None,
    typer.Option("--config", metavar="FILE", help="A TOML file with certificates and passwords."),
]


class Reach(NamedTuple):
    """Which graph a verb looks at.

    Attributes:
        connect: The endpoints to connect to; none means to look around.
        domain: Its domain, from 0 to `MOST_DOMAIN`.
        config: The file with the locks, if there are any.
    """

    connect: tuple[str, ...]
    domain: int
    config: str | None = None

    def locks(self) -> Locks:
        """What that file says.

        Raises:
            UsageError: if it cannot be read, or says what it cannot say.
        """
        from turtleact.commands.locks import Locks, read_locks

        return Locks() if self.config is None else read_locks(self.config)


def reach(connect: Connect = None, domain: Domain = None, config: Config = None) -> Reach:
    """The graph that ``--connect`` and ``--domain``, or ROS_DOMAIN_ID, mean.

    Raises:
        UsageError: if one of them is not what it should be.
    """
    to = endpoints("--connect", connect)
    name, text = "--domain", domain
    if text is None:
        name = "ROS_DOMAIN_ID"
        text = os.environ.get(name) or "0"
    return Reach(to, whole(name, text, most=MOST_DOMAIN), config)


def type_of(kind: Kind, *, is_asked: bool = False) -> Any:  # noqa: ANN401  # as of Typer's own
    """The argument TYPE; the graph is asked for one that may be left out."""
    name = f"pkg/{completing.SUFFIXES[kind]}/Name"
    return typer.Argument(
        metavar="TYPE",
        help=f"Its type, {name}; asked of the graph." if is_asked else f"The type, {name}.",
        autocompletion=completing.types(kind, of_name=is_asked),
    )


def message_of(what: str, metavar: str = "VALUES") -> Any:  # noqa: ANN401  # likewise
    """The argument that is a message."""
    return typer.Argument(
        metavar=metavar,
        help=f"The {what} as YAML or JSON; {{}} if left out.",
        autocompletion=completing.messages,
    )


def endpoints(option: str, text: str | None) -> tuple[str, ...]:
    """The endpoints that an option names, with commas between.

    Raises:
        UsageError: if one of them is none.
    """
    found = () if text is None else tuple(text.split(","))
    for each in found:
        port = _PORT.fullmatch(each)
        if not _ENDPOINT.fullmatch(each) or (port and not 0 < int(port["port"] or 0) < 65536):
            problem = f"is an endpoint such as tcp/127.0.0.1:7447, not {quoted(each)}"
            raise UsageError(f"{option} {problem}")
    return found


def type_and_text(
    type_name: str | None, text: str | None, what: str
) -> tuple[str | None, str | None]:
    """Tell TYPE from the text of a message: the first alone is a type if it looks like one.

    Args:
        type_name: What stands in the place of the type.
        text: What stands in the place of the message.
        what: What the message is called.

    Raises:
        UsageError: if there are two, and the first is no type.
    """
    if type_name is None or _TYPE_NAME.fullmatch(type_name):
        return type_name, text
    if text is None:
        return None, type_name
    raise UsageError(
        f"'{type_name}' is not a type such as pkg/kind/Name; "
        f'if it belongs to the {what}, quote the {what}: "{type_name} {text}"'
    )


def only_one(what: str, **given: bool) -> None:
    """Refuse what is said in two ways.

    Args:
        what: What is said.
        **given: Whether each way was taken, by its name: ``goal_file`` is ``--goal-file``.

    Raises:
        UsageError: if more than one was.
    """
    if sum(given.values()) > 1:
        *names, last = (name if name.isupper() else f"--{name.replace('_', '-')}" for name in given)
        ways = f"{', '.join(names)} and {last}"
        raise UsageError(f"{what} is given twice: give one of {ways}")


def number(option: str, text: str, *, unit: str = "seconds", is_positive: bool = False) -> float:
    """A number of seconds, or of something else, of 0 or more.

    Raises:
        UsageError: if it is something else.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0 and (value or not is_positive)):
        least = "above zero" if is_positive else "0 or more"
        raise UsageError(f"{option} is a number of {unit}, {least}, not {quoted(text)}")
    return value


def whole(option: str, text: str, *, least: int = 0, most: int | None = None) -> int:
    """A whole number.

    Raises:
        UsageError: if it is something else, or out of range.
    """
    if text.isascii() and text.isdigit() and len(text) <= MOST_DIGITS:
        value = int(text)
        if least <= value and (most is None or value <= most):
            return value
    digits = f"{least} or more, of {MOST_DIGITS} digits at most"
    limits = digits if most is None else f"{least} to {most}"
    raise UsageError(f"{option} is a whole number, {limits}, not {quoted(text)}")


def speed_factor(text: str, *, or_max: bool = False) -> float | str:
    """How fast time passes: a factor, or ``"max"`` where that is allowed.

    Raises:
        UsageError: if it is neither, or out of range.
    """
    if text == "1" or (or_max and text == "max"):  # as is nearly always the case
        return 1.0 if text == "1" else text
    from turtleact.clock import FASTEST

    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if 0 < value <= FASTEST:
        return value
    more = ", or max, as fast as it computes" if or_max else ""
    raise UsageError(f"--speed is above 0 and {FASTEST:g} at most{more}, not {quoted(text)}")


def quoted(text: str) -> str:
    """What the user typed, in quotes, and not too much of it."""
    return f"'{text}'" if len(text) <= LONGEST_SHOWN else f"'{text[:LONGEST_SHOWN]}…'"
