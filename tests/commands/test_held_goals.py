"""``goals``, ``cancel``, ``watch`` and ``result``: goals that others have sent."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from contextlib import asynccontextmanager
from typing import Any

import anyio
import pytest

from turtleact import QoS, open_node
from turtleact.interfaces import get_interface
from turtleact.interfaces.standard import (
    UUID,
    CancelGoal,
    GoalInfo,
    GoalStatusArray,
    GoalStatusMessage,
    Time,
)
from turtleact.interfaces.standard import ExampleFibonacci as Fibonacci
from turtleact.tasks.clock import EPOCH

FIBONACCI = "example_interfaces/action/Fibonacci"
HOLD = ("71a906369b85473ab15bb0160400f6a4", "71a9ffff9b85473ab15bb0160400f6a4")
interface: Callable[[str], Any] = get_interface
TABLE = """\
id                                action   state      age         client
71a906369b85473ab15bb0160400f6a4  /hold    EXECUTING  1 min 35 s  ?
0d4fd2a0d2b74b3f9a3f1f7c2f4f8f2e  /refuse  EXECUTING  1 min 34 s  ?
3c87eb979ec646d88d02a52e6a57ee59  /count   SUCCEEDED  1 min 33 s  ?
c53d3439a0e348a6b910e9028279a17a  /count   EXECUTING  1 min 32 s  ?
fbda737307334cbbb22f0a599bd12cac  /fail    ABORTED    1 min 31 s  ?
71a9ffff9b85473ab15bb0160400f6a4  /hold    EXECUTING  1.0 s       ?
"""


# --- goals ----------------------------------------------------------------------------------


def test_the_goals_of_all_servers_are_listed_in_the_order_of_their_acceptance(on_graph, graphs):
    assert on_graph(graphs.goals, "goals") == (0, TABLE, "")


def test_the_goals_of_one_action_are_listed(on_graph, graphs):
    lines = on_graph(graphs.goals, "goals", "refuse").out.splitlines()
    assert [line.split()[:3] for line in lines[1:]] == [
        [graphs.IDS["refuse"], "/refuse", "EXECUTING"]
    ]
    assert lines[0].index("action") == lines[1].index("/refuse")


def test_goals_may_be_listed_as_json(on_graph, graphs):
    [told] = map(json.loads, on_graph(graphs.goals, "goals", "fail", "--json").out.splitlines())
    assert told == {
        "id": graphs.IDS["fail"],
        "action": "/fail",
        "type": FIBONACCI,
        "state": "ABORTED",
        "is_paused": False,
        "stamp": {"sec": EPOCH // 10**9 + 4, "nanosec": 0},
        "age": 91.0,
        "clients": ["/aide"],
    }


def test_no_goals_are_noted(on_graph, graphs):
    ran = on_graph(graphs.fibonacci, "goals")
    assert ran == (0, "", "turtleact: no server in reach holds a goal\n")
    assert on_graph(graphs.fibonacci, "goals", "--json").out == ""


def test_an_action_that_nobody_serves_is_an_error_that_names_the_nearest(on_graph, graphs):
    ran = on_graph(graphs.goals, "goals", "cuont")
    assert (ran.status, ran.out) == (1, "")
    assert ran.err == (
        "turtleact: action '/cuont': nobody serves it, did you mean '/count'?; is your server "
        "running?\n"
    )


# --- peers that do things their own way -----------------------------------------------------

STRANGER = bytes(range(16))


def peer(
    *statuses, says=True, cancel_code=0, canceling=(), answers=True, leaves_after=None, end=None
):
    """An action server of another make: its endpoints, and goals of these states.

    It may answer no request, and leave after so many seconds. ``end`` handles the requests for a
    goal's result, if it is given.
    """

    @asynccontextmanager
    async def nodes(transport):
        async with open_node("peer", transport=transport) as node:
            send_goal = interface(f"{FIBONACCI}_SendGoal")
            get_result = interface(f"{FIBONACCI}_GetResult")
            node.service(send_goal, "/far/_action/send_goal", lambda _: send_goal.Response())
            result = get_result.Response()
            canceled = [GoalInfo(UUID(goal_id)) for goal_id in canceling]
            node.service(get_result, "/far/_action/get_result", end or answer(result, answers))
            response = CancelGoal.Response(cancel_code, canceled)
            node.service(CancelGoal, "/far/_action/cancel_goal", answer(response, answers))
            node.publisher(interface(f"{FIBONACCI}_FeedbackMessage"), "/far/_action/feedback")
            latched = QoS(depth=1, durability="transient_local")
            status = node.publisher(GoalStatusArray, "/far/_action/status", latched)
            if says:
                info = GoalInfo(UUID(STRANGER), Time(1, 500))
                status.publish(GoalStatusArray([GoalStatusMessage(info, s) for s in statuses]))
            async with anyio.create_task_group() as beside:
                if leaves_after is not None:
                    beside.start_soon(leave, node, leaves_after)
                yield

    return nodes


def answer(response, answers):
    async def handle(_):
        if not answers:
            await anyio.sleep_forever()
        return response

    return handle


async def leave(node, seconds):
    await node.clock.sleep(seconds)
    await node.aclose()


def test_a_goal_that_is_gone_when_its_result_is_asked_for_is_an_error(on_graph):
    ran = on_graph(peer(2), "result", STRANGER.hex())
    assert (ran.status, ran.out) == (1, "")
    assert ran.err == (
        f"turtleact: the goal is not known to the server: '/far' holds no goal {STRANGER.hex()}, "
        "or no longer holds it\n"
    )


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        (1, "the server refuses"),
        (2, "the server does not hold it any more"),
        (3, "it has ended"),
    ],
)
def test_the_reason_why_a_goal_is_not_canceled_is_that_of_the_server(on_graph, code, reason):
    ran = on_graph(peer(2, cancel_code=code), "cancel", STRANGER.hex())
    assert ran == (1, f"{STRANGER.hex()} of /far: not canceled: {reason}\n", "")


# --- cancel ---------------------------------------------------------------------------------


def test_goals_are_canceled_by_the_beginnings_of_their_ids(on_graph, graphs):
    ran = on_graph(graphs.goals, "cancel", "71a90636", "C53D3439-a0e3")
    assert ran == (
        0,
        f"{graphs.IDS['hold']} of /hold: canceling\n{graphs.IDS['count']} of /count: canceling\n",
        "",
    )


@pytest.mark.parametrize(
    ("known_as", "told"),
    [
        ("refuse", " of /refuse: not canceled: the server refuses"),
        ("done", " of /count: not canceled: it has ended SUCCEEDED"),
        ("fail", " of /fail: not canceled: it has ended ABORTED"),
    ],
)
def test_what_is_not_canceled_is_told_with_the_reason(on_graph, graphs, known_as, told):
    goal_id = graphs.IDS[known_as]
    assert on_graph(graphs.goals, "cancel", goal_id) == (1, f"{goal_id}{told}\n", "")


def test_a_goal_that_nobody_holds_does_not_keep_the_others(on_graph, graphs):
    ran = on_graph(graphs.goals, "cancel", "abcdef", graphs.IDS["hold"])
    assert ran == (
        1,
        "abcdef: not canceled: no server in reach holds it\n"
        f"{graphs.IDS['hold']} of /hold: canceling\n",
        "",
    )


def test_the_beginning_of_several_ids_cancels_nothing(on_graph, graphs):
    ran = on_graph(graphs.goals, "cancel", graphs.IDS["count"], "71a9")
    assert (ran.status, ran.out) == (2, "")
    assert ran.err == (
        "turtleact: '71a9' is the beginning of several goals: "
        f"{graphs.IDS['hold']}, {graphs.IDS['later']}\n"
    )


def test_all_goals_are_canceled(on_graph, graphs):
    ran = on_graph(graphs.goals, "cancel", "--all")
    assert ran.status == 1
    assert ran.out == (
        f"{graphs.IDS['hold']} of /hold: canceling\n"
        f"{graphs.IDS['refuse']} of /refuse: not canceled: the server refuses\n"
        f"{graphs.IDS['count']} of /count: canceling\n"
        f"{graphs.IDS['later']} of /hold: canceling\n"
    )


@pytest.mark.parametrize("line", [("--all", "count", "fail"), ("count", "--all")])
def test_all_goals_of_actions_are_canceled(on_graph, graphs, line):
    ran = on_graph(graphs.goals, "cancel", *line)
    assert ran == (0, f"{graphs.IDS['count']} of /count: canceling\n", "")


def test_goals_are_canceled_up_to_a_moment(on_graph, graphs):
    seconds = EPOCH // 10**9 + 50
    ran = on_graph(graphs.goals, "cancel", "hold", "--before", str(seconds))
    assert ran == (0, f"{graphs.IDS['hold']} of /hold: canceling\n", "")


def test_no_goal_to_cancel_is_noted(on_graph, graphs):
    ran = on_graph(graphs.goals, "cancel", "--all", "fail")
    assert ran == (0, "", "turtleact: there is no goal to cancel\n")


def test_a_goal_that_is_canceling_already_goes_on_doing_so(on_graph):
    ran = on_graph(peer(3), "cancel", "--all")
    assert ran == (0, f"{STRANGER.hex()} of /far: canceling\n", "")


@pytest.mark.parametrize("name", ["count", "/count"])
def test_an_action_with_one_running_goal_stands_for_it(on_graph, graphs, name):
    ran = on_graph(graphs.goals, "cancel", name)
    assert ran == (0, f"{graphs.IDS['count']} of /count: canceling\n", "")


def test_of_an_action_with_several_goals_one_is_given_or_all(on_graph, graphs):
    ran = on_graph(graphs.goals, "cancel", "hold")
    assert (ran.status, ran.out) == (2, "")
    assert "action '/hold' has 2 running goals, give one or --all: " in ran.err


def test_an_action_without_a_running_goal_has_none_to_cancel(on_graph, graphs):
    ran = on_graph(graphs.goals, "cancel", "fail")
    assert (ran.status, ran.out) == (1, "/fail: not canceled: it has no running goal\n")


def test_on_a_terminal_the_clients_of_goals_are_explained(on_graph, graphs, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    ran = on_graph(graphs.goals, "goals")
    assert "client: ? means that the action still has a client" in ran.err


# --- watch, result --------------------------------------------------------------------------


def test_a_goal_is_watched_to_its_end(on_graph, graphs):
    ran = on_graph(graphs.in_turn(graphs.fibonacci, sent(4)), "watch", "c53d")
    assert (ran.status, ran.err) == (0, "")
    assert ran.out == (
        "Feedback:\n    sequence:\n    - 0\n    - 1\n    - 1\n\n"
        "Feedback:\n    sequence:\n    - 0\n    - 1\n    - 1\n    - 2\n\n"
        "Feedback:\n    sequence:\n    - 0\n    - 1\n    - 1\n    - 2\n    - 3\n\n"
        "Result:\n    sequence:\n    - 0\n    - 1\n    - 1\n    - 2\n    - 3\n\n"
        "Goal finished with status: SUCCEEDED\n"
    )


def sent(order, wait=1.5):
    """A goal and another one that were sent to the server of the tutorials, some time ago."""

    @asynccontextmanager
    async def nodes(transport):
        async with open_node("boss", transport=transport) as node:
            client = node.action_client(Fibonacci, "/fibonacci")
            for goal_id in (bytes.fromhex("c53d" + 28 * "0"), bytes.fromhex("abcd" + 28 * "0")):
                async with client.send_goal(Fibonacci.Goal(order=order), goal_id=goal_id) as goal:
                    goal.detach()
                await node.clock.sleep(0.125)
            await node.clock.sleep(wait)
            yield

    return nodes


def test_a_result_that_is_kept_is_printed_at_once(on_graph, graphs):
    ran = on_graph(graphs.goals, "result", graphs.IDS["done"])
    assert ran == (
        0,
        "Result:\n    sequence:\n    - 0\n    - 1\n\nGoal finished with status: SUCCEEDED\n",
        "",
    )


def test_the_status_tells_of_a_goal_that_was_aborted(on_graph, graphs):
    ran = on_graph(graphs.goals, "result", graphs.IDS["fail"])
    assert ran.status == 4
    assert ran.out.endswith("\nGoal finished with status: ABORTED\n")


def test_the_status_tells_of_a_goal_that_was_canceled(on_graph, graphs):
    @asynccontextmanager
    async def canceling(transport):
        async def cancel():
            await transport.clock.sleep(2)
            async with open_node("other", transport=transport) as node:
                await node.action_client(Fibonacci, "/hold").cancel_all()

        async with anyio.create_task_group() as beside:
            beside.start_soon(cancel)
            yield

    ran = on_graph(graphs.in_turn(graphs.goals, canceling), "watch", graphs.IDS["hold"])
    assert ran.status == 5
    assert ran.out.endswith("\nGoal finished with status: CANCELED\n")


@pytest.mark.parametrize(
    ("name", "status", "problem"),
    [
        ("/hold", 2, f"action '/hold' has 2 running goals, give one: {HOLD[0]}, {HOLD[1]}"),
        ("fail", 1, "no server in reach holds a running goal of /fail; 'turtleact goals' lists"),
        ("hald", 1, "action '/hald': nobody serves it, did you mean '/hold'?"),
    ],
)
def test_an_action_without_exactly_one_running_goal_is_not_watched(
    on_graph, graphs, name, status, problem
):
    ran = on_graph(graphs.goals, "watch", name)
    assert (ran.status, ran.out) == (status, "")
    assert re.search(problem, ran.err)


def test_ctrl_c_lets_go_of_a_goal_that_is_watched(on_graph, graphs):
    nodes = graphs.in_turn(graphs.goals, graphs.interrupted(5))
    assert on_graph(nodes, "watch", graphs.IDS["hold"]) == (
        130,
        "Feedback:\n    sequence:\n    - 0\n\n",
        "",
    )


@pytest.mark.parametrize("verb", ["watch", "result"])
def test_a_goal_that_nobody_holds_is_an_error(on_graph, graphs, verb):
    ran = on_graph(graphs.goals, verb, "abcdef")
    assert (ran.status, ran.out) == (1, "")
    assert "no server in reach holds a goal abcdef; 'turtleact goals' lists all goals" in ran.err


# --- servers that are lost, or say nothing --------------------------------------------------


def test_a_server_that_answers_nothing_is_named(on_graph):
    ran = on_graph(peer(says=False, answers=False), "goals")
    assert ran == (
        1,
        "",
        "turtleact: server /peer does not answer: goals may be missing\n",
    )


def test_the_goals_of_servers_that_answer_are_listed_all_the_same(on_graph, graphs):
    nodes = graphs.in_turn(graphs.goals, peer(says=False, answers=False))
    ran = on_graph(nodes, "goals")
    assert (ran.status, ran.out.count("\n")) == (1, TABLE.count("\n"))
    assert "server /peer does not answer" in ran.err


@pytest.mark.parametrize("verb", ["watch", "result"])
def test_a_goal_that_a_silent_server_may_hold_is_an_error_that_names_it(on_graph, verb):
    ran = on_graph(peer(says=False, answers=False), verb, "abcd")
    assert ran == (
        1,
        "",
        "turtleact: no server in reach holds a goal abcd; server /peer does not answer\n",
    )


def test_a_silent_server_cancels_nothing(on_graph):
    nodes = peer(says=False, answers=False)
    assert on_graph(nodes, "cancel", "abcd") == (
        1,
        "abcd: not canceled: no server in reach holds it; server /peer does not answer\n",
        "",
    )
    assert on_graph(nodes, "cancel", "--all") == (
        1,
        "",
        "turtleact: server /peer does not answer: some goals may not be canceled\n",
    )


@pytest.mark.parametrize("which", [STRANGER.hex(), "--all"])
def test_a_server_that_has_become_silent_is_not_waited_for_for_ever(on_graph, which):
    ran = on_graph(peer(2, answers=False), "cancel", which)
    assert ran.status == 1
    assert ran.out == f"{STRANGER.hex()} of /far: not canceled: the server does not answer\n"


def test_a_server_that_goes_away_cancels_nothing(on_graph):
    ran = on_graph(peer(2, answers=False, leaves_after=3.0), "cancel", STRANGER.hex())
    assert (ran.status, ran.out) == (
        1,
        f"{STRANGER.hex()} of /far: not canceled: the server was closed\n",
    )


@pytest.mark.parametrize("verb", ["watch", "result"])
def test_a_silent_server_is_named_and_waited_for_until_it_goes_away(on_graph, verb):
    ran = on_graph(peer(2, answers=False, leaves_after=3.0), verb, STRANGER.hex())
    assert (ran.status, ran.out) == (1, "")
    assert ran.err.splitlines()[0] == "turtleact: server /peer does not answer; waiting for it"
    said, _, hint = ran.err.splitlines()[-1].partition(";")
    assert said == "turtleact: action '/far': the server was closed"
    assert "follows it again" in hint
