"""Where turtles are and have been, as the graph tells, and where a goal sends them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from turtleact.geometry import distance
from turtleact.interfaces import get_interface, to_dict
from turtleact.render import MapView, Target, Trails, Turtle
from turtleact.sim.kinematics import SIDE
from turtleact.transports import QoS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from turtleact.interfaces import Message
    from turtleact.node import Node
    from turtleact.topics import Subscription

__all__ = [
    "POSES_A_FRAME",
    "Course",
    "PoseTrails",
    "offset",
    "places_in",
    "pose_topics",
    "sends_a_turtle",
]

NEAR: Final = 0.15
"""A turtle that has come this near to a place has passed it (m)."""

COLOURS: Final = ("cyan", "magenta", "blue", "yellow", "red", "green")
"""The colours of the turtles, in the order of their names."""

MOST_TURTLES: Final = 32
"""How many turtles are followed; a map could not show more."""

POSES_A_FRAME: Final = 8192
"""How many poses are kept between two frames: those of a second at the highest speed."""

LOOKS: Final = 15
"""How many readings pass between two searches of the graph for new turtles."""

POSE_TYPES: Final = ("turtlesim/msg/Pose", "turtlesim_msgs/msg/Pose")
POSE: Final = "/pose"


class PoseTrails:
    """The turtles of a graph and their trails, from the poses that they publish.

    Args:
        node: A node on the graph.
        leader: The pose topic of the turtle that matters most, if one does.
    """

    def __init__(self, node: Node, leader: str = "") -> None:
        self._node = node
        self._leader = leader
        self._poses: dict[str, Subscription[Any]] = {}
        self._colours: dict[str, str] = {}
        self._trails = Trails(SIDE)
        self._looks = 0
        self._search()

    def look(self, course: Course | None = None) -> MapView:
        """Read the new poses, and return the map.

        Args:
            course: The course of the leader, which is updated.
        """
        self._looks += 1
        if self._looks % LOOKS == 0:
            self._search()
        turtles = []
        for topic, poses in self._poses.items():
            name, colour = topic.removesuffix(POSE).strip("/"), self._colours[topic]
            for pose in poses.drain():
                self._trails.follow(name, pose.x, pose.y, colour)
                if course is not None and topic == self._leader:
                    course.follow(pose.x, pose.y)
            latest = poses.latest
            if latest is not None:
                turtles.append(Turtle(latest.x, latest.y, latest.theta, name, colour))
        return MapView(SIDE, turtles, self._trails, () if course is None else course.ahead())

    def _search(self) -> None:
        """Follow new turtles, and forget those that are gone."""
        topics = pose_topics(self._node)
        for gone in self._poses.keys() - topics.keys():
            self._poses.pop(gone).close()
        leader_first = sorted(topics, key=lambda topic: topic != self._leader)
        for topic in leader_first[:MOST_TURTLES]:
            if topic not in self._poses:
                pose_type: Any = get_interface(topics[topic])
                qos = QoS(depth=POSES_A_FRAME)
                self._poses[topic] = self._node.subscription(pose_type, topic, qos)
                self._colours.setdefault(topic, COLOURS[len(self._colours) % len(COLOURS)])


class Course:
    """The places that a goal leads to, and how many of them its turtle has passed.

    Attributes:
        stops: How many places there are, all rounds together.
        passed: How many of them the turtle has passed, in order.
    """

    def __init__(self, goal: Message) -> None:
        self._places = list(places_in(to_dict(goal)))
        self.stops = len(self._places) * (1 + max(0, int(getattr(goal, "loops", 0))))
        self.passed = 0
        self._last: tuple[float, float] | None = None

    def follow(self, x: float, y: float) -> None:
        """Record that the turtle has moved to a point in a straight line (m)."""
        here, self._last = self._last or (x, y), (x, y)
        if self.passed < self.stops:
            place = self._places[self.passed % len(self._places)]
            self.passed += offset(place, here, (x, y)) <= NEAR

    def ahead(self) -> list[Target]:
        """The places ahead in this round, numbered as in the goal."""
        if self.passed >= self.stops:
            return []
        first = self.passed % len(self._places)
        return [Target(*place, i) for i, place in enumerate(self._places[first:], first + 1)]

    def told(self) -> str:
        """The progress in words; empty if there are no places."""
        return f"{self.passed} of {self.stops} places" if self.stops else ""


def pose_topics(node: Node) -> dict[str, str]:
    """The topics on which turtles publish their poses, sorted, with their types."""
    return {
        each.name: each.type_name
        for each in sorted(node.transport.endpoints(), key=lambda each: each.name)
        if each.kind == "publisher" and each.name.endswith(POSE) and each.type_name in POSE_TYPES
    }


def places_in(value: object) -> Iterator[tuple[float, float]]:
    """All pairs of x and y in the plain values of a message, in order."""
    if isinstance(value, dict):
        if isinstance(value.get("x"), float) and isinstance(value.get("y"), float):
            yield value["x"], value["y"]
            return
        value = list(value.values())
    if isinstance(value, list):
        for item in value:
            yield from places_in(item)


def sends_a_turtle(name: str, goal: Message) -> tuple[bool, str]:
    """Whether a goal seems to drive a turtle, and that turtle's pose topic.

    Args:
        name: The action's name: ``/turtle1/rotate_absolute`` drives ``turtle1``.
        goal: The goal. One that has places but names no turtle drives ``turtle1``.
    """
    named = str(getattr(goal, "turtle", "")) or name.rpartition("/")[0].strip("/")
    has_places = any(True for _ in places_in(to_dict(goal)))
    return bool(named) or has_places, f"/{(named or 'turtle1').strip('/')}{POSE}"


def offset(
    place: tuple[float, float], start: tuple[float, float], end: tuple[float, float]
) -> float:
    """The distance of a place from a line segment (m)."""
    length = distance(*start, *end)
    if not length:
        return distance(*place, *end)
    way = ((end[0] - start[0]) / length, (end[1] - start[1]) / length)
    along = (place[0] - start[0]) * way[0] + (place[1] - start[1]) * way[1]
    along = min(max(along, 0.0), length)
    return distance(*place, start[0] + along * way[0], start[1] + along * way[1])
