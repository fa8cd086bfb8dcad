"""Prints the state diagram of docs/architecture.md, drawn from the table that the code obeys.

    python scripts/draw_states.py

A test asserts that the page holds exactly this.
"""

from __future__ import annotations

from turtleact.goal import TRANSITIONS, GoalStatus


def draw() -> str:
    """`turtleact.goal.TRANSITIONS` as a Mermaid diagram."""
    steps = [
        f"{start.name} --> {end.name}: {event.name}" for (start, event), end in TRANSITIONS.items()
    ]
    ends = [f"{status.name} --> [*]" for status in GoalStatus if status.is_terminal]
    lines = [f"[*] --> {GoalStatus.ACCEPTED.name}", *steps, *ends]
    return "\n".join(["stateDiagram-v2", *(f"    {line}" for line in lines)])


if __name__ == "__main__":
    print(draw())
