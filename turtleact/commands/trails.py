"""Tracks the turtles on the graph: their poses, their trails, and the targets of goals."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

from turtleact.geometry import distance
from turtleact.interfaces import get_interface, to_dict
from turtleact.render import MapView, Target, Trails, Turtle
from turtleact.sim.kinematics import SIDE
from turtleact.sim.pictures import shades_of
from turtleact.transports import QoS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from turtleact.interfaces import Message
    from turtleact.node import Node
    from turtleact.node.topics import Subscription

__all__ = [
    "POSE",
    "POSES_A_FRAME",
    "Course",
    "Motion",
    "PoseTrails",
    "colour_of",
    "offset",
    "places_in",
    "pose_topics",
    "sends_a_turtle",
]

NEAR: Final = 0.15
"""A turtle reaches a place at this distance (m), or at the goal's tolerance if that is larger."""

STILL: Final = 1e-4
"""A turtle that moves backwards by at most this distance (m) between two poses is not reversing."""

JUMP: Final = 1.0
"""If a turtle moves at least this far (m) between two poses, the turtle was teleported."""

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
        leader: The pose topic of the leader, the turtle whose motion is observed; empty if there is
            none.

    Attributes:
        motion: How the leader moves.
    """

    def __init__(self, node: Node, leader: str = "") -> None:
        self._node = node
        self._leader = leader
        self._poses: dict[str, Subscription[Any]] = {}
        self.motion = Motion()
        self._trails = Trails(SIDE)
        self._looks = 0
        self._search()

    def look(self, course: Course | None = None) -> MapView:
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
            colour = colour_of(name)
            for pose in poses.drain():
                self._trails.follow(name, pose.x, pose.y, colour)
                if topic == self._leader:
                    self.motion.follow(pose.x, pose.y, pose.theta)
                    if course is not None:
                        course.follow(pose.x, pose.y)
            latest = poses.latest
            if latest is not None:
                turtles.append(Turtle(latest.x, latest.y, latest.theta, name, colour))
        return MapView(SIDE, turtles, self._trails, () if course is None else course.targets())

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


class Motion:
    """Infers from poses how a turtle moves, because turtlesim publishes speeds without a sign.

    Attributes:
        is_reversing: Whether the turtle moved backwards between its last two poses.
    """

    def __init__(self) -> None:
        self.is_reversing = False
        self._last: tuple[float, float] | None = None

    def follow(self, x: float, y: float, theta: float) -> None:
        """Record a pose (m, rad)."""
        before, self._last = self._last or (x, y), (x, y)
        along = (x - before[0]) * math.cos(theta) + (y - before[1]) * math.sin(theta)
        self.is_reversing = -JUMP < along < -STILL

    def told(self) -> str:
        """Return ``reversing`` if the turtle moves backwards, and otherwise an empty string."""
        return "reversing" if self.is_reversing else ""


class Course:
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
            self.passed += offset(place, here, (x, y)) <= self._near

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


def offset(
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
