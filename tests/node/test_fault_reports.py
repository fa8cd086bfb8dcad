"""Faults that a process reports: published when there are some, and taken back when they go."""

from __future__ import annotations

import shutil
import threading
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import turtleact
from turtleact.goals import fault_reports
from turtleact.goals.fault_reports import (
    ROOM,
    TOPIC,
    FaultReports,
    disk_fault,
    watching_disk,
)
from turtleact.interfaces.standard.diagnostic_msgs.msg import DiagnosticArray
from turtleact.recording import record
from turtleact.testing import FaultyTransport
from turtleact.transports import MemoryTransport, QoS, open_zenoh
from turtleact.transports.rmw_zenoh import topics

from ..lab import Count, count, feedback, goal, result, settle

LATCHED = QoS(depth=10, durability="transient_local")


class Usage(NamedTuple):
    total: int
    used: int
    free: int


def told(message: DiagnosticArray) -> list[tuple[str, str]]:
    return [(each.name, each.message) for each in message.status]


async def test_the_topic_exists_from_the_first_fault_on():
    async with turtleact.open_node("lab") as node:
        reports = FaultReports(node.transport, "/lab")
        assert not node.transport.endpoints(TOPIC)
        reports.report("disk /a", "it is full", "free some space")
        reader = node.subscription(DiagnosticArray, TOPIC, LATCHED)
        [message] = reader.drain()
        assert told(message) == [("disk /a", "it is full")]
        assert [(each.key, each.value) for each in message.status[0].values] == [
            ("advice", "free some space")
        ]
        reports.close()
        assert not [each for each in node.transport.endpoints(TOPIC) if each.kind == "publisher"]


async def test_a_fault_replaces_an_earlier_one_and_is_taken_back():
    async with turtleact.open_node("lab") as node:
        reports = FaultReports(node.transport, "/lab")
        reader = node.subscription(DiagnosticArray, TOPIC, LATCHED)
        reports.report("a", "one", "")
        reports.report("b", "two", "")
        reports.report("a", "three", "")
        reports.report("a", "three", "")  # nothing new, so nothing is published
        reports.clear("b")
        reports.clear("c")
        assert [told(each) for each in reader.drain()] == [
            [("a", "one")],
            [("a", "one"), ("b", "two")],
            [("a", "three"), ("b", "two")],
            [("a", "three")],
        ]
        reports.close()


@pytest.mark.parametrize(
    ("total", "free", "is_fault"),
    [
        (10**12, ROOM - 1, True),
        (10**12, ROOM, False),
        (10**9, 49_000_000, True),  # a small disk may be nearly full with less
        (10**9, 51_000_000, False),
    ],
)
def test_a_disk_is_nearly_full_by_its_size(monkeypatch, total, free, is_fault):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(total, 0, free))
    problem = disk_fault(Path("/data/goals.db"), "journal")
    assert bool(problem) is is_fault
    if is_fault:
        assert problem == (
            f"the disk of the journal /data/goals.db is nearly full: {free / 1e6:.0f} MB are free"
        )


async def test_a_disk_is_looked_at_again_and_again(monkeypatch, tmp_path):
    free = [0]
    monkeypatch.setattr(fault_reports, "LOOK_EVERY", 0.0)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**12, 0, free[0]))
    async with turtleact.open_node("lab") as node:
        reader = node.subscription(DiagnosticArray, TOPIC, LATCHED)
        async with watching_disk(node.transport, "/lab", tmp_path, "recording"):
            assert told(await anext(reader))[0][0] == f"disk {tmp_path}"
            free[0] = 10**12
            assert told(await anext(reader)) == []


async def test_a_client_reports_feedback_that_has_not_arrived(monkeypatch):
    monkeypatch.setattr("turtleact.goals.remote.LATE_FEEDBACK", 0.01)
    graph = MemoryTransport()
    async with (
        FaultyTransport(graph, seed=1) as faulty,
        turtleact.open_node("server", transport=graph) as far,
        turtleact.open_node("client", transport=faulty) as near,
    ):
        far.action_server(Count, "count", count, introspection="metadata")  # goals as messages
        client = near.action_client(Count, "count")
        await client.send_goal(goal(1))
        faulty.drop = 1.0
        await client.send_goal(goal(3))
        reader = far.subscription(DiagnosticArray, TOPIC, LATCHED)
        await settle()
        [(name, problem)] = told(reader.drain()[-1])
        assert name == "lost-feedback /count"
        assert problem == "3 feedback messages of action /count did not reach node /client"


@pytest.mark.loops("asyncio")
async def test_a_server_reports_feedback_that_it_had_to_drop(monkeypatch, tmp_path):
    monkeypatch.setattr(topics, "CAPACITY", 2_000)
    address = f"unixsock-stream/{tmp_path}/socket"
    gate = threading.Event()

    async def flood(goal: Count.Goal, handle: Any) -> Count.Result:
        there.context.send_queue.post(gate.wait)  # nothing is sent meanwhile
        for number in range(goal.upto):
            handle.publish_feedback(feedback(number))
        gate.set()
        return result()

    async with (
        open_zenoh([], listen=[address]) as there,
        open_zenoh([address], listen=[]) as here,
        turtleact.open_node("server", transport=there) as far,
        turtleact.open_node("client", transport=here) as near,
    ):
        monkeypatch.setattr("turtleact.goals.remote.LATE_FEEDBACK", 0.01)
        far.action_server(Count, "count", flood)
        client = near.action_client(Count, "count")
        await client.send_goal(goal(100))
        reader = far.subscription(DiagnosticArray, TOPIC, LATCHED)
        names = {name: problem async for name, problem in first_of(reader)}
        assert "were dropped by node /server" in names["lost-feedback /count"]


async def first_of(reader: Any) -> AsyncIterator[tuple[str, str]]:
    for each in told(await anext(reader)):
        yield each


async def test_a_recording_on_a_nearly_full_disk_is_reported(monkeypatch, tmp_path):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**12, 0, 0))
    async with turtleact.open_node("lab") as node:
        reader = node.subscription(DiagnosticArray, TOPIC, LATCHED)
        async with record(node, tmp_path / "run", topics=["/count"]):
            [(name, problem)] = told(await anext(reader))
        assert name == f"disk {tmp_path / 'run'}"
        assert problem.startswith("the disk of the recording")
