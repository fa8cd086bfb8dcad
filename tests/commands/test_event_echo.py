"""``action echo`` and ``service echo``: the requests and responses of others."""

from __future__ import annotations

from contextlib import aclosing, asynccontextmanager

import pytest
import yaml

from turtleact import open_node
from turtleact.interfaces.standard import ExampleFibonacci as Fibonacci
from turtleact.interfaces.standard.std_srvs.srv import SetBool
from turtleact.tasks import Background

CALLED = ["REQUEST_SENT", "REQUEST_RECEIVED", "RESPONSE_SENT", "RESPONSE_RECEIVED"]


@pytest.fixture
def shown(graphs):
    """Makes a node that acts once the echo listens."""

    def make(act, introspection="contents"):
        @asynccontextmanager
        async def nodes(transport):
            async with open_node("lab", transport=transport) as node:
                node.introspection = introspection
                node.action_server(Fibonacci, "fibonacci", graphs.fibonacci_body)
                node.service(SetBool, "flip", answer)

                async def run():
                    await node.clock.sleep(1)
                    await act(node)

                async with aclosing(Background(run(), "what is echoed")):
                    yield node

        return graphs.in_turn(nodes, graphs.interrupted(5))

    return make


def answer(request):
    return SetBool.Response(success=not request.data, message="ok")


async def flip(node):
    await node.service_client(SetBool, "flip").call(SetBool.Request(data=True))


async def count(node):
    await node.action_client(Fibonacci, "fibonacci").send_goal(Fibonacci.Goal(order=2))


def documents(out):
    return [yaml.safe_load(each) for each in out.split("---\n") if each]


def test_the_calls_of_a_service_are_printed_as_by_ros2(on_graph, shown):
    ran = on_graph(shown(flip), "service", "echo", "/flip")
    assert (ran.status, ran.err) == (130, "")
    events = documents(ran.out)
    assert [each["info"]["event_type"] for each in events] == CALLED
    assert list(events[0]) == ["info", "request", "response"]
    assert list(events[0]["info"]) == ["event_type", "stamp", "client_gid", "sequence_number"]
    assert events[0]["request"] == [{"data": True}]
    assert events[3]["response"] == [{"success": False, "message": "ok"}]
    assert len(events[0]["info"]["client_gid"]) == 16


def test_an_event_is_printed_on_one_line_if_asked(on_graph, shown):
    ran = on_graph(shown(flip), "service", "echo", "/flip", "--flow-style", "--no-arr", "--no-str")
    assert ran.out.splitlines()[1::2] == ["---"] * 4
    first = yaml.safe_load(ran.out.splitlines()[0])
    assert first["request"] == "<sequence type: std_srvs/srv/SetBool_Request[1], length: 1>"


def test_an_event_is_printed_as_values_separated_by_commas_if_asked(on_graph, shown):
    ran = on_graph(shown(flip), "service", "echo", "/flip", "std_srvs/srv/SetBool", "--csv")
    first, *_, last = ran.out.splitlines()
    assert first.startswith("0,")
    assert first.endswith(",1,True,")
    assert last.startswith("3,")
    assert last.endswith(",1,,False,ok")


def test_all_parts_of_an_action_are_printed(on_graph, shown):
    ran = on_graph(shown(count), "action", "echo", "fibonacci")
    assert (ran.status, ran.err) == (130, "")
    found: dict[str, list[str]] = {}
    for each in documents(ran.out):
        kind = each["info"]["event_type"] if "info" in each else ""
        found.setdefault(each["interface"], []).append(kind)
    assert found["GOAL_SERVICE"] == CALLED
    assert found["RESULT_SERVICE"] == CALLED
    assert found["FEEDBACK_TOPIC"] == [""]
    assert found["STATUS_TOPIC"]


@pytest.mark.parametrize("option", ["--interfaces", "-i"])
def test_only_some_parts_are_printed_if_asked(on_graph, shown, option):
    parts = "feedback_topic | RESULT_SERVICE"
    ran = on_graph(shown(count), "action", "echo", "fibonacci", option, parts)
    assert {each["interface"] for each in documents(ran.out)} == {
        "FEEDBACK_TOPIC",
        "RESULT_SERVICE",
    }


def test_an_unknown_part_is_refused(turtleact):
    ran = turtleact("action", "echo", "fibonacci", "-i", "GOALS")
    assert ran.status == 2
    assert "GOAL_SERVICE, CANCEL_SERVICE" in " ".join(ran.err.replace("│", "").split())


def test_an_action_without_introspection_shows_feedback_and_says_how_to_see_more(on_graph, shown):
    ran = on_graph(shown(count, "off"), "action", "echo", "fibonacci")
    assert {each["interface"] for each in documents(ran.out)} == {
        "FEEDBACK_TOPIC",
        "STATUS_TOPIC",
    }
    assert ran.err.count("\n") == 1
    assert "'turtleact serve --introspection contents'" in ran.err
