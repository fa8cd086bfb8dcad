# In a checkout: pip install . fastapi httpx
"""A web app that contains the bridge: its own routes beside rosbridge and the page, on one node.

``main`` serves it on any free port and visits it. ``uvicorn --app-dir examples 23_web_mount:app``
serves the same app, with the page at http://127.0.0.1:8000/robot/ and rosbridge at
ws://127.0.0.1:8000/robot/. Do not leave out the slash at the end.

Prints:

    GET /turtles: ['turtle1']
    GET /robot/: text/html; charset=utf-8
    call_service: geometry_msgs/msg/Twist
    subscribe: turtle1 is at 5.54, 5.54
    send_action_goal: [0, 1, 1]
    send_action_goal: [0, 1, 1, 2]
    action_result: 4 [0, 1, 1, 2]
"""

import asyncio
import json
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import httpx
import uvicorn
from fastapi import FastAPI, Request
from websockets.asyncio.client import connect

from turtleact import open_world
from turtleact.web import open_bridge


@asynccontextmanager
async def lifespan(app: FastAPI) -> AsyncIterator[None]:
    async with open_world() as node, open_bridge(node) as bridge:
        app.state.node = node
        app.mount("/robot", bridge)
        yield


app = FastAPI(lifespan=lifespan)


@app.get("/turtles")
async def turtles(request: Request) -> list[str]:
    topics = request.app.state.node.graph().topics
    return [topic.split("/")[1] for topic in topics if topic.endswith("/pose")]


async def visit(place: str) -> None:
    async with httpx.AsyncClient(base_url=f"http://{place}") as http:
        print("GET /turtles:", (await http.get("/turtles")).json())
        print("GET /robot/:", (await http.get("/robot/")).headers["content-type"])
    async with connect(f"ws://{place}/robot/") as rosbridge:

        async def hear() -> dict[str, Any]:
            frame: dict[str, Any] = json.loads(await rosbridge.recv())
            return frame

        async def say(op: str, **members: object) -> dict[str, Any]:
            await rosbridge.send(json.dumps({"op": op, **members}))
            return await hear()

        asked = {"service": "/rosapi/topic_type", "args": {"topic": "/turtle1/cmd_vel"}}
        print("call_service:", (await say("call_service", **asked))["values"]["type"])

        once = await say("subscribe", topic="/turtle1/pose", throttle_rate=3_600_000)
        print("subscribe: turtle1 is at {x:.2f}, {y:.2f}".format(**once["msg"]))

        goal = {"action": "/fibonacci", "args": {"order": 3}, "feedback": True}
        fibonacci = "action_tutorials_interfaces/Fibonacci"
        heard = await say("send_action_goal", id="1", action_type=fibonacci, **goal)
        while heard["op"] == "action_feedback":
            print("send_action_goal:", heard["values"]["partial_sequence"])
            heard = await hear()
        print("action_result:", heard["status"], heard["values"]["sequence"])


async def main() -> None:
    server = uvicorn.Server(uvicorn.Config(app, log_level="warning", ws="websockets-sansio"))
    with socket.create_server(("127.0.0.1", 0)) as listener:
        serving = asyncio.create_task(server.serve([listener]))
        await visit("{}:{}".format(*listener.getsockname()))
        server.should_exit = True
        await serving


if __name__ == "__main__":
    asyncio.run(main())
