"""``doctor``, and the notes of other verbs about definitions that differ."""

from __future__ import annotations

import json
from contextlib import asynccontextmanager

import pytest

from turtleact import QoS, open_node
from turtleact.commands.doctor import fact_lines
from turtleact.doctor.checks import Answer, NodeSeen, Router, Snapshot
from turtleact.interfaces.standard import Twist
from turtleact.transports.base import Endpoint

A, B = f"RIHS01_{'a' * 64}", f"RIHS01_{'b' * 64}"
DIFFER = (
    "the definitions of geometry_msgs/msg/Twist on /speed differ: RIHS01_aaaaaaa… at /one and "
    "RIHS01_bbbbbbb… at /two"
)


@asynccontextmanager
async def faulty(transport):
    """A subscription that asks for more than its publisher offers."""
    async with open_node("sensor", transport=transport) as node:
        node.publisher(Twist, "speed", QoS(reliability="best_effort"))
        node.subscription(Twist, "speed")
        yield


@asynccontextmanager
async def differing(transport):
    """Two nodes of other processes with different definitions."""
    seen = tuple(
        Endpoint("publisher", "/speed", Twist.type_name, node, type_hash=type_hash)
        for node, type_hash in (("/one", A), ("/two", B))
    )
    transport.endpoints = lambda name="": seen  # all have this name
    transport.nodes = lambda: ("/one", "/two")
    yield


@asynccontextmanager
async def healthy(transport):
    async with open_node("lab", transport=transport):
        yield


def test_a_healthy_graph_has_no_faults(on_graph):
    assert on_graph(healthy, "doctor") == (0, "no faults found\n", "")


def test_a_fault_is_one_line_with_what_to_do(on_graph):
    assert on_graph(faulty, "doctor") == (
        1,
        "qos: on topic /speed, /sensor asks for more reliability (reliable, not best_effort) than "
        "/sensor offers; choose the same quality of service on both sides\n",
        "",
    )


def test_faults_may_be_lines_of_json(on_graph):
    ran = on_graph(faulty, "doctor", "--json")
    [fault] = map(json.loads, ran.out.splitlines())
    assert (ran.status, fault["fault"], fault["names"]) == (
        1,
        "qos",
        ["/speed", "/sensor", "/sensor"],
    )
    assert on_graph(healthy, "doctor", "--json") == (0, "", "")


def test_facts_are_added_if_asked(on_graph):
    lines = on_graph(healthy, "doctor", "-v").out.splitlines()
    assert lines[0] == "no faults found"
    assert "nodes: 1 in 1 sessions" in lines
    [told] = map(json.loads, on_graph(healthy, "doctor", "-v", "--json").out.splitlines())
    assert told["facts"]["nodes"] == 1


def test_the_facts_are_sentences():
    seen = Snapshot(
        domain=7,
        domains=(0, 7),
        routers=(Router("abc", "1.10.2", 3), Router("def")),
        zenoh="1.9.0",
        nodes=(NodeSeen("/a", "1"), NodeSeen("/b", "1"), NodeSeen("/c", "2")),
        answers=(Answer("1", "/a", offset=-0.01, uncertainty=0.002), Answer("2", "/c")),
    )
    assert list(fact_lines(seen)) == [
        "domain: 7 (others in use: 0)",
        "router: abc, Zenoh 1.10.2, sessions: 3",
        "router: def, Zenoh unknown, sessions: unknown",
        "Zenoh here: 1.9.0",
        "nodes: 3 in 2 sessions",
        "endpoints: 0",
        "clock of /a: 0.0100 s behind (± 0.0020 s)",
    ]


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_a_graph_out_of_reach_is_a_fault(turtleact, options):
    ran = turtleact("doctor", "--connect", "tcp/127.0.0.1:1", *options)
    assert (ran.status, ran.err) == (1, "")
    assert "no-router" in ran.out
    assert "start a router there" in ran.out


def test_node_info_notes_definitions_that_differ(on_graph):
    ran = on_graph(differing, "node", "info", "/one")
    assert ran.status == 0
    assert ran.err.startswith(f"turtleact: {DIFFER}; use the same interface files")


def test_topic_echo_notes_a_definition_that_differs_from_the_one_here(on_graph):
    ran = on_graph(differing, "topic", "echo", "/speed", "--timeout", "0.1")
    assert "geometry_msgs/msg/Twist on /speed differ" in ran.err
    assert "RIHS01_9c45bf1… here" in ran.err
