"""Implements ``teleop``, which drives a turtle with the keys of ``turtle_teleop_key``.

The command drives a turtle on the graph. If no graph or no turtle is in reach, the command starts
an embedded world with a turtle. The event loop reads the keys, without a thread.

Source: turtlesim 1.8.2, ``tutorials/teleop_turtle_key.cpp``, for the keys, the speeds and the
wording of the output.
"""

from __future__ import annotations

import math
import sys
from functools import partial
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import anyio

from turtleact.commands import graph
from turtleact.commands.interrupts import Interrupts
from turtleact.commands.output import note, say
from turtleact.commands.screen import Screen, can_move, can_read_keys, cbreak, typed_keys
from turtleact.errors import TurtleactError, UsageError
from turtleact.goals.state import GoalStatus
from turtleact.interfaces.standard import RotateAbsolute, Twist, Vector3
from turtleact.transports import QoS

if TYPE_CHECKING:
    from contextlib import AbstractAsyncContextManager

    from turtleact.commands.live import Picture
    from turtleact.commands.settings import ConnectOptions
    from turtleact.commands.world_map import Turtle
    from turtleact.goals.client import ClientGoalHandle
    from turtleact.node import Node

__all__ = ["TeleopOptions", "run"]

HELP: Final = """Reading from keyboard
---------------------------
Use arrow keys to move the turtle.
Use G|B|V|C|D|E|R|T keys to rotate to absolute orientations. 'F' to cancel a rotation.
'Q' to quit.
"""

DRIVES: Final = {"up": (1.0, 0.0), "down": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}
"""The factors of the linear and angular speed for each key."""

HEADINGS: Final = {
    "g": 0.0,
    "t": 0.7854,
    "r": 1.5708,
    "e": 2.3562,
    "d": 3.1416,
    "c": -2.3562,
    "v": -1.5708,
    "b": -0.7854,
}
"""The heading for each key (rad), which is the direction from F to the key on a keyboard."""

CANCEL, QUIT = "f", "q"

SHOWN: Final = (
    "←↑↓→  drive",
    "E R T",
    "D   G  rotate",
    "C V B",
    "F  cancel   Q  quit",
)
"""The legend of the live display."""

COMMANDS, ROTATION = "cmd_vel", "rotate_absolute"

OK: Final = 0
"""The exit status if the user quits."""


class TeleopOptions(NamedTuple):
    """The options of the command: which turtle to drive, and how.

    Attributes:
        turtle: The name of the turtle to drive; None for turtle1 or, if there is no turtle1, for
            the only turtle.
        remaps: Other names for ``turtle1/cmd_vel`` and ``turtle1/rotate_absolute``.
        linear: The linear speed (m/s).
        angular: The angular speed (rad/s).
        is_plain: Whether to leave out the map, even on a terminal.
        reach: The graph on which to look for turtles; None to start an embedded world.
    """

    turtle: str | None
    remaps: dict[str, str]
    linear: float
    angular: float
    is_plain: bool
    reach: ConnectOptions | None


def run(order: TeleopOptions) -> int:
    """Drive a turtle until the user presses Q or a signal arrives, and return the exit status.

    Raises:
        UsageError: if stdin is not a terminal.
        TurtleactError: if the turtle is not in reach, or goes away while it is driven.
    """
    if not can_read_keys():
        raise UsageError("teleop reads keys, but stdin is not a terminal: run it in a terminal")
    is_live = not order.is_plain and can_move(sys.stdout)
    interrupts = Interrupts()

    async def drive(node: Node) -> int:
        turtle = _choose(_wanted(order), _turtles_in_reach(node))
        await _Driving(order, node, turtle, is_live=is_live).run()
        return OK

    with cbreak(sys.stdin) as interrupts.restore:
        return interrupts.run(graph.use(_open_node(order), drive))


def _open_node(order: TeleopOptions) -> AbstractAsyncContextManager[Node]:
    """Open a node on the graph, or in an embedded world if no turtle is in reach."""
    wanted = _wanted(order)

    async def has_turtles(node: Node) -> bool:
        return bool(_turtles_in_reach(node))

    def world(_why: str) -> AbstractAsyncContextManager[Node]:
        if wanted not in ("", "turtle1"):
            raise TurtleactError(f"no turtle '{wanted}' is in reach, and no other turtle")
        return graph.embedded_world()

    enter = partial(graph.enter_graph, name="teleop_turtle")
    return graph.open_or_embed(order.reach, "turtles", has_turtles, world, enter)


def _choose(wanted: str, turtles: list[str]) -> str:
    """Return the turtle to drive: the one that the user named, turtle1, or the only one.

    Raises:
        TurtleactError: if that turtle is not in reach, or none is the clear choice.
    """
    there_are = ", ".join(turtles) or "none"
    if wanted and wanted not in turtles:
        raise TurtleactError(f"no turtle '{wanted}' is in reach (there are: {there_are})")
    if not turtles:
        raise TurtleactError("no turtle is in reach: no node subscribes to a cmd_vel")
    if wanted or "turtle1" in turtles:
        return wanted or "turtle1"
    if len(turtles) > 1:
        raise TurtleactError(f"several turtles are in reach: say which with --turtle ({there_are})")
    return turtles[0]


def _wanted(order: TeleopOptions) -> str:
    """The turtle that the user named; empty if the user named none."""
    remapped = order.remaps.get(f"turtle1/{COMMANDS}", "").removesuffix(f"/{COMMANDS}")
    return (order.turtle or remapped).strip("/")


def _turtles_in_reach(node: Node) -> list[str]:
    """The names of all turtles in reach, sorted: a node subscribes to the topic ``cmd_vel``."""
    commanded = {
        each.name
        for each in node.transport.endpoints()
        if each.kind == "subscription" and each.type_name == Twist.type_name
    }
    suffix = f"/{COMMANDS}"
    return sorted(each.removesuffix(suffix)[1:] for each in commanded if each.endswith(suffix))


class _Driving:
    """Drives a turtle.

    Args:
        order: The options of the command.
        node: The node that sends the commands.
        turtle: The name of the turtle.
        is_live: Whether to show a map.
    """

    def __init__(self, order: TeleopOptions, node: Node, turtle: str, *, is_live: bool) -> None:
        self._order = order
        self._node = node
        self._turtle = turtle
        self._is_live = is_live
        self._commands = node.publisher(Twist, self._name(COMMANDS), QoS(depth=1))
        self._rotations = node.action_client(RotateAbsolute, self._name(ROTATION))
        self._rotation: ClientGoalHandle[Any, Any] | None = None
        self._tasks = anyio.create_task_group()

    async def run(self) -> None:
        """Act on keys until the user presses Q or the terminal is closed."""
        say(HELP)
        async with self._tasks:
            if self._is_live:
                self._tasks.start_soon(self._draw)
            async for key in typed_keys():
                self._press(key)
                if key == QUIT:
                    break
            self._tasks.cancel_scope.cancel()

    def _name(self, what: str) -> str:
        """The name of a topic or action of the turtle, with the user's remappings applied."""
        named = f"/{self._turtle}/{what}" if self._turtle else f"/{what}"
        return self._order.remaps.get(f"turtle1/{what}", named)

    def _press(self, key: str) -> None:
        if key in DRIVES:
            linear, angular = DRIVES[key]
            speeds = self._order.linear * linear, self._order.angular * angular
            self._commands.publish(Twist(Vector3(x=speeds[0]), Vector3(z=speeds[1])))
        elif key in HEADINGS:
            # Not awaited: the next key may ask for another heading, which preempts this rotation.
            self._tasks.start_soon(self._rotate, HEADINGS[key])
        elif key == CANCEL and self._rotation is not None:
            self._rotation.cancel_nowait()

    async def _rotate(self, theta: float) -> None:
        """Turn the turtle to a heading (rad). Tell the user only about failures."""
        try:
            async with self._rotations.send_goal(RotateAbsolute.Goal(theta)) as handle:
                handle.detach()  # it goes on when the user quits
                self._rotation = handle
                outcome = await handle.outcome()
        except TurtleactError as error:
            note(str(error))
            return
        if outcome.status is GoalStatus.ABORTED:
            note(f"the rotation was aborted: {outcome.reason or 'no reason given'}")

    async def _draw(self) -> None:
        from turtleact.commands.live import PanelData, board
        from turtleact.commands.world_map import PoseTrails

        trails = PoseTrails(self._node, f"/{self._turtle}/pose")

        def compose(*, width: int, height: int) -> Picture:
            world = trails.look()
            heading = [f"driving {self._turtle}"]
            poses = [each for each in world.turtles if each.name == self._turtle]
            heading += [_place(pose) for pose in poses]
            shown = PanelData(["   ".join(heading)], world if world.turtles else None, keys=SHOWN)
            return board(shown, width=width, height=height)

        await Screen(compose).run()


def _place(pose: Turtle) -> str:
    return f"x {pose.x:.2f}  y {pose.y:.2f}  {math.degrees(pose.theta):.0f}°"
