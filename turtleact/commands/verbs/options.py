"""Declares the Typer options that several verbs share, and parses the values of options."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from turtleact.commands import completion
from turtleact.commands.settings import Reach, quoted
from turtleact.commands.verbs import Job, Verb
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from turtleact.commands.message_text import Style
    from turtleact.graph import Kind
    from turtleact.node import Node

__all__ = [
    "Config",
    "Connect",
    "Domain",
    "Interfaces",
    "Look",
    "MessageVerb",
    "Plain",
    "Plan",
    "ShowTypes",
    "count_of",
    "folder",
    "hertz",
    "in_seconds",
    "journal_in",
    "message_of",
    "name_of",
    "on_graph",
    "on_known_graph",
    "only_one",
    "reach",
    "ros_domain",
    "seconds",
    "span",
    "speed",
    "speed_or_max",
    "stdin_of",
    "type_and_text",
    "type_of",
    "whole",
]

Look: TypeAlias = Callable[["Node"], Awaitable[int]]
"""A function that runs a verb with a node on the graph, and returns the exit status."""

Plan: TypeAlias = Callable[[], Look]
"""A function that prepares the work before the graph is opened, and may read stdin.

The function returns a `Look`.
"""

GRAPH = "Graph"
"""The heading of the options that select a graph."""

MOST_DOMAIN = 232
"""The highest domain; source: the ROS 2 article "The ROS_DOMAIN_ID"."""

MOST_DIGITS = 18
"""The maximum number of digits of a whole number, so that it fits 64 bits."""

_SPAN = re.compile(r"(?P<number>[0-9]{1,9}(?:\.[0-9]{1,9})?) *(?P<unit>s|min|h|d)")
UNITS = {"s": 1, "min": 60, "h": 3600, "d": 86400}

_IN_DOUBLE_QUOTES = re.compile(r'[^"$`\\!]*')
"""The pattern of text that needs no escapes between double quotes, in any shell."""

_TYPE_NAME = re.compile(r"[A-Za-z]\w*(/\w+)+")


class MessageVerb(Verb):
    """A verb that takes a message as its last argument.

    A shell splits a message without quotes into several arguments. If the arguments look like a
    message that was split, the error shows the command line with quotes around the message.
    """

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # as in `Verb`
        """Parse the arguments as `Verb` does, and fail if there are too many."""
        ctx.allow_extra_args = True
        typed = list(args)
        left = super().parse_args(ctx, args)
        if ctx.resilient_parsing:
            return left
        name = [each for each in self.params if each.param_type_name == "argument"][-1].name or ""
        first, text = ctx.params["type_name"], ctx.params[name]
        is_type = first is None or _TYPE_NAME.fullmatch(first)
        words = [each for each in ((text,) if is_type else (first, text)) if each is not None]
        words += left
        if len(words) > 1 and ":" in "".join(words) and not any(map(_is_option, words)):
            what = "goal" if name == "goal" else "message"
            meant = _quoted_in(typed, words)
            ctx.fail(
                f"the shell splits the {what} at its spaces. Quote it: {ctx.command_path} {meant}"
            )
        if left:
            ctx.fail(f"Got unexpected extra argument(s) ({' '.join(left)})")
        return left


def _is_option(word: str) -> bool:
    return word.startswith("--") and len(word) > len("---")


def _quoted_in(args: list[str], words: list[str]) -> str:
    """The arguments as the text of a command line, with ``words`` as one argument in quotes."""
    text, count = " ".join(words), len(words)
    starts = [i for i in range(len(args)) if args[i : i + count] == words]
    if starts:
        before, after = args[: starts[0]], args[starts[0] + count :]
    else:  # there are options between the words
        before, after = [each for each in args if each not in words], []
    is_plain = _IN_DOUBLE_QUOTES.fullmatch(text)
    in_quotes = f'"{text}"' if is_plain else shlex.quote(text)
    return " ".join([*map(shlex.quote, before), in_quotes, *map(shlex.quote, after)])


def ros_domain(given: str | int) -> int:
    """Parse a ROS domain.

    This is a parser for ``typer.Option(parser=...)``, like `seconds`, `hertz`, `speed` and `whole`.
    Typer also passes the default of an option to its parser, and a default may be a number.

    Raises:
        typer.BadParameter: if the text is not a whole number from 0 to `MOST_DOMAIN`.
    """
    text = str(given)
    if not (text.isascii() and text.isdigit() and len(text) <= 3 and int(text) <= MOST_DOMAIN):
        raise typer.BadParameter(f"{quoted(text)} is not a ROS domain, 0 to {MOST_DOMAIN}")
    return int(text)


Connect: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--connect",
        metavar="ENDPOINT",
        help="Where the graph is, such as tcp/127.0.0.1:7447. Separate several with commas.",
        rich_help_panel=GRAPH,
    ),
]
Domain: TypeAlias = Annotated[
    int,
    typer.Option(
        "--domain",
        metavar="N",
        parser=ros_domain,
        envvar="ROS_DOMAIN_ID",
        show_envvar=True,
        help="The ROS domain of the graph, 0 to 232.",
        rich_help_panel=GRAPH,
    ),
]
Config: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="A TOML file with certificates and passwords.",
        rich_help_panel=GRAPH,
    ),
]
Interfaces: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--interfaces",
        metavar="DIR",
        help="A folder with more interfaces: PACKAGE/KIND/NAME.EXT.",
    ),
]
Plain: TypeAlias = Annotated[
    bool, typer.Option("--plain", help="Print plain lines, even on a terminal.")
]

ShowTypes: TypeAlias = Annotated[
    bool, typer.Option("--show-types", "-t", help="Print the types too.")
]

Csv: TypeAlias = Annotated[
    bool, typer.Option("--csv", help="Print all values on one line, separated by commas.")
]
Flow: TypeAlias = Annotated[
    bool, typer.Option("--flow-style", help="Print each message on one line, in braces.")
]
FullLength: TypeAlias = Annotated[
    bool, typer.Option("--full-length", "-f", help="Print long lists and strings in full.")
]
Truncate: TypeAlias = Annotated[
    int,
    typer.Option(
        "--truncate-length",
        "-l",
        metavar="N",
        min=0,
        help="Cut lists and strings that are longer.",
    ),
]
NoArrays: TypeAlias = Annotated[
    bool, typer.Option("--no-arr", help="Print the length and type of lists only.")
]
NoStrings: TypeAlias = Annotated[
    bool, typer.Option("--no-str", help="Print the length of strings only.")
]


def reach(connect: str | None = None, domain: int = 0, config: Path | None = None) -> Reach:
    """Return the graph that these options select. Raises the errors of `Reach.of`."""
    return Reach.of(connect, domain, None if config is None else str(config))


def folder(interfaces: Path | None) -> str | None:
    """The value of ``--interfaces`` as text; None if the option is not given."""
    return None if interfaces is None else str(interfaces)


def journal_in(panel: str | None, text: str) -> Any:  # noqa: ANN401  # as typer.Option
    """Declare the option ``--journal``, with its help text and its heading in the help."""
    return typer.Option("--journal", metavar="FILE", help=text, rich_help_panel=panel)


def on_graph(where: Reach, look: Look) -> Job:
    """Make a job that opens a graph and calls ``look`` on it."""

    def job() -> int:
        from turtleact.commands import graph

        return graph.run(where, look)

    return job


def on_known_graph(where: Reach, interfaces: Path | None, plan: Plan) -> Job:
    """Return a job that finds the interfaces and runs the function from ``plan`` on a graph."""

    def job() -> int:
        from turtleact.commands import graph
        from turtleact.commands.interfaces import make_known

        make_known(folder(interfaces))
        return graph.run(where, plan())

    return job


def type_of(kind: Kind, *, is_asked: bool = False) -> Any:  # noqa: ANN401  # as typer.Argument
    """Declare the argument TYPE. If ``is_asked``, a missing type is looked up on the graph."""
    name = f"pkg/{completion.SUFFIXES[kind]}/Name"
    return typer.Argument(
        metavar="TYPE",
        help=f"The type, {name}." + (" If left out, the graph is asked." if is_asked else ""),
        autocompletion=completion.types(kind, of_name=is_asked),
        show_default=False,
    )


def style(*, csv: bool, flow: bool, longest: int | None, no_arr: bool, no_str: bool) -> Style:
    """Return the format in which messages are printed.

    Raises:
        UsageError: if both ``csv`` and ``flow`` are set.
    """
    from turtleact.commands.message_text import Style

    only_one("how messages are printed", csv=csv, flow_style=flow)
    return Style(csv=csv, flow=flow, longest=longest, arrays=not no_arr, strings=not no_str)


def name_of(what: str, example: str, known: Callable[..., Any], metavar: str = "NAME") -> Any:  # noqa: ANN401  # likewise
    """Declare the argument that names something on the graph."""
    return typer.Argument(
        metavar=metavar, help=f"The {what}, such as {example}.", autocompletion=known
    )


def message_of(what: str, metavar: str = "VALUES") -> Any:  # noqa: ANN401  # likewise
    """Declare the argument that takes a message."""
    return typer.Argument(
        metavar=metavar,
        help=f"The {what}, as YAML or JSON. If left out, {{}}.",
        autocompletion=completion.messages,
        show_default=False,
    )


def stdin_of(what: str) -> Any:  # noqa: ANN401  # as typer.Option
    """Declare the switch that makes a verb read a message from stdin."""
    return typer.Option("--stdin", help=f"Read the {what} from stdin.")


def count_of(name: str) -> Any:  # noqa: ANN401  # likewise
    """Declare the switch that makes a verb print only a count."""
    return typer.Option(name, "-c", help="Print only how many there are.")


def in_seconds(*names: str, text: str, panel: str | None = None, is_of_bag: bool = False) -> Any:  # noqa: ANN401  # likewise
    """Declare an option that takes a number of seconds, 0 or more.

    Args:
        *names: The names of the option.
        text: The help text of the option.
        panel: The heading under which the help lists the option.
        is_of_bag: Whether the value is a time in a bag, which has an upper limit; see
            `bag_seconds`.
    """
    parser = bag_seconds if is_of_bag else seconds
    return typer.Option(*names, metavar="SECONDS", parser=parser, help=text, rich_help_panel=panel)


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
        UsageError: if both arguments are given, and the first is not a type.
    """
    if type_name is None or _TYPE_NAME.fullmatch(type_name):
        return type_name, text
    if text is None:
        return None, type_name
    raise UsageError(
        f"'{type_name}' is not a type such as pkg/kind/Name; if it belongs to the {what}, write "
        f"the {what} as one argument in quotes"
    )


def only_one(what: str, **given: bool) -> None:
    """Raise an error if more than one of several options is given.

    Args:
        what: What the options specify, in the words of the error text.
        **given: Whether each option was given, by its name: ``goal_file`` is ``--goal-file``.

    Raises:
        UsageError: if more than one option was given.
    """
    if sum(given.values()) > 1:
        *names, last = (name if name.isupper() else f"--{name.replace('_', '-')}" for name in given)
        ways = f"{', '.join(names)} and {last}"
        raise UsageError(f"{what} is given twice: give one of {ways}")


def seconds(given: str | float) -> float:
    """Parse a number of seconds, 0 or more."""
    value = _finite(given)
    if not value >= 0:
        raise typer.BadParameter(f"{quoted(str(given))} is not a number of seconds, 0 or more")
    return value


def bag_seconds(given: str | float) -> float:
    """Parse a time in a bag: a number of seconds from 0 to `recording.storage.LONGEST`."""
    from turtleact.recording.storage import LONGEST

    value = seconds(given)
    if value > LONGEST:
        raise typer.BadParameter(f"{quoted(str(given))} is more than {LONGEST:,} seconds")
    return value


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


def hertz(given: str | float) -> float:
    """Parse a rate in Hz, above zero."""
    value = _finite(given)
    if not value > 0:
        raise typer.BadParameter(f"{quoted(str(given))} is not a rate in Hz above zero")
    return value


def speed(given: str | float) -> float:
    """Parse how fast a clock runs, as a factor: above 0, at most `clock.FASTEST`."""
    from turtleact.tasks.clock import FASTEST

    value = _finite(given)
    if not 0 < value <= FASTEST:
        problem = f"is not a factor above 0 and at most {FASTEST:g}"
        raise typer.BadParameter(f"{quoted(str(given))} {problem}")
    return value


def speed_or_max(text: str) -> float | str:
    """Parse how fast a clock runs: a factor as for `speed`, or ``max`` for no limit.

    Raises:
        UsageError: if the text is neither a factor nor ``max``.
    """
    if text == "max":
        return text
    try:
        return speed(text)
    except typer.BadParameter as error:
        raise UsageError(f"--speed: {error.message}, or max") from None


def whole(given: str | int) -> int:
    """Parse a whole number, 0 or more, of at most `MOST_DIGITS` digits."""
    text = str(given)
    if not (text.isascii() and text.isdigit() and len(text) <= MOST_DIGITS):
        problem = f"is not a whole number, 0 or more, of {MOST_DIGITS} digits at most"
        raise typer.BadParameter(f"{quoted(text)} {problem}")
    return int(text)


def _finite(given: str | float) -> float:
    """Parse a number. Return NaN if the text is not a number, or if the number is infinite."""
    try:
        value = float(given)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan
