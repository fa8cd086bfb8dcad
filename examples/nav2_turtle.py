"""A turtle that serves two actions of Nav2, so that its clients need no robot.

Run it with ``turtleact serve examples/nav2_turtle.py``.
A client needs none of the files in ``nav2``, because it learns the types from this server.
"""

import math
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import turtleact
from turtleact import ServerGoalHandle
from turtleact.actions.go_to import GoTo
from turtleact.interfaces import load_interfaces, stamp_of

load_interfaces(Path(__file__).parent / "nav2")
NavigateToPose: Any = turtleact.get_action("nav2_msgs/action/NavigateToPose")
FollowWaypoints: Any = turtleact.get_action("nav2_msgs/action/FollowWaypoints")
PoseStamped: Any = turtleact.get_message("geometry_msgs/msg/PoseStamped")
Duration: Any = turtleact.get_message("builtin_interfaces/msg/Duration")

Handle = ServerGoalHandle[Any, Any, Any]


def order(pose: Any) -> GoTo.Goal:
    """Return the goal of ``/go_to`` for a pose on the map, which is the turtle's field."""
    place, turn = pose.pose.position, pose.pose.orientation
    theta = 2 * math.atan2(turn.z, turn.w)
    return GoTo.Goal(x=place.x, y=place.y, theta=theta, heading_tolerance=0.1)


def pose_of(turtle: Any) -> Any:
    pose = PoseStamped()
    pose.header.frame_id = "map"
    pose.pose.position.x, pose.pose.position.y = turtle.x, turtle.y
    pose.pose.orientation.z = math.sin(turtle.theta / 2)
    pose.pose.orientation.w = math.cos(turtle.theta / 2)
    return pose


@turtleact.action(NavigateToPose, "/navigate_to_pose", policy="preempt")
async def navigate_to_pose(goal: Any, handle: Handle) -> AsyncIterator[Any]:
    """Drive to a pose, and tell once a second how far it still is."""
    start = handle.node.clock.now()
    client = handle.node.action_client(GoTo, "/go_to")
    async with client.send_goal(order(goal.pose)) as drive:
        async for step in drive:
            passed = stamp_of(handle.node.clock.now() - start)
            yield NavigateToPose.Feedback(
                current_pose=pose_of(step.pose),
                navigation_time=Duration(passed.sec, passed.nanosec),
                distance_remaining=step.distance_remaining,
            )
        await drive.result()
    yield NavigateToPose.Result()


@turtleact.action(FollowWaypoints, "/follow_waypoints", policy="preempt")
async def follow_waypoints(goal: Any, handle: Handle) -> AsyncIterator[Any]:
    """Drive to one pose after another."""
    client = handle.node.action_client(GoTo, "/go_to")
    for index, pose in enumerate(goal.poses):
        yield FollowWaypoints.Feedback(current_waypoint=index)
        await client.send_goal(order(pose))
    yield FollowWaypoints.Result()
