"""Draws goals, feedback and turtles for a terminal: makes rich renderables from plain values.

This package has no logic and no time: `turtleact.commands` decides what to show, and how often.
Only this package imports rich.
"""

from turtleact.render.lines import Picture, lines
from turtleact.render.panels import (
    Board,
    GoalRow,
    GoalView,
    board,
    feedback_table,
    frame,
    goal_panel,
    progress_line,
)
from turtleact.render.world_map import Braille, Ink, MapView, Target, Trails, Turtle, world_map

__all__ = [
    "Board",
    "Braille",
    "GoalRow",
    "GoalView",
    "Ink",
    "MapView",
    "Picture",
    "Target",
    "Trails",
    "Turtle",
    "board",
    "feedback_table",
    "frame",
    "goal_panel",
    "lines",
    "progress_line",
    "world_map",
]
