"""``snapshot``, as Typer sees it."""

from __future__ import annotations

from typing import Annotated

import typer

from turtleact.commands import VERBS
from turtleact.commands.verbs.arguments import quoted
from turtleact.commands.verbs.looking import Look, on_graph
from turtleact.commands.verbs.reading import Verb
from turtleact.errors import UsageError

__all__ = ["app"]

_File = Annotated[str, typer.Argument(metavar="FILE", help="The picture: NAME.png or NAME.svg.")]

_EXAMPLES = """\b
Examples:
  turtleact snapshot turtles.png
  turtleact snapshot turtles.svg --connect tcp/127.0.0.1:7447
"""

app = typer.Typer()


@app.command("snapshot", cls=Verb, help=VERBS["snapshot"], epilog=_EXAMPLES)
@on_graph
def snapshot(file: _File) -> Look:
    """``snapshot``."""
    from pathlib import Path

    path = Path(file)
    if path.suffix.lower() not in (".png", ".svg"):
        raise UsageError(f"FILE ends in .png or .svg, unlike {quoted(file)}")

    from turtleact.commands.user_messages import take

    return lambda node: take(node, path)
