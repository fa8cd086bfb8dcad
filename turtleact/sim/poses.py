"""The poses of all turtles in one message, for those who watch a fleet.

Arrays, as one message a turtle would take longer to make than a tick lasts; and names, which
``geometry_msgs/msg/PoseArray`` has not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec import field

from turtleact.interfaces import Message, float32, string
from turtleact.interfaces.standard import Time
from turtleact.sim.world import FEW

if TYPE_CHECKING:
    from turtleact.sim.world import World

__all__ = ["Poses", "poses_of"]


class Poses(Message, type_name="turtleact_interfaces/msg/Poses"):
    """Where all turtles of a world are after a tick, each field as in ``turtlesim/msg/Pose``.

    Attributes:
        stamp: ROS time of the tick.
        names: The turtles; the numbers of each stand in the same place.
        x: From the left edge (m).
        y: From the lower edge (m).
        theta: Heading (rad).
        linear_velocity: Speed (m/s), never negative.
        angular_velocity: Turning to the left (rad/s).
    """

    stamp: Time = field(default_factory=Time)
    names: list[string] = field(default_factory=list)
    x: list[float32] = field(default_factory=list)
    y: list[float32] = field(default_factory=list)
    theta: list[float32] = field(default_factory=list)
    linear_velocity: list[float32] = field(default_factory=list)
    angular_velocity: list[float32] = field(default_factory=list)


def poses_of(world: World, stamp: Time) -> Poses:
    """The poses of a world."""
    names = list(world.names)
    if len(names) > FEW:
        columns = world.poses().T.tolist()
    else:
        columns = [list(column) for column in zip(*map(world.pose, names), strict=True)]
    return Poses(stamp, names, *columns)
