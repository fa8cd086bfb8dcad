"""The checks of the doctor, on snapshots made by hand: each fault is named, and nothing else is."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from turtleact.doctor.checks import (
    Answer,
    EndpointSeen,
    Fault,
    NodeSeen,
    Report,
    Router,
    Snapshot,
    find_faults,
)
from turtleact.transports.base import Endpoint, EndpointKind, QoS, TimePolicies

OURS, THEIRS = f"RIHS01_{'a' * 64}", f"RIHS01_{'b' * 64}"
COUNT = "lab_interfaces/action/Count"
TWIST = "geometry_msgs/msg/Twist"
KNOWN = {TWIST: OURS, f"{COUNT}_SendGoal": OURS, f"{COUNT}_GetResult": OURS}
HEALTHY = Snapshot(domain=0, routers=(Router("r", "1.10.2"),), zenoh="1.9.0", known=KNOWN)


def end(
    kind: EndpointKind,
    node: str,
    *,
    name: str = "/cmd_vel",
    type_name: str = TWIST,
    type_hash: str = OURS,
    **more: Any,
) -> EndpointSeen:
    """An endpoint; every node is in a session of its own."""
    endpoint = Endpoint(kind, name, type_name, node, type_hash=type_hash, **more)
    return EndpointSeen(endpoint, f"session of {node}")


def server(node: str, service: str = "send_goal", type_hash: str = OURS) -> EndpointSeen:
    """A service of the action ``/count``."""
    word = {"send_goal": "SendGoal", "get_result": "GetResult"}[service]
    name, type_name = f"/count/_action/{service}", f"{COUNT}_{word}"
    return end("service", node, name=name, type_name=type_name, type_hash=type_hash)


def faults(**seen: Any) -> list[Fault]:
    """The faults of a graph that is healthy but for what is given."""
    return find_faults(msgspec.structs.replace(HEALTHY, **seen))


def only(**seen: Any) -> Fault:
    """The one fault of such a graph."""
    [fault] = faults(**seen)
    return fault


def test_a_graph_within_a_process_needs_no_router():
    assert not faults(routers=None)


def test_a_missing_router_is_named():
    assert str(only(routers=())) == (
        "no-router: no router is in reach, so nodes that start later are not found; start one with "
        "'turtleact serve' or with rmw_zenohd"
    )


def test_a_router_of_another_major_version_is_named():
    fault = only(routers=(Router("abc", "0.11.0"),))
    assert fault.problem == "router abc has Zenoh 0.11.0, this program 1.9.0"


@pytest.mark.parametrize("version", ["", "1.0.0"])
def test_a_router_of_the_same_or_an_unknown_version_is_no_fault(version):
    assert not faults(routers=(Router("abc", version),))


def test_an_empty_domain_is_a_fault_if_another_one_is_in_use():
    assert str(only(domains=(5, 9))) == (
        "domain: no node is in domain 0, but there are some in 5, 9; set ROS_DOMAIN_ID=5, or give "
        "--domain 5"
    )
    assert not faults(domains=(0, 5), nodes=(NodeSeen("/a", "1"),))
    assert not faults(domains=(0,))


def test_tools_that_take_whatever_they_find_are_no_fault():
    hidden = "/_recorder"
    assert not faults(
        nodes=(NodeSeen(hidden, "1"), NodeSeen(hidden, "2")),
        endpoints=(
            end("publisher", "/a"),
            end("subscription", hidden, type_hash="TypeHashNotSupported"),
            end("subscription", hidden, type_hash=THEIRS),
            end("subscription", hidden, type_name="std_msgs/msg/String"),
        ),
    )


def test_a_type_that_nobody_offers_under_a_name_is_named():
    other = "lab_interfaces/action/Other"
    known = {**KNOWN, f"{other}_SendGoal": OURS, f"{other}_GetResult": OURS}
    wrong = [
        end("client", "/b", name=f"/count/_action/{part}", type_name=f"{other}_{word}")
        for part, word in (("send_goal", "SendGoal"), ("get_result", "GetResult"))
    ]
    ends = (server("/a"), server("/a", "get_result"), *wrong)
    fault = only(known=known, endpoints=ends)
    assert fault.names == ("/count", other, "/b", "/a")
    assert str(fault) == (
        f"type: /count has type {COUNT} at /a, but {other} at /b; use the same type on both sides, "
        "or another name"
    )


def test_a_name_may_be_offered_with_several_types():
    other = "std_msgs/msg/String"
    known = {**KNOWN, other: OURS}
    both = (end("publisher", "/a"), end("publisher", "/a", type_name=other))
    assert not faults(known=known, endpoints=(*both, end("subscription", "/b", type_name=other)))
    assert not faults(endpoints=(end("subscription", "/b"),))


def test_a_process_that_does_not_answer_is_named_with_all_its_nodes():
    fault = only(
        nodes=(NodeSeen("/b", "1"), NodeSeen("/a", "1"), NodeSeen("/c", "2")),
        answers=(Answer("1", "/a", is_answered=False), Answer("2", "/c")),
    )
    assert (fault.kind, fault.names) == ("silent-node", ("/a", "/b"))
    assert fault.problem.startswith("nodes /a, /b do not answer")


@pytest.mark.parametrize(
    ("offset", "words"),
    [(5.0, "5 s ahead of"), (-0.2, "0.2 s behind")],
)
def test_clocks_that_differ_are_named(offset, words):
    fault = only(answers=(Answer("1", "/a", offset=offset, uncertainty=0.01),))
    assert (fault.kind, fault.names) == ("clock", ("/a",))
    assert words in fault.problem


def test_an_offset_that_a_slow_answer_explains_is_no_fault():
    assert not faults(answers=(Answer("1", "/a", offset=0.3, uncertainty=0.25),))


def test_nodes_of_one_name_are_named_whether_in_one_session_or_in_several():
    fault = only(nodes=(NodeSeen("/a", "1"), NodeSeen("/a", "1"), NodeSeen("/b", "1")))
    assert str(fault).startswith("duplicate-node: 2 nodes are called /a; give each")


def test_two_servers_of_an_action_are_named():
    fault = only(endpoints=(server("/b"), server("/a"), server("/a", "get_result")))
    assert fault.names == ("/count", "/a", "/b")
    assert fault.problem == "2 nodes serve action /count: /a, /b"


def test_one_node_may_serve_an_action_under_several_types():
    other = end("service", "/a", name="/count/_action/send_goal", type_name="x/action/Y_SendGoal")
    assert not faults(endpoints=(server("/a"), other), known=KNOWN | {"x/action/Y_SendGoal": OURS})


def test_the_fields_that_differ_are_named():
    fault = only(
        endpoints=(
            server("/a"),
            end(
                "client",
                "/b",
                name="/count/_action/send_goal",
                type_name=f"{COUNT}_SendGoal",
                type_hash=THEIRS,
            ),
        ),
        fields={
            (f"{COUNT}_SendGoal", OURS): {"request.goal.upto": "int32", "request.goal.by": "int8"},
            (f"{COUNT}_SendGoal", THEIRS): {"request.goal.upto": "int64"},
        },
    )
    assert fault.problem.endswith("(goal.upto is int32 and int64, goal.by is int8 and missing)")


def test_a_definition_that_only_this_program_has_counts_too():
    fault = only(endpoints=(end("publisher", "/a", type_hash=THEIRS),))
    assert "RIHS01_aaaaaaa… here" in fault.problem
    assert fault.names == ("/cmd_vel", TWIST, "/a")


def test_an_unknown_interface_is_named_once_by_the_name_that_users_write():
    ends = [server("/a"), server("/a", "get_result")]
    fault = only(endpoints=tuple(ends), known={})
    assert (fault.kind, fault.names) == ("unknown-interface", (COUNT, "/count"))


@pytest.mark.parametrize(
    ("offered", "asked", "words"),
    [
        ({"qos": QoS(reliability="best_effort")}, {}, "more reliability"),
        ({}, {"qos": QoS(durability="transient_local")}, "more durability"),
        ({}, {"times": TimePolicies(deadline=10**8)}, "a shorter deadline (0.1 s)"),
        (
            {"times": TimePolicies(lease=2 * 10**9)},
            {"times": TimePolicies(lease=10**9)},
            "a shorter lease duration (1 s)",
        ),
        ({}, {"times": TimePolicies(liveliness="manual_by_topic")}, "more liveliness"),
    ],
)
def test_a_subscription_that_asks_for_more_than_is_offered_is_named(offered, asked, words):
    fault = only(endpoints=(end("publisher", "/a", **offered), end("subscription", "/b", **asked)))
    assert (fault.kind, fault.names) == ("qos", ("/cmd_vel", "/a", "/b"))
    assert words in fault.problem


def test_what_processes_report_is_passed_on():
    fault = only(reports=(Report("disk /data/goals.db", "the disk is nearly full", "free some"),))
    assert str(fault) == "disk: the disk is nearly full; free some"
    assert fault.names == ("/data/goals.db",)
