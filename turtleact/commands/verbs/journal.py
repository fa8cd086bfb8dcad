"""Declares the group ``journal`` for Typer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from turtleact.commands import VERBS
from turtleact.commands.verbs import Job, Verb, new_group
from turtleact.commands.verbs.options import span

__all__ = ["app"]

File: TypeAlias = Annotated[Path, typer.Argument(metavar="FILE", help="The journal.")]
Keep: TypeAlias = Annotated[
    float,
    typer.Option(
        "--keep",
        metavar="TIME",
        parser=span,
        help="Keep the goals that ended within this time, such as 7d, 12h or 30min.",
    ),
]

app = new_group("journal", VERBS["journal"])


@app.command(cls=Verb)
def prune(file: File, *, keep: Keep) -> Job:
    """Delete goals that ended long ago. A server may be writing the journal meanwhile."""

    def job() -> int:
        from turtleact.commands.journaled_goals import prune_goals

        return prune_goals(file, round(keep * 1e9))

    return job
