"""Ctrl-C at every kind of moment of a program, each in a process of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from .. import warm

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")

PATIENCE = 30.0
"""How long a program may take to end (s); two seconds on a machine with nothing else to do."""

HEAD = """
import os, signal, sys, threading, time

def interrupt():
    os.kill(os.getpid(), signal.SIGINT)

def interrupt_in(function):
    # Sends the signal as soon as the main thread is seen in a function of that name, where it
    # must stay or come back to, because this thread looks only now and then.
    def watch():
        main = threading.main_thread().ident
        while True:
            frame = sys._current_frames()[main]
            while frame is not None:
                if frame.f_code.co_name == function:
                    return interrupt()
                frame = frame.f_back
            time.sleep(0.0005)
    threading.Thread(target=watch, daemon=True).start()
"""

IMPORTS = """
import rclpy
from rclpy.action import ActionClient, ActionServer
from rclpy.executors import MultiThreadedExecutor
from example_interfaces.action import Fibonacci
from example_interfaces.srv import AddTwoInts
"""

NODE = f"""
{IMPORTS}
rclpy.init()
node = rclpy.create_node('lab')
executor = MultiThreadedExecutor()

def spin_beside():
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()

def execute(goal_handle):
    time.sleep(0.01)
    interrupt()
    time.sleep(0.3)
    goal_handle.succeed()
    return Fibonacci.Result()
"""

MOMENTS = {
    "in a spin with nothing to do": "{node}interrupt_in('_sleep'); rclpy.spin(node)",
    "in a callback": "{node}node.create_timer(0.001, interrupt); rclpy.spin(node)",
    "in a callback that sleeps": "{node}interrupt_in('nap')\n"
    "def nap():\n  while True: time.sleep(0.01)\n"
    "node.create_timer(0.001, nap); rclpy.spin(node)",
    "in a callback of another thread": "{node}node.create_timer(0.001, interrupt)\n"
    "executor.add_node(node); executor.spin()",
    "in wait_for_service": "{node}interrupt_in('wait_until')\n"
    "node.create_client(AddTwoInts, 'add').wait_for_service()",
    "in call": "{node}interrupt_in('wait_for_answer'); spin_beside()\n"
    "node.create_client(AddTwoInts, 'add').call(AddTwoInts.Request())",
    "in a sleep of a rate": "{node}rate = node.create_rate(0.01); interrupt_in('sleep')\n"
    "spin_beside(); rate.sleep()",
    "in an execute callback": "{node}server = ActionServer(node, Fibonacci, 'f', execute)\n"
    "ActionClient(node, Fibonacci, 'f').send_goal_async(Fibonacci.Goal())\n"
    "executor.add_node(node); executor.spin()",
    "after shutdown": "{node}rclpy.shutdown(); interrupt(); time.sleep(60)",
}


@pytest.fixture
def run(tmp_path):
    """Runs a program on a graph of its own; returns its exit status and what it said."""
    processes: list[subprocess.Popen[str]] = []

    def run(body: str) -> tuple[int, str, str]:
        program = tmp_path / "program.py"
        program.write_text(HEAD + body.replace("{node}", NODE))
        command = [sys.executable, "-m", "turtleact.rclpy", "--face=turtleact", "--alone"]
        process = warm.start(
            [*command, str(program)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=Path.home(),
        )
        processes.append(process)
        out, err = process.communicate(timeout=PATIENCE)
        return process.returncode, out, err

    yield run
    for process in processes:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("moment", MOMENTS)
def test_an_interrupt_ends_a_program_with_rclpys_status(run, moment):
    status, _, err = run(MOMENTS[moment])
    assert status == -signal.SIGINT, err
    assert "KeyboardInterrupt" in err


def test_nothing_runs_on_after_shutdown(run):
    status, out, err = run(
        """{node}
node.create_timer(0.001, lambda: None)
spin_beside()
ActionServer(node, Fibonacci, 'f', execute)
rclpy.shutdown()
for thread in threading.enumerate():
    if thread.name.startswith(('rclpy', 'Thread-')):  # the last is the one that spins
        thread.join()
print([each.name for each in threading.enumerate() if not each.name.startswith('turtleact-')])
"""
    )
    assert (status, out) == (0, "['MainThread']\n"), err
