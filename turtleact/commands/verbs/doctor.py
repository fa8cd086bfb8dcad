"""The verb ``doctor``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from turtleact.commands import VERBS
from turtleact.commands.verbs import SETTINGS, verb
from turtleact.commands.verbs.options import flag

if TYPE_CHECKING:
    from turtleact.commands.settings import Reach

__all__ = ["app"]

app = typer.Typer(**SETTINGS)


@verb(app, knows=True, help=VERBS["doctor"])
def doctor(
    reach: Reach,
    *,
    as_json: Annotated[bool, flag("--json", text="Print a line of JSON for each fault.")] = False,
    verbose: Annotated[
        bool,
        flag(
            *("--verbose", "-v"),
            text="Print facts too: routers, versions, sessions, domains in use.",
        ),
    ] = False,
) -> int:
    """``doctor``."""
    from turtleact.commands import doctor

    return doctor.run(reach, as_json=as_json, verbose=verbose)
