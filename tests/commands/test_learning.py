"""Verbs that talk to a robot none of whose interfaces is known here."""

from __future__ import annotations

import re
import signal

import pytest

from turtleact.commands import send_goal

from ..lab import free_endpoint
from ..registry import isolated_registry
from ..robots import FILES, write_package

ROBOT = """
import anyio
import turtleact
from turtleact.interfaces import load_interfaces

load_interfaces("{package}")
Dig = turtleact.get_action("robot_msgs/action/Dig")
Battery = turtleact.get_message("robot_msgs/msg/Battery")
Grip = turtleact.get_service("robot_msgs/srv/Grip")


@turtleact.action(Dig, "dig")
async def dig(goal):
    yield Dig.Feedback(so_far=goal.speed)
    yield Dig.Result(dug=int(goal.depth))


@turtleact.background
async def live(node):
    node.service(Grip, "grip", lambda request: Grip.Response(held=request.force > 1))
    battery = node.publisher(Battery, "battery")
    while True:
        battery.publish(Battery(charge=0.5))
        await anyio.sleep(0.05)
"""


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """The address of a robot in a process of its own."""
    from .conftest import Program

    folder = tmp_path_factory.mktemp("robot")
    script = folder / "robot.py"
    script.write_text(ROBOT.format(package=write_package(folder)))
    address = free_endpoint()
    serve = ("serve", str(script), "--no-sim", "--listen", address, "--node-name", "digger")
    program = Program(*serve, module=True)
    program.wait_for("/dig")
    yield address
    program.process.kill()
    program.process.communicate()


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "turtleact" / "types"


@pytest.fixture
def at_robot(start, robot):
    """Runs a verb in a process of its own, for what it learns ends with the process."""
    return lambda *line: start(*line, "--connect", robot, module=True).end()


def test_a_goal_is_sent_by_the_name_of_the_action_alone(at_robot):
    ran = at_robot("send-goal", "/dig", "{depth: 3, speed: 2}", "--feedback", "--plain")
    assert (ran.status, ran.err) == (0, "")
    assert "so_far: 2" in ran.out
    assert "dug: 3" in ran.out


def test_a_goal_is_sent_by_a_type_name_that_is_not_known_here(at_robot):
    ran = at_robot("send-goal", "/dig", "robot_msgs/action/Dig", "{depth: 3}", "--plain")
    assert (ran.status, ran.err) == (0, "")
    assert ran.out.startswith("Waiting for an action server")


def test_a_service_is_called_and_a_topic_is_shown(at_robot):
    assert "held=True" in at_robot("service", "call", "/grip", "{force: 2}").out
    assert at_robot("topic", "echo", "/battery", "--once").out == "charge: 0.5\n---\n"


@pytest.mark.parametrize(
    "line", [["send-goal", "/dig", "{}"], ["topic", "echo", "/battery"]], ids=" ".join
)
def test_no_node_is_asked_with_no_learn(at_robot, cache, line):
    ran = at_robot(*line, "--no-learn")
    assert (ran.status, "is not known here: source the ROS workspace" in ran.err) == (1, True)
    assert not cache.exists()


def test_definitions_that_differ_are_told_before_the_timeout(turtleact, robot, cache, monkeypatch):
    file = cache.parents[1] / "robot_msgs" / "action" / "Dig.action"
    file.parent.mkdir(parents=True)
    file.write_text("string where\n---\n---\n")
    monkeypatch.setattr(send_goal, "PATIENCE", 1.0)
    with isolated_registry():
        ran = turtleact("send-goal", "/dig", "-t", "0.1", "--no-learn", "--connect", robot)
    assert (ran.status, "the definitions of robot_msgs/action/Dig differ" in ran.err) == (1, True)


PROGRAM = """
import rclpy
from robot_msgs.msg import Battery, Tool

rclpy.init()
node = rclpy.create_node("reader")
node.create_subscription(Battery, "battery", lambda each: print(each.charge, Tool().name == ""), 1)
rclpy.spin_once(node, timeout_sec=20)
"""


def test_a_program_for_rclpy_imports_what_the_robot_has(start, robot, tmp_path):
    (tmp_path / "program.py").write_text(PROGRAM)
    ran = start("run", "--connect", robot, "program.py", module=True).end()
    assert (ran.status, ran.out, ran.err) == (0, "0.5 True\n", "")


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("from robot_msgs.msg import Bat", "no node on the graph uses it"),
        ("import attic_interfaces.msg", "in none of these places"),
    ],
)
def test_an_import_of_what_no_node_has_says_so(start, robot, tmp_path, line, problem):
    (tmp_path / "program.py").write_text(line)
    ran = start("run", "--connect", robot, "program.py", module=True).end()
    assert ran.status == 1
    assert problem in ran.err


def test_a_recording_has_the_schemas_of_learned_types(start, robot, tmp_path):
    line = ("bag", "record", "/battery", "-o", "bag", "--connect", robot)
    program = start(*line, module=True)
    while not program.stderr.readline().endswith("Ctrl-C ends it\n"):
        pass
    program.send(signal.SIGINT)
    assert program.end().status == 0
    [bag] = (tmp_path / "bag").glob("*.mcap")
    assert b"float32 charge" in bag.read_bytes()


def test_the_interfaces_of_a_node_are_fetched_as_packages(at_robot, start, cache, tmp_path):
    ran = at_robot("interface", "fetch", "digger", "-o", "src")
    assert (ran.status, ran.err) == (0, "")
    for name, text in FILES.items():
        assert (tmp_path / "src" / "robot_msgs" / name).read_text() == text
    made = (tmp_path / "src" / "robot_msgs" / "CMakeLists.txt").read_text()
    assert '  "action/Dig.action"\n' in made
    assert "find_package(geometry_msgs REQUIRED)" in made
    package = (tmp_path / "src" / "robot_msgs" / "package.xml").read_text()
    assert "<depend>geometry_msgs</depend>" in package
    line = ("interface", "python", "robot_msgs", "--interfaces", "src", "-o", "made")
    assert start(*line, module=True).end().status == 0
    assert "class Dig(Action" in (tmp_path / "made" / "robot_msgs" / "action.py").read_text()


def test_the_definition_of_a_type_is_asked_for(at_robot):
    shown = at_robot("interface", "show", "robot_msgs/msg/Battery")
    assert shown.out == "# What is left (%)\nfloat32 charge\n"
    assert "turtleact: robot_msgs/msg/Battery was learned from node /digger (RIHS01_" in shown.err
    assert "no node on the graph uses it" in at_robot("interface", "show", "no_such/msg/Type").err


def test_what_was_learned_is_listed_and_shown_with_its_node(at_robot, start):
    at_robot("send-goal", "/dig", "{}")
    listed = start("interface", "list", "--learned", module=True).end().out
    assert re.fullmatch(r"robot_msgs/action/Dig RIHS01_\w{64} /digger\n", listed)
    shown = start("interface", "show", "robot_msgs/action/Dig", module=True).end()
    assert "# How deep to dig (m)\n" in shown.out
    assert "turtleact: robot_msgs/action/Dig was learned from node /digger (RIHS01_" in shown.err


@pytest.mark.parametrize("line", [[], ["digger", "--all"]])
def test_fetch_takes_nodes_or_all(at_robot, line):
    assert (
        "give the names of nodes, or --all" in at_robot("interface", "fetch", *line, "-o", ".").err
    )
