"""Programs as students write them, run in processes of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from .. import warm

HEAD = """
import sys
import time

import rclpy
from rclpy.action import ActionClient, ActionServer
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from lab_interfaces.action import Count
from std_msgs.msg import String
"""

NODE = """
class Lab(Node):

    def __init__(self):
        super().__init__('lab')
        self.count = 0
        self.publisher = self.create_publisher(String, 'chatter', 10)
        self.create_subscription(String, 'chatter', self.heard, 10)
        self.server = ActionServer(self, Count, 'count', self.execute)
        self.client = ActionClient(self, Count, 'count')
        self.create_timer(0.01, self.tick)

    def tick(self):
        self.count += 1
        self.publisher.publish(String(data=f'hello {self.count}'))

    def heard(self, message):
        if self.count == 1:
            print(message.data, flush=True)

    def execute(self, goal_handle):
        for number in range(goal_handle.request.to):
            goal_handle.publish_feedback(Count.Feedback(at=number))
            time.sleep(0.001)
        goal_handle.succeed()
        return Count.Result(numbers=list(range(goal_handle.request.to)))
"""


@pytest.fixture
def start(tmp_path):
    """Starts a program with an interface beside it, on a graph that nobody else sees."""
    action = tmp_path / "lab_interfaces" / "action" / "Count.action"
    action.parent.mkdir(parents=True)
    action.write_text("int32 to\n---\nint32[] numbers\n---\nint32 at\n")
    started = []

    def start(body: str, *arguments: str) -> subprocess.Popen[str]:
        program = tmp_path / "program.py"
        program.write_text(HEAD + NODE + body)
        command = [sys.executable, "-m", "turtleact.rclpy", "--face=turtleact", "--alone"]
        process = warm.start(
            [*command, str(program), *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=Path.home(),
            env={**os.environ, "PYTHONWARNINGS": "error"},
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def first_line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def test_a_program_uses_its_own_interface_parameters_and_names(start):
    process = start(
        """
rclpy.init()
node = Lab()
speed = node.declare_parameter('speed', 1.0).value
executor = MultiThreadedExecutor()
executor.add_node(node)
heard = []
node.client.wait_for_server()
sent = node.client.send_goal_async(Count.Goal(to=3), feedback_callback=heard.append)
executor.spin_until_future_complete(sent)
ended = sent.result().get_result_async()
executor.spin_until_future_complete(ended)
print(node.get_fully_qualified_name(), speed, ended.result().result, sys.argv[1])
print([message.feedback.at for message in heard])
rclpy.shutdown()
sys.exit(3)
""",
        *("word", "--ros-args", "-r", "__ns:=/hall", "-p", "speed:=2.5"),
    )
    out, err = process.communicate(timeout=30)
    lines = [line for line in out.splitlines() if not line.startswith("hello")]
    result = "lab_interfaces.action.Count_Result(numbers=[0, 1, 2])"
    assert (lines, process.returncode) == ([f"/hall/lab 2.5 {result} word", "[0, 1, 2]"], 3), err


@pytest.mark.parametrize(
    ("number", "spin", "status", "said"),
    [
        (signal.SIGINT, "rclpy.spin(node)", -signal.SIGINT, "KeyboardInterrupt"),
        (signal.SIGTERM, "rclpy.spin(node)", 1, "ExternalShutdownException"),
        (signal.SIGTERM, "executor.spin()", 0, ""),
    ],
)
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_signal_ends_a_program_with_rclpys_status(start, number, spin, status, said):
    process = start(
        f"""
rclpy.init()
node = Lab()
executor = MultiThreadedExecutor()
if 'executor' in {spin!r}:
    executor.add_node(node)
{spin}
"""
    )
    assert first_line(process) == "hello 1"
    process.send_signal(number)
    _, err = process.communicate(timeout=10)
    assert process.returncode == status, err
    assert said in err


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_callback_that_never_ends_does_not_keep_the_program(start):
    process = start(
        """
rclpy.init()
node = Lab()
node.create_timer(0.02, lambda: (print('stuck', flush=True), time.sleep(60)))
executor = MultiThreadedExecutor()
executor.add_node(node)
executor.spin()
"""
    )
    while first_line(process) != "stuck":
        pass
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=10)
    assert process.returncode == 0
    assert "leaving without threads that do not end: rclpy_0" in err


def test_a_program_that_never_shuts_down_ends_with_its_exception(start):
    process = start("rclpy.init()\nnode = Lab()\nraise ValueError('broken')\n")
    _, err = process.communicate(timeout=30)
    assert process.returncode == 1
    assert err.rstrip().endswith("ValueError: broken")
