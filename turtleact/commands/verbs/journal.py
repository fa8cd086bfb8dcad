"""The verb of ``journal``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from turtleact.commands import VERBS
from turtleact.commands.verbs import new_group, verb
from turtleact.commands.verbs.options import argument, span, value

__all__ = ["app"]

app = new_group("journal", VERBS["journal"])


@verb(app)
def prune(
    file: Annotated[Path, argument("FILE", "The journal.")],
    *,
    keep: Annotated[
        float,
        value(
            "--keep",
            metavar="TIME",
            text="Keep the goals that ended within this time, such as 7d, 12h or 30min.",
            parser=span,
        ),
    ],
) -> int:
    """Delete goals that ended long ago. A server may be writing the journal meanwhile."""
    from turtleact.commands.journaled_goals import prune_goals

    return prune_goals(file, round(keep * 1e9))
