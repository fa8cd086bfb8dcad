"""``pause`` and ``resume``: goals that others have sent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import anyio

from turtleact.commands.held_goals import (
    DONE,
    NOT_DONE,
    HeldGoal,
    find_goals,
    held_goals,
    served_actions,
    silence,
)
from turtleact.commands.output import note, say_names
from turtleact.commands.pause_requests import paused_goals, set_paused
from turtleact.errors import PauseRefused, TurtleactError

if TYPE_CHECKING:
    from turtleact.node import Node

__all__ = ["switch", "switch_all"]


async def switch(node: Node, wanted: Sequence[str], *, is_paused: bool, timeout: float) -> int:
    """Pause or resume goals by the beginnings of their ids, and print the outcome for each.

    Raises:
        UsageError: if a text fits several goals; then nothing is done.
    """
    goals, silent = await held_goals(node, served_actions(node, None))
    status = DONE
    for found, text in [(find_goals(goals, text), text) for text in wanted]:
        if found is None:
            problem = "no server in reach holds it"
            problem = f"{problem}; {silence(silent)}" if silent else problem
            say_names(f"{text}: {_word(is_paused=is_paused, problem=problem)}\n")
            status = NOT_DONE
        elif await _switch(node, found, is_paused=is_paused, timeout=timeout):
            status = NOT_DONE
    return status


async def switch_all(node: Node, name: str | None, *, is_paused: bool, timeout: float) -> int:
    """Pause or resume all goals of an action, or of all actions, and print the outcome for each.

    All of them are asked at the same time.

    Raises:
        ServerUnavailable: if nobody serves an action of that name.
    """
    goals, silent = await held_goals(node, served_actions(node, name))
    goals = [goal for goal in goals if goal.status.is_active]
    if not is_paused:
        paused = await paused_goals(node, {goal.action for goal in goals})
        goals = [goal for goal in goals if goal.goal_id in paused]
    problems = list[str]()

    async def try_to(goal: HeldGoal) -> None:
        problem = await _switch(node, goal, is_paused=is_paused, timeout=timeout)
        problems.extend([problem] if problem else [])

    async with anyio.create_task_group() as group:
        for goal in goals:
            group.start_soon(try_to, goal)
    if silent:
        note(f"{silence(silent)}: goals may be missing")
    elif not goals:
        note(f"there is no goal to {'pause' if is_paused else 'resume'}")
    return NOT_DONE if problems or silent else DONE


async def _switch(node: Node, goal: HeldGoal, *, is_paused: bool, timeout: float) -> str:
    """Pause or resume a goal and print the outcome; return why not, or nothing."""
    problem = ""
    if goal.status.is_terminal:
        problem = f"it has ended {goal.status.name}"
    else:
        try:
            await set_paused(node, goal.action, goal.goal_id, is_paused=is_paused, timeout=timeout)
        except PauseRefused as refused:
            problem = refused.reason
        except TurtleactError as error:
            problem = str(error)
    word = _word(is_paused=is_paused, problem=problem)
    say_names(f"{goal.goal_id.hex()} of {goal.action}: {word}\n")
    return problem


def _word(*, is_paused: bool, problem: str) -> str:
    word = "paused" if is_paused else "resumed"
    return f"not {word}: {problem}" if problem else word
