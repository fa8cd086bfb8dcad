"""Follows the turtles on a graph, and draws a map of their world with rich, in braille characters.

A map shows walls, trails, turtles and the targets of goals. Each of its cells is 2 dots wide and 4
dots high. The dots are evenly spaced in both directions if the terminal's cells are twice as high
as wide. A cell has only one colour: the colour of the dot that was drawn last.

Source: the Unicode Standard, "Braille Patterns", from U+2800, where each dot is a bit.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

from rich.text import Text

from turtleact.geometry import distance
from turtleact.interfaces import get_interface, to_dict
from turtleact.sim.kinematics import SIDE
from turtleact.sim.pictures import shades_of
from turtleact.transports import QoS

if TYPE_CHECKING:
    from turtleact.interfaces import Message
    from turtleact.node import Node
    from turtleact.node.topics import Subscription

__all__ = [
    "POSE",
    "POSES_A_FRAME",
    "TICK",
    "Braille",
    "GoalPath",
    "MapView",
    "PoseTrails",
    "Target",
    "Turtle",
    "colour_of",
    "pose_topics",
    "printable",
    "sends_a_turtle",
    "shortened",
    "world_map",
]

ARROWS: Final = "→↗↑↖←↙↓↘"
WALL, TRAIL, TARGET, REACHED, TURTLE = "dim", "cyan", "yellow", "green", "green"
TICK: Final = "✓"

LONGEST_NAME: Final = 12
LONGEST_TEXT: Final = 400
"""Longer texts are cut to this many characters; no window is wide enough for more."""

BLANK: Final = chr(0x2800)

Marks: TypeAlias = dict[tuple[int, int], tuple[str, str]]
"""Maps the row and column of a cell to its character and style. Rows are counted from the top."""


class Turtle(NamedTuple):
    """A turtle: its x and y (m), its theta (rad, 0 is to the right), its name and its colour."""

    x: float
    y: float
    theta: float
    name: str = ""
    colour: str = TURTLE


class Target(NamedTuple):
    """A target: x and y (m), its number and colour, and whether the turtle has reached it."""

    x: float
    y: float
    number: int
    colour: str = TARGET
    is_reached: bool = False

    @property
    def label(self) -> str:
        """The character that marks the target: its number, or a cross if the number is above 9."""
        return str(self.number) if self.number < 10 else "×"

    @property
    def style(self) -> str:
        """The style in which the target is shown."""
        return REACHED if self.is_reached else self.colour


class MapView(NamedTuple):
    """The part of a world that a map shows. The world's lower left corner is at (0, 0).

    Attributes:
        side: The length of each of the world's four walls (m), above zero.
        turtles: The turtles.
        ink: Draws the lines of the turtles on a canvas of so many columns and rows; None if the map
            does not show them. The world's lower left corner is at (0, 0).
        targets: The targets of the turtles.
    """

    side: float
    turtles: Sequence[Turtle]
    ink: Callable[[int, int], Braille] | None = None
    targets: Sequence[Target] = ()


def world_map(view: MapView, rows: int) -> Text:
    """Draw the world in ``rows`` rows and twice as many columns, surrounded by the world's walls.

    A target that has been reached has a check mark beside its number. A turtle hides a target in
    the same cell. A turtle's name is drawn near the turtle. The name never covers a turtle, a
    target, a trail or another name. If there is no room near the turtle, the name is left out.
    """
    columns = 2 * rows
    canvas = Braille(columns, rows) if view.ink is None else view.ink(columns, rows)
    scale = (canvas.width - 1) / view.side
    marks: Marks = {}
    for target in view.targets:
        row, column = _cell(target.x * scale, target.y * scale, columns, rows)
        if target.is_reached:  # the tick is beside the number: a turtle may stand there
            marks[row, column + (1 if column < columns - 1 else -1)] = (TICK, target.style)
        marks[row, column] = (target.label, target.style)
    cells = [_cell(each.x * scale, each.y * scale, columns, rows) for each in view.turtles]
    for turtle, cell in zip(view.turtles, cells, strict=True):
        marks[cell] = (ARROWS[round(turtle.theta / math.tau * 8) % 8], f"bold {turtle.colour}")
    for turtle, cell in zip(view.turtles, cells, strict=True):
        _label(marks, turtle, cell, canvas.rows())
    return _bordered(canvas, marks)


def printable(text: str) -> str:
    """Replace control characters, which must not reach the terminal, and cut off a long text."""
    return "".join(c if c.isprintable() else "·" for c in text[:LONGEST_TEXT])


def shortened(text: str, columns: int) -> str:
    """Return a text, cut off if it is longer than ``columns``."""
    return text if len(text) <= columns else f"{text[: max(columns - 1, 0)]}…"


def _cell(x: float, y: float, columns: int, rows: int) -> tuple[int, int]:
    """Return the row (from the top) and the column of the cell that contains a dot.

    For a dot outside the map, return the nearest cell.
    """
    column = min(max(round(x) // 2, 0), columns - 1)
    return min(max(rows - 1 - round(y) // 4, 0), rows - 1), column


def _label(marks: Marks, turtle: Turtle, cell: tuple[int, int], drawn: Sequence[str]) -> None:
    """Put a turtle's name beside, above or below the turtle.

    The name covers no trail, and neither covers nor touches another mark: "turtle1" beside target 2
    would read as "turtle12". If there is no room, it is left out.
    """
    name = shortened(printable(turtle.name), LONGEST_NAME)
    row, column = cell
    last = len(drawn[0]) - len(name)
    middle = min(max(column - len(name) // 2, 0), last)
    places = [
        (row, column + 2),
        (row, column - 1 - len(name)),
        (row - 1, middle),
        (row + 1, middle),
    ]
    for at, start in places:
        if not (0 <= at < len(drawn) and 0 <= start <= last):
            continue
        around = {(at, start + i) for i in range(-1, len(name) + 1)}
        if set(drawn[at][start : start + len(name)]) <= {BLANK} and not marks.keys() & around:
            marks.update({(at, start + i): (each, turtle.colour) for i, each in enumerate(name)})
            return


def _bordered(canvas: Braille, marks: Marks) -> Text:
    text = Text(no_wrap=True)
    rows = canvas.rows()
    edge = "─" * len(rows[0])
    text.append(f"┌{edge}┐\n", WALL)
    for number, (row, colours) in enumerate(zip(rows, canvas.colours, strict=True)):
        cells = [
            marks.get((number, column), (character, colour or TRAIL))
            for column, (character, colour) in enumerate(zip(row, colours, strict=True))
        ]
        text.append("│", WALL)
        for style, run in itertools.groupby(cells, lambda cell: cell[1]):
            text.append("".join(character for character, _ in run), style)
        text.append("│\n", WALL)
    text.append(f"└{edge}┘", WALL)
    return text


STRIDE: Final = 0.08
"""How far a turtle moves before its trail is extended (m)."""

LONGEST: Final = 2000
"""How many points of a trail are kept, to redraw it for a map of another size."""


class Braille:
    """A canvas of dots. Each character has 2 by 4 dots. (0, 0) is the lower left dot.

    >>> canvas = Braille(2, 1)
    >>> canvas.line(0, 0, 3, 3)
    >>> canvas.rows()
    ['⡠⠊']

    Attributes:
        width: The number of dots in a row.
        height: The number of dots in a column.
        colours: The colours of the cells by row, from top to bottom; "" for none.
    """

    BITS: Final = ((0x40, 0x80), (0x04, 0x20), (0x02, 0x10), (0x01, 0x08))

    def __init__(self, columns: int, rows: int) -> None:
        self.width = 2 * columns
        self.height = 4 * rows
        self._cells = [[0] * columns for _ in range(rows)]
        self.colours = [[""] * columns for _ in range(rows)]

    def dot(self, x: int, y: int, colour: str = "") -> None:
        """Set a dot, unless it is outside the canvas."""
        if 0 <= x < self.width and 0 <= y < self.height:
            row, column = len(self._cells) - 1 - y // 4, x // 2
            self._cells[row][column] |= self.BITS[y % 4][x % 2]
            self.colours[row][column] = colour

    def line(self, x0: int, y0: int, x1: int, y1: int, colour: str = "") -> None:
        """Set all dots of a line, its ends included."""
        steps = max(abs(x1 - x0), abs(y1 - y0), 1)
        for step in range(steps + 1):
            x = round(x0 + (x1 - x0) * step / steps)
            self.dot(x, round(y0 + (y1 - y0) * step / steps), colour)

    def rows(self) -> list[str]:
        """Return the rows of characters, from top to bottom."""
        return ["".join(chr(0x2800 + bits) for bits in row) for row in self._cells]


# following

NEAR: Final = 0.15
"""A turtle reaches a place at this distance (m), or at the goal's tolerance if that is larger."""

MOST_TURTLES: Final = 32
"""At most this many turtles are followed, because a map has no room for more turtles."""

POSES_A_FRAME: Final = 8192
"""How many poses are kept between two frames: enough for a second at the highest speed."""

LOOKS: Final = 15
"""How many calls of `look` pass between two searches of the graph for new turtles."""

POSE_TYPES: Final = ("turtlesim/msg/Pose", "turtlesim_msgs/msg/Pose")
POSE: Final = "/pose"


class PoseTrails:
    """Follows the turtles of a graph and their trails, by the poses that the turtles publish.

    Args:
        node: A node on the graph.
        leader: The pose topic of the turtle that runs the goal; empty if there is none.
    """

    def __init__(self, node: Node, leader: str = "") -> None:
        self._node = node
        self._leader = leader
        self._poses: dict[str, Subscription[Any]] = {}
        self._trails: dict[str, list[tuple[float, float]]] = {}
        self._canvas = Braille(1, 1)
        self._looks = 0
        self._search()

    def look(self, course: GoalPath | None = None) -> MapView:
        """Read the new poses, and return the map.

        Args:
            course: The places that the leader has to pass. This method records the leader's new
                poses in ``course``.
        """
        self._looks += 1
        if self._looks % LOOKS == 0:
            self._search()
        turtles = []
        for topic, poses in self._poses.items():
            name = topic.removesuffix(POSE).strip("/")
            for pose in poses.drain():
                self._extend(name, pose.x, pose.y)
                if course is not None and topic == self._leader:
                    course.follow(pose.x, pose.y)
            latest = poses.latest
            if latest is not None:
                turtles.append(Turtle(latest.x, latest.y, latest.theta, name, colour_of(name)))
        return MapView(SIDE, turtles, self._draw_all, () if course is None else course.targets())

    def _extend(self, turtle: str, x: float, y: float) -> None:
        """Extend a turtle's trail, once the turtle has moved `STRIDE` since the last point."""
        trail = self._trails.setdefault(turtle, [(x, y)])
        if distance(*trail[-1], x, y) >= STRIDE:
            self._draw(*trail[-1], x, y, colour_of(turtle))
            trail.append((x, y))
            del trail[:-LONGEST]

    def _draw_all(self, columns: int, rows: int) -> Braille:
        """Return a canvas with all trails. Only a canvas of a new size is drawn from the start."""
        if (self._canvas.width, self._canvas.height) != (2 * columns, 4 * rows):
            self._canvas = Braille(columns, rows)
            for turtle, trail in self._trails.items():
                for here, there in itertools.pairwise(trail):
                    self._draw(*here, *there, colour_of(turtle))
        return self._canvas

    def _draw(self, x0: float, y0: float, x1: float, y1: float, colour: str) -> None:
        scale = (self._canvas.width - 1) / SIDE
        start, end = (round(x0 * scale), round(y0 * scale)), (round(x1 * scale), round(y1 * scale))
        self._canvas.line(*start, *end, colour)

    def _search(self) -> None:
        """Subscribe to the poses of new turtles, and unsubscribe from turtles that are gone."""
        topics = pose_topics(self._node)
        for gone in self._poses.keys() - topics.keys():
            self._poses.pop(gone).close()
        leader_first = sorted(topics, key=lambda topic: topic != self._leader)
        for topic in leader_first[:MOST_TURTLES]:
            if topic not in self._poses:
                pose_type: Any = get_interface(topics[topic])
                qos = QoS(depth=POSES_A_FRAME)
                self._poses[topic] = self._node.subscription(pose_type, topic, qos)


def colour_of(turtle: str) -> str:
    """The colour of a turtle on a terminal, as ``#rrggbb``."""
    return "#" + bytes(shades_of(turtle).mark).hex()


class GoalPath:
    """The places to which a goal sends a turtle, and how many of them the turtle has passed.

    Attributes:
        stops: How many places the turtle has to pass. Each place counts once for each round.
        passed: How many of the ``stops`` the turtle has passed, in the order of the goal.
    """

    def __init__(self, goal: Message) -> None:
        self._places = list(places_in(to_dict(goal)))
        self._near = max(NEAR, float(getattr(goal, "tolerance", 0.0)))
        self.stops = len(self._places) * (1 + max(0, int(getattr(goal, "loops", 0))))
        self.passed = 0
        self._last: tuple[float, float] | None = None

    def follow(self, x: float, y: float) -> None:
        """Record that the turtle has moved in a straight line to the point ``x``, ``y`` (m)."""
        here, self._last = self._last or (x, y), (x, y)
        if self.passed < self.stops:
            place = self._places[self.passed % len(self._places)]
            self.passed += _offset(place, here, (x, y)) <= self._near

    def targets(self) -> list[Target]:
        """The places of the goal, numbered from 1.

        The places that the turtle has passed in this round are marked as reached.
        """
        count = len(self._places)
        passed = count if self.passed >= self.stops else self.passed % count
        return [
            Target(*place, number, is_reached=number <= passed)
            for number, place in enumerate(self._places, 1)
        ]

    def told(self) -> str:
        """Return how many places the turtle has passed, in words; empty if there are no places."""
        return f"{self.passed} of {self.stops} targets" if self.stops else ""


def pose_topics(node: Node) -> dict[str, str]:
    """The topics on which turtles publish their poses, sorted by name, and the type of each."""
    return {
        each.name: each.type_name
        for each in sorted(node.transport.endpoints(), key=lambda each: each.name)
        if each.kind == "publisher" and each.name.endswith(POSE) and each.type_name in POSE_TYPES
    }


def places_in(value: object) -> Iterator[tuple[float, float]]:
    """Yield the pair ``x``, ``y`` of each place in a message's plain values, in order."""
    if isinstance(value, dict):
        if isinstance(value.get("x"), float) and isinstance(value.get("y"), float):
            yield value["x"], value["y"]
            return
        value = list(value.values())
    if isinstance(value, list):
        for item in value:
            yield from places_in(item)


def sends_a_turtle(name: str, goal: Message) -> tuple[bool, str]:
    """Return whether a goal seems to drive a turtle, and the pose topic of the turtle.

    If neither the goal nor the action's name contains the name of a turtle, a goal with places is
    assumed to drive ``turtle1``.

    Args:
        name: The name of the action. In ``/turtle1/rotate_absolute``, the turtle is ``turtle1``.
        goal: The goal.
    """
    named = str(getattr(goal, "turtle", "")) or name.rpartition("/")[0].strip("/")
    has_places = any(True for _ in places_in(to_dict(goal)))
    return bool(named) or has_places, f"/{(named or 'turtle1').strip('/')}{POSE}"


def _offset(
    place: tuple[float, float], start: tuple[float, float], end: tuple[float, float]
) -> float:
    """The distance (m) of a place from the line segment between two points."""
    length = distance(*start, *end)
    if not length:
        return distance(*place, *end)
    way = ((end[0] - start[0]) / length, (end[1] - start[1]) / length)
    along = (place[0] - start[0]) * way[0] + (place[1] - start[1]) * way[1]
    along = min(max(along, 0.0), length)
    return distance(*place, start[0] + along * way[0], start[1] + along * way[1])
