"""Types of a genuine node of rclpy that nobody here knows, learned and then used.

The node speaks through Fast DDS, and turtleact through Zenoh, so a relay carries each request and
each response, byte for byte.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import anyio
import anyio.to_thread
import pytest

import turtleact
from turtleact.interfaces import get_interface, type_hash
from turtleact.interfaces.loading import authored_text
from turtleact.interfaces.types import REGISTRY
from turtleact.transports import Transport, open_zenoh
from turtleact.transports.base import Endpoint, RawFormat, Reply, ServiceHandler

from ..registry import isolated_registry
from .conftest import Ros

FIBONACCI = "test_msgs/action/Fibonacci"
DESCRIBE = "type_description_interfaces/srv/GetTypeDescription"


class Relay(ServiceHandler):
    """Passes the bytes of requests to a service of the node."""

    def __init__(self, process: subprocess.Popen[str], service: str, lock: anyio.Lock) -> None:
        self._process = process
        self._service = service
        self._lock = lock

    async def reply(self, request: object, caller: bytes) -> Reply:
        assert isinstance(request, bytes)
        line = json.dumps({"service": self._service, "cdr": request.hex()})
        async with self._lock:
            said = await anyio.to_thread.run_sync(self._ask, line)
        return Reply(bytes.fromhex(said))

    def _ask(self, line: str) -> str:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(line, file=self._process.stdin, flush=True)
        return self._process.stdout.readline()


class Robot:
    """A node of rclpy in a process of its own, with the files of its types."""

    def __init__(self, ros: Ros) -> None:
        self._prefixes = ros.prefixes
        self.process = ros.start("ros_types.py")
        assert self.process.stdout is not None
        if self.process.stdout.readline() != "ready\n":
            pytest.skip("rclpy does not find its own endpoints on this machine")

    def file(self, type_name: str, suffix: str = "") -> Path:
        package, kind, name = type_name.split("/")
        places = [each / "share" / package / kind for each in self._prefixes]
        files = [each / f"{name}{suffix or f'.{kind}'}" for each in places]
        return next(each for each in files if each.is_file())

    def hash_of(self, type_name: str, of: str = "") -> str:
        hashes = json.loads(self.file(type_name, ".json").read_text("utf-8"))["type_hashes"]
        wanted = f"{type_name}{of}"
        found = {row["type_name"]: str(row["hash_string"]) for row in hashes}
        return found[wanted]

    @asynccontextmanager
    async def shown(self, at: str) -> AsyncIterator[Transport]:
        """Show the node on a graph of Zenoh."""
        action = "/count/_action"
        lock = anyio.Lock()
        async with open_zenoh(mode="router", listen=[at]) as graph:
            node = graph.enter("/robot")

            def serve(name: str, type_name: str, type_hash: str) -> None:
                end = Endpoint("service", name, type_name, "/robot")
                graph.serve(end, RawFormat(type_hash), Relay(self.process, name, lock))

            def publish(name: str, type_name: str, type_hash: str) -> Any:
                end = Endpoint("publisher", name, type_name, "/robot")
                return graph.advertise(end, RawFormat(type_hash))

            parts = {part: self.hash_of(FIBONACCI, part) for part in ("_SendGoal", "_GetResult")}
            serve("/robot/get_type_description", DESCRIBE, self.hash_of(DESCRIBE))
            serve(f"{action}/send_goal", f"{FIBONACCI}_SendGoal", parts["_SendGoal"])
            serve(f"{action}/get_result", f"{FIBONACCI}_GetResult", parts["_GetResult"])
            feedback = f"{FIBONACCI}_FeedbackMessage"
            publish(f"{action}/feedback", feedback, self.hash_of(FIBONACCI, "_FeedbackMessage"))
            serve("/fill", "test_msgs/srv/BasicTypes", self.hash_of("test_msgs/srv/BasicTypes"))
            publish("/defaults", "test_msgs/msg/Defaults", self.hash_of("test_msgs/msg/Defaults"))
            yield graph
            node.close()


@pytest.fixture(scope="module")
def robot(ros: Ros) -> Iterator[Robot]:
    found = Robot(ros)
    yield found
    found.process.kill()
    found.process.communicate()


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with isolated_registry():
        REGISTRY.forget(FIBONACCI)  # another test has a class of this name
        yield


@pytest.fixture
def at() -> Iterator[str]:
    folder = tempfile.mkdtemp(prefix="zenoh")
    yield f"unixsock-stream/{Path(folder) / 'socket'}"
    shutil.rmtree(folder)


@asynccontextmanager
async def here(at: str) -> AsyncIterator[turtleact.Node]:
    async with (
        open_zenoh([at], mode="client") as graph,
        turtleact.open_node("here", transport=graph) as node,
    ):
        await graph.explore()
        yield node


async def test_an_action_is_learned_and_a_goal_sent_by_its_name_alone(robot: Robot, at: str):
    with pytest.raises(turtleact.UnknownInterface):
        get_interface(FIBONACCI)
    async with robot.shown(at), here(at) as node:
        found: Any = await turtleact.learn_interface(node, "count")
        assert type_hash(found) == robot.hash_of(FIBONACCI)
        # rosidl leaves out the line break at the end.
        assert authored_text(found) == robot.file(FIBONACCI).read_text("utf-8").rstrip()
        client = node.action_client("count")
        assert (await client.send_goal({"order": 6})).sequence == [0, 1, 1, 2, 3, 5]


async def test_a_service_is_learned_and_called(robot: Robot, at: str):
    async with robot.shown(at), here(at) as node:
        response = await node.service_client("fill").call({"int32_value": 7})
        assert response.string_value == "7"


async def test_a_topic_is_learned_with_the_defaults_of_its_text(robot: Robot, at: str):
    async with robot.shown(at), here(at) as node:
        found: Any = await turtleact.learn_interface(node, "defaults")
        assert type_hash(found) == robot.hash_of("test_msgs/msg/Defaults")
        assert (found().int32_value, found().bool_value, found().float64_value) == (
            -30000,
            True,
            1.125,
        )
