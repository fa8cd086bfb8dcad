"""Declares the verbs and their options for Typer, which turns a command line into a job.

A command function checks its arguments as far as possible and returns a job, which does the work.
The job runs outside of Typer, because Typer handles broken pipes and interrupts in its own way.
Each group of verbs is a module, which is imported only when the user chooses the group. The job
imports the modules of `turtleact.commands` that do the work.

`Verb` accepts the forms of arguments that ``ros2`` accepts. If the user types a verb that
only ``ros2`` has, `Group` suggests an alternative. Both classes override only documented methods
of click.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from typing import Annotated, Any, Final, TypeAlias

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from turtleact.commands import GROUPS, VERBS
from turtleact.commands.output import printable
from turtleact.errors import UsageError

__all__ = [
    "SETTINGS",
    "Group",
    "Job",
    "Verb",
    "assemble",
    "load",
    "new_group",
    "parse",
    "without_daemon",
]

Job: TypeAlias = Callable[[], int]
"""A function that does the work of a verb and returns the exit status."""

SETTINGS: Final[dict[str, Any]] = {
    "add_completion": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}
"""The options of Typer for all groups of verbs."""

_VALUE: Final = re.compile(r"-[\d.\s]|---\s")
"""The beginning of a value with a leading dash: ``-5``, ``- x: 1``, or a YAML document."""

_NO_BUILD: Final = (
    "nothing has to be built or sourced; 'turtleact run --help' lists what can be run here"
)

_TEST: Final = "'python -m pytest' runs your tests"
_ELSEWHERE: Final = {
    "build": _NO_BUILD,
    "colcon": _NO_BUILD,
    "component": "each node is a program of its own, such as 'turtleact serve'",
    "control": "there are no controllers; 'turtleact action list' lists actions",
    "extension_points": "there are no plug-ins; 'turtleact pkg list' lists packages",
    "extensions": "there are no plug-ins; 'turtleact pkg list' lists packages",
    "launch": "start each program in a terminal of its own, such as 'turtleact serve'",
    "lifecycle": "there are no managed nodes; 'turtleact node list' lists all nodes",
    "multicast": "nodes find each other through a router, such as 'turtleact serve'",
    "pkg build": _NO_BUILD,
    "pkg prefix": "'turtleact pkg executables' lists what packages can run",
    "pkg xml": "'turtleact pkg executables' lists what packages can run",
    "plugin": "there are no plug-ins; 'turtleact pkg list' lists packages",
    "pytest": _TEST,
    "rosdep": "pip installs what Python programs need; 'turtleact pkg list' lists what is here",
    "security": "'turtleact serve --config FILE' controls who may connect",
    "rqt": "'turtleact serve --web 9090' shows goals, topics and turtles in a browser",
    "rqt_graph": "'turtleact node list' lists the nodes, 'turtleact node info NODE' describes one",
    "rviz2": "'turtleact serve --web 9090' shows the turtles in a browser",
    "test": _TEST,
    "wtf": "'turtleact doctor' finds out what is wrong",
}
"""Verbs of ``ros2`` that turtleact does not have, and what to use instead."""


BROKEN_PIPE: Final = 141

HOMES: Final = {
    **dict.fromkeys(
        ("send-goal", "cancel", "pause", "resume", "watch", "result", "action"), "goals"
    ),
    **dict.fromkeys(("param", "service"), "node"),
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


_UNKNOWN: Final = ("--port", "--host")
"""Options of other programs that users may try. The error message suggests `_MEANT` instead."""

_MEANT: Final = {"--web": "[HOST:]PORT", "--listen": "tcp/HOST:PORT"}
"""Maps each option that replaces an option in `_UNKNOWN` to the form of its value."""


class Verb(TyperCommand):
    """A command that accepts the forms of arguments that ``ros2`` accepts.

    A `UsageError` is reported in the format of Typer's own usage errors.
    """

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # Typer makes no other context
        """Parse the arguments.

        Values may begin with a dash, such as ``-5``. Options that control the daemon of ``ros2``
        are ignored.
        """
        known = {option for param in self.params for option in param.opts}
        if "--connect" in known:
            args = without_daemon(args)
        if "--param" in known:  # in ROS 2, parameters stand behind --ros-args
            args = [arg for arg in args if arg != "--ros-args"]
        if any(arg not in known and _VALUE.match(arg) for arg in args):
            ctx.ignore_unknown_options = True
        typed = (arg.partition("=")[0] for arg in args)  # such as --port=9090
        unknown = [name for name in typed if name in _UNKNOWN and name not in known]
        if unknown and known >= _MEANT.keys():
            options = " or ".join(f"{name} {value}" for name, value in _MEANT.items())
            ctx.fail(f"No such option: {unknown[0]}. Did you mean {options}?")
        left = super().parse_args(ctx, args)
        for param in self.params:
            _check_text(ctx, param)
        return left

    def get_params(self, ctx: typer.Context) -> list[Any]:  # type: ignore[override]  # as above
        """Return the options and arguments, set up so that the help shows no type for switches."""
        return _without_type(super().get_params(ctx))

    def invoke(self, ctx: typer.Context) -> Any:  # type: ignore[override]  # noqa: ANN401  # as above; the job
        """Call the command function, which makes the job.

        Report a `UsageError` in the format of Typer's own usage errors.
        """
        try:
            return super().invoke(ctx)
        except UsageError as error:
            ctx.fail(printable(str(error)))


class Group(TyperGroup):
    """A group that suggests what to use instead of verbs that only ``ros2`` has."""

    def get_params(self, ctx: typer.Context) -> list[Any]:  # type: ignore[override]  # as above
        """Return the options, set up so that the help shows no type for switches."""
        return _without_type(super().get_params(ctx))

    def resolve_command(self, ctx: typer.Context, args: list[str]) -> Any:  # type: ignore[override]  # noqa: ANN401  # as above
        """Find the verb.

        If only ``ros2`` has the verb, the error says what to use instead. If the verb belongs to a
        group and the group was left out, the error suggests the group. For any other unknown verb,
        Typer suggests the nearest one.
        """
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


def parse(arguments: Sequence[str]) -> Job:
    """Parse a command line into a job. Typer prints help, completions and usage errors.

    If Typer has printed help, completions or a usage error, the job only returns the exit status.
    """
    jobs: list[Job | None] = []
    # The options for completion can only stand before a verb. Even when they are absent, Typer
    # imports pydantic to read them, so a line that begins with a verb does without them.
    completion = not arguments or arguments[0].startswith("-")
    command = get_command(assemble(lambda job, **_: jobs.append(job), completion=completion))
    try:
        command.main(list(arguments), prog_name="turtleact")
    except SystemExit as end:
        if jobs and jobs[0] is not None:
            return jobs[0]
        is_unread = isinstance(end.__context__, BrokenPipeError)
        return partial(_exit_status, BROKEN_PIPE if is_unread else int(end.code or 0))
    raise AssertionError("Typer always exits")


def assemble(take: Callable[..., None], *, completion: bool = True) -> typer.Typer:
    """Make the Typer app that lists all verbs, without importing them.

    Args:
        take: Called with the job that the command function returns.
        completion: Whether to add the options that install and show shell completion.
    """
    app = typer.Typer(
        cls=LazyGroup,
        callback=_root,
        result_callback=take,
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
    home = import_module(f"turtleact.commands.verbs.{HOMES.get(verb, verb)}")
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


def without_daemon(args: Sequence[str]) -> list[str]:
    """Remove the options that control the daemon of ``ros2``, because turtleact has no daemon.

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


def _daemon(what: Annotated[str, typer.Argument()] = "") -> Job:  # noqa: ARG001  # whatever it is
    """Say that the daemon of ``ros2`` is not running."""
    typer.echo("The daemon is not running: each command asks the graph itself")
    return partial(_exit_status, 0)


def _without_type(params: list[Any]) -> list[Any]:
    """Give switches an empty metavar, because the help would otherwise show ``<bool>`` for them."""
    for param in params:
        if getattr(param, "is_flag", False) and param.metavar is None:
            param.metavar = ""
    return params


def _exit_status(status: int) -> int:
    return status


def _check_text(ctx: typer.Context, param: Any) -> None:  # noqa: ANN401  # option or argument
    """Raise an error if text is not UTF-8. Paths are not checked: a file may have any name."""
    value = ctx.params.get(param.name)
    for text in value if isinstance(value, list | tuple) else [value]:
        if not isinstance(text, str):
            continue
        try:
            text.encode()
        except UnicodeEncodeError:
            problem = f"it is not UTF-8: {os.fsencode(text)!r}"
            raise typer.BadParameter(problem, ctx=ctx, param=param) from None
