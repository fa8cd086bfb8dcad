"""``serve lab.py --reload`` as a process of its own."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager

import pytest

BROKEN = "def mine(:\n"
LAB = """
import anyio
import turtleact
from turtleact.interfaces.standard import Fibonacci

speed = turtleact.parameter("speed", 1.0, range=(0.0, 2.0))


@turtleact.background
async def beat(node):
    print("beating on", node.name, flush=True)


@turtleact.action(Fibonacci, "mine")
async def mine(goal):
    yield Fibonacci.Feedback(partial_sequence=[0])
    await anyio.sleep_forever()
"""


def command(folder, *arguments):
    return subprocess.Popen(  # a new Python, whose command line can be run again
        [sys.executable, "-m", "turtleact", *arguments],
        cwd=folder,
        env={**os.environ, "ROS_DOMAIN_ID": "0"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


@contextmanager
def reloading(folder, text):
    """A server of ``lab.py`` that prints to a pipe, and where it listens."""
    (folder / "lab.py").write_text(text)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        at = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    options = "--reload", "--no-sim", "--listen", at, "--ros-args", "-p", "speed:=2"
    process = command(folder, "serve", "lab.py", *options)
    try:
        yield process, at
    finally:
        process.kill()
        process.communicate()


def lines_until(process, text):
    """The lines that a process prints, to the first that has a text."""
    lines = []
    for line in process.stdout:
        lines.append(line)
        if text in line:
            return lines
    pytest.fail(f"no line has {text!r}: {lines}")


def save(folder, text):
    (folder / "lab.new").write_text(text)
    (folder / "lab.new").rename(folder / "lab.py")


def test_a_file_is_served_and_served_anew_and_its_goals_end(tmp_path):
    with reloading(tmp_path, BROKEN) as (server, at):
        first = lines_until(server, "ready at")
        assert first[0].startswith("turtleact: lab.py:1: module 'lab' cannot be imported: ")
        assert "; nothing of it is served until the next change" in first[0]
        save(tmp_path, LAB)
        lines_until(server, "reloading: lab.py changed")
        lines_until(server, "ready at")
        with command(tmp_path, "send-goal", "mine", "--plain", "--connect", at) as goal:
            lines_until(server, "EXECUTING")
            save(tmp_path, LAB.replace('"mine"', '"yours"'))
            out, _ = goal.communicate(timeout=20)
        assert goal.returncode == 4
        assert "turtleact: the goal was aborted: shutdown" in out
        ready = lines_until(server, "ready at")
        assert "beating on lab\n" in ready
        assert ready[-1].endswith(": /yours\n")
        with command(tmp_path, "param", "get", "/lab", "speed", "--connect", at) as param:
            assert param.communicate(timeout=20)[0] == "Double value is: 2.0\n"
        server.send_signal(signal.SIGINT)
        server.communicate(timeout=20)
        assert server.returncode == 0


def test_reload_needs_a_target(turtleact):
    ran = turtleact("serve", "--reload")
    assert ran.status == 2
    assert (
        "--reload is for your own actions: name a module or a file, such as lab.py" in ran.problem
    )
