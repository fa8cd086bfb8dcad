"""``send-goal`` from its text to the exit status: the words of ROS 2, errors, signals, timeouts."""

from __future__ import annotations

import json
import re
import shlex
import signal
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from turtleact import open_node
from turtleact.commands import send_goal
from turtleact.interfaces.standard.simulation_interfaces.msg import SimulationState
from turtleact.interfaces.standard.simulation_interfaces.srv import (
    GetSimulationState,
)
from turtleact.transports import QoS
from turtleact.transports.base import Endpoint

STAGE = Path(__file__).with_name("stage.py")
GOLDEN = json.loads(Path(__file__).with_name("golden").joinpath("send_goal.json").read_text())
EMBEDDED = [case for case in GOLDEN if case["case"] not in ("abort", "reject")]
GOAL_ID = re.compile(r"ID: [0-9a-f]{32}$", re.MULTILINE)
STARTED = re.compile(
    r"turtleact: started an embedded world, which ends with this command, because .*\n"
)
STATUSES = [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
WAITING = "Waiting for an action server to become available...\n"
FIBONACCI = "example_interfaces/action/Fibonacci"


def recorded(case):
    """What ROS 2 printed, with all YAML indented alike, and without the goal's id."""
    columns, lines = 0, []
    for line in case["stdout"].splitlines():
        if line.endswith(":") and line[0].isalpha():
            columns = 5 if line == "Sending goal:" else 4
        continues = re.match(r"- |  \w", line)
        lines.append(" " * columns + line if continues else line)
    return GOAL_ID.sub("ID:", "\n".join(lines) + "\n")


def arguments_of(case, name=None):
    _, *arguments = shlex.split(case["command"])
    return [name if name and each == "/fibonacci" else each for each in arguments]


@pytest.mark.parametrize("case", EMBEDDED, ids=lambda case: case["case"])
def test_the_transcript_is_that_of_ros2(turtleact, case):
    ran = turtleact(*arguments_of(case), "--speed", "max")
    assert (ran.status, GOAL_ID.sub("ID:", ran.out)) == (case["exit"], recorded(case))


@pytest.mark.parametrize("name", ["abort", "reject"])
def test_the_transcript_of_a_goal_without_success_is_that_of_ros2(on_stage, name):
    [case] = [case for case in GOLDEN if case["case"] == name]
    ran = on_stage(*arguments_of(case, {"abort": "/fail"}.get(name, f"/{name}")))
    assert GOAL_ID.sub("ID:", ran.out) == recorded(case)


# --- exit statuses --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "status", "reason"),
    [
        ("now", 0, ""),
        ("reject", 3, "turtleact: reason: not today\n"),
        ("crash", 4, "turtleact: the goal was aborted: ZeroDivisionError: by hand\n"),
        ("fail", 4, "turtleact: the goal was aborted: no reason given\n"),
        ("quit", 5, ""),
    ],
)
def test_the_exit_status_and_stderr_say_how_the_goal_ended(on_stage, name, status, reason):
    ran = on_stage("send-goal", name)
    assert ran.status == status
    assert STARTED.sub("", ran.err) == reason


def test_a_rejection_without_a_reason_says_that_there_is_none(on_stage, stage, monkeypatch):
    monkeypatch.setattr(stage, "REASON", "")
    ran = on_stage("send-goal", "reject")
    assert ran.err.endswith("turtleact: the server gave no reason\n")


# --- which action, which type ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("fibonaci", ", did you mean '/fibonacci'?"),
        (
            "zzz",
            " (there are: /command_turtle, /fibonacci, /go_to, /patrol, /turtle1/rotate_absolute, "
            "/world/simulate_steps)",
        ),
    ],
)
def test_an_action_that_the_embedded_world_lacks_is_an_error_that_names_the_nearest_or_all(
    turtleact, name, hint
):
    ran = turtleact("send-goal", name, "--speed", "max")
    assert ran.status == 1
    assert ran.err.splitlines()[-1] == (
        f"turtleact: action '/{name}': the embedded world does not serve it{hint}; "
        "--embedded, --speed and --seed use no other server"
    )


def test_a_type_with_which_the_action_is_not_served_is_named_with_the_one_it_is(on_stage):
    ran = on_stage("send-goal", "now", "action_tutorials_interfaces/Fibonacci")
    assert ran.status == 1
    assert ran.err.splitlines()[-1] == (
        f"turtleact: action '/now': it is served as {FIBONACCI}, "
        "not as action_tutorials_interfaces/action/Fibonacci"
    )


@pytest.mark.parametrize(
    ("type_name", "message"),
    [
        ("example_interfaces/action/Fibonaci", f"did you mean '{FIBONACCI}'?"),
        ("std_msgs/msg/String", "std_msgs/msg/String: it is not the type of an action"),
    ],
)
def test_a_type_that_is_no_action_is_an_error_before_anything_is_printed(
    turtleact, type_name, message
):
    ran = turtleact("send-goal", "fibonacci", type_name)
    assert (ran.status, ran.out) == (1, "")
    assert message in ran.err


def test_a_type_that_is_on_the_graph_and_not_known_here_says_what_to_do(on_graph):
    @asynccontextmanager
    async def nodes(transport):
        parts: list[tuple[Any, str, str]] = [
            ("service", "send_goal", "SendGoal"),
            ("service", "get_result", "GetResult"),
            ("publisher", "feedback", "FeedbackMessage"),
        ]
        far = [
            Endpoint(kind, f"/far/_action/{part}", f"far_msgs/action/Away_{name}", "/ns/far", QoS())
            for kind, part, name in parts
        ]
        transport.endpoints = lambda name="": tuple(e for e in far if name in ("", e.name))
        yield

    ran = on_graph(nodes, "send-goal", "far")
    assert (ran.status, ran.err) == (
        1,
        "turtleact: far_msgs/action/Away as the graph uses it is not known here and cannot be "
        "learned: node /ns/far sends no type hash, as in ROS 2 Humble: source the ROS workspace "
        "that has the interface, give --interfaces DIR, or change to the folder of its package\n",
    )
    ran = on_graph(nodes, "send-goal", "far", "--no-learn")
    assert ran.err.startswith(
        "turtleact: action '/far': its type far_msgs/action/Away is not known here: source the"
    )


def test_a_type_that_only_the_world_declares_is_known(start):
    ran = start("send-goal", "now", "turtleact_interfaces/GoTo").end()
    assert "not as turtleact_interfaces/action/GoTo" in ran.err


# --- the goal -------------------------------------------------------------------------------


@pytest.mark.parametrize("goal", ["{order: 5", "{orderr: 5}", "{order: 5.7}", "-5"])
def test_a_goal_that_does_not_fit_is_refused_before_anything_is_printed(turtleact, goal):
    ran = turtleact("action", "send_goal", "/fibonacci", FIBONACCI, goal)
    assert (ran.status, ran.out) == (2, "")
    assert ran.err.startswith("turtleact: goal")


def test_a_goal_is_checked_with_the_type_that_the_graph_gives(on_stage):
    ran = on_stage("send-goal", "now", "{orderr: 5}")
    assert (ran.status, ran.out) == (2, WAITING)
    assert ran.err.endswith("turtleact: goal: unknown field 'orderr', did you mean 'order'?\n")


# --- JSON -----------------------------------------------------------------------------------


def events(text):
    return [json.loads(line) for line in text.splitlines()]


def test_json_tells_each_event_on_a_line_of_its_own_with_the_goal_and_its_messages(on_stage):
    told = events(on_stage("send-goal", "fail", "{order: 3}", "--json").out)
    assert [each["event"] for each in told if each["event"] != "status"] == [
        "accepted",
        "feedback",
        "feedback",
        "result",
    ]
    assert len({each["goal_id"] for each in told}) == 1
    assert (told[0]["name"], told[0]["type"], told[0]["goal"]) == ("/fail", FIBONACCI, {"order": 3})
    assert [each["feedback"] for each in told if "feedback" in each] == [
        {"sequence": [0, 1, 1]},
        {"sequence": [0, 1, 1, 2]},
    ]
    assert told[-1]["result"] == {"sequence": [0, 1, 1, 2]}
    assert told[-1]["reason"] == "out of paper"


def test_json_tells_of_a_rejection(on_stage):
    ran = on_stage("send-goal", "reject", "--json")
    assert ran.status == 3
    assert events(ran.out) == [{"event": "rejected", "goal_id": "", "reason": "not today"}]
    assert ran.err.endswith("turtleact: the goal was rejected: not today\n")


def test_json_tells_of_a_cancel(on_stage):
    ran = on_stage("send-goal", "hold", "--json", "-t", "0.01")
    assert ran.status == 124
    assert [each["status"] for each in events(ran.out) if each["event"] == "status"] == [
        "EXECUTING",
        "CANCELING",
        "CANCELED",
    ]


# --- timeouts -------------------------------------------------------------------------------


def test_a_timeout_cancels_the_goal_and_prints_its_result(on_stage):
    ran = on_stage("send-goal", "hold", "--timeout", "0.01")
    assert ran.status == 124
    assert ran.out.endswith(
        "Canceling goal...\n\nResult:\n    sequence: []\n\nGoal finished with status: CANCELED\n"
    )


def test_a_timeout_of_zero_leaves_once_the_goal_is_accepted(on_graph, graphs):
    ran = on_graph(graphs.goals, "send-goal", "hold", "-t0", "--plain")
    assert (ran.status, ran.err.count("the goal goes on; 'turtleact watch ")) == (0, 1)
    assert re.search(r"Goal accepted with ID: [0-9a-f]{32}\n\n\Z", ran.out)


@pytest.mark.parametrize(
    ("state", "note"),
    [
        (SimulationState.STATE_PLAYING, ""),
        (
            SimulationState.STATE_PAUSED,
            "turtleact: the world is paused; 'turtleact service call /world/set_simulation_state "
            '"state: {state: 1}"\' resumes it\n',
        ),
    ],
)
def test_a_paused_world_is_told_of(on_graph, graphs, state, note):
    @asynccontextmanager
    async def world(transport):
        response = GetSimulationState.Response(SimulationState(state))
        async with open_node("world", transport=transport) as node:
            node.service(GetSimulationState, "~/get_simulation_state", lambda _: response)
            yield

    ran = on_graph(graphs.in_turn(graphs.fibonacci, world), "send-goal", "fibonacci", "order: 3")
    assert (ran.status, ran.err) == (0, note)
    echoing = graphs.in_turn(graphs.fibonacci, world)
    line = ["topic", "echo", "/fibonacci/_action/feedback", "--timeout", "2"]
    assert note in on_graph(echoing, *line).err


@pytest.mark.parametrize("name", ["stubborn", "refuse", "deaf"])
def test_a_goal_that_does_not_end_after_its_timeout_is_left(start, name):
    ran = start("send-goal", name, "-t", "0.01").end()
    refusal = ["turtleact: the server refuses to cancel the goal"] if name == "refuse" else []
    assert ran.status == 124
    assert ran.err.splitlines()[1:] == [
        "turtleact: no result after 0.01 s",
        *refusal,
        "turtleact: the goal ended together with the embedded world",
    ]


def test_a_server_that_does_not_take_the_goal_in_time_is_given_up(on_stage, monkeypatch):
    monkeypatch.setattr(send_goal, "PATIENCE", 0.01)
    ran = on_stage("send-goal", "consider", "-t", "0.02")
    assert (ran.status, ran.out.count("accepted")) == (124, 0)
    assert ran.err.splitlines()[1:] == [
        "turtleact: no answer from the server after 0.02 s; giving up",
        "turtleact: given up before the goal was accepted, so it was withdrawn",
    ]


def test_a_server_that_does_not_take_the_goal_is_told_of(start):
    program = start("send-goal", "consider")
    for line in iter(program.stderr.readline, ""):
        if "no answer" in line:
            break
    assert line == "turtleact: no answer from the server for 0.1 s; waiting for it\n"
    program.send(signal.SIGINT)
    assert program.end().status == 130


# --- signals --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "status", "module"),
    [
        pytest.param(*STATUSES[0], True, id="embedded world"),
        *((*each, False) for each in STATUSES),
    ],
)
def test_a_signal_cancels_the_goal_and_its_result_is_printed(start, number, status, module):
    arguments = ["fibonacci", "order: 40"] if module else ["hold"]
    program = start("send-goal", *arguments, "-f", module=module)
    program.wait_for("Feedback:")
    program.send(number)
    ran = program.end()
    assert ran.status == status
    assert "\nCanceling goal...\n\nResult:\n    sequence:" in ran.out
    assert ran.out.endswith("Goal finished with status: CANCELED\n")
    started, waiting = ran.err.splitlines(keepends=True)
    assert STARTED.fullmatch(started)
    assert waiting == "turtleact: waiting for the goal's end; Ctrl-C again exits at once\n"


@pytest.mark.parametrize("name", ["stubborn", "deaf"])
def test_a_second_signal_lets_go_of_the_goal(start, name):
    program = start("send-goal", name)
    program.wait_for("Goal accepted")
    program.send(signal.SIGINT)
    program.wait_for("Canceling goal...")
    program.send(signal.SIGINT)
    ran = program.end()
    assert ran.status == 130
    assert "turtleact: the goal ended together with the embedded world" in ran.err.splitlines()[-1]


@pytest.mark.parametrize(
    ("name", "number", "status"),
    [
        *((name, *STATUSES[0]) for name in ("stubborn", "refuse", "deaf")),
        ("stubborn", *STATUSES[1]),
    ],
)
def test_one_signal_lets_go_of_a_goal_that_does_not_end(start, name, number, status):
    program = start("send-goal", name)
    program.wait_for("Goal accepted")
    program.send(number)
    ran = program.end()
    refusal = ["turtleact: the server refuses to cancel the goal"] if name == "refuse" else []
    assert (ran.status, ran.err.splitlines()[1:]) == (
        status,
        [
            "turtleact: waiting for the goal's end; Ctrl-C again exits at once",
            *refusal,
            "turtleact: the goal ended together with the embedded world",
        ],
    )


def test_a_signal_before_the_acceptance_leaves_no_goal_behind(start):
    program = start("send-goal", "consider")
    program.wait_for("order: 0")
    program.send(signal.SIGINT)
    ran = program.end()
    assert ran.status == 130
    assert ran.err.endswith("interrupted before the goal was accepted, so it was withdrawn\n")


def test_a_signal_before_the_world_is_there_ends_the_program(start):
    program = start("send-goal", "fibonacci", "order: 40", module=True)
    program.wait_for("Waiting")
    program.send(signal.SIGINT)
    ran = program.end()
    assert ran.status == 130
    assert "Traceback" not in ran.err


# --- pipes ----------------------------------------------------------------------------------


def test_a_reader_that_goes_away_ends_the_program_quietly(start):
    program = start("send-goal", "fibonacci", "order: 40", "-f", "--speed", "100", module=True)
    program.wait_for("Waiting")
    program.stdout.close()
    err = program.stderr.read()
    assert program.process.wait(30) == 141
    assert err == "turtleact: started an embedded world, which ends with this command\n"
