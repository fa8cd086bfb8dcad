"""Reading: how Typer is made to take command lines as they are typed.

All values come in as plain text, for two reasons: the messages are ours, and Typer (0.29) would
load pydantic for every other type, which takes longer than the rest of it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from functools import partial
from typing import Any, Final, Protocol, cast, runtime_checkable

import typer
from typer.core import TyperCommand, TyperGroup

from turtleact.commands.verbs.outside import without_daemon
from turtleact.errors import UsageError

__all__ = ["SETTINGS", "ArgumentError", "Verb", "Verbs", "explain", "new_group"]

ArgumentError = cast("type[Exception]", typer.BadParameter.__base__)  # click's UsageError

_OPTION = re.compile(r"-[A-Za-z]\S*|--[A-Za-z][\w-]*(=.*)?", re.DOTALL)

_TEXT = "\0"
"""Stands before an argument that begins with a dash and is no option; no argument can hold it."""

SETTINGS: Final[dict[str, Any]] = {
    "rich_markup_mode": None,
    "add_completion": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}
"""What every group of verbs has in common."""

_FILES = ("FILE", "PATH", "DIR")
"""What names of files are called, which the system takes as they are."""

NEAR = 0.75
"""How much alike a mistyped option and the one that was meant are, from 0 to 1."""


class Verb(TyperCommand):
    """A command whose arguments may begin with a dash: ``-5`` or ``- x: 1`` is text."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # Typer makes no other context
        """Mark such arguments, so that they are not taken for options."""
        params = self.get_params(ctx)
        _keep_as_typed(params)
        _name_plainly(params)
        known = {option for param in params for option in param.opts} | {"--"}
        if "--connect" in known:
            args = without_daemon(args)
        marked = [
            _TEXT + arg
            if arg[:1] == "-" and arg not in known and not _OPTION.fullmatch(arg)
            else arg
            for arg in args
        ]
        try:
            return super().parse_args(ctx, marked)
        except ArgumentError as error:
            if error.ctx is None:  # type: ignore[attr-defined]  # as of an option without its value
                error.ctx = ctx  # type: ignore[attr-defined]
            raise


class Verbs(TyperGroup):
    """A group of commands."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # Typer makes no other context
        """Read the group's own options."""
        _keep_as_typed(self.get_params(ctx))
        return super().parse_args(ctx, args)


def new_group(name: str) -> typer.Typer:
    """A group of verbs that prints what there is if no verb is given, as ros2 does."""

    def print_help(ctx: typer.Context) -> None:
        if ctx.invoked_subcommand is None:
            typer.echo(ctx.get_help())

    return typer.Typer(
        name=name, cls=Verbs, callback=print_help, invoke_without_command=True, **SETTINGS
    )


@runtime_checkable
class _Suggesting(Protocol):
    """What Typer's and click's NoSuchOption have in common."""

    option_name: str
    possibilities: Sequence[str] | None


class _Parameter(Protocol):
    """What Typer's and click's parameters have in common."""

    required: bool
    nargs: int
    opts: Sequence[str]
    metavar: str | None
    process_value: Callable[[typer.Context, object], object]
    get_usage_pieces: Callable[[typer.Context], list[str]]
    get_help_record: Callable[[typer.Context], tuple[str, str] | None]


def explain(error: Exception) -> str:
    """Typer's message in our form, and where there is help."""
    if isinstance(error, _Suggesting):  # Typer suggests --plain for --domain
        error.possibilities = get_close_matches(
            error.option_name, error.possibilities or (), cutoff=NEAR
        )
    message = str(getattr(error, "format_message", error.__str__)()).rstrip(".")
    for marker in (_TEXT, repr(_TEXT)[1:-1]):
        message = message.replace(marker, "")
    context = getattr(error, "ctx", None)
    path = context.command_path if context is not None else "turtleact"
    return f"{message[:1].lower()}{message[1:]}\nTry '{path} --help'."


def _keep_as_typed(params: Iterable[object]) -> None:
    """Let no value pass through pydantic that needs no change."""
    for param in cast("Iterable[_Parameter]", params):
        param.process_value = partial(_take, param, param.process_value)


def _name_plainly(params: Iterable[object]) -> None:
    """Let ``--help`` write arguments as programs do elsewhere: NAME and [NAME]."""
    for param in cast("Iterable[_Parameter]", params):
        if param.opts[0].startswith("-"):
            continue
        name = str(param.metavar)
        more = "..." if param.nargs != 1 and "..." not in name else ""
        usage = (name if param.required else f"[{name}]") + more
        param.get_usage_pieces = partial(_usage, usage)
        param.get_help_record = partial(_record, name, param.get_help_record)


def _usage(piece: str, _: typer.Context) -> list[str]:
    return [piece]


def _record(
    name: str,
    record: Callable[[typer.Context], tuple[str, str] | None],
    ctx: typer.Context,
) -> tuple[str, str]:
    _, text = record(ctx) or ("", "")
    return name, text


def _take(
    param: _Parameter,
    process: Callable[[typer.Context, object], object],
    ctx: typer.Context,
    value: object,
) -> object:
    if isinstance(value, str):
        return _unmarked(value, param)
    if isinstance(value, list | tuple) and value:
        return [_unmarked(str(each), param) for each in value]
    is_left_out = value is None and (ctx.resilient_parsing or not param.required)
    return None if is_left_out else process(ctx, value)


def _unmarked(text: str, param: _Parameter) -> str:
    """An argument as it was typed; only the name of a file may be of bytes that are no text."""
    text = text.removeprefix(_TEXT)
    if param.metavar not in _FILES:
        try:
            text.encode()
        except UnicodeEncodeError:
            option = max(param.opts, key=len)
            name = option if option.startswith("-") else param.metavar
            raise UsageError(f"{name} is not UTF-8: {os.fsencode(text)!r}") from None
    return text
