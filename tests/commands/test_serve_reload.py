"""``serve lab.py --reload`` as a process of its own."""

from __future__ import annotations

import signal

from .test_serve import first_lines, serving

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


def save(folder, text):
    (folder / "lab.new").write_text(text)
    (folder / "lab.new").rename(folder / "lab.py")


def test_a_file_is_served_and_served_anew_and_its_goals_end(tmp_path):
    save(tmp_path, BROKEN)
    options = "lab.py", "--reload", "--no-sim", "--ros-args", "-p", "speed:=2"
    with serving(tmp_path, *options) as server:
        out, err = server.process.stdout, server.process.stderr
        assert out is not None
        assert err is not None
        first = err.readline()
        assert first.startswith("turtleact: lab.py:1: module 'lab' cannot be imported: ")
        assert "; nothing of it is served until the next change" in first
        save(tmp_path, LAB)
        assert any(line == "turtleact: reloading: lab.py changed\n" for line in err)
        first_lines(server.process, "ready at")
        with server.start("send-goal", "mine", "--plain") as goal:
            first_lines(server.process, "EXECUTING")
            save(tmp_path, LAB.replace('"mine"', '"yours"'))
            _, said = goal.communicate(timeout=20)
        assert goal.returncode == 4
        assert "turtleact: the goal was aborted: shutdown" in said
        first_lines(server.process, "beating on lab")
        assert out.readline().endswith(": /yours\n")
        assert server.run("param", "get", "/lab", "speed")[1] == "Double value is: 2.0\n"
        assert server.end(signal.SIGINT)[0] == 0


def test_reload_needs_a_target(turtleact):
    ran = turtleact("serve", "--reload")
    assert ran.status == 2
    assert (
        "--reload is for your own actions: name a module or a file, such as lab.py" in ran.problem
    )
