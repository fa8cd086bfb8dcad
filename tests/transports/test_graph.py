"""What exists on a graph: which names there are, of which types, and what of it is hidden."""

from __future__ import annotations

import pytest

from turtleact.interfaces import WireFormat
from turtleact.interfaces.standard import Empty, Kill, TurtlePose, Twist
from turtleact.names import action_names
from turtleact.transports import MemoryTransport, QoS
from turtleact.transports.base import Endpoint, EndpointKind, ServiceHandler, TimePolicies
from turtleact.transports.graph import Graph, graph_of, misfits

POSE, TWIST = "turtlesim/msg/Pose", "geometry_msgs/msg/Twist"
PUBLISHER: EndpointKind = "publisher"
SUBSCRIPTION: EndpointKind = "subscription"
SERVICE: EndpointKind = "service"
CLIENT: EndpointKind = "client"


def graph_with(*opened: tuple[EndpointKind, str, str]) -> Graph:
    """The graph of a transport on which some endpoints are open: kind, name and type."""
    transport = MemoryTransport()
    for kind, name, type_name in opened:
        endpoint = Endpoint(kind, name, type_name, "/lab")
        if kind == "publisher":
            transport.advertise(endpoint, WireFormat(Twist))
        elif kind == "subscription":
            transport.subscribe(endpoint, WireFormat(Twist), lambda message: None)
        elif kind == "service":
            transport.serve(endpoint, WireFormat(Empty), ServiceHandler())
        else:
            transport.join(endpoint, WireFormat(Empty))
    return graph_of(transport)


def test_where_nothing_is_there_is_nothing_on_the_graph():
    assert graph_of(MemoryTransport()) == Graph((), {}, {}, {})


def test_a_name_that_two_nodes_have_is_on_the_graph_once():
    transport = MemoryTransport()
    for name in ("/lab", "/user", "/lab", "/a/user"):
        transport.enter(name)
    assert graph_of(transport).nodes == ("/a/user", "/lab", "/user")


def test_topics_are_shown_with_all_their_types_in_order():
    graph = graph_with(
        (PUBLISHER, "/words", TWIST),
        (SUBSCRIPTION, "/words", TWIST),
        (SUBSCRIPTION, "/words", POSE),
        (SUBSCRIPTION, "/a/listened", POSE),
    )
    assert list(graph.topics.items()) == [("/a/listened", (POSE,)), ("/words", (TWIST, POSE))]


def test_services_are_shown_if_they_are_served():
    graph = graph_with((SERVICE, "/kill", Kill.type_name), (CLIENT, "/clear", Empty.type_name))
    assert graph.services == {"/kill": (Kill.type_name,)}


def test_an_action_is_shown_by_its_name_and_types_if_it_is_served():
    served, asked = action_names("/turn"), action_names("/nobody")
    graph = graph_with(
        (SERVICE, served.send_goal, "lab/action/Turn_SendGoal"),
        (SERVICE, served.send_goal, "lab/action/Rest_SendGoal"),
        (SERVICE, served.get_result, "lab/action/Turn_GetResult"),
        (PUBLISHER, served.feedback, "lab/action/Turn_FeedbackMessage"),
        (CLIENT, asked.send_goal, "lab/action/Turn_SendGoal"),
    )
    assert graph.actions == {"/turn": ("lab/action/Rest", "lab/action/Turn")}
    assert (graph.topics, graph.services) == ({}, {})


@pytest.mark.parametrize("name", ["/_secret", "/a/_secret/b"])
def test_hidden_names_are_left_out(name):
    graph = graph_with((PUBLISHER, name, TurtlePose.type_name), (SERVICE, name, Empty.type_name))
    assert (graph.topics, graph.services) == ({}, {})


@pytest.mark.parametrize(
    ("offered", "requested", "expected"),
    [
        ({}, {}, []),
        ({"qos": QoS(durability="transient_local")}, {}, []),
        ({"times": TimePolicies(deadline=1)}, {"times": TimePolicies(deadline=1)}, []),
        ({"times": TimePolicies(deadline=2)}, {"times": TimePolicies(deadline=1)}, ["deadline"]),
        ({}, {"times": TimePolicies(lease=1)}, ["lease"]),
        ({}, {"times": TimePolicies(lifespan=1)}, []),
        ({}, {"times": TimePolicies(liveliness="manual_by_topic")}, ["liveliness"]),
        (
            {"qos": QoS(reliability="best_effort")},
            {"qos": QoS(durability="transient_local")},
            ["durability", "reliability"],
        ),
    ],
)
def test_a_publisher_must_offer_what_a_subscription_requests(offered, requested, expected):
    publisher = Endpoint(PUBLISHER, "/pose", POSE, "/a", **offered)
    subscription = Endpoint(SUBSCRIPTION, "/pose", POSE, "/b", **requested)
    assert list(misfits(publisher, subscription)) == expected
    assert list(misfits(subscription, publisher)) == expected
