"""``teleop``: what its keys do, and the terminal as it is found behind it."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import asynccontextmanager

import anyio
import pytest

from turtleact import Abort, open_node
from turtleact.interfaces.standard import RotateAbsolute, Twist

from .ttys import HIDE, SHOW, Terminal, open_terminal

ARROWS = {"up": "\x1b[A", "down": "\x1b[B", "right": "\x1b[C", "left": "\x1b[D"}
EMBEDDED = ("teleop", "--embedded")


@pytest.fixture
def keyboard(monkeypatch):
    """What is typed at the terminal that is stdin."""
    main, other = open_terminal()
    with os.fdopen(other, "r") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield main
    os.close(main)


class Robot:
    """A turtle on a graph, that notes what it is told.

    Args:
        name: Its name.
        keyboard: Where to type.
        keys: What is typed when a rotation has begun.
    """

    def __init__(self, name="turtle1", keyboard=None, keys=""):
        self.name = name
        self.keyboard = keyboard
        self.keys = keys
        self.rotations = []
        self.twists = []

    @asynccontextmanager
    async def __call__(self, transport):
        async with open_node("sim", transport=transport) as node:
            commands = node.subscription(Twist, f"/{self.name}/cmd_vel")
            node.action_server(RotateAbsolute, f"/{self.name}/rotate_absolute", self.rotate)
            self.node = node
            yield node
            self.twists = [(each.linear.x, each.angular.z) for each in commands.drain()]

    async def rotate(self, goal):
        os.write(self.keyboard, self.keys.encode())
        try:
            await anyio.sleep_forever()
            yield RotateAbsolute.Result()
        finally:
            self.rotations.append(goal.theta)


def typed(keyboard, *keys):
    os.write(keyboard, "".join(ARROWS.get(key, key) for key in keys).encode())


def test_arrows_drive_at_the_speeds_of_turtle_teleop_key(on_graph, keyboard):
    robot = Robot()
    typed(keyboard, "up", "down", "left", "right", "q")
    ran = on_graph(robot, "teleop", "--plain")
    assert (ran.status, ran.err) == (0, "")
    assert ran.out.startswith("Reading from keyboard\n-----")
    assert ran.out.endswith("quit.\n")
    assert robot.twists == [(2.0, 0.0), (-2.0, 0.0), (0.0, 2.0), (0.0, -2.0)]


def test_the_speeds_may_be_others(on_graph, keyboard):
    robot = Robot()
    typed(keyboard, "up", "left", "q")
    on_graph(robot, "teleop", "--plain", "--scale-linear", "0.5", "--scale-angular", "-1")
    assert robot.twists == [(0.5, 0.0), (0.0, -1.0)]


@pytest.mark.parametrize(
    ("key", "degrees"),
    [("g", 0), ("t", 45), ("R", 90), ("e", 135), ("d", 180), ("c", -135), ("V", -90), ("b", -45)],
)
def test_letters_around_f_rotate_and_f_cancels(on_graph, keyboard, key, degrees):
    robot = Robot(keyboard=keyboard, keys="fq")
    typed(keyboard, key)
    ran = on_graph(robot, "teleop", "--plain")
    assert (ran.status, ran.err) == (0, "")
    [theta] = robot.rotations
    assert round(theta * 180 / 3.14159, 1) == pytest.approx(degrees, abs=0.1)


def test_another_turtle_is_driven_by_its_name(on_graph, graphs, keyboard):
    first, second = Robot(), Robot("turtle2")
    typed(keyboard, "up", "q")
    on_graph(graphs.in_turn(first, second), "teleop", "--plain", "--turtle", "turtle2")
    assert (first.twists, second.twists) == ([], [(2.0, 0.0)])


def test_the_only_turtle_needs_no_name(on_graph, keyboard):
    robot = Robot("leo")
    typed(keyboard, "up", "q")
    assert on_graph(robot, "teleop", "--plain").status == 0
    assert robot.twists == [(2.0, 0.0)]


def test_of_several_turtles_one_has_to_be_named(on_graph, graphs, keyboard):
    ran = on_graph(graphs.in_turn(Robot("a"), Robot("b")), "teleop", "--plain")
    assert (ran.status, ran.out) == (1, "")
    assert ran.err == "turtleact: several turtles are in reach: say which with --turtle (a, b)\n"


def test_a_turtle_that_is_not_there_is_an_error(on_graph, keyboard):
    ran = on_graph(Robot(), "teleop", "--plain", "--turtle", "bob")
    assert ran == (1, "", "turtleact: no turtle 'bob' is in reach (there are: turtle1)\n")


def test_where_no_turtle_is_connected_to_that_is_an_error(on_graph, graphs, keyboard):
    ran = on_graph(graphs.fibonacci, "teleop", "--plain", "--connect", "tcp/127.0.0.1:1")
    assert ran.err == ("turtleact: no turtle is in reach: no node subscribes to a cmd_vel\n")


def test_where_there_is_no_turtle_a_world_is_started(on_graph, graphs, keyboard):
    typed(keyboard, "up", "q")
    ran = on_graph(graphs.fibonacci, "teleop", "--plain")
    assert (ran.status, ran.err) == (
        0,
        "turtleact: started an embedded world, which ends with this command, because domain 231 "
        "has no turtles; is your server running?\n",
    )


def test_that_world_has_no_turtle_of_another_name(on_graph, graphs, keyboard):
    ran = on_graph(graphs.fibonacci, "teleop", "--plain", "--turtle", "bob")
    assert ran == (1, "", "turtleact: no turtle 'bob' is in reach, and no other turtle\n")


def test_a_rotation_that_nobody_serves_or_that_is_aborted_is_a_line(on_graph, graphs, keyboard):
    @asynccontextmanager
    async def without_rotation(transport):
        async with open_node("sim", transport=transport) as node:
            node.subscription(Twist, "/turtle1/cmd_vel")
            yield

    class Stuck(Robot):
        async def rotate(self, goal):
            raise Abort("stuck")

    typed(keyboard, "g")
    quits = graphs.after(9.0, lambda: typed(keyboard, "q"))
    ran = on_graph(graphs.in_turn(without_rotation, quits), "teleop", "--plain")
    assert "turtleact: action '/turtle1/rotate_absolute': no server answers;" in ran.err
    typed(keyboard, "g")
    ran = on_graph(graphs.in_turn(Stuck(), quits), "teleop", "--plain")
    assert "turtleact: the rotation was aborted: stuck\n" in ran.err


def test_stdin_that_is_no_terminal_is_one_line(turtleact, stdin_of, monkeypatch):
    stdin_of(b"q")
    error = "turtleact: teleop reads keys, but stdin is not a terminal: run it in a terminal\n"
    assert turtleact("teleop") == (2, "", error)
    monkeypatch.setattr(sys, "stdin", None)
    assert turtleact("teleop") == (2, "", error)


@pytest.mark.parametrize("verb", [("teleop",), ("send-goal", "fibonacci")])
def test_a_file_with_locks_that_cannot_be_read_starts_no_world(turtleact, keyboard, verb):
    ran = turtleact(*verb, "--config", "nowhere.toml")
    assert (ran.status, ran.err) == (
        2,
        "turtleact: --config nowhere.toml: cannot be read: No such file or directory\n",
    )


# --- run turtlesim turtle_teleop_key --------------------------------------------------------


def test_it_is_the_program_of_ros(on_graph, graphs, keyboard):
    first, second = Robot(), Robot("turtle2")
    typed(keyboard, "up", "q")
    ran = on_graph(
        graphs.in_turn(first, second),
        *("run", "turtlesim", "turtle_teleop_key", "--ros-args"),
        *("--remap", "turtle1/cmd_vel:=turtle2/cmd_vel", "-p", "scale_linear:=3.5"),
    )
    assert (ran.status, ran.err) == (0, "")
    assert (first.twists, second.twists) == ([], [(3.5, 0.0)])


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["-p", "scale:=1"], "has no parameter 'scale': it has scale_linear and scale_angular"),
        (["-r", "pose:=p"], "has no topic 'pose': it has turtle1/cmd_vel and"),
        (["-p", "scale_linear"], "-p takes NAME:=VALUE, such as"),
        (["-p", "scale_linear:=fast"], "scale_linear is a number, not 'fast'"),
        (["--log-level", "WARN"], "--ros-args are -r FROM:=TO and -p NAME:=VALUE, not '--log-l"),
    ],
)
def test_arguments_that_it_has_not_are_refused(turtleact, arguments, problem):
    ran = turtleact("run", "turtlesim", "turtle_teleop_key", "--ros-args", *arguments)
    assert (ran.status, ran.out) == (2, "")
    assert problem in ran.problem


def test_arguments_stand_behind_ros_args(turtleact):
    ran = turtleact("run", "turtlesim", "turtle_teleop_key", "fast")
    assert ran.problem == "expected --ros-args, not 'fast'"


# --- the terminal ---------------------------------------------------------------------------


LIVE = "driving turtle1"


def test_the_map_shows_where_the_turtle_goes():
    with Terminal(*EMBEDDED) as terminal:
        terminal.wait_for(LIVE)
        assert not terminal.echoes
        typed(terminal.main, "up")
        terminal.wait_for(r"x 6\.\d\d")
        typed(terminal.main, "q")
        assert terminal.end() == (0, True)
        assert terminal.written.rindex(SHOW) > terminal.written.rindex(HIDE)


@pytest.mark.parametrize(
    ("number", "status"),
    [
        (signal.SIGINT, 130),
        (signal.SIGTERM, 143),
        (signal.SIGHUP, 129),
    ],
)
def test_a_signal_gives_the_terminal_back(number, status):
    with Terminal(*EMBEDDED) as terminal:
        terminal.wait_for(LIVE)
        terminal.process.send_signal(number)
        assert terminal.end() == (status, True)
