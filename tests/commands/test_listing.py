"""What there is on the graph, as ``ros2`` lists it."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from turtleact import open_node
from turtleact.interfaces import get_interface
from turtleact.transports.base import TimePolicies

GOLDEN = json.loads(Path(__file__).with_name("golden").joinpath("verbs.json").read_text())
interface: Callable[[str], Any] = get_interface
ON_FIBONACCI = [
    "list",
    "list_c",
    "list_ct",
    "list_t",
    "info",
    "info_c",
    "info_noslash",
    "info_t",
    "info_unknown",
    "type",
    "type_noslash",
    "type_unknown",
    "node_list",
    "service_list_hidden",
    "topic_list_hidden",
    "topic_info_feedback",
    "topic_info_status",
    "rolling_find",
    "rolling_find_c",
    "rolling_find_unknown",
]
ON_TURTLESIM = ["action_list_t", "node_info_turtlesim", "topic_info_cmdvel", "topic_info_pose"]
ON_NOTHING = ["info_no_server", "list_no_server", "type_no_server"]
NOT_OURS = re.compile(r"^.*(/parameter_events|/rosout|parameter|type_description).*\n", re.M)
GID = re.compile(r"^GID: .*\n", re.M)


def recorded(name):
    """A recording, without what only nodes of ROS 2 have."""
    [case] = [case for case in GOLDEN if case["case"] == name]
    return case["command"], case["exit"], GID.sub("", NOT_OURS.sub("", case["stdout"]))


def as_recorded(run, nodes, name):
    command, status, out = recorded(name)
    ran = run(nodes, *shlex.split(command)[1:])
    assert (ran.status, NOT_OURS.sub("", ran.out), ran.err) == (status, out, "")


# --- as recorded ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ON_FIBONACCI)
def test_the_tutorials_server_is_listed_as_by_ros2(on_graph, graphs, name):
    as_recorded(on_graph, graphs.fibonacci, name)


@pytest.mark.parametrize("name", ON_TURTLESIM)
def test_turtlesim_is_listed_as_by_ros2(on_graph, graphs, name):
    as_recorded(on_graph, graphs.turtlesim, name)


@pytest.mark.parametrize("name", ON_NOTHING)
def test_an_empty_graph_is_listed_as_by_ros2(on_graph, graphs, name):
    as_recorded(on_graph, graphs.nothing, name)


def test_two_servers_of_one_name_are_both_listed(on_graph, graphs):
    """As ROS 2 allows; turtleact would refuse the second one."""

    @asynccontextmanager
    async def twice(transport):
        async with graphs.fibonacci(transport):
            once = transport.endpoints
            transport.endpoints = lambda *names: [*once(*names)] * 2
            yield

    as_recorded(on_graph, twice, "two_servers_info")


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("/fibonaci", "turtleact: nobody serves '/fibonaci', did you mean '/fibonacci'?\n"),
        ("/nix", ""),
        ("/fibonacci", ""),
    ],
)
def test_the_nearest_action_is_suggested_for_one_that_nobody_serves(on_graph, graphs, name, hint):
    ran = on_graph(graphs.fibonacci, "action", "info", name)
    assert (ran.status, ran.err) == (0, hint)


# --- a graph of our own ---------------------------------------------------------------------


@asynccontextmanager
async def talkers(transport):
    """A topic with two types, two publishers and a subscription; a hidden node; a latched topic."""
    string, number = interface("std_msgs/msg/String"), interface("std_msgs/msg/Int32")
    trigger = interface("std_srvs/srv/Trigger")
    async with (
        open_node("talker", namespace="/demo", transport=transport) as talker,
        open_node("listener", transport=transport) as listener,
        open_node("_hidden", transport=transport) as hidden,
    ):
        talker.publisher(string, "/chatter")
        hidden.publisher(number, "/chatter")
        talker.publisher(string, "secret/_topic")
        listener.subscription(string, "/chatter")
        talker.service(trigger, "/_private", lambda request: trigger.Response())
        listener.service_client(trigger, "/_private")
        listener.service(trigger, "/trigger", lambda request: trigger.Response())
        talker.service_client(trigger, "/trigger")
        yield


@pytest.mark.parametrize(
    ("arguments", "out"),
    [
        ("topic list", "/chatter\n"),
        ("topic list -t", "/chatter [std_msgs/msg/Int32, std_msgs/msg/String]\n"),
        ("topic list --include-hidden-topics", "/chatter\n/demo/secret/_topic\n"),
        (
            "topic list -v",
            "Published topics:\n"
            " * /chatter [std_msgs/msg/Int32, std_msgs/msg/String] 2 publishers\n\n"
            "Subscribed topics:\n"
            " * /chatter [std_msgs/msg/Int32, std_msgs/msg/String] 1 subscriber\n\n",
        ),
        ("topic type /chatter", "std_msgs/msg/Int32\nstd_msgs/msg/String\n"),
        (
            "topic find std_msgs/msg/String --include-hidden-topics",
            "/chatter\n/demo/secret/_topic\n",
        ),
        ("topic find -c std_msgs/msg/Bool", "0\n"),
        (
            "topic info chatter",
            "Type: ['std_msgs/msg/Int32', 'std_msgs/msg/String']\n"
            "Publisher count: 2\nSubscription count: 1\n",
        ),
        ("service list", "/trigger\n"),
        ("service list --include-hidden-services", "/_private\n/trigger\n"),
        ("service find -c std_srvs/srv/Trigger --include-hidden-services", "2\n"),
        (
            "service info trigger",
            "Type: std_srvs/srv/Trigger\nClients count: 1\nServices count: 1\n",
        ),
        ("node list", "/demo/talker\n/listener\n"),
        (
            "node info listener",
            "/listener\n  Subscribers:\n    /chatter: std_msgs/msg/String\n"
            "  Publishers:\n\n  Service Servers:\n    /trigger: std_srvs/srv/Trigger\n"
            "  Service Clients:\n\n  Action Servers:\n\n  Action Clients:\n\n",
        ),
    ],
)
def test_what_there_is_is_printed(on_graph, arguments, out):
    ran = on_graph(talkers, *arguments.split())
    assert (ran.status, ran.out, ran.err) == (0, out, "")


def test_all_nodes_are_the_hidden_ones_too_and_the_one_that_looks(on_graph):
    first, own, *others = on_graph(talkers, "node", "list", "-a").out.splitlines()
    assert (first, others) == ("/_hidden", ["/demo/talker", "/listener"])
    assert re.fullmatch(r"/_turtleact_cli_\d+", own)


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ("topic info chater", "unknown topic '/chater', did you mean '/chatter'?"),
        ("topic info /zzz", "unknown topic '/zzz' (there are: /chatter)"),
        ("service info /triger", "unknown service '/triger', did you mean '/trigger'?"),
        ("node info /_hidden", "there is no node '/_hidden'"),
    ],
)
def test_what_is_unknown_is_an_error_that_names_the_nearest(on_graph, arguments, problem):
    ran = on_graph(talkers, *arguments.split())
    assert (ran.status, ran.out) == (1, "")
    assert ran.err.startswith(f"turtleact: {problem}")


@pytest.mark.parametrize("what", ["topic", "service", "action"])
def test_the_type_of_what_is_unknown_is_not_spoken_of(on_graph, what):
    assert on_graph(talkers, what, "type", "/zzz") == (1, "", "")


def test_an_action_has_the_clients_that_joined_it(on_graph, graphs):
    ran = on_graph(graphs.goals, "action", "info", "-t", "count")
    assert ran.out == (
        "Action: count\nAction clients: 2\n"
        "    /aide [example_interfaces/action/Fibonacci]\n"
        "    /boss [example_interfaces/action/Fibonacci]\n"
        "Action servers: 1\n    /server [example_interfaces/action/Fibonacci]\n"
    )


def test_nodes_that_share_a_name_are_noted(on_graph, graphs):
    @asynccontextmanager
    async def twice(transport):
        async with (
            graphs.fibonacci(transport),
            open_node("fibonacci_action_server", transport=transport),
        ):
            yield

    ran = on_graph(twice, "node", "list")
    assert ran.out == "/fibonacci_action_server\n/fibonacci_action_server\n"
    assert ran.err.endswith("several nodes have the same name: /fibonacci_action_server\n")
    ran = on_graph(twice, "node", "info", "/fibonacci_action_server")
    assert "2 nodes have the name '/fibonacci_action_server'" in ran.err
    assert "  Action Servers:\n    /fibonacci: example_interfaces/action/Fibonacci\n" in ran.out


# --- what only a wire tells -----------------------------------------------------------------


def test_the_gid_and_the_hash_of_a_wire_are_shown(on_graph, graphs):
    nodes = graphs.on_a_wire(type_hash="RIHS01_ab", gid=bytes.fromhex("0110b022"))
    out = on_graph(nodes, "topic", "info", "-v", "/far").out
    assert "Node name: far\nNode namespace: /ns\n" in out
    assert "Topic type hash: RIHS01_ab\nEndpoint type: PUBLISHER\nGID: 01.10.b0.22\nQoS" in out


def test_the_policies_in_time_of_a_peer_are_printed_as_rclpy_prints_them(on_graph, graphs):
    times = TimePolicies(
        deadline=500_000_000, lifespan=10**10, liveliness="manual_by_topic", lease=10**9
    )
    out = on_graph(graphs.on_a_wire(times=times), "topic", "info", "-v", "/far").out
    assert (
        "  Lifespan: 10000000000 nanoseconds\n"
        "  Deadline: 500000000 nanoseconds\n"
        "  Liveliness: MANUAL_BY_TOPIC\n"
        "  Liveliness lease duration: 1000000000 nanoseconds\n"
    ) in out


def test_a_name_of_a_wire_commands_no_terminal(on_graph, graphs):
    nodes = graphs.on_a_wire(name="/far\x1b[2J")
    assert on_graph(nodes, "topic", "list").out == "/far\\x1b[2J\n"
