"""Prints the dashboard of ``serve`` that docs/cli.md shows: five seconds of a patrol.

    python scripts/draw_dashboard.py

The times and the ids of the goals are made up. A test asserts that the page holds exactly this.
"""

from __future__ import annotations

import asyncio
from io import StringIO
from typing import Any

from rich.console import Console

from turtleact import open_world
from turtleact.actions.patrol import Patrol
from turtleact.commands.live import Dashboard
from turtleact.goals.state import GoalStatus
from turtleact.interfaces.standard import Point, RotateAbsolute

WIDTH, HEIGHT = 59, 14
TARGETS = [Point(x=9.0, y=7.0), Point(x=5.0, y=1.0), Point(x=2.0, y=9.0)]
READY = "ready at tcp/127.0.0.1:7447, domain 0: /command_turtle, /fibonacci, /go_to, /patrol"
IDS = "0ea56cbca5434d8bb0c0c6494ccfcbd8", "1bf42122964e4a0f8c8a1c6c2f1e7a55"


async def draw() -> list[str]:
    """The lines of the dashboard, without colours."""
    board = Dashboard()
    log: list[str] = []
    board.say(READY)

    def tell(goal: Any, _old: GoalStatus, new: GoalStatus) -> None:  # noqa: ANN401  # any goal
        board.tell(goal, new)
        time = f"12:00:{int(goal.node.clock.time()) % 60:02}"
        log.append(f"{time} {goal.action_name} {goal.goal_id.hex()[:8]} {new.name}")

    world = open_world(speed="max", turtles=2, on_start=board.begin, on_transition=tell)
    async with world as node:
        ids = map(bytes.fromhex, IDS)
        patrol = node.action_client(Patrol, "/patrol")
        async with patrol.send_goal(Patrol.Goal(targets=TARGETS), goal_id=next(ids)) as goal:
            await node.clock.sleep(1.0)
            turn = node.action_client(RotateAbsolute, "/turtle2/rotate_absolute")
            async with turn.send_goal(RotateAbsolute.Goal(2.0), goal_id=next(ids)) as turning:
                await turning.outcome()
            await node.clock.sleep(2.0)
            goal.detach()
            content = board.compose(width=WIDTH, height=HEIGHT)
            console = Console(file=StringIO(), width=WIDTH, record=True)
            console.print(content)
            drawn = console.export_text().splitlines()[:HEIGHT]
            return [*log[-3:], *map(str.rstrip, drawn)]


if __name__ == "__main__":
    print("\n".join(asyncio.run(draw())))
