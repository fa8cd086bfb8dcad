"""The doctor on a running graph: twelve faults are planted, and each is named."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import anyio
import pytest

import turtleact
from turtleact import QoS
from turtleact.doctor.checks import Fault, find_faults
from turtleact.doctor.gathering import take_snapshot
from turtleact.goals.fault_reports import TOPIC, FaultReports
from turtleact.interfaces import Message, int32, int64
from turtleact.interfaces import type_hash as hash_of
from turtleact.interfaces.standard import Twist
from turtleact.interfaces.standard.diagnostic_msgs.msg import (
    DiagnosticArray,
    DiagnosticStatus,
    KeyValue,
)
from turtleact.interfaces.standard.type_description_interfaces.srv import GetTypeDescription
from turtleact.node import Node
from turtleact.transports import MemoryTransport, ZenohTransport, open_zenoh
from turtleact.transports.base import Endpoint
from turtleact.transports.rmw_zenoh.wire import endpoint_token

from ..lab import Count, count

pytestmark = pytest.mark.loops("asyncio", "trio")

SOON = 3.0
"""How quickly the doctor names a fault (s)."""

OLD = "TypeHashNotSupported"
"""What ROS 2 Humble writes instead of a hash."""


@pytest.fixture
def address(tmp_path) -> str:
    return f"unixsock-stream/{tmp_path}/router"


class Graph:
    """A router, and the sessions of several processes."""

    def __init__(self, address: str, stack: AsyncExitStack) -> None:
        self._address = address
        self._stack = stack

    async def session(self, mode: Any = "client") -> ZenohTransport:
        """Another process."""
        opened = open_zenoh([self._address], mode=mode, listen=[])
        return await self._stack.enter_async_context(opened)

    async def node(self, name: str) -> Node:
        """A node in a process of its own."""
        opened = turtleact.open_node(name, transport=await self.session())
        return await self._stack.enter_async_context(opened)

    async def faults(self, *, endpoints: int = 0, is_faulty: bool = False) -> list[Fault]:
        """Wait until the graph has that many endpoints, and return what the doctor then finds.

        With ``is_faulty``, the doctor looks again after each change until it finds a fault.
        """
        transport = await self.session()
        async with turtleact.open_node("_doctor", transport=transport) as node:
            await transport.explore()
            while len(transport.endpoints()) < endpoints:
                await transport.wait_for_change()
            with anyio.fail_after(SOON):
                while True:
                    seen = transport.changes
                    found = find_faults(await take_snapshot(node))
                    if found or not is_faulty:
                        return found
                    if transport.changes == seen:
                        await transport.wait_for_change()

    async def only_fault(self, *, endpoints: int = 0) -> Fault:
        """The one fault."""
        [fault] = await self.faults(endpoints=endpoints, is_faulty=True)
        return fault


@asynccontextmanager
async def graph_at(address: str) -> AsyncIterator[Graph]:
    async with AsyncExitStack() as stack:
        opened = open_zenoh([], mode="router", listen=[address])
        await stack.enter_async_context(opened)
        yield Graph(address, stack)


async def test_a_healthy_graph_has_no_faults(address):
    async with graph_at(address) as graph:
        server = await graph.node("server")
        server.action_server(Count, "count", count)
        client = (await graph.node("client")).action_client(Count, "count")
        assert await client.wait_for_server()
        assert await graph.faults() == []


async def test_different_definitions_are_named_with_their_fields(address):
    class Here(Message, type_name="lab_interfaces/msg/Level"):
        height: int32 = 0

    async with graph_at(address) as graph:
        one = await graph.node("one")
        one.publisher(Here, "level")

        class There(Message, type_name="lab_interfaces/msg/Level"):
            height: int64 = 0
            unit: int32 = 0

        two = await graph.node("two")
        two.subscription(There, "level")
        fault = await graph.only_fault(endpoints=2)
        assert fault.names == ("/level", "lab_interfaces/msg/Level", "/one", "/two")
        assert " at /one" in fault.problem
        assert " at /two" in fault.problem


async def test_a_node_of_an_old_release_is_named(address):
    async with graph_at(address) as graph:
        kept = plant(await graph.session(), "/humble", Twist.type_name, OLD)
        fault = await graph.only_fault(endpoints=1)
        assert (fault.kind, fault.names) == ("version", ("/humble",))
        kept.clear()


@pytest.mark.parametrize("kind", ["lost-feedback", "disk"])
async def test_what_a_process_reports_is_named_also_to_a_doctor_that_comes_later(address, kind):
    async with graph_at(address) as graph:
        node = await graph.node("server")
        reports = FaultReports(node.transport, "/server")
        reports.report(f"{kind} /it", "something is wrong", "mend it")
        for _ in range(2):
            fault = await graph.only_fault(endpoints=1)
            assert str(fault) == f"{kind}: something is wrong; mend it"
        reports.close()


@pytest.mark.parametrize(("until", "is_fault"), [("", True), ("9e9", True), ("1e9", False)])
async def test_a_reported_fault_ends_at_its_time(address, until, is_fault):
    values = [KeyValue("advice", "mend it"), KeyValue("until", until)]
    async with graph_at(address) as graph:
        node = await graph.node("server")
        topic = node.publisher(DiagnosticArray, TOPIC, QoS(durability="transient_local"))
        topic.publish(DiagnosticArray(status=[DiagnosticStatus(name="disk /a", values=values)]))
        assert bool(await graph.faults(endpoints=1)) is is_fault


async def test_a_graph_of_peers_alone_lacks_a_router(address):
    async with (
        open_zenoh([], listen=[address]),
        open_zenoh([address], listen=[]) as here,
        turtleact.open_node("_doctor", transport=here) as node,
    ):
        [fault] = find_faults(await take_snapshot(node))
        assert fault.kind == "no-router"


async def test_the_facts_name_the_router_and_its_version(address):
    async with graph_at(address) as graph:
        transport = await graph.session()
        async with turtleact.open_node("_doctor", transport=transport) as node:
            snapshot = await take_snapshot(node, with_domains=True)
        [router] = snapshot.routers or ()
        assert router.version == snapshot.zenoh
        assert (router.sessions, snapshot.domain) == (1, transport.context.domain)


async def test_a_graph_within_one_process_is_looked_at_too():
    async with turtleact.open_node("lab", transport=MemoryTransport()) as node:
        node.publisher(Twist, "speed", QoS(reliability="best_effort"))
        async with turtleact.open_node("reader", transport=node.transport) as reader:
            reader.subscription(Twist, "speed")
            async with turtleact.open_node("_doctor", transport=node.transport) as doctor:
                [fault] = find_faults(await take_snapshot(doctor))
        assert fault.names == ("/speed", "/lab", "/reader")


def plant(transport: ZenohTransport, node: str, type_name: str, type_hash: str) -> list[object]:
    """Declare the token of a publisher that turtleact itself would not open, and return it."""
    kept: list[object] = []
    context = transport.context
    endpoint = Endpoint("publisher", "/planted", type_name, node, type_hash=type_hash)
    token = endpoint_token(context.domain, context.session.zid, 99, 99, endpoint)
    # Without a reference to it, the token would be undeclared at once.
    context.send_queue.post(lambda: kept.append(context.session.declare_token(token)))
    return kept


async def test_a_node_describes_its_types_once_another_process_asks(address):
    async with graph_at(address) as graph:
        node = await graph.node("lab")
        node.publisher(Twist, "cmd_vel")
        name = "/lab/get_type_description"
        assert not node.transport.endpoints(name)
        asker = await graph.node("asker")
        for _ in range(2):  # the second time, it is there already
            client = asker.service_client(GetTypeDescription, name)
            assert await client.wait_for_service()
            request = GetTypeDescription.Request(type_hash=hash_of(Twist))
            response = await client.call(request)
            assert response.type_description.type_description.type_name == Twist.type_name
            await client.aclose()
        await node.aclose()
        while asker.transport.endpoints(name):
            await asker.transport.wait_for_change()
