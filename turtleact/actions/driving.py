"""Drives turtles to the targets of goals.

`Turtles` knows the area in which the turtles of a graph may move, and which turtles are being
driven. Only one goal at a time drives a turtle. A `Drive` takes a turtle from target to target: it
reads poses from one topic and publishes twists on another. A drive needs only these two topics, so
it can drive any `Robot`.

What can go wrong on the way:

- If somebody else moves the turtle, the drive continues from the turtle's new place.
- If no pose arrives for half a second, the drive stops the turtle and continues with the next pose.
  After two seconds without poses, or once nobody publishes the poses any more, the drive fails.
- A pose is ignored if its stamp is too old, or older than the stamp of an earlier pose.
- If poses arrive faster or slower than ``Robot.dt`` says, commands are calculated for the measured
  time between two poses.

If a robot keeps its commands (see `Robot.keeps_commands`), the drive steers only with every few
poses, and checks in between whether the turtle has reached its target. A fleet then needs half the
processor time.

While a goal is paused, its turtle stands still, the turtle's poses are ignored, and `Drive.time`
does not advance. A pause therefore delays the goal, but uses up none of the goal's time limits.
"""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any, Final, cast

import anyio
from msgspec.structs import replace

from turtleact.actions.robots import PoseSample, Robot
from turtleact.actions.steering import STILL, Area, Limits, Steering, time_limit
from turtleact.errors import Abort, InvalidMessage, InvalidName, Reject
from turtleact.geometry import distance
from turtleact.interfaces.standard import Point, TurtlePose
from turtleact.names import resolve_name, validate_name
from turtleact.tasks import Background

if TYPE_CHECKING:
    from turtleact.actions.steering import Speeds
    from turtleact.interfaces import Message
    from turtleact.node import Node, ServerGoalHandle
    from turtleact.node.topics import Publisher, Subscription

__all__ = ["PATIENCE", "Drive", "Turtles"]

PAUSE: Final = 0.5
"""The interval (s) at which a drive checks whether a new pose has arrived.

If no new pose has arrived, the drive stops its turtle. The turtle therefore stops between one and
two `PAUSE` after its last pose.
"""

SILENCE: Final = 2.0
"""A drive fails if no pose arrives for this long (s).

A drive checks for poses only every `PAUSE` seconds, so the failure may come up to `PAUSE` later.
"""

PATIENCE: Final = 2.0
"""A drive gives up a target after `time_limit`, multiplied by this factor."""

LEARNING: Final = 0.3
"""The weight of the newest pose interval in the moving average of the pose intervals."""

MOST_HELD: Final = 8
"""A command is held for at most this many poses."""

_TURN_HELD: Final = 0.3
"""While a command is held, the turtle turns by at most this angle (rad)."""

_WAY_HELD: Final = 3.0
"""While a command is held, the turtle drives at most this many tolerances far."""


class Drive:
    """Drives one turtle to the targets of a goal.

    Attributes:
        travelled: The distance that the turtle has driven (m).
    """

    def __init__(self, node: Node, robot: Robot, turtle: str, steering: Steering) -> None:
        self.travelled = 0.0
        self._node = node
        self._clock = node.clock
        self._robot = robot
        self._turtle = turtle
        self._steering = steering
        self._speeds: Speeds = STILL
        self._seen = PoseSample((0.0, 0.0, 0.0))
        self._unread: TurtlePose | None = None  # newer than `_seen`
        self._pace = robot.dt
        self._steered: float | None = None
        self._poses_since = 0
        self._held_for = _poses_to_hold(robot, steering.limits)
        self._target = (math.inf, math.inf)
        self._until = -math.inf  # the first pose wakes the drive
        self._paused: anyio.Event | None = None  # set when the turtle is released
        self._passed_over = 0.0
        self._heard = self._clock.time()  # when the last pose came
        self._pose_topic, self._twist_topic = robot.topics(turtle)
        self._nothing_heard = f"nothing was heard of {self._pose_topic} for {SILENCE:g} s"
        self._why = self._nothing_heard
        self._poses: Subscription[Message] = node.subscription(robot.pose_class, self._pose_topic)
        self._poses.taker = self._take
        self._twists: Publisher[Message] = node.publisher(robot.twist_class, self._twist_topic)
        self._watch = Background(self._keep_watch(), f"the watch over {self._pose_topic}")

    @property
    def seen(self) -> PoseSample:
        """The turtle's place and speed according to its newest pose."""
        if self._unread is not None:
            self._seen, self._unread = self._robot.read(self._unread), None
        return self._seen

    @property
    def pose(self) -> TurtlePose:
        """The newest pose as a message of turtlesim."""
        return TurtlePose(*self.seen.pose, *self.seen.speeds)

    def has_reached(self, target: Point, *, theta: float | None = None) -> bool:
        """Whether the turtle is at a target and, if ``theta`` is given, has that heading (rad)."""
        return self._steering.is_reached(self.seen.pose, (target.x, target.y), theta=theta)

    def distance_to(self, target: Point) -> float:
        """Return the length of the straight line from the turtle to a target (m)."""
        return distance(*self.seen.pose[:2], target.x, target.y)

    def time(self) -> float:
        """Return the time of the drive (s): the time of the node's clock without the pauses.

        A pause counts from the last pose before the pause to the last pose during the pause. Poses
        come once per tick, so each pause counts as a whole number of ticks. The time is rounded to
        nanoseconds, to remove the rounding errors that arise when the lengths of pauses are added
        up.
        """
        return round(self._clock.time() - self._passed_over, 9)

    def hold(self) -> None:
        """Stop the turtle from the next tick on, until `release` is called."""
        if self._paused is None:
            self._paused = anyio.Event()
            self._forget_speeds()
            self._publish(STILL)

    def release(self) -> None:
        """Let the turtle go on after `hold`.

        With limited accelerations, the turtle starts from rest. Otherwise it continues at once at
        the speeds that it had before `hold`.
        """
        if self._paused is not None:
            self._paused.set()
            self._paused = None
            self._publish(self._speeds)

    def deadline(self, target: Point, *, theta: float | None = None) -> float:
        """Return when to give up a target, in seconds on the drive's clock (see `time`)."""
        stops = [(target.x, target.y)]
        limit = time_limit(self.seen.pose, stops, self._steering.limits, theta=theta)
        return self.time() + PATIENCE * limit

    def too_late(self, target: str) -> Abort:
        """Return the error for a target that was not reached in time, with a possible reason."""
        others = self._node.count_publishers(self._twist_topic) > 1
        hint = f": somebody else publishes {self._twist_topic} too" if others else ""
        return Abort(f"{target} was not reached in time{hint}")

    async def towards(
        self,
        target: Point,
        next_target: Point | None = None,
        *,
        theta: float | None = None,
        until: float = math.inf,
    ) -> None:
        """Steer once, and wait for the pose with which to steer again.

        Args:
            target: The target to drive to (m).
            next_target: The target after ``target`` (m).
            theta: The wanted heading at the target (rad); None for any heading.
            until: A deadline on the clock of `time` (s). The method returns no later than with the
                first pose at or after this deadline.

        Raises:
            Abort: if no pose of the turtle arrives.
        """
        after = None if next_target is None else (next_target.x, next_target.y)
        # Hold no command across a silence: the watch may have stopped the turtle meanwhile.
        self._target, self._until = (target.x, target.y), min(until, self.time() + PAUSE)
        self._steer(self._target, after, theta=theta)
        await self.wait_for_pose()

    async def rest(self) -> None:
        """Brake until the turtle stands still.

        With unlimited accelerations, this does nothing, because `aclose` stops the turtle at once.

        Raises:
            Abort: if no pose of the turtle arrives.
        """
        while self._steering.limits.is_eased and self._speeds != STILL:
            await self.stay()

    async def stay(self) -> None:
        """Brake, or stand still, until the next pose.

        Raises:
            Abort: if no pose of the turtle arrives.
        """
        self._until = -math.inf
        self._steer(self.seen.pose[:2])
        await self.wait_for_pose()

    async def wait_for_pose(self) -> None:
        """Wait for the next pose. If several poses have already arrived, use only the newest.

        Between `hold` and `release`, the method does not return.

        Raises:
            Abort: if no pose arrives, or if a pose is not valid.
        """
        while True:
            try:
                message = await anext(self._poses)
            except StopAsyncIteration:
                raise Abort(self._why) from None
            # More may have come while this task waited for its turn. Only the newest tells where
            # the turtle is now; steering by an older one would swing.
            for message in self._poses.drain():  # noqa: B007
                pass
            seen = self._read(message)
            if not self._objection(seen):
                break
        self.travelled += distance(*self.seen.pose[:2], *seen.pose[:2])
        self._seen = seen
        self._keep_pace()
        while self._paused is not None:
            await self._paused.wait()

    async def aclose(self) -> None:
        """Stop the turtle where it is, and close its topics."""
        # Before the first await: a cancelled task may not get another turn, and a turtle that keeps
        # its commands would drive on for a second.
        self._tell(STILL)
        await self._watch.aclose()
        await self._twists.aclose()
        await self._poses.aclose()

    def _steer(
        self,
        target: tuple[float, float],
        after: tuple[float, float] | None = None,
        *,
        theta: float | None = None,
    ) -> None:
        self._tell(self._steering.command(self.seen.pose, target, after, self._speeds, theta=theta))

    def _take(self, message: Message) -> bool:
        """Return False to wake the drive for a new command, or True to let the drive wait.

        While the last command is held, record the pose. While the goal is paused, ignore the pose.
        """
        # This is called while a pose is being published, 62 times a second for each turtle. It must
        # be short and must not await. It reads the whole message only if somebody asks for it.
        before, self._heard = self._heard, self._clock.time()
        if self._paused is not None:
            self._passed_over += self._heard - before
            if not self._robot.keeps_commands:
                self._publish(STILL)
            return True
        self._poses_since += 1
        if self._poses_since >= self._held_for or self.time() >= self._until:
            return False
        pose = cast("TurtlePose", message)  # only a turtle of turtlesim keeps its commands
        if distance(pose.x, pose.y, *self._target) <= self._steering.limits.tolerance:
            return False
        self.travelled += distance(*self._place, pose.x, pose.y)
        self._unread = pose
        return True

    @property
    def _place(self) -> tuple[float, float]:
        if self._unread is not None:
            return self._unread.x, self._unread.y
        return self._seen.pose[:2]

    def _keep_pace(self) -> None:
        """Measure the time between poses, which may differ from ``Robot.dt``."""
        before, self._steered = self._steered, self.time()
        poses, self._poses_since = max(1, self._poses_since), 0
        if before is not None:
            # One pose may be late by chance: a time longer than twice the estimate counts as twice
            # the estimate.
            lasted = min((self._steered - before) / poses, 2.0 * self._pace)
            self._pace += LEARNING * (lasted - self._pace)
        limits = self._steering.limits
        dt = max(self._robot.dt / 8.0, self._pace) * self._held_for
        dt = min(dt, math.pi / 2.0 / limits.max_angular)
        if abs(dt - limits.dt) > limits.dt / 4.0:
            self._steering = replace(self._steering, limits=replace(limits, dt=dt))

    def _read(self, message: Message) -> PoseSample:
        try:
            return self._robot.read(message)
        except InvalidMessage as error:
            raise Abort(f"{self._pose_topic}: {error}") from None

    def _forget_speeds(self) -> None:
        """If the accelerations are limited, let the law start from rest."""
        if self._steering.limits.is_eased:
            self._speeds = STILL

    def _tell(self, speeds: Speeds) -> None:
        self._speeds = speeds
        if self._paused is None:
            self._publish(speeds)

    def _publish(self, speeds: Speeds) -> None:
        self._twists.publish(self._robot.write(speeds, self._clock.now()))

    async def _keep_watch(self) -> None:
        """Stop the turtle when no more poses arrive.

        After `SILENCE` seconds without poses, end the drive, so that `wait_for_pose` raises Abort.
        If the pose topic has lost its publishers, end the drive sooner.
        """
        last: Message | None = None
        silence = 0.0
        while silence < SILENCE:
            await self._clock.sleep(PAUSE)
            latest = self._poses.latest
            if latest is not None and latest is not last and self._is_heard(latest):
                last, silence = latest, 0.0
                continue
            silence += PAUSE
            if not self._node.count_publishers(self._pose_topic):
                what = f"nobody publishes {self._pose_topic} any more"
                self._why = f"turtle '{self._turtle}' is gone: {what}"
                break
            if silence == PAUSE:
                self._tell(STILL)
        await self._poses.aclose()
        self._speeds = STILL
        self.release()  # a driver that waits for the release gives up, too

    def _is_heard(self, message: Message) -> bool:
        """Return whether a pose can be used. If not, record why, for a later error message."""
        try:
            seen = self._robot.read(message)
        except InvalidMessage:  # the driver reads it again and reports the error
            return True
        objection = self._objection(seen)
        self._why = objection or self._nothing_heard
        return not objection

    def _objection(self, seen: PoseSample) -> str:
        """Return why a pose must not be used, or an empty string for a usable pose."""
        if seen.stamp is None:
            return ""
        age = (self._clock.now() - seen.stamp) / 1e9
        if age > self._robot.max_age:
            problem = f"by its stamp, the last one is {age:.3g} s old"
            return f"{self._pose_topic} publishes old poses: {problem}; set the clocks, or max_age"
        back = ((self.seen.stamp or 0) - seen.stamp) / 1e9
        return f"the stamps of {self._pose_topic} went back by {back:.3g} s" if back > 0.0 else ""


def _poses_to_hold(robot: Robot, limits: Limits) -> int:
    """Return the number of poses for which each command is held."""
    if limits.is_eased or not robot.keeps_commands:
        return 1
    longest = min(_TURN_HELD / limits.turn, _WAY_HELD * limits.tolerance / limits.step)
    return max(1, min(MOST_HELD, int(longest)))


class Turtles:
    """The turtles of a graph, and the drives of these turtles.

    Args:
        node: The node that opens the topics of the turtles.
        area: The area in which targets must lie (m).
        robot: The kind of robot to drive; None for the turtles of turtlesim.
    """

    def __init__(self, node: Node, area: Area, robot: Robot | None = None) -> None:
        self._node = node
        self._area = area
        self._robot = robot or Robot()
        self._driven: set[str] = set()
        self._drives: dict[bytes, Drive] = {}

    def steering(self, goal: Any, heading_tolerance: float = 0.0) -> Steering:  # noqa: ANN401  # of any action that drives
        """Return the steering law for these turtles with the options of a goal.

        Args:
            goal: The goal message.
            heading_tolerance: How far the turtle's heading may be from the wanted heading (rad); 0
                for the default.

        Raises:
            Reject: if the style does not exist, or a number is out of its range.
        """
        robot = self._robot
        if goal.max_angular > robot.fastest:
            most = f"{robot.fastest:.4g} rad/s at most"
            raise Reject(f"max_angular: must be {most}, not {goal.max_angular}")
        try:
            limits = Limits(
                max_linear=goal.max_linear,
                max_angular=goal.max_angular,
                max_acceleration=robot.max_acceleration,
                max_angular_acceleration=robot.max_angular_acceleration,
                tolerance=goal.tolerance,
                heading_tolerance=heading_tolerance or Limits().heading_tolerance,
                dt=robot.dt,
                area=self._area,
            )
            return Steering(goal.style, limits)
        except InvalidMessage as error:
            raise Reject(str(error)) from None

    def check_turtle(self, turtle: str) -> None:
        """Check that a turtle can be driven.

        Raises:
            Reject: if the name is not valid, nobody publishes the turtle's pose, or another goal
                drives the turtle.
        """
        poses, _ = self._robot.topics(turtle)
        try:
            if turtle:
                validate_name(turtle)
            publishers = self._node.count_publishers(poses)
        except InvalidName as error:
            raise Reject(f"'{turtle}' is not a valid name of a turtle: {error.problem}") from None
        if not publishers:
            raise Reject(f"there is no turtle '{turtle}': nobody publishes {poses}")
        if self._topic(turtle) in self._driven:
            raise Reject(_taken(turtle))

    def check_target(self, target: Point, *, path: str = "") -> None:
        """Check that a target is inside the area.

        Args:
            target: The target (m).
            path: A prefix for the coordinate's name in the error, such as ``targets[2].``.

        Raises:
            Reject: if the target is outside the area. The error names the first coordinate that is
                outside.
        """
        area = self._area
        ranges = {"x": (area.left, area.right), "y": (area.bottom, area.top)}
        for name, (low, high) in ranges.items():
            value = getattr(target, name)
            if not low <= value <= high:
                problem = f"is {value}, outside the world: from {low:.9g} to {high:.9g}"
                raise Reject(f"{path}{name} {problem}")

    @asynccontextmanager
    async def drive(
        self, turtle: str, steering: Steering, goal: ServerGoalHandle[Any, Any, Any] | None = None
    ) -> AsyncIterator[Drive]:
        """Open a `Drive` of a turtle. The turtle stops at the end of the ``async with`` block.

        The turtle also stops if the block raises an error.

        Args:
            turtle: The name of the turtle.
            steering: The steering law.
            goal: The goal for which the turtle is driven. While the goal is paused, the turtle
                stands still.

        Raises:
            Abort: if no pose of the turtle arrives, or another goal drives the turtle already.
        """
        topic = self._topic(turtle)
        # Two goals may have been accepted before either has begun: `check_turtle` saw neither.
        if topic in self._driven:
            raise Abort(_taken(turtle))
        drive = Drive(self._node, self._robot, turtle, steering)
        self._driven.add(topic)
        if goal is not None:
            self._drives[goal.goal_id] = drive
            if goal.is_paused:  # the goal was paused before its body began
                drive.hold()
        try:
            # The first pose only says where the turtle is: nothing has been travelled yet.
            await drive.wait_for_pose()
            drive.travelled = 0.0
            yield drive
        finally:
            self._driven.discard(topic)
            if goal is not None:
                del self._drives[goal.goal_id]
            await drive.aclose()

    async def hold(self, goal: ServerGoalHandle[Any, Any, Any]) -> None:
        """Stop the turtle of a paused goal. This is an ``on_pause`` callback."""
        if goal.goal_id in self._drives:
            self._drives[goal.goal_id].hold()

    async def release(self, goal: ServerGoalHandle[Any, Any, Any]) -> None:
        """Let the turtle of a resumed goal go on. This is an ``on_resume`` callback."""
        if goal.goal_id in self._drives:
            self._drives[goal.goal_id].release()

    def _topic(self, turtle: str) -> str:
        """Return the full name of a turtle's pose topic.

        A relative and an absolute name of the same turtle give the same full name.
        """
        poses, _ = self._robot.topics(turtle)
        return resolve_name(poses, self._node.namespace, self._node.name)


def _taken(turtle: str) -> str:
    return f"turtle '{turtle}' is being driven by another goal"
