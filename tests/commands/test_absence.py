"""What a command says when the server, the router or the nodes that it looks for are not there."""

from __future__ import annotations

import shlex
import signal
import threading

import pytest

from turtleact import open_node, open_zenoh
from turtleact.commands import graph, send_goal
from turtleact.commands.graph import none_in_domain
from turtleact.commands.settings import ConnectOptions
from turtleact.errors import TurtleactError

from ..lab import free_endpoint

HERE = ConnectOptions((), 0)


@pytest.fixture
def at():
    return free_endpoint()


@pytest.fixture
def without_router(monkeypatch):
    """No router lets a command in; gives how often it was asked."""
    asked = []

    def refuse(reach, *_):
        asked.append(reach)
        raise TurtleactError("no ROS 2 graph in reach")

    monkeypatch.setattr(graph, "open_transport", refuse)
    return asked


async def test_an_empty_domain_names_the_domains_that_have_nodes(at):
    async with (
        open_zenoh(listen=[at], mode="router", domain=3) as lab,
        open_node("lab", transport=lab),
        open_zenoh([at], domain=0) as other,
        open_node("_hidden", transport=other),
    ):
        await lab.flush()
        said = await none_in_domain(other, HERE, "actions")
        assert said == "domain 0 has no actions (domain 3 has nodes: try --domain 3)"
        async with open_zenoh([at], domain=5) as third, open_node("third", transport=third):
            await third.flush()
            said = await none_in_domain(other, HERE)
            assert "(domains 3, 5 have nodes: try --domain 3)" in said


def test_a_world_is_started_with_the_reason(turtleact, without_router):
    ran = turtleact("send-goal", "fibonaci")
    assert (ran.status, ran.err.splitlines()) == (
        1,
        [
            "turtleact: started an embedded world, which ends with this command, because no "
            "router answers at tcp/localhost:7447 ('turtleact serve' starts one)",
            "turtleact: action '/fibonaci': nobody serves it, did you mean '/fibonacci'?; is your "
            "server running?",
        ],
    )


def test_a_timeout_of_zero_starts_no_world(turtleact, without_router):
    ran = turtleact("send-goal", "fibonacci", "--timeout", "0")
    assert (ran.status, ran.err) == (
        1,
        "turtleact: action '/fibonacci': no server is in reach; no router answers at "
        "tcp/localhost:7447 ('turtleact serve' starts one)\n",
    )


@pytest.mark.parametrize("connect", ["", "--connect tcp/127.0.0.1:1"])
def test_reattach_waits_for_a_server_instead_of_starting_a_world(
    turtleact, without_router, monkeypatch, connect
):
    monkeypatch.setattr(send_goal, "AGAIN", 0.01)
    ran = turtleact(*shlex.split(f"send-goal now --reattach 0.1 {connect}"))
    assert ran.status == 1
    assert len(without_router) > 2
    first, last = ran.err.splitlines()
    assert first == "turtleact: nobody serves '/now' yet: waiting for a server for up to 0.1 s"
    assert last.startswith(
        "turtleact: no ROS 2" if connect else "turtleact: action '/now': no server after 0.1 s; no"
    )


def test_reattach_waits_until_the_action_is_served(on_graph, graphs):
    ran = on_graph(
        graphs.in_turn(graphs.parameters, graphs.later(0.01, graphs.fibonacci)),
        *shlex.split("send-goal fibonacci 'order: 1' --reattach 20 --plain"),
    )
    assert (ran.status, ran.err.count("waiting for a server for up to 20 s")) == (0, 1)


def test_a_signal_ends_that_wait(turtleact, without_router):
    threading.Timer(0.1, signal.raise_signal, [signal.SIGINT]).start()
    ran = turtleact("send-goal", "now", "--reattach", "600")
    assert (ran.status, ran.err.splitlines()[-1]) == (
        130,
        "turtleact: interrupted before the goal was accepted, so it was withdrawn",
    )
