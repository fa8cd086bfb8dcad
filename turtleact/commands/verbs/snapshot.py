"""``snapshot``, as Typer sees it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from turtleact.commands import VERBS
from turtleact.commands.verbs.arguments import (
    Config,
    Connect,
    Domain,
    Job,
    Verb,
    on_graph,
    quoted,
)
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from turtleact.node import Node

__all__ = ["app"]

_File = Annotated[str, typer.Argument(metavar="FILE", help="The picture: NAME.png or NAME.svg.")]

_EXAMPLES = """\b
Examples:
  turtleact snapshot turtles.png
  turtleact snapshot turtles.svg --connect tcp/127.0.0.1:7447
"""

app = typer.Typer()


@app.command("snapshot", cls=Verb, help=VERBS["snapshot"], epilog=_EXAMPLES)
def snapshot(
    file: _File, *, connect: Connect = None, domain: Domain = None, config: Config = None
) -> Job:
    """``snapshot``."""
    from pathlib import Path

    path = Path(file)
    if path.suffix.lower() not in (".png", ".svg"):
        raise UsageError(f"FILE ends in .png or .svg, unlike {quoted(file)}")

    async def look(node: Node) -> int:
        from turtleact.commands.snapshot import take

        return await take(node, path)

    return on_graph(look, connect, domain, config)
