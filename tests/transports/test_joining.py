"""How a peer joins a graph: routers that say little, that die, and peers that hang."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import anyio
import anyio.to_thread
import pytest

from turtleact import open_node
from turtleact.interfaces.standard import Twist
from turtleact.transports import open_zenoh
from turtleact.transports.rmw_zenoh.session import census

from .. import warm

PATIENCE = 60.0

DOMAIN = int(os.environ["ROS_DOMAIN_ID"])

NODE = """
import sys, anyio
from turtleact import open_node
from turtleact.transports import open_zenoh

async def main():
    async with (
        open_zenoh([sys.argv[1]]) as transport,
        open_node(sys.argv[2], transport=transport),
    ):
        await transport.flush()
        print("up", flush=True)
        await anyio.sleep_forever()

anyio.run(main)
"""


def free_endpoint() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{free.getsockname()[1]}"


@contextmanager
def process(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A process of Python that has printed its first line."""
    with warm.start([sys.executable, *arguments], stdout=subprocess.PIPE, text=True) as running:
        try:
            assert running.stdout is not None
            assert running.stdout.readline()
            yield running
        finally:
            running.kill()


def nodes_seen(at: str) -> set[str]:
    """What ``turtleact node list`` prints in a process of its own."""
    command = [sys.executable, "-m", "turtleact", "node", "list", "--connect", at]
    ran = warm.run(command, capture_output=True, text=True, timeout=PATIENCE, check=True)
    return set(ran.stdout.split())


# A router of Zenoh 1.10 has no tokens of a node of Zenoh 1.8 that was there before it. Access
# control makes the same of any node.
FORGETFUL = {
    "access_control": {
        "enabled": True,
        "default_permission": "allow",
        "rules": [
            {
                "id": "no tokens",
                "permission": "deny",
                "flows": ["ingress"],
                "messages": ["liveliness_token"],
                "key_exprs": ["@ros2_lv/**"],
            }
        ],
        "subjects": [{"id": "all"}],
        "policies": [{"rules": ["no tokens"], "subjects": ["all"]}],
    }
}


@pytest.mark.parametrize(("mode", "seen"), [("peer", ("/robot",)), ("client", ())])
async def test_a_peer_sees_at_once_the_nodes_whose_tokens_the_router_does_not_know(mode, seen):
    at = free_endpoint()
    async with (
        open_zenoh(mode="router", listen=[at], config=FORGETFUL),
        open_zenoh([at]) as far,
        open_node("robot", transport=far),
    ):
        await far.flush()
        async with open_zenoh([at], mode=mode) as near:
            await near.explore()
            assert near.nodes() == seen
        graph = await anyio.to_thread.run_sync(census, [at], DOMAIN, None, mode)
        assert graph.nodes() == seen


async def test_two_peers_that_join_at_once_see_each_other():
    at = free_endpoint()
    async with (
        open_zenoh(mode="router", listen=[at]),
        open_zenoh([at]) as here,
        open_zenoh([at]) as there,
        open_node("robot", transport=there) as robot,
    ):
        robot.publisher(Twist, "/cmd_vel")
        while here.nodes() != ("/robot",) or len(here.endpoints()) < len(there.endpoints()):
            await here.wait_for_change()


async def test_a_node_may_wait_for_its_router_as_those_of_ros_2_do():
    at = free_endpoint()
    waits = {
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 50, "period_max_ms": 50},
    }
    async with (
        open_zenoh([at], config=waits) as here,
        open_node("robot", transport=here),
        open_zenoh(mode="router", listen=[at]) as there,
        open_node("lab", transport=there),
    ):
        while here.nodes() != ("/robot", "/lab"):
            await here.wait_for_change()


def test_a_command_sees_the_nodes_that_have_outlived_a_router():
    at = free_endpoint()
    serve = ("-m", "turtleact", "serve", "--no-sim", "--listen", at)
    with process(*serve) as router, process("-c", NODE, at, "robot"):
        assert nodes_seen(at) == {"/robot", "/turtleact"}
        router.send_signal(signal.SIGKILL)
        router.wait()
        with process(*serve):
            deadline = time.monotonic() + PATIENCE
            while nodes_seen(at) != {"/robot", "/turtleact"}:  # it looks for a router every second
                assert time.monotonic() < deadline


def test_a_peer_that_hangs_keeps_no_command_for_long():
    at = free_endpoint()
    serve = ("-m", "turtleact", "serve", "--no-sim", "--listen", at)
    with process(*serve), process("-c", NODE, at, "robot"), process("-c", NODE, at, "stuck") as it:
        it.send_signal(signal.SIGSTOP)
        took = []
        for _ in range(3):  # Zenoh is held up in one run of two, for five seconds and more
            began = time.monotonic()
            assert {"/robot", "/turtleact"} <= nodes_seen(at)
            took.append(time.monotonic() - began)
        it.send_signal(signal.SIGCONT)
    assert max(took) - min(took) < 4.0
