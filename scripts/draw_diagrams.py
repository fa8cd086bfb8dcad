"""Prints a drawing of docs/architecture.md as SVG: ``python scripts/draw_diagrams.py layers``.

The other drawings are ``path``, the way of a goal, and ``states``, which is made from the
transition table of the code. All have colours for light and dark. A test asserts that docs/ holds
exactly what this script prints.
"""

from __future__ import annotations

import configparser
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from turtleact.goals.state import TRANSITIONS, GoalStatus

ROOT = Path(__file__).parents[1]

BANDS: Final = (
    ("Command line", "main", "cli"),
    ("Doors", "main", "web"),
    ("What watches", "fill", "testing"),
    ("What acts", "fill", "sim"),
    ("A participant", "main", "node"),
    ("Goals", "main", "goals"),
    ("Between nodes", "main", "transports"),
    ("Time and tasks", "fill", "tasks"),
    ("Data", "pure", "interfaces"),
)
"""The layers from top to bottom: a title, a colour, and a module of the first row that it holds."""

OUTSIDE: Final = (
    ("Terminal", "shell, ros2 commands", 0, 0),
    ("Browser", "page, rosbridge clients", 1, 1),
    ("Your program", "bodies, clients, topics", 4, 5),
    ("Other processes", "turtleact, ROS 2 over Zenoh", 6, 6),
)
"""The things outside the package: a name, a note, and the first and last band that it touches."""

LIVES: Final = ("your program", "ActionClient", "ActionServer", "your body")
STEPS: Final = (
    (0, 1, "send_goal(goal)"),
    (1, 2, "goal request"),
    (2, 1, "accepted"),
    (2, 3, "starts in a task"),
    (1, 2, "result request"),
    (3, 2, "yields feedback"),
    (2, 1, "feedback"),
    (1, 0, "async for"),
    (3, 2, "yields the result"),
    (2, 1, "SUCCEEDED, result"),
    (1, 0, "await goal.result()"),
)
"""The way of a goal: for each arrow, its two life lines and its text."""

PLACES: Final = {
    GoalStatus.ACCEPTED: (110, 50),
    GoalStatus.EXECUTING: (345, 50),
    GoalStatus.CANCELING: (345, 270),
    GoalStatus.SUCCEEDED: (660, 50),
    GoalStatus.ABORTED: (660, 160),
    GoalStatus.CANCELED: (660, 270),
}
"""The centre of each state (px)."""

COLOURS: Final = {
    GoalStatus.SUCCEEDED: "green",
    GoalStatus.ABORTED: "red",
    GoalStatus.CANCELED: "amber",
}

STYLE: Final = """\
.drawing { --ink: #1d2733; --soft: #5b6876; --line: #9aa7b5; --paper: #ffffff; --fill: #f2f5f9;
  --main: #e3edfd; --edge: #3367d6; --green: #16794c; --red: #b3261e; --amber: #9a5b00; }
@media (prefers-color-scheme: dark) { .drawing { --ink: #e8edf3; --soft: #a3b0be; --line: #5d6b7a;
  --paper: #14181e; --fill: #1e252e; --main: #1c2f52; --edge: #7fa8ff; --green: #56c590;
  --red: #ff8a80; --amber: #f2b35c; } }
.drawing text { font: 14px system-ui, sans-serif; fill: var(--ink); text-anchor: middle; }
.drawing .code { font: 13px ui-monospace, monospace; }
.drawing .soft { font-size: 12px; fill: var(--soft); }
.drawing .left { text-anchor: start; }
.drawing .band { fill: var(--fill); stroke: none; }
.drawing .main { fill: var(--main); }
.drawing .pure { fill: none; stroke: var(--line); stroke-dasharray: 4 4; }
.drawing .box { fill: var(--paper); stroke: var(--line); }
.drawing .blue { stroke: var(--edge); stroke-width: 2; }
.drawing .life { stroke: var(--line); stroke-dasharray: 2 4; }
.drawing .arrow { fill: none; stroke: var(--edge); stroke-width: 1.5; }
.drawing .head { fill: var(--edge); }
.drawing .green { stroke: var(--green); stroke-width: 2; }
.drawing .red { stroke: var(--red); stroke-width: 2; }
.drawing .amber { stroke: var(--amber); stroke-width: 2; }
.drawing .label { paint-order: stroke; stroke: var(--paper); stroke-width: 5px; }"""


class Rect(NamedTuple):
    """A rectangle: its left upper corner and its size (px)."""

    x: float
    y: float
    width: float
    height: float

    def draw(self, kind: str) -> str:
        """The rectangle as an element."""
        size = f'width="{self.width:g}" height="{self.height:g}"'
        return f'<rect class="{kind}" x="{self.x:g}" y="{self.y:g}" {size} rx="6"/>'


def text(x: float, y: float, content: str, kind: str = "") -> str:
    """A line of text around a point, or to its right if it is of the kind ``left``."""
    return f'<text class="{kind}" x="{x:g}" y="{y:g}">{content}</text>'


def arrow(points: Sequence[tuple[float, float]], drawing: str, *, both: bool = False) -> str:
    """A line with a head at its end, or at both ends."""
    path = " L".join(f"{x:g} {y:g}" for x, y in points)
    start = f' marker-start="url(#{drawing}-head)"' if both else ""
    return f'<path class="arrow" d="M{path}" marker-end="url(#{drawing}-head)"{start}/>'


def picture(name: str, width: int, height: int, parts: list[str]) -> str:
    """A whole drawing."""
    head = (
        f'<defs><marker id="{name}-head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto-start-reverse"><path class="head" d="M0 0 L8 4 L0 8 Z"/>'
        "</marker></defs>"
    )
    root = (
        f'<svg class="drawing" xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}">'
    )
    paper = f'<rect width="{width}" height="{height}" rx="8" style="fill: var(--paper)"/>'
    return "\n".join([root, f"<style>\n{STYLE}\n</style>", head, paper, *parts, "</svg>"])


def modules() -> list[list[str]]:
    """The modules of each band, from the rows of the import contract."""
    contract = configparser.ConfigParser()
    contract.read(ROOT / ".importlinter", "utf-8")
    rows = contract["importlinter:contract:layers"]["layers"].split("\n")
    bands: list[list[str]] = []
    for row in rows:
        names = re.findall(r"\w+", row)
        if len(bands) < len(BANDS) and BANDS[len(bands)][2] in names:
            bands.append([])
        if bands:
            bands[-1] += names
    return bands


def layers() -> str:
    """The drawing of the package's layers and of the things outside."""
    bands = modules()
    top, step, height = 20, 50, 40
    left, title, box, gap = 16, 132, 104, 6
    width = title + max(map(len, bands)) * (box + gap) + gap
    parts = []
    for row, (name, kind, _) in enumerate(BANDS):
        y = top + row * step
        parts.append(Rect(left, y, width, height).draw(f"band {kind}"))
        parts.append(text(left + 12, y + 25, name, "left"))
        for column, module in enumerate(bands[row]):
            place = Rect(left + title + column * (box + gap) + gap, y + 6, box, height - 12)
            parts.append(place.draw("box"))
            parts.append(text(place.x + box / 2, y + 24.5, module, "code"))
    edge = left + width
    for name, note, first, last in OUTSIDE:
        centre = top + step * (first + last) / 2 + height / 2
        place = Rect(edge + 50, centre - height / 2, 200, height)
        parts += [
            place.draw("box"),
            text(place.x + 100, centre - 3, name),
            text(place.x + 100, centre + 13, note, "soft"),
            arrow([(edge + 4, centre), (place.x - 2, centre)], "layers", both=True),
        ]
    bottom = top + len(BANDS) * step
    parts.append(
        text(left, bottom + 16, "Each layer imports only from the layers below it.", "left soft")
    )
    parts.append(
        text(left, bottom + 34, "Dashed layers use no clock and start no tasks.", "left soft")
    )
    return picture("layers", int(edge + 50 + 200 + 16), bottom + 50, parts)


def path() -> str:
    """The way of a goal from a program to its result."""
    first, across, top, down = 90, 200, 76, 32
    places = [first + across * column for column in range(len(LIVES))]
    bottom = top + down * len(STEPS)
    middle = (places[1] + places[2]) / 2
    parts = []
    for x, name in zip(places, LIVES, strict=True):
        parts += [
            f'<path class="life" d="M{x} 50 L{x} {bottom}"/>',
            Rect(x - 70, 16, 140, 34).draw("box" if name.startswith("your") else "box blue"),
            text(x, 38, name, "" if name.startswith("your") else "code"),
        ]
    for row, (start, end, what) in enumerate(STEPS):
        y = top + row * down
        side = 3 if end > start else -3
        parts.append(arrow([(places[start] + side, y), (places[end] - side, y)], "path"))
        parts.append(text((places[start] + places[end]) / 2, y - 6, what, "soft label"))
    note = "a call in one process; topics and services over Zenoh between processes"
    parts.append(text(middle, bottom + 22, note, "soft"))
    return picture("path", places[-1] + 90, bottom + 38, parts)


def states() -> str:
    """The states of a goal and the events that change them."""
    half, tall = 66, 20
    parts = [arrow([(6, 50), (PLACES[GoalStatus.ACCEPTED][0] - half - 2, 50)], "states")]
    for (start, event), end in TRANSITIONS.items():
        (x0, y0), (x1, y1) = PLACES[start], PLACES[end]
        if x0 == x1:
            points = [(x0, y0 + tall), (x1, y1 - tall - 2)]
        else:
            points = [(x0 + half, y0), (x1 - half - 2, y1)]
        (ax, ay), (bx, by) = points
        share = 0.5 if ay == by or ax == bx else 0.36
        label = text(ax + share * (bx - ax), ay + share * (by - ay) - 6, event.name, "soft label")
        parts += [arrow(points, "states"), label]
    for status, (x, y) in PLACES.items():
        kind = f"box {COLOURS.get(status, '')}".strip()
        parts += [
            Rect(x - half, y - tall, 2 * half, 2 * tall).draw(kind),
            text(x, y + 5, status.name, "code"),
        ]
    return picture("states", 746, 312, parts)


DRAWINGS: Final = {"layers": layers, "path": path, "states": states}

if __name__ == "__main__":
    print(DRAWINGS[sys.argv[1]]())
