"""One turtle as other ROS nodes see it: its topics, its services and its action.

- ``<turtle>/cmd_vel`` (geometry_msgs/msg/Twist): commands, which take effect at the next tick;
- ``<turtle>/pose`` (turtlesim/msg/Pose) and ``<turtle>/color_sensor`` (turtlesim/msg/Color),
  published after each tick if somebody subscribes to them;
- ``<turtle>/set_pen``, ``<turtle>/teleport_absolute`` and ``<turtle>/teleport_relative``;
- ``<turtle>/rotate_absolute``, one goal at a time.

This module rounds to float32 wherever turtlesim does. The module has no clock: the module
`turtlesim` calls each turtle's methods at each tick.

Source: turtlesim 1.8.2, ``turtle.cpp`` (for the controller ``Turtle::update`` and
``Turtle::rotateAbsoluteAcceptCallback``) and ``qos.hpp``.
"""

from __future__ import annotations

import logging
import math
from array import array
from functools import partial
from typing import TYPE_CHECKING, Final, NamedTuple

import anyio

from turtleact.errors import Abort, Reject, SimError
from turtleact.goals.state import GoalResponse
from turtleact.interfaces.standard import (
    Color,
    RotateAbsolute,
    SetPen,
    TeleportAbsolute,
    TeleportRelative,
    TurtlePose,
    Twist,
)
from turtleact.sim.kinematics import wrap
from turtleact.sim.pictures import Colour
from turtleact.transports import QoS

if TYPE_CHECKING:
    from collections.abc import Callable

    from turtleact.node import Node, ServerGoalHandle
    from turtleact.sim.drawing import Pens
    from turtleact.sim.world import World

    Handle = ServerGoalHandle[RotateAbsolute.Goal, RotateAbsolute.Result, RotateAbsolute.Feedback]

__all__ = ["TOPIC_QOS", "Habitat", "Turtle"]

logger = logging.getLogger("turtleact.turtlesim")

TOPIC_QOS = QoS(depth=7)

TURN_SPEED: Final = 1.0
"""How fast a turtle turns (rad/s)."""

TOLERANCE: Final = 0.02
"""A turtle stops turning when its heading is less than this angle from the target (rad)."""


class Habitat(NamedTuple):
    """The objects that all turtles of a world share.

    Attributes:
        node: The node that opens the turtles' topics, services and actions.
        world: The world of the turtles.
        pens: The turtles' pens.
        on_work: Called with a turtle that has received a command or goal for the next tick.
        on_read: Called when the pose or colour topic of a turtle gets its first reader or loses its
            last one.
    """

    node: Node
    world: World
    pens: Pens
    on_work: Callable[[Turtle], object]
    on_read: Callable[[], object]


class Turtle:
    """The topics, the services and the action of one turtle. The constructor opens them.

    Args:
        name: The turtle's name in the world.
        habitat: The objects that the turtle shares with the other turtles.
        on_demand: Whether other processes see the turtle's topics, services and action only when
            they ask for them; see `Node`.

    Raises:
        InvalidName: if ``name`` cannot be part of a topic's name. The constructor then leaves
            nothing open.

    Attributes:
        name: The turtle's name.
        commands: The subscription that keeps the commands until the next tick.
        poses: The publisher of the turtle's pose.
        colours: The publisher of the colour under the turtle.
        turn: The ``rotate_absolute`` goal that is running, if there is one.
    """

    def __init__(self, name: str, habitat: Habitat, *, on_demand: bool = False) -> None:
        self.name = name
        self.turn: _Turn | None = None
        self._gone = ""
        node, self._world, self._pens, self._on_work, on_read = habitat
        subscription = partial(node.subscription, qos=TOPIC_QOS, on_demand=on_demand)
        publisher = partial(node.publisher, qos=TOPIC_QOS, on_demand=on_demand)
        service = partial(node.service, on_demand=on_demand)
        self.commands = subscription(Twist, f"{name}/cmd_vel")
        self.commands.notify = lambda: self._on_work(self)
        self.poses = publisher(TurtlePose, f"{name}/pose", on_matched=on_read)
        self.colours = publisher(Color, f"{name}/color_sensor", on_matched=on_read)
        self._opened = (
            self.commands,
            self.poses,
            self.colours,
            service(SetPen, f"{name}/set_pen", self._set_pen),
            service(TeleportAbsolute, f"{name}/teleport_absolute", self._teleport_absolute),
            service(TeleportRelative, f"{name}/teleport_relative", self._teleport_relative),
        )
        self._rotations = node.action_server(
            RotateAbsolute,
            f"{name}/rotate_absolute",
            self._rotate,
            on_demand=on_demand,
            goal_callback=_check,
            on_pause=self._hold,
            on_resume=self._release,
        )

    def leave(self, reason: str) -> None:
        """Record that the turtle is gone, and abort its running goal with ``reason``.

        Call this as soon as the world has removed the turtle, because `aclose` may take a while.
        """
        self._gone = reason
        self.commands.notify = None
        if self.turn is not None:
            self.turn.abort(reason)
            self.turn = None

    async def aclose(self) -> None:
        """Close the turtle's topics, services and action."""
        for each in (*self._opened, self._rotations):
            await each.aclose()

    # the ticks

    def take_up(self, twist: Twist) -> None:
        """Give the turtle a command. If a rotation is running, abort it."""
        try:
            self._world.set_velocity(self.name, twist.linear.x, twist.linear.y, twist.angular.z)
        except SimError as error:
            logger.warning("a command was ignored: %s", error)
            return
        if self.turn is not None:
            logger.warning("Velocity command received during rotation goal. Aborting goal")
            self.turn.abort("a velocity command arrived")
            self.turn = None

    def rotate(self, turn: _Turn) -> None:
        """Turn for one tick; stand still if the goal is paused."""
        if turn.is_held:
            self._world.set_velocity(self.name, 0.0)
            return
        # A velocity of zero in the last tick is a command like any other, as in turtlesim.
        omega = turn.tick(self._world.heading(self.name))
        if omega is None:
            logger.info("Rotation goal completed successfully")
            self.turn = None
        self._world.set_velocity(self.name, 0.0, 0.0, omega or 0.0)

    def tell_colour(self, colour: Colour) -> None:
        """Publish the colour under the turtle, if the colour topic has a subscription."""
        if self.colours.has_subscriptions:
            self.colours.publish(Color(*colour))

    # the services

    def _set_pen(self, request: SetPen.Request) -> SetPen.Response:
        if not self._gone:
            colour = Colour(request.r, request.g, request.b)
            self._pens.set(self.name, colour, request.width, is_off=bool(request.off))
        return SetPen.Response()

    def _teleport_absolute(self, request: TeleportAbsolute.Request) -> TeleportAbsolute.Response:
        self._teleport(self._world.teleport_absolute, request.x, request.y, request.theta)
        return TeleportAbsolute.Response()

    def _teleport_relative(self, request: TeleportRelative.Request) -> TeleportRelative.Response:
        self._teleport(self._world.teleport_relative, request.linear, request.angular)
        return TeleportRelative.Response()

    def _teleport(self, teleport: Callable[..., None], *numbers: float) -> None:
        if self._gone:
            return
        try:
            teleport(self.name, *numbers)
        except SimError as error:
            logger.warning("a teleport was ignored: %s", error)

    # the action

    async def _rotate(self, goal: RotateAbsolute.Goal, handle: Handle) -> RotateAbsolute.Result:
        # The goal may have been accepted just before the turtle was killed.
        if self._gone:
            raise Abort(self._gone)
        # Commands that came before the goal must not end it: they are taken up now, while there is
        # no goal that they could abort.
        for twist in self.commands.drain():
            self.take_up(twist)
        if self.turn is not None:
            logger.warning(
                "Rotation goal received before a previous goal finished. Aborting previous goal"
            )
            self.turn.abort("preempted by another goal")
        turn = self.turn = _Turn(goal.theta, self._world.heading(self.name), handle)
        self._on_work(self)
        try:
            await turn.ended.wait()
        except anyio.get_cancelled_exc_class():
            # The last tick may have ended the goal before the cancellation reached this task. The
            # turtle has then arrived, and turtlesim reports success, too.
            if turn.ended.is_set():
                return turn.take()
            self.turn = None
            self._world.set_velocity(self.name, 0.0)
            if handle.is_cancel_requested:
                logger.info("Rotation goal canceled")
            handle.set_partial_result(turn.result)
            raise
        return turn.take()

    async def _hold(self, handle: Handle) -> None:
        self._set_held(handle, is_held=True)

    async def _release(self, handle: Handle) -> None:
        self._set_held(handle, is_held=False)

    def _set_held(self, handle: Handle, *, is_held: bool) -> None:
        if self.turn is not None and self.turn.goal_id == handle.goal_id:
            self.turn.is_held = is_held


class _Turn:
    """A goal of ``rotate_absolute`` that is running: turns a turtle to a heading, tick by tick.

    Args:
        target: The heading to turn to (rad), any finite angle.
        theta: The turtle's heading before the turn (rad).
        handle: The handle of the goal.

    Attributes:
        ended: Set when the goal ends.
        is_held: Whether the goal is paused.
        result: The result message: the heading before the turn minus the heading before the latest
            tick (rad).
    """

    def __init__(self, target: float, theta: float, handle: Handle) -> None:
        self.ended = anyio.Event()
        self.is_held = handle.is_paused
        self.result = RotateAbsolute.Result()
        self.goal_id = handle.goal_id
        self._target = wrap(*array("f", (target,)))
        self._start = theta
        self._handle = handle
        self._reason = ""

    def take(self) -> RotateAbsolute.Result:
        """Return the result of the ended goal. Raise `Abort` if the goal was aborted."""
        if self._reason:
            raise Abort(self._reason, self.result)
        return self.result

    def tick(self, theta: float) -> float | None:
        """Publish the remaining turn, and return how fast to turn in this tick (rad/s).

        If the target is exactly opposite, the turtle turns right. The result is None if the heading
        ``theta`` (rad) is the wanted one, so that the turtle must stand still.
        """
        now, turned = array("f", (theta, self._start - theta))
        remaining = wrap(self._target - now)
        told, delta = array("f", (remaining, wrap(turned)))
        self._handle.publish_feedback(RotateAbsolute.Feedback(told))
        self.result = RotateAbsolute.Result(delta)
        # As in turtlesim, the difference is taken the other way round here.
        if abs(wrap(now - self._target)) < TOLERANCE:
            self.ended.set()
            return None
        return -TURN_SPEED if remaining < 0.0 else TURN_SPEED

    def abort(self, reason: str) -> None:
        """End the goal, so that `take` raises `Abort` with ``reason``."""
        self._reason = reason
        self.ended.set()


def _check(goal: RotateAbsolute.Goal) -> GoalResponse:
    """Reject a goal if theta is not finite: with such a goal, the turtle would turn forever."""
    if not math.isfinite(goal.theta):
        raise Reject(f"theta is {goal.theta}: give a finite number")
    return GoalResponse.ACCEPT
