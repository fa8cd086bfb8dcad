"""The verbs of the command line.

Each is declared in `turtleact.commands.verbs`; this table alone is what ``turtleact --help`` needs,
so that it answers before Typer could be imported.
"""

from __future__ import annotations

from typing import Final

__all__ = ["VERBS"]

VERBS: Final = {
    "send-goal": "Send a goal, follow it to its end, print the result.",
    "action": "The verbs of 'ros2 action': send_goal.",
    "interface": "The verbs of 'ros2 interface': list, package, packages, proto, show.",
}
"""What there is, and what it does."""
