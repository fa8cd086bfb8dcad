"""The kinds of robot that actions can drive: their topics, message types and limits.

A `Robot` receives its speeds on one topic and publishes its pose on another. `POSE_TYPES` and
`TWIST_TYPES` list the types that these topics may have. By default, a robot has the topics and
types of turtlesim.

Source: the message definitions of ROS 2 Jazzy; Diebel, Representing Attitude, 2006, equation 290
(the heading of a quaternion).
"""

from __future__ import annotations

import math
from operator import attrgetter
from typing import TYPE_CHECKING, Final, NamedTuple, cast

import msgspec

from turtleact.errors import InvalidMessage, InvalidOption
from turtleact.geometry import wrap_angle
from turtleact.interfaces import from_dict, get_interface
from turtleact.interfaces.standard import Twist, Vector3
from turtleact.names import resolve_name

if TYPE_CHECKING:
    from turtleact.actions.steering import Pose, Speeds
    from turtleact.interfaces import Message
    from turtleact.interfaces.standard import Time

__all__ = ["POSE_TYPES", "TWIST_TYPES", "PoseSample", "Robot"]


class PoseSample(NamedTuple):
    """A robot's place and speed, as reported in a pose message.

    Attributes:
        pose: x and y (m), and the heading (rad, in [-pi, pi)).
        speeds: Linear (m/s, never negative) and angular (rad/s); zeros if the message has none.
        stamp: The ROS time of the message (ns); None if it has no stamp.
    """

    pose: Pose
    speeds: Speeds = (0.0, 0.0)
    stamp: int | None = None


class _Fields(NamedTuple):
    """The names of the message fields that hold the pose and the twist."""

    pose: str
    twist: str = ""


POSE_TYPES: Final[dict[str, _Fields | None]] = {
    "turtlesim/msg/Pose": None,  # its fields are numbers, without messages inside
    "turtlesim_msgs/msg/Pose": None,
    "nav_msgs/msg/Odometry": _Fields("pose.pose", "twist.twist"),
    "geometry_msgs/msg/PoseStamped": _Fields("pose"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _Fields("pose.pose"),
}
"""The types of pose topics, and which of their fields hold the pose and the twist."""

TWIST_TYPES: Final = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
"""The types of twist topics."""


class Robot(msgspec.Struct, frozen=True, kw_only=True):
    """A kind of robot: its topics, message types and limits.

    Attributes:
        pose_topic: The topic of the robot's pose. ``{turtle}`` is replaced by the goal's turtle.
        pose_type: One of `POSE_TYPES`.
        twist_topic: The topic of the robot's commands. ``{turtle}`` is replaced by the goal's
            turtle.
        twist_type: One of `TWIST_TYPES`.
        frame_id: The ``frame_id`` in the header of a stamped twist.
        dt: The approximate time between two poses (s). Unless the robot keeps its commands (see
            `keeps_commands`), it gets a command after each pose. If poses come at another rate, the
            drive adapts to that rate.
        max_age: Poses with a stamp older than this (s) are ignored.
        max_acceleration: How fast the robot's speed may change (m/s²), above zero; may be infinite.
        max_angular_acceleration: How fast the robot's turn rate may change (rad/s²), above zero;
            may be infinite.

    Raises:
        InvalidOption: if a type is not in `POSE_TYPES` or `TWIST_TYPES`, or a number is out of
            range.
        InvalidName: if the name of a topic breaks ROS 2's rules.

    Example:
        >>> Robot().topics("turtle1")
        ('turtle1/pose', 'turtle1/cmd_vel')
        >>> Robot(pose_topic="/odom", twist_topic="/cmd_vel").topics("")
        ('/odom', '/cmd_vel')
    """

    pose_topic: str = "{turtle}/pose"
    pose_type: str = "turtlesim/msg/Pose"
    twist_topic: str = "{turtle}/cmd_vel"
    twist_type: str = "geometry_msgs/msg/Twist"
    frame_id: str = "base_link"
    dt: float = 0.016
    max_age: float = 1.0
    max_acceleration: float = math.inf
    max_angular_acceleration: float = math.inf

    def __post_init__(self) -> None:
        for name, known in (("pose_type", POSE_TYPES), ("twist_type", TWIST_TYPES)):
            if getattr(self, name) not in known:
                problem = f"'{getattr(self, name)}' is none of {', '.join(known)}"
                raise InvalidOption(name, problem)
        for topic in self.topics("turtle"):
            resolve_name(topic)
        for name in ("max_age", "max_acceleration", "max_angular_acceleration"):
            if not getattr(self, name) > 0.0:
                raise InvalidOption(name, f"must be above zero, not {getattr(self, name)}")
        if not (math.isfinite(self.dt) and self.dt > 0.0):
            raise InvalidOption("dt", f"must be finite and above zero, not {self.dt}")

    @property
    def fastest(self) -> float:
        """The highest turn rate (rad/s) that the steering law supports for this robot."""
        return math.pi / 2.0 / self.dt

    @property
    def keeps_commands(self) -> bool:
        """Whether the robot follows each command for a second, so that commands need no repetition.

        A turtlesim turtle follows each command for a second. Any other robot may stop sooner, so
        the drive sends a command after each pose.
        """
        return POSE_TYPES[self.pose_type] is None

    @property
    def pose_class(self) -> type[Message]:
        """The message class of the robot's poses."""
        return cast("type[Message]", get_interface(self.pose_type))

    @property
    def twist_class(self) -> type[Message]:
        """The message class of the robot's commands."""
        return cast("type[Message]", get_interface(self.twist_type))

    def topics(self, turtle: str) -> tuple[str, str]:
        """Return the names of a turtle's pose topic and twist topic."""
        pose, twist = (
            topic.replace("{turtle}", turtle) for topic in (self.pose_topic, self.twist_topic)
        )
        return pose, twist

    def read(self, message: Message) -> PoseSample:
        """Return the robot's pose and speeds from a pose message.

        Raises:
            InvalidMessage: if the message holds no valid place or heading.
        """
        fields = POSE_TYPES[self.pose_type]
        seen = _read_turtle(message) if fields is None else _read_stamped(message, fields)
        for name, value in zip(("x", "y", "theta"), seen.pose, strict=True):
            if not math.isfinite(value):
                raise InvalidMessage(name, f"is {value}, which is not a place")
        return seen

    def write(self, speeds: Speeds, now: int) -> Message:
        """Return the message that makes the robot drive at some speeds.

        Args:
            speeds: Linear (m/s) and angular (rad/s).
            now: The ROS time (ns) for the stamp of the message.
        """
        if self.twist_type == TWIST_TYPES[0]:
            return Twist(linear=Vector3(x=speeds[0]), angular=Vector3(z=speeds[1]))
        twist = {"linear": {"x": speeds[0]}, "angular": {"z": speeds[1]}}
        sec, nanosec = divmod(now, 10**9)
        header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": self.frame_id}
        return from_dict(self.twist_class, {"header": header, "twist": twist})


_turtle = attrgetter("x", "y", "theta", "linear_velocity", "angular_velocity")
_place = attrgetter("position.x", "position.y")
_quaternion = attrgetter("orientation.x", "orientation.y", "orientation.z", "orientation.w")
_speeds = attrgetter("linear.x", "linear.y", "angular.z")
_stamp = attrgetter("header.stamp")


def _read_turtle(message: Message) -> PoseSample:
    x, y, theta, linear, angular = _turtle(message)
    return PoseSample((x, y, theta), (linear, angular))


def _read_stamped(message: Message, fields: _Fields) -> PoseSample:
    pose = attrgetter(fields.pose)(message)
    x, y = _place(pose)
    theta = _heading(*_quaternion(pose), path=f"{fields.pose}.orientation")
    speeds = (0.0, 0.0)
    if fields.twist:
        ahead, aside, angular = _speeds(attrgetter(fields.twist)(message))
        speeds = math.hypot(ahead, aside), angular
    stamp: Time = _stamp(message)
    return PoseSample((x, y, theta), speeds, stamp.sec * 10**9 + stamp.nanosec or None)


def _heading(x: float, y: float, z: float, w: float, *, path: str) -> float:
    """Return the heading of a quaternion (rad). The quaternion may have any length above zero."""
    # Some drivers send quaternions that are not quite of length 1, and zeros before they know where
    # they are. A quaternion of any length has a heading, except one of length zero.
    if not x * x + y * y + z * z + w * w > 0.0:
        raise InvalidMessage(path, f"({x}, {y}, {z}, {w}) is no rotation")
    return wrap_angle(math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))
