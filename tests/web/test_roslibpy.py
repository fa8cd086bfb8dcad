"""An unchanged roslibpy, in a process of its own, does all that it can do against a bridge."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import aclosing
from pathlib import Path
from typing import Any

import anyio
import pytest
from anyio.streams.text import TextReceiveStream

import turtleact
from turtleact import Abort, GoalResponse, Reject
from turtleact.errors import ServiceError
from turtleact.interfaces import get_interface
from turtleact.interfaces.standard import Point
from turtleact.web import open_web

from ..lab import Count, feedback, result

CLIENT = Path(__file__).with_name("roslibpy_client.py")
AddTwoInts: Any = get_interface("example_interfaces/srv/AddTwoInts")


def decide(goal: Count.Goal) -> GoalResponse:
    if goal.upto == -1:
        raise Reject("not today")
    return GoalResponse.ACCEPT


async def execute(goal: Count.Goal) -> AsyncIterator[Any]:
    if goal.upto < 0:
        raise Abort("no more", result(7))
    for number in range(goal.upto):
        yield feedback(number)
        if goal.upto == 1000:
            await anyio.sleep_forever()
    yield result(goal.upto)


async def play_topics(node: turtleact.Node) -> None:
    down, up = node.publisher(Point, "down"), node.subscription(Point, "up")
    while not down.has_subscriptions:
        await node.transport.wait_for_change()
    down.publish(Point(x=1.0))
    assert await anext(up) == Point(x=2.0)


async def play_services(node: turtleact.Node) -> None:
    multiply = node.service_client(AddTwoInts, "multiply")
    await multiply.wait_for_service()
    assert (await multiply.call(AddTwoInts.Request(a=6, b=7))).sum == 42
    with pytest.raises(ServiceError, match="its server says"):
        await multiply.call(AddTwoInts.Request(a=-1, b=1))


async def run_client(*command: str | Path) -> tuple[dict[str, Any], str]:
    """What the client has said, and what it has complained of."""
    async with await anyio.open_process(command, stdin=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        async with aclosing(TextReceiveStream(process.stdout)) as output:
            said = "".join([text async for text in output])
        async with aclosing(TextReceiveStream(process.stderr)) as output:
            complaints = "".join([text async for text in output])
        await process.wait()
    return dict(json.loads(line) for line in said.splitlines()), complaints


SAID = {
    "heard": {"x": 1.0, "y": 0.0, "z": 0.0},
    "sum": {"sum": 3},
    "refused": "args.a: expected a whole number (int64), got 'one'",
    "asked": [{"a": 6, "b": 7}, {"a": -1, "b": 1}],
    "succeeded": [
        ["feedback", {"so_far": [0]}],
        ["feedback", {"so_far": [1]}],
        ["result", {"status": "SUCCEEDED", "values": {"counted": [2]}}],
    ],
    "canceled": [
        ["feedback", {"so_far": [0]}],
        ["result", {"status": "CANCELED", "values": {"counted": []}}],
    ],
    "aborted": [["result", {"status": "ABORTED", "values": {"counted": [7]}}]],
    "rejected": [["error", {"status": "UNKNOWN", "values": "Action goal was rejected: not today"}]],
    "topics": ["/down", "/up"],
    "time": True,
    "nodes": ["/lab"],
    "actions": ["/count"],
    "parameter": [1.5, "fast"],
}


@pytest.mark.parametrize("transport", ["twisted", "asyncio"])
async def test_roslibpy_does_all_that_it_can(transport, monkeypatch, caplog):
    monkeypatch.setenv("ROSLIBPY_TRANSPORT", transport)
    async with turtleact.open_node("lab") as node, open_web(node, port=0) as web:
        node.action_server(Count, "count", execute, goal_callback=decide)
        node.service(AddTwoInts, "add", lambda r: AddTwoInts.Response(sum=r.a + r.b))
        async with anyio.create_task_group() as group:
            group.start_soon(play_topics, node)
            group.start_soon(play_services, node)
            said, complaints = await run_client(sys.executable, CLIENT, f"{web.port}")
    assert said == SAID, complaints
    assert complaints == ""
