"""An unchanged roslib in node, where both are: ``ROSLIB`` names the folder of the package."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import anyio
import pytest

import turtleact
from turtleact.interfaces.standard import Point
from turtleact.web import open_web

from ..lab import Count, goal
from .test_roslibpy import ON_ONE, AddTwoInts, decide, execute, play_services, run_client

NODE = shutil.which("node") or ""
ROSLIB = Path(
    os.environ.get("ROSLIB") or Path(__file__).parents[2] / "node_modules" / "roslib"
).joinpath("dist", "RosLib.js")
CLIENT = Path(__file__).with_name("roslib_client.mjs")


async def play_topics(node: turtleact.Node) -> None:
    """Sends to each new reader, and waits for what it sends back."""
    down, up = node.publisher(Point, "down"), node.subscription(Point, "up")
    for _ in range(3):
        while not down.has_subscriptions:
            await node.transport.wait_for_change()
        down.publish(Point(x=1.0))
        assert await anext(up) == Point(x=2.0)


async def play_goals(node: turtleact.Node) -> None:
    client = node.action_client(Count, "served")
    await client.wait_for_server()
    assert (await client.send_goal(goal(3))).counted == [3]
    async with client.send_goal(goal(0)) as handle:
        async for feedback in handle:
            assert feedback.so_far == [0]
            await handle.cancel()
        outcome = await handle.outcome()
    assert (outcome.status.name, outcome.result.counted) == ("CANCELED", [7])


SAID = {
    "none": {"x": 1, "y": 0, "z": 0},
    "cbor": {"x": 1, "y": 0, "z": 0},
    "cbor-raw": 28,
    "sum": {"sum": 3},
    "refused": "args.a: expected a whole number (int64), got 'one'",
    "succeeded": [
        ["feedback", {"so_far": [0]}],
        ["feedback", {"so_far": [1]}],
        ["result", {"counted": [2]}],
    ],
    "canceled": [
        ["feedback", {"so_far": [0]}],
        ["failed", 'GoalError: Action was canceled: {"counted":[]}'],
    ],
    "all canceled": [
        ["feedback", {"so_far": [0]}],
        ["failed", 'GoalError: Action was canceled: {"counted":[]}'],
    ],
    "aborted": [["failed", 'GoalError: Action was aborted: {"counted":[7]}']],
    "rejected": [
        ["failed", "GoalError: Action status unknown: Action goal was rejected: not today"]
    ],
    "topics": ["/down", "/up"],
}


@pytest.mark.skipif(not NODE, reason="node is not installed")
@pytest.mark.skipif(not ROSLIB.is_file(), reason="roslib is not installed: see ROSLIB")
@ON_ONE
async def test_roslib_does_all_that_it_can(caplog):
    async with turtleact.open_node("lab") as node, open_web(node, port=0) as web:
        node.action_server(Count, "count", execute, goal_callback=decide)
        node.service(AddTwoInts, "add", lambda r: AddTwoInts.Response(sum=r.a + r.b))
        async with anyio.create_task_group() as group:
            for play in (play_topics, play_services, play_goals):
                group.start_soon(play, node)
            said, complaints = await run_client(NODE, CLIENT, ROSLIB.as_uri(), f"{web.port}")
    assert said == SAID, complaints
