"""``action``, as Typer sees it."""

from __future__ import annotations

from turtleact.commands import VERBS
from turtleact.commands.verbs.arguments import Verb, new_group
from turtleact.commands.verbs.send_goal import EXAMPLES, send_goal

__all__ = ["app"]

app = new_group("action")
app.command("send_goal", cls=Verb, help=VERBS["send-goal"], epilog=EXAMPLES)(send_goal)
