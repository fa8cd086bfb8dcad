"""The verbs and their options, as Typer sees them: arguments in, a job out.

A command function checks what can be checked without a world and gives back a job: what is then
run, outside of Typer. All values come in as plain text, for two reasons: the messages are ours, and
Typer (0.29) would load pydantic for every other type, which takes longer than the rest of it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from functools import partial
from typing import TYPE_CHECKING, Annotated, Protocol, cast, runtime_checkable

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from turtleact.commands import VERBS
from turtleact.commands.interrupts import Interrupts
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from turtleact.commands.send_goal import View

__all__ = ["Job", "parse"]

Job = Callable[[Interrupts], int]
"""Runs a verb and gives the exit status."""

_ArgumentError = cast("type[Exception]", typer.BadParameter.__base__)  # click's UsageError

_OPTION = re.compile(r"-[A-Za-z]\S*|--[A-Za-z][\w-]*(=.*)?", re.DOTALL)
_TYPE_NAME = re.compile(r"[A-Za-z]\w*(/\w+)+")
_TEXT = "\0"
"""Stands before an argument that begins with a dash and is no option; no argument can hold it."""

MOST_DIGITS = 18
"""A whole number has no more, so that it fits 64 bits."""

LONGEST_SHOWN = 60
"""So many characters of an argument are repeated in an error."""

NEAR = 0.75
"""How much alike a mistyped option and the one that was meant are, from 0 to 1."""

_EXAMPLES = """\b
Examples:
  turtleact send-goal fibonacci "order: 5" --feedback
  turtleact send-goal patrol "targets: [{x: 9, y: 7}, {x: 5, y: 1}]"
  turtleact send-goal go_to "{x: 2, y: 9}" --speed max --json
"""


def parse(arguments: Sequence[str]) -> Job:
    """The job that a command line asks for.

    Raises:
        UsageError: if it cannot be understood; the text names the mistake and where to get help.
    """
    command = get_command(app)
    try:  # what `main` does besides is to have its own view of a reader that has gone
        with command.make_context("turtleact", list(arguments)) as context:
            job = command.invoke(context)
    except _ArgumentError as error:
        raise UsageError(_explain(error)) from None
    except typer.Exit as printed:
        return partial(_exit_status, printed.exit_code)
    return cast("Job", job) if callable(job) else partial(_exit_status, 0)


class Verb(TyperCommand):
    """A command whose arguments may begin with a dash: ``-5`` or ``- x: 1`` is text."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # Typer makes no other context
        """Mark such arguments, so that they are not taken for options."""
        _keep_as_typed(self.get_params(ctx))
        marked = [
            _TEXT + arg if arg[:1] == "-" and arg != "--" and not _OPTION.fullmatch(arg) else arg
            for arg in args
        ]
        return super().parse_args(ctx, marked)


class Verbs(TyperGroup):
    """A group of commands."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # Typer makes no other context
        """Read the group's own options."""
        _keep_as_typed(self.get_params(ctx))
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=Verbs,
    rich_markup_mode=None,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
action = typer.Typer(cls=Verbs, rich_markup_mode=None, invoke_without_command=True)
app.add_typer(action, name="action", help=VERBS["action"])


@action.callback()
def action_group(ctx: typer.Context) -> None:
    """Print what there is if no verb is given, as ros2 does."""
    if ctx.invoked_subcommand is None:
        typer.echo(ctx.get_help())


_Name = Annotated[str, typer.Argument(metavar="NAME", help="The action, such as /patrol.")]
_Type = Annotated[
    str | None,
    typer.Argument(metavar="TYPE", help="Its type, pkg/action/Name; asked of the graph."),
]
_Goal = Annotated[
    str | None, typer.Argument(metavar="GOAL", help="The goal as YAML or JSON; {} if left out.")
]
_Feedback = Annotated[
    bool, typer.Option("--feedback", "-f", help="Print each feedback message, and let it stand.")
]
_Timeout = Annotated[
    str | None,
    typer.Option(
        "--timeout",
        "-t",
        metavar="SECONDS",
        help="Cancel the goal if it takes longer; 0 leaves once it is accepted.",
    ),
]
_Stdin = Annotated[bool, typer.Option("--stdin", help="Read the goal from stdin.")]
_GoalFile = Annotated[
    str | None, typer.Option("--goal-file", metavar="PATH", help="Read the goal from a file.")
]
_Json = Annotated[
    bool, typer.Option("--json", help="Print one JSON object a line, feedback included.")
]
_Plain = Annotated[bool, typer.Option("--plain", help="No live display, even on a terminal.")]
_Speed = Annotated[
    str, typer.Option(metavar="FACTOR", help="How fast time passes in the embedded world, or max.")
]
_Seed = Annotated[str, typer.Option(metavar="NUMBER", help="What its random choices begin with.")]
_Embedded = Annotated[
    bool, typer.Option("--embedded", help="Use an embedded world, as is done anyway.")
]


@app.command("send-goal", cls=Verb, help=VERBS["send-goal"], epilog=_EXAMPLES)
@action.command("send_goal", cls=Verb, help=VERBS["send-goal"], epilog=_EXAMPLES)
def send_goal(
    name: _Name,
    type_name: _Type = None,
    goal: _Goal = None,
    *,
    feedback: _Feedback = False,
    timeout: _Timeout = None,
    stdin: _Stdin = False,
    goal_file: _GoalFile = None,
    json: _Json = False,
    plain: _Plain = False,
    speed: _Speed = "1",
    seed: _Seed = "0",
    embedded: _Embedded = False,
) -> Job:
    """``send-goal`` and ``action send_goal``."""
    del embedded  # there is no other world to send to
    type_name, goal = _type_and_goal(type_name, goal)
    view = _view(json=json, plain=plain)
    seconds = None if timeout is None else _number("--timeout", timeout, least=0.0)
    factor = speed if speed == "max" else _factor(speed)
    number = _whole("--seed", seed)
    sources = [goal is not None, stdin, goal_file is not None]
    if sum(sources) > 1:
        raise UsageError("the goal is given twice: give one of GOAL, --stdin and --goal-file")

    def job(interrupts: Interrupts) -> int:
        from turtleact.commands.goal_text import GoalText
        from turtleact.commands.send_goal import Order, run

        text = GoalText.read(goal, stdin=stdin, path=goal_file, interrupts=interrupts)
        order = Order(name, type_name, text, feedback, seconds, view, factor, number)
        return run(order, interrupts)

    return job


# what the arguments mean


def _type_and_goal(type_name: str | None, goal: str | None) -> tuple[str | None, str | None]:
    """Tell TYPE from GOAL: the first alone is a type if it looks like one."""
    if type_name is None or _TYPE_NAME.fullmatch(type_name):
        return type_name, goal
    if goal is None:
        return None, type_name
    raise UsageError(
        f"'{type_name}' is not a type such as pkg/action/Name; "
        f'if it belongs to the goal, quote the goal: "{type_name} {goal}"'
    )


def _view(*, json: bool, plain: bool) -> View:
    if json and plain:
        raise UsageError("give --json or --plain, not both")
    return "json" if json else "plain" if plain else "auto"


def _number(option: str, text: str, *, least: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= least):
        problem = f"is a number of seconds, {least:g} or more, not {_quoted(text)}"
        raise UsageError(f"{option} {problem}")
    return value


def _factor(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise UsageError(f"--speed is a number above zero, or max, not {_quoted(text)}")
    if value > 1:
        from turtleact.clock import FASTEST

        if value > FASTEST:
            problem = f"is {FASTEST:g} at most, not {_quoted(text)}; max is as fast as it computes"
            raise UsageError(f"--speed {problem}")
    return value


def _whole(option: str, text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= MOST_DIGITS):
        problem = f"is a whole number, 0 or more, of {MOST_DIGITS} digits at most"
        raise UsageError(f"{option} {problem}, not {_quoted(text)}")
    return int(text)


def _quoted(text: str) -> str:
    return f"'{text}'" if len(text) <= LONGEST_SHOWN else f"'{text[:LONGEST_SHOWN]}…'"


# getting along with Typer


@runtime_checkable
class _Suggesting(Protocol):
    """What Typer's and click's NoSuchOption have in common."""

    option_name: str
    possibilities: Sequence[str] | None


class _Parameter(Protocol):
    """What Typer's and click's parameters have in common."""

    required: bool
    process_value: Callable[[typer.Context, object], object]


def _keep_as_typed(params: Iterable[object]) -> None:
    """Let no value pass through pydantic that needs no change."""
    for param in cast("Iterable[_Parameter]", params):
        param.process_value = partial(_take, param.process_value, param.required)


def _take(
    process: Callable[[typer.Context, object], object],
    is_required: bool,
    ctx: typer.Context,
    value: object,
) -> object:
    if isinstance(value, str):
        return value.removeprefix(_TEXT)
    return None if value is None and not is_required else process(ctx, value)


def _explain(error: Exception) -> str:
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


def _exit_status(status: int, _: Interrupts) -> int:
    return status
