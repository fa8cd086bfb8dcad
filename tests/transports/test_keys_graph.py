"""What the tokens of other sessions say of the graph."""

from __future__ import annotations

from turtleact.transports.base import Endpoint
from turtleact.transports.rmw_zenoh.keys import Graph, endpoint_token, node_token


def token(number: int, name: str, zid: str = "them") -> str:
    described = Endpoint("publisher", name, "std_msgs/msg/Empty", "/lab", type_hash="RIHS01_0")
    return endpoint_token(0, zid, 0, number, described)


def names(graph: Graph, name: str = "") -> list[str]:
    return [each.name for each in graph.endpoints(name)]


def test_endpoints_are_found_by_name_and_all_together_in_the_order_of_their_coming():
    graph = Graph("us")
    for number, name in enumerate(["/b", "/a", "/b"]):
        graph.add(token(number, name))
    assert names(graph) == ["/b", "/a", "/b"]
    assert names(graph, "/b") == ["/b", "/b"]
    assert names(graph, "/c") == []


def test_an_endpoint_that_is_gone_is_found_no_more():
    graph = Graph("us")
    for number in range(2):
        graph.add(token(number, "/a"))
    graph.remove(token(0, "/a"))
    assert names(graph, "/a") == names(graph) == ["/a"]
    graph.remove(token(1, "/a"))
    assert names(graph, "/a") == names(graph) == []


def test_a_token_that_is_known_or_unknown_is_no_news():
    graph = Graph("us")
    assert graph.add(token(0, "/a")) is not None
    assert graph.add(token(0, "/a")) is None
    assert graph.remove(token(1, "/a")) is None
    assert names(graph, "/a") == ["/a"]


def test_our_own_tokens_do_not_count():
    graph = Graph("us")
    assert graph.add(token(0, "/a", "us")) is None
    assert graph.endpoints() == ()


def test_a_node_is_no_endpoint():
    graph = Graph("us")
    graph.add(node_token(0, "them", 0, "/lab"))
    assert (graph.nodes(), graph.endpoints()) == (("/lab",), ())
    graph.remove(node_token(0, "them", 0, "/lab"))
    assert graph.nodes() == ()
