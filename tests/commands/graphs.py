"""Graphs for tests: nodes in this process, in virtual time. As a program: the command line there.

Each is an async context manager that takes a transport; ``open_graph`` makes a transport of it, as
``turtleact.commands.graph.open_transport`` would.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from contextlib import aclosing, asynccontextmanager
from typing import Any

import anyio

from turtleact import Abort, CancelResponse, QoS, cli, open_node
from turtleact.commands import graph
from turtleact.interfaces import get_interface
from turtleact.interfaces.standard import ExampleFibonacci as Fibonacci
from turtleact.interfaces.standard import TurtlePose, Twist
from turtleact.tasks import Background
from turtleact.tasks.clock import VirtualClock, WallClock
from turtleact.transports import MemoryTransport
from turtleact.transports.base import Endpoint

interface: Callable[[str], Any] = get_interface

POSE = TurtlePose(x=5.544444561004639, y=5.544444561004639)
SERVICES = {
    "/clear": "std_srvs/srv/Empty",
    "/kill": "turtlesim/srv/Kill",
    "/reset": "std_srvs/srv/Empty",
    "/spawn": "turtlesim/srv/Spawn",
    "/turtle1/set_pen": "turtlesim/srv/SetPen",
    "/turtle1/teleport_absolute": "turtlesim/srv/TeleportAbsolute",
    "/turtle1/teleport_relative": "turtlesim/srv/TeleportRelative",
}


def open_graph(nodes, clock=VirtualClock):
    """What opens the graph of these nodes for a verb."""

    @asynccontextmanager
    async def open_transport(reach, mode=None):
        transport = MemoryTransport(clock())
        async with aclosing(Background(transport.clock.run(), "the clock")), nodes(transport):
            yield transport

    return open_transport


@asynccontextmanager
async def nothing(transport):
    yield


def in_turn(*several):
    """The nodes of several graphs."""

    @asynccontextmanager
    async def nodes(transport):
        if not several:
            yield
            return
        async with several[0](transport), in_turn(*several[1:])(transport):
            yield

    return nodes


def after(seconds, act):
    """Calls something after some seconds of the graph's clock."""

    @asynccontextmanager
    async def nodes(transport):
        async def run():
            await transport.clock.sleep(seconds)
            act()

        async with aclosing(Background(run(), "what comes after")):
            yield

    return nodes


def later(seconds, nodes):
    """The nodes of a graph that come some seconds after its beginning, by its clock."""

    @asynccontextmanager
    async def coming(transport):
        async def run():
            await transport.clock.sleep(seconds)
            async with nodes(transport):
                await anyio.sleep_forever()

        async with aclosing(Background(run(), "who comes later")):
            yield

    return coming


def interrupted(seconds):
    """Ctrl-C after some seconds."""
    return after(seconds, lambda: signal.raise_signal(signal.SIGINT))


def on_a_wire(name="/far", **known):
    """A publisher of another process, such as a wire would tell of."""

    @asynccontextmanager
    async def nodes(transport):
        far = Endpoint("publisher", name, "far_msgs/msg/Away", "/ns/far", QoS(), **known)
        transport.endpoints = lambda *_: (far,)
        yield

    return nodes


async def fibonacci_body(goal, handle):
    sequence = [0, 1]
    for i in range(1, goal.order):
        await handle.node.clock.sleep(1)
        sequence.append((sequence[i] + sequence[i - 1]) % 100_000)
        yield Fibonacci.Feedback(sequence=sequence)
    yield Fibonacci.Result(sequence=sequence)


@asynccontextmanager
async def fibonacci(transport):
    async with open_node("fibonacci_action_server", transport=transport) as node:
        node.action_server(Fibonacci, "fibonacci", fibonacci_body)
        yield node


@asynccontextmanager
async def turtlesim(transport):
    """The endpoints of turtlesim; its turtle stands still, 62.5 poses a second tell."""
    async with open_node("turtlesim", transport=transport) as node:
        event = interface("rcl_interfaces/msg/ParameterEvent")
        node.publisher(event, "/parameter_events", QoS(depth=1000))
        qos = QoS(depth=7)
        node.subscription(Twist, "/turtle1/cmd_vel", qos)
        node.publisher(interface("turtlesim/msg/Color"), "/turtle1/color_sensor", qos)
        pose = node.publisher(TurtlePose, "/turtle1/pose", qos)
        for name, type_name in SERVICES.items():
            node.service(interface(type_name), name, answer(interface(type_name)))
        rotate = interface("turtlesim/action/RotateAbsolute")
        node.action_server(rotate, "/turtle1/rotate_absolute", fibonacci_body)
        async with aclosing(Background(again_and_again(node, pose, POSE, 0.016), "poses")):
            yield node


@asynccontextmanager
async def parameters(transport):
    async with open_node("turtlesim", transport=transport) as node:
        declared = {}
        for name, value in (("r", 69), ("g", 86), ("b", 255)):
            colour = {"r": "Red", "g": "Green", "b": "Blue"}[name]
            text = f"{colour} channel of the background color"
            declared[f"background_{name}"] = node.parameter(
                f"background_{name}", value, description=text, range=(0, 255, 1)
            )
        text = "If true, then turtles will be holonomic"
        declared["holonomic"] = node.parameter("holonomic", False, description=text)
        yield declared


@asynccontextmanager
async def driver(transport):
    """A node with a parameter, as docs/nodes.md declares it."""
    async with open_node("driver", transport=transport) as node:
        text = "Highest speed (m/s)"
        node.parameter("max_speed", 1.0, description=text, range=(0.0, 2.0))
        yield


def answer(service_type):
    names = {"turtlesim/srv/Spawn": {"name": "turtle2"}}
    response = names.get(service_type.type_name, {})
    return lambda request: service_type.Response(**response)


async def again_and_again(node, publisher, message, period):
    while True:
        publisher.publish(message)
        await node.clock.sleep(period)


async def hold(goal):
    yield Fibonacci.Feedback(sequence=[0])
    await anyio.sleep_forever()


async def fail(goal, handle):
    yield Fibonacci.Feedback(sequence=[7])
    await handle.node.clock.sleep(60)
    raise Abort("by hand")


IDS = {
    "hold": "71a906369b85473ab15bb0160400f6a4",
    "later": "71a9ffff9b85473ab15bb0160400f6a4",
    "refuse": "0d4fd2a0d2b74b3f9a3f1f7c2f4f8f2e",
    "count": "c53d3439a0e348a6b910e9028279a17a",
    "done": "3c87eb979ec646d88d02a52e6a57ee59",
    "fail": "fbda737307334cbbb22f0a599bd12cac",
}


@asynccontextmanager
async def goals(transport):
    """Goals in all states: two that hold, one that refuses, one that counts, one done, one failing.

    They are accepted a second after each other; the last one, ``later``, 90 seconds behind them.
    """
    async with (
        open_node("server", transport=transport) as server,
        open_node("boss", transport=transport) as boss,
        open_node("aide", transport=transport) as aide,
    ):
        server.action_server(Fibonacci, "hold", hold, result_timeout=None)
        server.action_server(Fibonacci, "count", fibonacci_body, result_timeout=None)
        server.action_server(
            Fibonacci, "refuse", hold, cancel_callback=lambda handle: CancelResponse.REJECT
        )
        server.action_server(Fibonacci, "fail", fail, result_timeout=None)
        clients = {
            name: boss.action_client(Fibonacci, name) for name in ("hold", "count", "refuse")
        }
        clients["fail"] = aide.action_client(Fibonacci, "fail")
        aide.action_client(Fibonacci, "count")
        order = [("hold", 0, "hold"), ("refuse", 0, "refuse"), ("count", 1, "done")]
        order += [("count", 120, "count"), ("fail", 0, "fail"), ("hold", 0, "later")]
        for name, number, known_as in order:
            goal_id = bytes.fromhex(IDS[known_as])
            goal = Fibonacci.Goal(order=number)
            async with clients[name].send_goal(goal, goal_id=goal_id) as handle:
                handle.detach()
            await transport.clock.sleep(90 if name == "fail" else 1)
        yield


if __name__ == "__main__":
    graph.open_transport = open_graph(in_turn(fibonacci, turtlesim), WallClock)
    sys.exit(cli.main())
