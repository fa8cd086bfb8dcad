"""The interfaces that ship: as data files, and some of them as classes.

The files hold the fields of ROS 2 Jazzy's interfaces, comments left out; ``get_interface`` finds
all of them. What turtleact itself handles, and what one types most, is here as a class; the
messages of parameters are in ``parameters``.
"""

from __future__ import annotations

from typing import ClassVar

from msgspec import field

from turtleact.interfaces.types import (
    Action,
    Message,
    Service,
    array,
    char,
    float32,
    float64,
    int8,
    int32,
    int64,
    string,
    uint8,
    uint32,
)

__all__ = [
    "UUID",
    "CancelGoal",
    "Color",
    "Duration",
    "Empty",
    "ExampleFibonacci",
    "Fibonacci",
    "GoalInfo",
    "GoalStatusArray",
    "GoalStatusMessage",
    "Kill",
    "PatrolCommandInterface",
    "Point",
    "RotateAbsolute",
    "ServiceEventInfo",
    "SetPen",
    "Spawn",
    "TeleportAbsolute",
    "TeleportRelative",
    "Time",
    "TurtlePose",
    "Twist",
    "Vector3",
]


class Time(Message, type_name="builtin_interfaces/msg/Time"):
    """A point in time: seconds and nanoseconds of a clock."""

    sec: int32 = 0
    nanosec: uint32 = 0


class Duration(Message, type_name="builtin_interfaces/msg/Duration"):
    """A length of time, in seconds and nanoseconds."""

    sec: int32 = 0
    nanosec: uint32 = 0


class UUID(Message, type_name="unique_identifier_msgs/msg/UUID"):
    """A universally unique id of 16 bytes."""

    uuid: array[bytes, 16] = bytes(16)


class GoalInfo(Message, type_name="action_msgs/msg/GoalInfo"):
    """A goal's id, and when it was accepted."""

    goal_id: UUID = field(default_factory=UUID)
    stamp: Time = field(default_factory=Time)


class GoalStatusMessage(Message, type_name="action_msgs/msg/GoalStatus"):
    """A goal and its state, as sent; ``turtleact.GoalStatus`` is the enum."""

    STATUS_UNKNOWN: ClassVar[int8] = 0
    STATUS_ACCEPTED: ClassVar[int8] = 1
    STATUS_EXECUTING: ClassVar[int8] = 2
    STATUS_CANCELING: ClassVar[int8] = 3
    STATUS_SUCCEEDED: ClassVar[int8] = 4
    STATUS_CANCELED: ClassVar[int8] = 5
    STATUS_ABORTED: ClassVar[int8] = 6

    goal_info: GoalInfo = field(default_factory=GoalInfo)
    status: int8 = 0


class GoalStatusArray(Message, type_name="action_msgs/msg/GoalStatusArray"):
    """The goals that an action server holds."""

    status_list: list[GoalStatusMessage] = field(default_factory=list)


class CancelGoal(Service, type_name="action_msgs/srv/CancelGoal"):
    """Asks an action server to cancel goals, selected by id and stamp."""

    class Request(Message):
        """Zeros in the id, and in the stamp, select every goal."""

        goal_info: GoalInfo = field(default_factory=GoalInfo)

    class Response(Message):
        """What came of it, and the goals that are canceling now."""

        ERROR_NONE: ClassVar[int8] = 0
        ERROR_REJECTED: ClassVar[int8] = 1
        ERROR_UNKNOWN_GOAL_ID: ClassVar[int8] = 2
        ERROR_GOAL_TERMINATED: ClassVar[int8] = 3

        return_code: int8 = 0
        goals_canceling: list[GoalInfo] = field(default_factory=list)


class ServiceEventInfo(Message, type_name="service_msgs/msg/ServiceEventInfo"):
    """Which call of a service an event is about, and what has just happened to it."""

    REQUEST_SENT: ClassVar[uint8] = 0
    REQUEST_RECEIVED: ClassVar[uint8] = 1
    RESPONSE_SENT: ClassVar[uint8] = 2
    RESPONSE_RECEIVED: ClassVar[uint8] = 3

    event_type: uint8 = 0
    stamp: Time = field(default_factory=Time)
    client_gid: array[list[char], 16] = field(default_factory=lambda: [0] * 16)
    sequence_number: int64 = 0


class Point(Message, type_name="geometry_msgs/msg/Point"):
    """A place in space (m)."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


class Vector3(Message, type_name="geometry_msgs/msg/Vector3"):
    """A direction and length in space."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


class Twist(Message, type_name="geometry_msgs/msg/Twist"):
    """A velocity: linear (m/s) and angular (rad/s)."""

    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


class TurtlePose(Message, type_name="turtlesim/msg/Pose"):
    """Where a turtle is (m, rad) and how it moves (m/s, rad/s)."""

    x: float32 = 0.0
    y: float32 = 0.0
    theta: float32 = 0.0
    linear_velocity: float32 = 0.0
    angular_velocity: float32 = 0.0


class Color(Message, type_name="turtlesim/msg/Color"):
    """The colour of the drawing under a turtle."""

    r: uint8 = 0
    g: uint8 = 0
    b: uint8 = 0


class Empty(Service, type_name="std_srvs/srv/Empty"):
    """A call without words."""

    class Request(Message):
        """Nothing."""

    class Response(Message):
        """Nothing."""


class Spawn(Service, type_name="turtlesim/srv/Spawn"):
    """Puts a new turtle into the world."""

    class Request(Message):
        """Where (m, rad), and its name; one is made up if it is empty."""

        x: float32 = 0.0
        y: float32 = 0.0
        theta: float32 = 0.0
        name: string = ""

    class Response(Message):
        """The name; empty if there is no new turtle."""

        name: string = ""


class Kill(Service, type_name="turtlesim/srv/Kill"):
    """Takes a turtle out of the world."""

    class Request(Message):
        """Which one."""

        name: string = ""

    class Response(Message):
        """Nothing."""


class SetPen(Service, type_name="turtlesim/srv/SetPen"):
    """Changes a turtle's pen."""

    class Request(Message):
        """The colour, the width (pixels, 0 is 1), and whether the pen is off."""

        r: uint8 = 0
        g: uint8 = 0
        b: uint8 = 0
        width: uint8 = 0
        off: uint8 = 0

    class Response(Message):
        """Nothing."""


class TeleportAbsolute(Service, type_name="turtlesim/srv/TeleportAbsolute"):
    """Puts a turtle somewhere else."""

    class Request(Message):
        """Where (m, rad)."""

        x: float32 = 0.0
        y: float32 = 0.0
        theta: float32 = 0.0

    class Response(Message):
        """Nothing."""


class TeleportRelative(Service, type_name="turtlesim/srv/TeleportRelative"):
    """Turns a turtle, then puts it ahead."""

    class Request(Message):
        """How far ahead (m), and how far to turn (rad)."""

        linear: float32 = 0.0
        angular: float32 = 0.0

    class Response(Message):
        """Nothing."""


class RotateAbsolute(Action, type_name="turtlesim/action/RotateAbsolute"):
    """Turns a turtle to a heading."""

    class Goal(Message):
        """The heading (rad)."""

        theta: float32 = 0.0

    class Result(Message):
        """The heading at the start minus the one at the end (rad)."""

        delta: float32 = 0.0

    class Feedback(Message):
        """How far it still is (rad)."""

        remaining: float32 = 0.0


class Fibonacci(Action, type_name="action_tutorials_interfaces/action/Fibonacci"):
    """The action of the ROS 2 tutorials."""

    class Goal(Message):
        """How far to go."""

        order: int32 = 0

    class Result(Message):
        """The whole sequence."""

        sequence: list[int32] = field(default_factory=list)

    class Feedback(Message):
        """The sequence so far."""

        partial_sequence: list[int32] = field(default_factory=list)


class ExampleFibonacci(Action, type_name="example_interfaces/action/Fibonacci"):
    """The action of the ROS 2 examples, whose feedback is named otherwise."""

    class Goal(Message):
        """How far to go."""

        order: int32 = 0

    class Result(Message):
        """The whole sequence."""

        sequence: list[int32] = field(default_factory=list)

    class Feedback(Message):
        """The sequence so far."""

        sequence: list[int32] = field(default_factory=list)


class PatrolCommandInterface(Action, type_name="patrol_interfaces/action/PatrolCommandInterface"):
    """Sends a turtle from target to target."""

    class Goal(Message):
        """The places to visit, in order."""

        targets: list[Point] = field(default_factory=list)

    class Result(Message):
        """How it went, in words."""

        result_msg: string = ""

    class Feedback(Message):
        """What was reached last, in words."""

        feedback_msg: string = ""
