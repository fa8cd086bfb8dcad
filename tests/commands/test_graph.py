"""How a verb reaches the graph, and how the looking ends."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from turtleact.transports.rmw_zenoh import config

GRAPHS = Path(__file__).with_name("graphs.py")


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("--connect", "tcp/127.0.0.1:1"), "no router answers at tcp/127.0.0.1:1"),
        (
            ("--connect", "tcp/127.0.0.1:1,tcp/127.0.0.1:2"),
            "no router answers at tcp/127.0.0.1:1, tcp/127.0.0.1:2",
        ),
        ((), "no router answers at tcp/127.0.0.1:3"),
    ],
)
def test_one_line_says_that_no_graph_is_in_reach(turtleact, arguments, problem, monkeypatch):
    monkeypatch.setitem(config.CONNECT, "peer", ("tcp/127.0.0.1:3",))
    ran = turtleact("topic", "list", *arguments)
    assert (ran.status, ran.out, ran.err) == (
        1,
        "",
        f"turtleact: no ROS 2 graph in reach: {problem}; 'turtleact serve' starts one\n",
    )


@pytest.mark.parametrize(
    ("arguments", "number", "status"),
    [
        (["topic", "list"], signal.SIGTERM, 143),
        (["send-goal", "fibonacci", "{}"], signal.SIGINT, 130),
    ],
)
def test_a_router_that_hangs_is_not_waited_for_behind_a_second_signal(
    start, arguments, number, status
):
    with socket.create_server(("127.0.0.1", 0)) as router:
        where = f"tcp/127.0.0.1:{router.getsockname()[1]}"
        program = start(*arguments, "--connect", where, module=True)
        connection, _ = router.accept()
        with connection:
            program.send(number)
            ran = program.end()
    assert (ran.status, "Traceback" in ran.err) == (status, False)


VERBS = [
    ["topic", "echo", "/turtle1/pose"],
    ["topic", "hz", "/turtle1/pose"],
    ["topic", "hz", "/nothing"],
    ["topic", "pub", "/turtle1/cmd_vel"],
    ["topic", "pub", "-w", "2", "/turtle1/cmd_vel"],
    ["action", "echo", "/turtle1/rotate_absolute"],
    ["service", "call", "-r", "1", "/clear"],
    ["service", "call", "/nothing", "std_srvs/srv/Empty"],
]


@pytest.mark.parametrize("arguments", VERBS, ids=" ".join)
def test_ctrl_c_ends_a_verb_that_has_no_end(on_graph, graphs, arguments):
    nodes = graphs.in_turn(graphs.turtlesim, graphs.interrupted(5))
    ran = on_graph(nodes, *arguments)
    assert ran.status == 130
    assert "Error" not in ran.err


def test_ctrl_c_ends_a_program_that_echoes(start):
    program = start("topic", "echo", "/turtle1/pose", script=GRAPHS)
    program.wait_for("---")
    program.send(signal.SIGINT)
    ran = program.end()
    assert (ran.status, ran.err) == (130, "")


@pytest.mark.parametrize(
    ("verb", "line"),
    [("echo", r"x: 5.544444561004639"), ("hz", r"average rate: \d+\.\d+")],
)
def test_a_program_that_echoes_or_measures_may_lose_its_reader(verb, line):
    shell = subprocess.run(
        [
            "bash",
            "-c",
            '"$0" -W error "$1" topic "$2" /turtle1/pose | head -1; echo "${PIPESTATUS[0]}"',
            sys.executable,
            GRAPHS,
            verb,
        ],
        capture_output=True,
        text=True,
        check=True,
        timeout=30,
        env=os.environ | {"PYTHONUNBUFFERED": ""},
    )
    assert re.fullmatch(f"{line}\n141\n", shell.stdout)
    assert shell.stderr == ""


def test_a_verb_imports_neither_numpy_nor_rich():
    code = (
        "import sys; sys.argv = ['graphs', 'topic', 'list']; import runpy, atexit;"
        "atexit.register(lambda: print(sorted({'numpy', 'rich'} & {*sys.modules})));"
        f"runpy.run_path({str(GRAPHS)!r}, run_name='__main__')"
    )
    out = subprocess.check_output([sys.executable, "-c", code], text=True)
    assert out.splitlines()[-1] == "[]"
