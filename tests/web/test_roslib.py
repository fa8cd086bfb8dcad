"""An unchanged roslib, in node, does all that it can do against a bridge."""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path

import anyio

import turtleact
from turtleact.interfaces.standard import Point
from turtleact.web import open_web

from ..commands.test_serve import PATIENCE, first_lines, serving
from ..lab import Count, goal
from .test_roslibpy import AddTwoInts, decide, execute, play_services, run_client

CLIENT = Path(__file__).with_name("roslib_client.mjs")
SERVER = Path(__file__).with_name("roslib_server.mjs")


async def play_topics(node: turtleact.Node) -> None:
    """Sends to each new reader, and waits for what it sends back."""
    down, up = node.publisher(Point, "down"), node.subscription(Point, "up")
    for _ in range(4):
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
    "png": {"x": 1, "y": 0, "z": 0},
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


async def test_roslib_does_all_that_it_can(javascript, caplog):
    async with turtleact.open_node("lab") as node, open_web(node, port=0) as web:
        node.action_server(Count, "count", execute, goal_callback=decide)
        node.service(AddTwoInts, "add", lambda r: AddTwoInts.Response(sum=r.a + r.b))
        async with anyio.create_task_group() as group:
            for play in (play_topics, play_services, play_goals):
                group.start_soon(play, node)
            said, complaints = await run_client("node", CLIENT, javascript.as_uri(), f"{web.port}")
    assert said == SAID, complaints


def test_an_action_in_javascript_is_sent_goals_from_the_command_line(javascript, tmp_path):
    with serving(tmp_path, "--no-sim", "--web", "0") as server:
        url = server.ready.split()[-1].replace("http:", "ws:")
        command = ["node", str(SERVER), javascript.as_uri(), url]
        with subprocess.Popen(command, stdin=subprocess.DEVNULL) as roslib:
            try:
                status, out, _ = server.run("send-goal", "served", "order: 3", "--json")
                events = [json.loads(line) for line in out.splitlines()]
                heard = [each["feedback"] for each in events if each["event"] == "feedback"]
                assert heard == [{"sequence": [0, 1, 1]}, {"sequence": [0, 1, 1, 2]}]
                assert (status, events[-1]["result"]) == (0, {"sequence": [0, 1, 1, 2]})

                status, out, _ = server.run("send-goal", "served", "order: 0", "--plain")
                assert (status, out.endswith("status: ABORTED\n")) == (4, True)

                sender = server.start("send-goal", "served", "order: -1", "--feedback", "--plain")
                first_lines(sender, "Feedback:")
                sender.send_signal(signal.SIGINT)
                out, _ = sender.communicate(timeout=PATIENCE)
                assert (sender.returncode, "- 7\n" in out) == (130, True)
                assert out.endswith("status: CANCELED\n")
            finally:
                roslib.kill()
