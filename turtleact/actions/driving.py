"""The turtles that actions can drive, and the way of one turtle to its targets.

`Turtles` knows the turtles of the graph, the area in which they may move, and the goals that drive
them. Only one goal at a time drives a turtle. A `Drive` takes a turtle from target to target: it
reads poses from one topic and publishes twists on another. A drive needs nothing else, so it can
drive any `Robot`.

What can go wrong on the way:

- If somebody else moves the turtle, the drive continues from its new place.
- If no pose arrives for half a second, the drive stops the turtle and continues with the next pose.
  The drive gives up after two seconds, or once nobody publishes the pose any more.
- A pose that is too old, or older than one seen before, is ignored.
- If poses arrive faster or slower than ``Robot.dt`` says, each command is calculated for the actual
  time until the next pose.

A robot that keeps its last command gets another one only when the command changes. While such a
robot's poses are as expected, they do not wake the driver.

While a goal is paused, its drive is held: the turtle stands still, its poses are ignored, and the
time of the drive stands still. A pause therefore changes nothing but the duration.
"""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, cast

import anyio.lowlevel
from msgspec.structs import replace

from turtleact.actions.robots import Robot, Sighting
from turtleact.actions.steering import (
    STILL,
    Area,
    Helm,
    Limits,
    Steering,
    rising_times,
    time_bound,
)
from turtleact.errors import Abort, InvalidMessage, InvalidName, Reject
from turtleact.geometry import distance
from turtleact.interfaces.standard import Point, TurtlePose
from turtleact.names import resolve_name, validate_name
from turtleact.tasks import Background

if TYPE_CHECKING:
    from turtleact.actions.steering import Speeds, Style
    from turtleact.interfaces import Message
    from turtleact.node import Node, ServerGoalHandle
    from turtleact.topics import Publisher, Subscription

__all__ = ["PATIENCE", "Drive", "Turtles"]

PAUSE: Final = 0.5
"""The drive stops a turtle after this time (s) without poses, or after at most twice this time."""

SILENCE: Final = 2.0
"""A drive fails after this time (s) without poses, or at most `PAUSE` later."""

PATIENCE: Final = 2.0
"""A target is given up after this multiple of the longest time that the steering law needs."""

LEARNING: Final = 0.3
"""With each pose, the measured time between poses moves by this share towards the newest time."""


class Drive:
    """The way of one turtle to the targets of a goal.

    Attributes:
        travelled: How far it has gone (m).
    """

    def __init__(
        self, node: Node, robot: Robot, turtle: str, steering: Steering, proving: anyio.Lock
    ) -> None:
        self.travelled = 0.0
        self._proving = proving
        self._seen = Sighting((0.0, 0.0, 0.0))
        self._taken: TurtlePose | None = None
        self._taken_since = 0
        self._node = node
        self._clock = node.clock
        self._pace = robot.dt
        self._decided: float | None = None
        self._robot = robot
        self._turtle = turtle
        self._helm = Helm(steering) if robot.keeps_commands else Helm(steering, longest=1)
        self._until = math.inf
        self._held: anyio.Event | None = None  # set when the turtle is released
        self._is_standing = False
        self._passed_over = 0.0
        self._heard = self._clock.time()  # when the last pose came
        self._pose_topic, self._twist_topic = robot.topics(turtle)
        self._nothing_heard = f"nothing was heard of {self._pose_topic} for {SILENCE:g} s"
        self._why = self._nothing_heard
        self._poses: Subscription[Message] = node.subscription(robot.pose_class, self._pose_topic)
        if robot.keeps_commands:
            self._poses.taker = cast("Callable[[Message], bool]", self._take)
        self._twists: Publisher[Message] = node.publisher(robot.twist_class, self._twist_topic)
        self._watch = Background(self._keep_watch(), f"the watch over {self._pose_topic}")

    @property
    def seen(self) -> Sighting:
        """The place and heading of the newest pose."""
        if self._taken is not None:
            self._seen, self._taken = self._robot.read(self._taken), None
        return self._seen

    @seen.setter
    def seen(self, sighting: Sighting) -> None:
        self._seen, self._taken = sighting, None

    @property
    def pose(self) -> TurtlePose:
        """The newest pose, as turtlesim's message."""
        return TurtlePose(*self.seen.pose, *self.seen.speeds)

    def has_reached(self, target: Point, *, theta: float | None = None) -> bool:
        """Whether the turtle has reached a target and, if given, the heading ``theta`` (rad)."""
        return self._helm.steering.is_reached(self.seen.pose, (target.x, target.y), theta=theta)

    def distance_to(self, targets: Sequence[Point]) -> float:
        """The length of the straight lines from here through the targets (m)."""
        stops = [self.seen.pose[:2], *((target.x, target.y) for target in targets)]
        return sum(distance(*a, *b) for a, b in pairwise(stops))

    def time(self) -> float:
        """The time of the drive (s): that of the node's clock, minus the time during pauses.

        The time advances with each pose. A pause therefore takes out exactly the ticks that it
        lasts, no matter when between two ticks it begins and ends. The time is rounded to
        nanoseconds, because the rounding errors of added pauses could otherwise put a moment after
        its tick.
        """
        return round(self._clock.time() - self._passed_over, 9)

    def hold(self) -> None:
        """Let the turtle stand still from the next tick on, until `release`."""
        if self._held is None:
            self._held = anyio.Event()
            if self._helm.steering.limits.is_eased:
                self._helm.stop()
            self._publish(STILL)

    def release(self) -> None:
        """Let the turtle go on.

        With limited accelerations, the turtle starts from rest. Otherwise it moves at its earlier
        speeds at once.
        """
        if self._held is None:
            return
        self._held.set()
        self._held = None
        if self._helm.steering.limits.is_eased:
            self._helm.stop()  # the law starts from rest, with the next pose
        elif not self._is_standing:  # else a pose has come that needs a new command
            self._publish(self._helm.speeds)

    async def checkpoint(self) -> None:
        """Let other tasks run, and wait while the turtle is held."""
        await anyio.lowlevel.checkpoint()
        await self._stand()

    def deadline(self, target: Point, *, theta: float | None = None) -> float:
        """When to give up a target, by the time of the drive (s)."""
        stops = [(target.x, target.y)]
        bound = time_bound(self.seen.pose, stops, self._helm.steering, theta=theta)
        return self.time() + PATIENCE * bound

    async def shortest_time(self, targets: Sequence[Point], *, theta: float | None = None) -> float:
        """The shortest possible time (s) from here through the targets.

        The calculation runs step by step, for one turtle at a time, so that other tasks can run in
        between.
        """
        stops, least = [(target.x, target.y) for target in targets], 0.0
        async with self._proving:
            for time in rising_times(self.seen.pose, stops, self._helm.steering, theta=theta):
                least = max(least, time)
                await anyio.lowlevel.checkpoint()
        await self._stand()
        return least

    def too_late(self, target: str) -> Abort:
        """The error for a target that was not reached in time, with a possible cause."""
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
        """Drive for one tick, or for longer while the same command stays right.

        Args:
            target: The target to drive to.
            next_target: The target after that.
            theta: The heading at the target (rad). If left out, any heading will do.
            until: This returns no later than the first tick at or after this time of the drive (s).

        Raises:
            Abort: if no pose of the turtle arrives.
        """
        after = None if next_target is None else (next_target.x, next_target.y)
        self._tell(self._helm.command(self.seen.pose, (target.x, target.y), after, theta=theta))
        self._until = until
        await self.wait_for_pose()

    async def rest(self) -> None:
        """Stop as fast as the accelerations allow. If they are not limited, this takes no tick.

        Raises:
            Abort: if no pose of the turtle arrives.
        """
        while self._helm.steering.limits.is_eased and self._helm.speeds != STILL:
            await self.stay()

    async def stay(self) -> None:
        """Come to rest for one tick.

        Raises:
            Abort: if no pose of the turtle arrives.
        """
        here = self.seen.pose
        self._tell(self._helm.command(here, here[:2]))
        self._until = -math.inf
        await self.wait_for_pose()

    async def wait_for_pose(self) -> None:
        """Wait for the next pose. If poses have already come, take the newest.

        While the turtle is held, this does not return.

        Raises:
            Abort: if no pose arrives, or it is not valid.
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
            if self._objection(seen):
                continue
            if self._robot.keeps_commands:  # `_take` ignores poses and notes when they come
                break
            if self._held is None:
                self._heard = self._clock.time()
                break
            self._pass_over()
            self._publish(STILL)
        self.travelled += distance(*self.seen.pose[:2], *seen.pose[:2])
        self._seen = seen
        self._keep_pace(is_a_tick=self._robot.keeps_commands and self._helm.foresees(seen.pose))
        await self._stand()

    async def aclose(self) -> None:
        """Stop the turtle where it is, and close its topics."""
        # Before the first await: a cancelled task may not get another turn, and a turtle that keeps
        # its commands would drive on for a second.
        self._stop()
        await self._watch.aclose()
        await self._twists.aclose()
        await self._poses.aclose()

    def _take(self, message: TurtlePose) -> bool:
        """Take a pose if it needs no new command; return whether the driver can sleep on."""
        # This is called while a pose is being published, 62 times a second for each turtle. It must
        # be short and must not await. It reads the whole message only if somebody asks for it.
        if self._held is not None:
            self._pass_over()
            return True
        helm, x, y = self._helm, message.x, message.y
        before, self._heard = helm.at, self._clock.time()
        if not helm.holds((x, y, message.theta)) or self.time() >= self._until:
            return False
        self.travelled += math.hypot(x - before[0], y - before[1])
        self._taken = message
        self._taken_since += 1
        return True

    def _pass_over(self) -> None:
        """Ignore a pose that came while the turtle was held: for the turtle, no time has passed."""
        now = self._clock.time()
        self._passed_over += now - self._heard
        self._heard = now

    async def _stand(self) -> None:
        """Wait while the turtle is held."""
        self._is_standing = True
        try:
            while self._held is not None:
                await self._held.wait()
        finally:
            self._is_standing = False

    def _keep_pace(self, *, is_a_tick: bool) -> None:
        """Measure the time between poses, which may differ from ``Robot.dt``.

        If the turtle has moved by exactly one tick, one tick has passed for it, however late the
        machine is.
        """
        before, self._decided = self._decided, self.time()
        poses, self._taken_since = 1 + self._taken_since, 0
        if before is None:
            return
        # One pose may be late by chance. Each pose moves the estimate by the share `LEARNING`. A
        # time longer than twice the estimate counts as twice the estimate.
        lasted = self._robot.dt if is_a_tick else (self._decided - before) / poses
        change = min(lasted, 2.0 * self._pace) - self._pace
        self._pace += (1.0 - (1.0 - LEARNING) ** poses) * change
        limits = self._helm.steering.limits
        dt = min(max(self._robot.dt / 8.0, self._pace), math.pi / 2.0 / limits.max_angular)
        # A new law drops the command that the helm holds, so a small change of the pace does not
        # make a new law.
        if abs(dt - limits.dt) > limits.dt / 4.0:
            limits = replace(limits, dt=dt)
            self._helm.steering = replace(self._helm.steering, limits=limits)

    def _read(self, message: Message) -> Sighting:
        try:
            return self._robot.read(message)
        except InvalidMessage as error:
            raise Abort(f"{self._pose_topic}: {error}") from None

    def _stop(self) -> None:
        self._helm.stop()
        self._tell(STILL)

    def _tell(self, speeds: Speeds) -> None:
        if self._held is None:
            self._publish(speeds)

    def _publish(self, speeds: Speeds) -> None:
        self._twists.publish(self._robot.write(speeds, self._clock.now()))

    async def _keep_watch(self) -> None:
        """Stop the turtle when its poses stop arriving.

        If they do not come back, fail the waiting goal.
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
                self._stop()
        await self._poses.aclose()
        self._helm.stop()
        self.release()  # a driver that waits for the release gives up, too

    def _is_heard(self, message: Message) -> bool:
        """Return whether a pose can be used. If not, keep the reason for the error."""
        try:
            seen = self._robot.read(message)
        except InvalidMessage:  # the driver reads it again and reports the error
            return True
        objection = self._objection(seen)
        self._why = objection or self._nothing_heard
        return not objection

    def _objection(self, seen: Sighting) -> str:
        """Why a pose must not be used; empty if it may."""
        if seen.stamp is None:
            return ""
        age = (self._clock.now() - seen.stamp) / 1e9
        if age > self._robot.max_age:
            problem = f"by its stamp, the last one is {age:.3g} s old"
            return f"{self._pose_topic} publishes old poses: {problem}; set the clocks, or max_age"
        back = ((self.seen.stamp or 0) - seen.stamp) / 1e9
        return f"the stamps of {self._pose_topic} went back by {back:.3g} s" if back > 0.0 else ""


class Turtles:
    """The turtles of a graph, and which of them are being driven.

    Args:
        node: The node that opens their topics.
        area: The area in which targets must lie (m).
        robot: The kind of robot they are; turtlesim's turtles if left out.
    """

    def __init__(self, node: Node, area: Area, robot: Robot | None = None) -> None:
        self._node = node
        self._area = area
        self._robot = robot or Robot()
        self._driven: set[str] = set()
        self._drives: dict[bytes, Drive] = {}
        self._proving = anyio.Lock()

    def steering(
        self,
        *,
        style: str,
        max_linear: float,
        max_angular: float,
        tolerance: float,
        heading_tolerance: float = Limits().heading_tolerance,
    ) -> Steering:
        """The steering law for these robots, with the options of a goal.

        Raises:
            Reject: if there is no such style, or a number is out of its range.
        """
        robot = self._robot
        if max_angular > robot.fastest:
            most = f"{robot.fastest:.4g} rad/s at most"
            raise Reject(f"max_angular: must be {most}, not {max_angular}")
        try:
            limits = Limits(
                max_linear=max_linear,
                max_angular=max_angular,
                max_acceleration=robot.max_acceleration,
                max_angular_acceleration=robot.max_angular_acceleration,
                tolerance=tolerance,
                heading_tolerance=heading_tolerance,
                dt=robot.dt,
                area=self._area,
            )
            return Steering(cast("Style", style), limits)
        except InvalidMessage as error:
            raise Reject(str(error)) from None

    def check_turtle(self, turtle: str) -> None:
        """Check that a turtle can be driven.

        Raises:
            Reject: if nobody publishes its pose, or another goal drives it.
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
            target: The target.
            path: A prefix for the coordinate's name in the error, such as ``targets[2].``.

        Raises:
            Reject: if the target is outside. The error names the first coordinate that is.
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
        """Give a block the drive of a turtle. However the block ends, the turtle then stands still.

        Args:
            turtle: Its name.
            steering: The law of steering.
            goal: The goal that needs the turtle. While the goal is paused, the turtle is held.

        Raises:
            Abort: if the turtle reports no pose, or another goal drives it already.
        """
        topic = self._topic(turtle)
        # Two goals may have been accepted before either has begun: `check_turtle` saw neither.
        if topic in self._driven:
            raise Abort(_taken(turtle))
        drive = Drive(self._node, self._robot, turtle, steering, self._proving)
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
        """Hold the turtle of a goal that is paused. This is an ``on_pause`` callback."""
        if goal.goal_id in self._drives:
            self._drives[goal.goal_id].hold()

    async def release(self, goal: ServerGoalHandle[Any, Any, Any]) -> None:
        """Release the turtle of a goal that is resumed. This is an ``on_resume`` callback."""
        if goal.goal_id in self._drives:
            self._drives[goal.goal_id].release()

    def _topic(self, turtle: str) -> str:
        """The full name of a turtle's pose topic.

        The topic is the same for all names of the turtle.
        """
        poses, _ = self._robot.topics(turtle)
        return resolve_name(poses, self._node.namespace, self._node.name)


def _taken(turtle: str) -> str:
    return f"turtle '{turtle}' is being driven by another goal"
