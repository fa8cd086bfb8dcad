"""Draws goals, feedback and turtles for a terminal, with the library rich.

The functions take plain values and return rich renderables. `turtleact.commands` decides what to
show, and how often. No other package imports rich.
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
