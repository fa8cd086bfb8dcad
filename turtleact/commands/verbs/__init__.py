"""The verbs and their options, as Typer reads them: a command line in, a job out.

A command function checks what can be checked at once and returns a job, which does the work. The
job is run outside of Typer, because Typer has its own view of broken pipes and interrupts. Each
group of verbs is a module, imported only when it is asked for; what does the work, in
`turtleact.commands`, is imported later still.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from typer.core import TyperGroup
from typer.main import get_command

from turtleact.commands import GROUPS, VERBS
from turtleact.commands.verbs.parsing import SETTINGS, Group, Job

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts

__all__ = ["assemble", "load", "parse"]

BROKEN_PIPE: Final = 141

HOMES: Final = {
    "send-goal": "send_goal",
    **dict.fromkeys(("cancel", "watch", "result"), "goals"),
    **dict.fromkeys(("run", "teleop", "snapshot"), "turtlesim"),
}
"""The modules of the verbs that are not in a module of their own name."""

PANELS: Final = {
    **dict.fromkeys(("send-goal", "goals", "cancel", "watch", "result"), "Goals"),
    **dict.fromkeys(("serve", "run", "teleop", "snapshot"), "Turtles"),
    **dict.fromkeys(GROUPS, "Verbs of ros2"),
}
"""The heading of each verb in ``turtleact --help``."""


class LazyGroup(Group):
    """The whole command line; a verb is imported when it is chosen, not when it is listed."""

    def resolve_command(self, ctx: typer.Context, args: list[str]) -> Any:  # type: ignore[override]  # noqa: ANN401  # as in `Group`
        """Import the verb that was chosen."""
        name, command, rest = super().resolve_command(ctx, args)
        return name, load(name) if name in VERBS else command, rest


def parse(arguments: Sequence[str]) -> Job:
    """The job that a command line asks for; Typer prints help, completions and usage errors.

    What Typer has done already leaves a job that only returns its exit status.
    """
    jobs: list[Job | None] = []
    command = get_command(assemble(lambda job, **_: jobs.append(job)))
    try:
        command.main(list(arguments), prog_name="turtleact")
    except SystemExit as end:
        if jobs and jobs[0] is not None:
            return jobs[0]
        is_unread = isinstance(end.__context__, BrokenPipeError)
        return partial(_exit_status, BROKEN_PIPE if is_unread else int(end.code or 0))
    raise AssertionError("Typer always exits")


def assemble(take: Callable[..., None]) -> typer.Typer:
    """The command line: all verbs by name, none of them imported.

    Args:
        take: Called with what the command function returned.
    """
    app = typer.Typer(
        cls=LazyGroup,
        callback=_root,
        result_callback=take,
        invoke_without_command=True,
        **(SETTINGS | {"add_completion": True}),
    )
    for name, summary in VERBS.items():
        listed = app.command(
            name, help=summary, short_help=summary, rich_help_panel=PANELS[name]
        )  # click would cut a help text at 45 characters, but no short help
        listed(_unloaded)
    app.command("daemon", hidden=True)(_daemon)
    return app


def load(verb: str) -> Any:  # noqa: ANN401  # of click, which Typer brings along privately
    """The command or group of a verb."""
    home = HOMES.get(verb, verb)
    command = get_command(import_module(f"turtleact.commands.verbs.{home}").app)
    if isinstance(command, TyperGroup) and verb not in GROUPS:
        return command.commands[verb]
    return command


def _root(
    ctx: typer.Context,
    *,
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
    """Stands for a verb in the list; `LazyGroup` puts the verb in its place."""


def _daemon(what: Annotated[str, typer.Argument()] = "") -> Job:  # noqa: ARG001  # whatever it is
    """What ``ros2 daemon`` is asked: we have none."""
    typer.echo("The daemon is not running: each command asks the graph itself")
    return partial(_exit_status, 0)


def _exit_status(status: int, _: Interrupts) -> int:
    return status
