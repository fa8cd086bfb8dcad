"""How our commands and groups differ from Typer's: what ``ros2`` accepts, and what it has besides.

Typer calls the methods that are overridden here, and they are part of click's documented interface.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from turtleact.commands import GROUPS
from turtleact.commands.interrupts import Interrupts
from turtleact.commands.output import printable
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from typer.core import TyperArgument

__all__ = ["SETTINGS", "Group", "Job", "Verb", "new_group", "without_daemon"]

Job: TypeAlias = Callable[[Interrupts], int]
"""Does the work of a verb and returns the exit status."""

SETTINGS: Final[dict[str, Any]] = {
    "add_completion": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}
"""What all groups of verbs have in common."""

_VALUE: Final = re.compile(r"-[\d.\s]|---\s")
"""How a value begins that has a dash and is no option: ``-5``, ``- x: 1``, a YAML document."""

_ELSEWHERE: Final = {
    "bag": "'turtleact topic echo NAME --csv' prints messages, one a line, to keep in a file",
    "component": "a node is a program here, such as 'turtleact serve'",
    "control": "it has no controllers",
    "doctor": "'turtleact node list' tells whether a graph is in reach",
    "extension_points": "it has no plug-ins",
    "extensions": "it has no plug-ins",
    "launch": "start each program by itself, such as 'turtleact serve'",
    "lifecycle": "it has no managed nodes",
    "multicast": "nodes find each other through a router, such as 'turtleact serve'",
    "pkg": "'turtleact interface packages' lists the packages with interfaces",
    "security": "'turtleact serve --config FILE' says who may connect",
    "service echo": "nodes do not publish their service calls; use 'turtleact service call'",
    "wtf": "'turtleact node list' tells whether a graph is in reach",
}
"""Verbs of ``ros2`` that turtleact does not have, and what to use instead."""


class Verb(TyperCommand):
    """A command that takes what ``ros2`` takes, and says what is wrong as Typer does."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # Typer makes no other context
        """Read the arguments; values may begin with a dash, and there is no daemon."""
        _spare_validators(self.get_params(ctx))
        known = {option for param in self.params for option in param.opts}
        if "--connect" in known:
            args = without_daemon(args)
        if any(arg not in known and _VALUE.match(arg) for arg in args):
            ctx.ignore_unknown_options = True
        left = super().parse_args(ctx, args)
        for param in self.params:
            _check_text(ctx, param)
        return left

    def invoke(self, ctx: typer.Context) -> Any:  # type: ignore[override]  # noqa: ANN401  # as above; the job
        """Make the job; what our own checks refuse is a usage error like Typer's."""
        try:
            return super().invoke(ctx)
        except UsageError as error:
            ctx.fail(printable(str(error)))


class Group(TyperGroup):
    """A group that knows what to use instead of verbs that only ``ros2`` has."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # as above
        """Read the options of the group."""
        _spare_validators(self.get_params(ctx))
        return super().parse_args(ctx, args)

    def resolve_command(self, ctx: typer.Context, args: list[str]) -> Any:  # type: ignore[override]  # noqa: ANN401  # as above
        """Find the verb; Typer suggests the nearest one if there is none of that name."""
        verb = args[0]
        if verb not in self.commands and not ctx.resilient_parsing:
            path = verb if ctx.parent is None else f"{ctx.info_name} {verb}"
            if path in _ELSEWHERE:
                ctx.fail(f"turtleact has no '{path}': {_ELSEWHERE[path]}")
            groups = [name for name, verbs in GROUPS.items() if verb in verbs]
            if ctx.parent is None and groups and verb != "send_goal":  # we have send-goal too
                meant = " or ".join(f"'{group} {verb}'" for group in groups)
                ctx.fail(f"No such command '{verb}'. Did you mean {meant}?")
        return super().resolve_command(ctx, args)


def new_group(name: str) -> typer.Typer:
    """A group that prints its help if no verb is given, as in ``ros2``."""

    def print_help(ctx: typer.Context) -> None:
        if ctx.invoked_subcommand is None:
            typer.echo(ctx.get_help())

    return typer.Typer(
        name=name, cls=Group, callback=print_help, invoke_without_command=True, **SETTINGS
    )


def without_daemon(args: Sequence[str]) -> list[str]:
    """Arguments without the options that tell ``ros2`` how to use its daemon: we have none.

    >>> without_daemon(["--no-daemon", "--spin-time", "2", "-t", "--spin-time=1"])
    ['-t']
    """
    kept: list[str] = []
    left = iter(args)
    for arg in left:
        if arg == "--spin-time":
            next(left, None)
        elif arg != "--no-daemon" and not arg.startswith("--spin-time="):
            kept.append(arg)
    return kept


def _spare_validators(params: Iterable[Any]) -> None:
    """Handle values that need no validator without one: defaults, plain text, our own parsers.

    Typer itself does so for flags only. For any other parameter, given or not, it builds a pydantic
    validator, and importing pydantic takes 60 ms: as long as Typer, for each command and each Tab.
    """
    for param in params:
        param.process_value = partial(_process, param, param.process_value)


def _process(
    param: TyperOption | TyperArgument,
    convert: Callable[[typer.Context, object], object],
    ctx: typer.Context,
    value: object,
) -> object:
    if value is param.default and not (param.required and not ctx.resilient_parsing):
        return value
    kind = param.type_descriptor
    parse = kind.parameter_info.parser
    if isinstance(value, str) and (parse is not None or kind.annotation is str):
        return value if parse is None else parse(value)
    if isinstance(value, list | tuple) and value and kind.annotation == list[str]:
        return value
    return convert(ctx, value)


def _check_text(ctx: typer.Context, param: Any) -> None:  # noqa: ANN401  # option or argument
    """Refuse text that is not UTF-8; only names of files may be, and those are paths."""
    value = ctx.params.get(param.name)
    for text in value if isinstance(value, list | tuple) else [value]:
        if not isinstance(text, str):
            continue
        try:
            text.encode()
        except UnicodeEncodeError:
            problem = f"it is not UTF-8: {os.fsencode(text)!r}"
            raise typer.BadParameter(problem, ctx=ctx, param=param) from None
