"""``doctor``, and the notes of other verbs about definitions that differ."""

from __future__ import annotations

import json
from contextlib import asynccontextmanager

import pytest

from turtleact import QoS, open_node
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
