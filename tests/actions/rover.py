"""A rover: a robot on two wheels that is none of ours, with odometry, and topics of its own."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, aclosing, asynccontextmanager
from typing import Any

from turtleact.actions import Area, Robot, Turtles, go_to, patrol
from turtleact.interfaces import from_dict
from turtleact.node import Node, open_node
from turtleact.tasks import Background
from turtleact.tasks.clock import VirtualClock
from turtleact.transports import MemoryTransport, QoS

TRACK = 0.4
"""Between the wheels (m)."""

WHEEL_SPEED = 1.2
"""The highest speed of a wheel (m/s)."""

WHEEL_ACCELERATION = 4.0
"""How fast a wheel gains speed (m/s²)."""

DT = 0.02
"""The odometry comes 50 times a second."""

ODOMETRY = Robot(
    pose_topic="/{turtle}/odom",
    pose_type="nav_msgs/msg/Odometry",
    twist_topic="/{turtle}/diff_drive/cmd_vel",
    twist_type="geometry_msgs/msg/TwistStamped",
    dt=DT,
    max_acceleration=1.0,
    max_angular_acceleration=3.0,
)
AREA = Area(-5.0, -5.0, 5.0, 5.0)


class Rover:
    """The robot, as a node: it does what its wheels can of what it is told.

    Attributes:
        pose: x, y (m), theta (rad).
        told: The speeds of each command.
        messages: Those commands as they came.
        age: How old its odometry is when it is published (s).
        is_silent: Whether it tells nothing.
        every: It tells its pose in every so manieth tick.
        turned: How far it has turned, to either side (rad).
    """

    def __init__(self, node: Node, robot: Robot, name: str = "rover") -> None:
        self.pose = (0.0, 0.0, 0.0)
        self.told = [(0.0, 0.0)]
        self.messages: list[Any] = []
        self.age = 0.0
        self.is_silent = False
        self.every = 1
        self.turned = 0.0
        self.orientation: dict[str, float] | None = None
        self.node = node
        self._robot = robot
        self._wheels = [0.0, 0.0]
        pose_topic, twist_topic = robot.topics(name)
        self.poses = node.publisher(robot.pose_class, pose_topic)
        self._twists = node.subscription(robot.twist_class, twist_topic, QoS(depth=1000))

    @property
    def speeds(self):
        left, right = self._wheels
        return (left + right) / 2, (right - left) / TRACK

    async def run(self):
        clock, ticks = self.node.clock, 0
        start = clock.time()
        while True:
            for twist in self._twists.drain():
                self.messages.append(twist)
                body: Any = getattr(twist, "twist", twist)
                self.told.append((body.linear.x, body.angular.z))
            self._roll()
            if not (self.is_silent or ticks % self.every):
                self.poses.publish(self._message())
            ticks += 1
            await clock.sleep_until(start + ticks * DT)

    def _roll(self):
        linear, angular = self.told[-1]
        for wheel, side in enumerate((-1, 1)):
            wanted = max(-WHEEL_SPEED, min(WHEEL_SPEED, linear + side * angular * TRACK / 2))
            change = wanted - self._wheels[wheel]
            most = WHEEL_ACCELERATION * DT
            self._wheels[wheel] += max(-most, min(most, change))
        linear, angular = self.speeds
        x, y, theta = self.pose
        middle = theta + angular * DT / 2
        self.turned += abs(angular) * DT
        x, y = x + linear * math.cos(middle) * DT, y + linear * math.sin(middle) * DT
        self.pose = (x, y, math.remainder(theta + angular * DT, math.tau))

    def _message(self):
        x, y, theta = self.pose
        linear, angular = self.speeds
        if self._robot.pose_type.startswith("turtlesim"):
            return from_dict(self._robot.pose_class, {"x": x, "y": y, "theta": theta})
        stamp = self.node.clock.now() - round(self.age * 1e9)
        header = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}}
        orientation = {"z": math.sin(theta / 2), "w": math.cos(theta / 2)}
        pose = {"position": {"x": x, "y": y}, "orientation": self.orientation or orientation}
        if self._robot.pose_type == "geometry_msgs/msg/PoseStamped":
            return from_dict(self._robot.pose_class, {"header": header, "pose": pose})
        fields = {"header": header, "pose": {"pose": pose}}
        if self._robot.pose_type == "nav_msgs/msg/Odometry":
            fields["twist"] = {"twist": {"linear": {"x": linear}, "angular": {"z": angular}}}
        return from_dict(self._robot.pose_class, fields)


@asynccontextmanager
async def rover(robot: Robot = ODOMETRY, area: Area = AREA) -> AsyncIterator[Rover]:
    """A rover in virtual time, and a node that serves ``/patrol`` and ``/go_to`` for it."""
    clock = VirtualClock()
    transport = MemoryTransport(clock)
    async with AsyncExitStack() as stack:
        open_up = stack.enter_async_context
        await open_up(aclosing(Background(clock.run(), "the clock")))
        one = Rover(await open_up(open_node("rover", transport=transport)), robot)
        await open_up(aclosing(Background(one.run(), "the rover")))
        actions = await open_up(open_node("actions", transport=transport))
        turtles = Turtles(actions, area, robot)
        patrol.serve(actions, turtles)
        go_to.serve(actions, turtles)
        yield one
