"""Foxglove and Lichtblick: their libraries, unchanged, make the calls of their rosbridge player."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import anyio

import turtleact
from turtleact.interfaces import get_interface, standard, to_dict
from turtleact.interfaces.standard import Point
from turtleact.web import open_web

from .test_roslibpy import AddTwoInts, run_client

CLIENT = Path(__file__).with_name("player_client.mjs")
LEFT_OUT = [
    "rcl_interfaces/msg/Log",  # it has to be there by itself
    "rcl_interfaces/msg/ParameterType",  # a message of constants alone is none to their parser
    "example_interfaces/msg/WString",  # Foxglove reads no wstring
]
SHIPPED = Path(standard.__file__).parent
MESSAGES: dict[str, Any] = {
    f"/{name.replace('/msg/', '/').lower()}": get_interface(name)
    for name in (f"{file.parts[-3]}/msg/{file.stem}" for file in sorted(SHIPPED.rglob("*.msg")))
    if name not in LEFT_OUT
}


async def test_foxglove_reads_every_message_that_ships(javascript, caplog):
    async with turtleact.open_node("lab") as node, open_web(node, port=0) as web:
        node.service(AddTwoInts, "add", lambda r: AddTwoInts.Response(sum=r.a + r.b))
        publishers = [(node.publisher(cls, topic), cls) for topic, cls in MESSAGES.items()]
        told = node.subscription(Point, "up")

        async def publish() -> None:
            assert await anext(told) == Point(x=1.0, y=2.0, z=3.0)
            for publisher, cls in publishers:
                publisher.publish(cls())

        async with anyio.create_task_group() as group:
            group.start_soon(publish)
            said, complaints = await run_client("node", CLIENT, javascript.as_uri(), f"{web.port}")
    assert complaints == ""
    assert said.pop("is ROS 2") is True
    assert said.pop("/lab") == [sorted([*MESSAGES, "/rosout", "/up"]), sorted(MESSAGES), ["/add"]]
    assert said.pop("sum") == ["example_interfaces/srv/AddTwoInts", {"sum": 3}]
    assert said.pop("/up") == {"x": 1, "y": 2, "z": 3}
    messages = {topic: to_dict(cls()) for topic, cls in MESSAGES.items()}
    assert said == json.loads(json.dumps(messages, default=list))
