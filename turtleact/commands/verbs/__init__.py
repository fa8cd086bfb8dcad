"""The verbs and their options, as Typer sees them: arguments in, a job out.

A command function checks what can be checked without a world or graph and gives back a job: what
is then run, outside of Typer. Each group of verbs is a module here; only the one that is asked for
is imported, and what does the work, in `turtleact.commands`, not before the job runs.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Final, cast

import typer
from typer.main import get_command

from turtleact.commands import VERBS
from turtleact.commands.verbs.outside import NO_DAEMON, problem_of_outside
from turtleact.commands.verbs.reading import SETTINGS, ArgumentError, Verbs, explain
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts
    from turtleact.commands.verbs.arguments import Job

__all__ = ["assemble", "parse"]

HOMES: Final = {
    "send-goal": "send_goal",
    **dict.fromkeys(("cancel", "watch", "result"), "goals"),
}
"""The modules of the verbs whose module has not the verb's own name."""


def parse(arguments: Sequence[str]) -> Job:
    """The job that a command line asks for.

    Raises:
        UsageError: if it cannot be understood; the text names the mistake and where to get help.
    """
    verb = arguments[0]
    if problem := problem_of_outside(arguments):
        raise UsageError(problem)
    if verb == "daemon":
        return _tell_of_daemon
    command = get_command(assemble([verb] if verb in VERBS else VERBS))
    try:  # what `main` does besides is to have its own view of a reader that has gone
        with command.make_context("turtleact", list(arguments)) as context:
            job = command.invoke(context)
    except ArgumentError as error:
        raise UsageError(explain(error)) from None
    except typer.Exit as printed:
        return partial(_exit_status, printed.exit_code)
    return cast("Job", job) if callable(job) else partial(_exit_status, 0)


def assemble(verbs: Collection[str]) -> typer.Typer:
    """The command line with these verbs, and those that are declared beside them."""
    app = typer.Typer(cls=Verbs, callback=_root, **SETTINGS)
    for home in dict.fromkeys(HOMES.get(verb, verb) for verb in verbs):
        group: typer.Typer = import_module(f"turtleact.commands.verbs.{home}").app
        app.add_typer(group, help=VERBS.get(group.info.name or ""))
    return app


def _root() -> None:
    """ROS 2 actions, without ROS."""


def _tell_of_daemon(_: Interrupts) -> int:
    typer.echo(NO_DAEMON)
    return 0


def _exit_status(status: int, _: Interrupts) -> int:
    return status
