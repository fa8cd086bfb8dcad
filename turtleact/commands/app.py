"""Turns functions into the verbs of the command line, with Typer.

A verb is a function with Typer options, which does its work and returns the exit status. `verb`
adds the options that many verbs share, such as ``--connect``, and opens the graph for a function
that takes a node. Each group of verbs is a module, which is imported only when the user chooses the
group. The functions import what they need, so that ``--help`` and the Tab key stay fast.

`Verb` accepts the forms of arguments that ``ros2`` accepts. `Verb` and `Group` override only
documented methods of click.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Sequence
from importlib import import_module
from inspect import Parameter, signature
from itertools import pairwise
from typing import Annotated, Any, Final, TypeVar, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from turtleact.commands import GROUPS, VERBS
from turtleact.commands.options import BUNDLES, TYPE_NAME, Interfaces, folder
from turtleact.commands.output import printable
from turtleact.commands.settings import WrongOptions

__all__ = [
    "SETTINGS",
    "Group",
    "ManyVerb",
    "MessageVerb",
    "Verb",
    "load",
    "new_group",
    "run",
    "verb",
]

F = TypeVar("F", bound=Callable[..., Any])

SETTINGS: Final[dict[str, Any]] = {
    "add_completion": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}
"""The options of Typer for all groups of verbs."""

UNSEEN: Final = ("Node", "ConnectOptions", "Style", "Policies")
"""The types of what `BUNDLES` makes, which modules of verbs import for the type checker alone."""

_KIND: Final = Parameter.KEYWORD_ONLY

_VALUE: Final = re.compile(r"-[\d.\s]|---\s")
"""The beginning of a value with a leading dash: ``-5``, ``- x: 1``, or a YAML document."""

BROKEN_PIPE: Final = 141

HOMES: Final = {
    **dict.fromkeys(
        ("send-goal", "cancel", "pause", "resume", "watch", "result", "action"), "goals"
    ),
    **dict.fromkeys(("param", "service"), "node"),
    "pkg": "run",
    **dict.fromkeys(("teleop", "snapshot"), "turtlesim"),
}
"""Maps each verb to its module, unless the verb and the module have the same name."""

PANELS: Final = {
    **dict.fromkeys(
        ("send-goal", "goals", "cancel", "pause", "resume", "watch", "result"), "Goals"
    ),
    **dict.fromkeys(("serve", "run", "mcp"), "Servers and programs"),
    **dict.fromkeys(("teleop", "snapshot"), "Turtles"),
    **dict.fromkeys(GROUPS, "Verbs of ros2"),
    "journal": "Goals",
    "doctor": "Verbs of ros2",
}
"""The heading under which ``turtleact --help`` lists each verb."""


class Verb(TyperCommand):
    """A command that accepts the forms of arguments that ``ros2`` accepts."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # Typer makes no other context
        """Parse the arguments.

        Values may begin with a dash, such as ``-5``.
        """
        known = {option for param in self.params for option in param.opts}
        if "--param" in known:  # in ROS 2, parameters stand behind --ros-args
            args = [arg for arg in args if arg != "--ros-args"]
        if any(arg not in known and _VALUE.match(arg) for arg in args):
            ctx.ignore_unknown_options = True
        return super().parse_args(ctx, args)

    def get_params(self, ctx: typer.Context) -> list[Any]:  # type: ignore[override]  # as above
        """Return the options and arguments, set up so that the help shows no type for switches."""
        return _without_type(super().get_params(ctx))


class _Ended(Exception):
    """A verb has ended with an exception that Typer would handle in its own way."""

    def __init__(self, error: BaseException) -> None:
        super().__init__(error)
        self.error = error


class MessageVerb(Verb):
    """A verb that takes a message as its last argument.

    A shell splits a message without quotes into several arguments. If the arguments look like a
    message that was split, the error says so.
    """

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # as in `Verb`
        """Parse the arguments as `Verb` does, and fail if there are too many."""
        ctx.allow_extra_args = True
        left = super().parse_args(ctx, args)
        if ctx.resilient_parsing:
            return left
        name = [each for each in self.params if each.param_type_name == "argument"][-1].name or ""
        first, text = ctx.params["type_name"], ctx.params[name]
        # Without a type, the message begins where the type would be.
        given = (text,) if first is None or TYPE_NAME.fullmatch(first) else (first, text)
        words = [each for each in (*given, *left) if each is not None]
        if len(words) > 1 and ":" in "".join(words):
            what, quotes = ("goal" if name == "goal" else "message"), shlex.quote(" ".join(words))
            ctx.fail(f"the shell splits the {what} at its spaces. Quote it: {quotes}")
        if left:
            ctx.fail(f"Got unexpected extra argument(s) ({' '.join(left)})")
        return left


class ManyVerb(Verb):
    """A verb with options that take several values, as in argparse: ``--topics /a /b``."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # as in `Verb`
        """Turn ``--topics /a /b`` into ``--topics /a --topics /b``, and parse the arguments."""
        lists = [each for each in self.params if getattr(each, "multiple", False)]
        many = {name for each in lists for name in each.opts}
        for option, following in pairwise([*args, "--"]):
            if option in many and following.startswith("-"):
                ctx.fail(f"Option '{option}' requires an argument.")
        return super().parse_args(ctx, _repeated(args, many))


def _repeated(args: Sequence[str], many: set[str]) -> list[str]:
    """Insert the name of an option in ``many`` before each of its values.

    The values end at the next option or at ``--``.

    >>> _repeated(["--topics", "/a", "/b", "-o", "run", "/c"], {"--topics"})
    ['--topics', '/a', '--topics', '/b', '-o', 'run', '/c']
    """
    found: list[str] = []
    option = ""
    for arg in args:
        if arg.startswith("-"):
            if arg not in many and not (option and arg == "--"):
                found.append(arg)
            option = arg if arg in many else ""
        else:
            found += [option, arg] if option else [arg]
    return found


class Group(TyperGroup):
    """A group that suggests the group of a verb that stands without it."""

    def get_params(self, ctx: typer.Context) -> list[Any]:  # type: ignore[override]  # as above
        """Return the options, set up so that the help shows no type for switches."""
        return _without_type(super().get_params(ctx))

    def resolve_command(self, ctx: typer.Context, args: list[str]) -> Any:  # type: ignore[override]  # noqa: ANN401  # as above
        """Find the verb.

        If the verb belongs to a group and the group was left out, the error suggests the group. For
        any other unknown verb, Typer suggests the nearest one.
        """
        verb = args[0]
        if verb not in self.commands and not ctx.resilient_parsing:
            groups = [name for name, verbs in GROUPS.items() if verb in verbs]
            if ctx.parent is None and groups and verb != "send_goal":  # we have send-goal too
                meant = " or ".join(f"'{group} {verb}'" for group in groups)
                ctx.fail(f"No such command '{verb}'. Did you mean {meant}?")
        return super().resolve_command(ctx, args)


class LazyGroup(Group):
    """The command ``turtleact``, a group of all verbs.

    A verb is imported when the user chooses it, not when it is listed. `_root` declares the help
    option, because Typer's own help option imports pydantic. Importing pydantic takes longer than
    importing Typer.
    """

    def get_params(self, ctx: typer.Context) -> list[Any]:  # type: ignore[override]  # noqa: ARG002  # as in `Group`
        """Return the options that `_root` declares, and the options for shell completion."""
        return _without_type([*self.params])

    def get_help_option(self, ctx: typer.Context) -> Any:  # type: ignore[override]  # noqa: ANN401, ARG002  # as above
        """Return the option ``--help``, which click mentions in usage errors."""
        return next(param for param in self.params if param.name == "_help")

    def resolve_command(self, ctx: typer.Context, args: list[str]) -> Any:  # type: ignore[override]  # noqa: ANN401  # as in `Group`
        """Find the verb that the user chose, and import it."""
        name, command, rest = super().resolve_command(ctx, args)
        return name, load(name) if name in VERBS else command, rest


def run(arguments: Sequence[str]) -> int:
    """Run a command line, and return the exit status.

    Typer prints help, completions and usage errors. All exceptions of verbs are raised.
    """
    # The options for completion can only stand before a verb. Even when they are absent, Typer
    # imports pydantic to read them, so a line that begins with a verb does without them.
    completion = not arguments or arguments[0].startswith("-")
    command = get_command(_assemble(completion=completion))
    try:
        command.main(list(arguments), prog_name="turtleact")
    except _Ended as ended:
        raise ended.error from None
    except SystemExit as end:
        is_unread = isinstance(end.__context__, BrokenPipeError)
        return BROKEN_PIPE if is_unread else int(end.code or 0)
    raise AssertionError("Typer always exits")


def verb(
    group: typer.Typer,
    name: str | None = None,
    *,
    cls: type[TyperCommand] = Verb,
    knows: bool = False,
    bundles: dict[str, Callable[..., Any]] = BUNDLES,
    **settings: Any,  # noqa: ANN401  # those of Typer.command
) -> Callable[[F], F]:
    """Add a function to a group as a verb.

    Each parameter of the function is an option or argument, except those in `BUNDLES` and
    ``bundles``, which stand for several options. If the function has the parameter ``node``, it is
    a coroutine function, and runs on the graph that the options select.

    Args:
        group: The group.
        name: The name of the verb; None for the name of the function.
        cls: The class of the command.
        knows: Whether to add ``--interfaces``, and to find the interfaces before the verb runs.
        bundles: More parameters that stand for several options, as in `BUNDLES`.
        **settings: More arguments of `typer.Typer.command`.
    """

    def add(function: F) -> F:
        group.command(name, cls=cls, **settings)(_command(function, BUNDLES | bundles, knows=knows))
        return function

    return add


def _command(
    function: Callable[..., Any], bundles: dict[str, Callable[..., Any]], *, knows: bool
) -> Callable[..., None]:
    """Make the function that Typer calls, with a parameter for each option."""
    own = signature(function).parameters
    bundled = {each: _options(bundles[each]) for each in own if each in bundles}
    single = _options(function)
    added = [Parameter("ctx", _KIND, annotation=typer.Context)]
    # The options of the graph are the last ones of each help text.
    for each in sorted(own, key=("node", "reach").__contains__):
        added += bundled[each].values() if each in bundled else [single[each]]
    if knows:
        added.append(Parameter("interfaces", _KIND, default=None, annotation=Interfaces))

    def act(ctx: typer.Context, **given: Any) -> None:  # noqa: ANN401  # whatever the options are
        try:
            values = {each: given[each] for each in own if each not in bundled}
            for each, options in bundled.items():
                values[each] = bundles[each](**{option: given[option] for option in options})
            if knows:
                from turtleact.commands.message_text import make_known

                make_known(folder(given["interfaces"]))
            if "node" in own:
                from turtleact.commands import graph

                node = values.pop("node")
                status = graph.run(node, lambda node: function(node=node, **values))
            else:
                status = function(**values)
        except WrongOptions as error:
            ctx.fail(printable(str(error)))
        # For these, Typer would print a text of its own, and exit with a status of its own.
        except (EOFError, KeyboardInterrupt, OSError, SystemExit) as error:
            raise _Ended(error) from None
        raise typer.Exit(status)

    act.__name__, act.__doc__ = function.__name__, function.__doc__
    act.__signature__ = signature(act).replace(parameters=added)  # type: ignore[attr-defined]  # read by inspect
    act.__annotations__ = {each.name: each.annotation for each in added}
    return act


def _options(function: Callable[..., Any]) -> dict[str, Parameter]:
    """Return the parameters of a function, with annotations that Typer can read."""
    unseen = dict.fromkeys(UNSEEN, object)
    hints = get_type_hints(function, None, unseen, include_extras=True)
    return {
        name: each.replace(annotation=hints[name], kind=_KIND)
        for name, each in signature(function).parameters.items()
    }


def _assemble(*, completion: bool) -> typer.Typer:
    """Make the Typer app that lists all verbs, without importing them.

    Args:
        completion: Whether to add the options that install and show shell completion.
    """
    app = typer.Typer(
        cls=LazyGroup,
        callback=_root,
        invoke_without_command=True,
        **(SETTINGS | {"add_completion": completion}),
    )
    for name, summary in VERBS.items():
        listed = app.command(
            name, help=summary, short_help=summary, rich_help_panel=PANELS[name]
        )  # click would cut a help text at 45 characters, but no short help
        listed(_unloaded)
    app.command("daemon", hidden=True)(_daemon)
    return app


def load(verb: str) -> Any:  # noqa: ANN401  # of click, which Typer brings along privately
    """Import and return the command or group of a verb."""
    home = import_module(f"turtleact.commands.{HOMES.get(verb, verb)}")
    group = getattr(home, verb) if verb in GROUPS and verb in HOMES else home.app
    command = get_command(group)
    if isinstance(command, TyperGroup) and verb not in GROUPS:
        return command.commands[verb]
    return command


def new_group(name: str, summary: str = "") -> typer.Typer:
    """Make a group that prints its help if no verb is given, as in ``ros2``.

    Args:
        name: The name of the group.
        summary: The help text of the group. If ``summary`` is empty, the help says that the group
            has the verbs of ``ros2``.
    """

    def print_help(ctx: typer.Context) -> None:
        if ctx.invoked_subcommand is None:
            typer.echo(ctx.get_help())

    return typer.Typer(
        name=name,
        help=summary or f"The verbs of 'ros2 {name}', with the same options and output.",
        cls=Group,
        callback=print_help,
        invoke_without_command=True,
        **SETTINGS,
    )


def _print_help(ctx: typer.Context, value: bool) -> None:
    if value and not ctx.resilient_parsing:
        typer.echo(ctx.get_help())
        raise typer.Exit


def _root(
    ctx: typer.Context,
    *,
    _help: Annotated[  # its callback prints the help
        bool,
        typer.Option(
            "--help",
            "-h",
            help="Show this message and exit.",
            is_eager=True,
            callback=_print_help,
        ),
    ] = False,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """ROS 2 actions for asyncio: serve, send, watch and cancel goals. No ROS needed."""
    if version:
        from turtleact import __version__

        typer.echo(f"turtleact {__version__}")
        raise typer.Exit
    if ctx.invoked_subcommand is None:
        typer.echo(ctx.get_help())


def _unloaded() -> None:
    """Stand in for the command function of a verb that `LazyGroup` has not imported yet."""


def _daemon(what: Annotated[str, typer.Argument()] = "") -> None:  # noqa: ARG001  # whatever it is
    """Say that the daemon of ``ros2`` is not running."""
    typer.echo("The daemon is not running: each command asks the graph itself")


def _without_type(params: list[Any]) -> list[Any]:
    """Give switches an empty metavar, because the help would otherwise show ``<bool>`` for them."""
    for param in params:
        if getattr(param, "is_flag", False) and param.metavar is None:
            param.metavar = ""
    return params
