"""``topic echo``, ``hz`` and ``pub``; ``service call``: what goes over the graph."""

from __future__ import annotations

import json
import re
import shlex
import sys
from collections.abc import Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import anyio
import pytest

from turtleact import QoS, open_node
from turtleact.interfaces import get_interface, load_interface
from turtleact.interfaces.standard import (
    UUID,
    GoalInfo,
    GoalStatusArray,
    GoalStatusMessage,
    Twist,
)

GOLDEN = {
    case["case"]: case
    for case in json.loads(Path(__file__).with_name("golden").joinpath("verbs.json").read_text())
}
interface: Callable[[str], Any] = get_interface
START = 1_700_000_000
"""When the graph's clock begins (s)."""


def arguments_of(name):
    return shlex.split(GOLDEN[name]["command"])[1:]


def words(line):
    return line.split()


def publishing(topic, *messages, latched=True, period=0.0, wait=0.0):
    """A node that publishes messages, one after another, and then waits."""

    @asynccontextmanager
    async def nodes(transport):
        async with open_node("talker", transport=transport) as node:
            durability: Any = "transient_local" if latched else "volatile"
            qos = QoS(depth=max(len(messages), 1), durability=durability)
            publisher = node.publisher(type(messages[0]), topic, qos)

            async def publish():
                await node.clock.sleep(wait)
                for message in messages:
                    publisher.publish(message)
                    await node.clock.sleep(period)

            async with anyio.create_task_group() as beside:
                if period or wait:
                    beside.start_soon(publish)
                else:
                    await publish()
                yield node
                beside.cancel_scope.cancel()

    return nodes


def text(data):
    return interface("std_msgs/msg/String")(data=data)


# --- echo -----------------------------------------------------------------------------------


def test_a_message_is_echoed_as_by_ros2(on_graph, graphs):
    ran = on_graph(graphs.turtlesim, *arguments_of("pose_once"))
    assert ran == (0, GOLDEN["pose_once"]["stdout"], "")


def ids_of(recording):
    return bytes(int(number) for number in re.findall(r"- (\d+)$", recording, re.M)[:16])


def test_the_status_of_goals_is_echoed_as_by_ros2(on_graph, graphs):
    recording = GOLDEN["echo_status"]["stdout"]
    goal_id = UUID(ids_of(recording))
    sec, nanosec = (int(each) for each in re.findall(r"sec: (\d+)", recording)[:2])
    stamp = interface("builtin_interfaces/msg/Time")(sec=sec, nanosec=nanosec)
    messages = [
        GoalStatusArray([GoalStatusMessage(GoalInfo(goal_id, stamp), status)]) for status in (2, 4)
    ]
    nodes = graphs.in_turn(
        publishing("/fibonacci/_action/status", *messages), graphs.interrupted(1)
    )
    assert on_graph(nodes, *arguments_of("echo_status")).out == recording


TWIST = Twist(
    linear=interface("geometry_msgs/msg/Vector3")(x=1.0, y=2.5),
    angular=interface("geometry_msgs/msg/Vector3")(z=-1e-9),
)


@pytest.mark.parametrize(
    ("options", "out"),
    [
        ("--field linear.x", "1.0\n---\n"),
        ("--field linear", "x: 1.0\ny: 2.5\nz: 0.0\n---\n"),
        ("--csv", "1.0,2.5,0.0,0.0,0.0,-1e-09\n"),
        ("--csv --field linear.y", "2.5\n"),
    ],
)
def test_a_field_may_be_chosen(on_graph, options, out):
    ran = on_graph(
        publishing("/cmd_vel", TWIST), "topic", "echo", "cmd_vel", "--once", *options.split()
    )
    assert ran == (0, out, "")


@pytest.mark.parametrize(
    ("field", "problem"),
    [
        (
            "lineer.x",
            "lineer: geometry_msgs/msg/Twist has no field 'lineer', did you mean 'linear'?",
        ),
        ("linear.x.y", "linear.x.y: 'x' is not a single message"),
    ],
)
def test_a_field_that_is_not_there_is_a_usage_error(on_graph, field, problem):
    ran = on_graph(publishing("/cmd_vel", TWIST), "topic", "echo", "cmd_vel", "--field", field)
    assert (ran.status, ran.out) == (2, "")
    assert ran.err == f"turtleact: --field {problem}\n"


STATUSES = GoalStatusArray([GoalStatusMessage(), GoalStatusMessage(status=4)])


@pytest.mark.parametrize(
    ("message", "options", "out"),
    [
        (text("no"), "", "data: 'no'\n---\n"),
        (text("x" * 200), "", f"data: {'x' * 128}...\n---\n"),
        (text("x" * 200), "-f", f"data: {'x' * 200}\n---\n"),
        (text("x" * 200), "--truncate-length 3", "data: xxx...\n---\n"),
        (interface("std_msgs/msg/Bool")(data=True), "--field data", "True\n---\n"),
        (UUID(bytes(range(16))), "-l 2", "uuid:\n- 0\n- 1\n- '...'\n---\n"),
        (STATUSES, "-l 1 --csv", "0,...,0,0,0,...\n"),
        (interface("std_srvs/srv/Empty_Request")(), "", "{}\n---\n"),
    ],
)
def test_a_message_is_printed_as_asked_for(on_graph, message, options, out):
    ran = on_graph(publishing("/it", message), "topic", "echo", "/it", "--once", *options.split())
    assert ran == (0, out, "")


LONG = load_interface(
    "float64[3] place\nbyte[<=4] raw\nstring[] words\nstring name\n"
    "geometry_msgs/Point[] points\nstd_msgs/String text\nstd_msgs/String[] texts\n",
    type_name="printed_interfaces/msg/Long",
)


@pytest.mark.parametrize(
    ("options", "out"),
    [
        (
            "--no-arr",
            "place: '<array type: double[3]>'\n"
            "raw: '<sequence type: octet[4], length: 1>'\n"
            "words: '<sequence type: string, length: 1>'\n"
            "name: abc\n"
            "points: '<sequence type: geometry_msgs/msg/Point, length: 0>'\n"
            "text:\n  data: ab\n"
            "texts: '<sequence type: std_msgs/msg/String, length: 1>'\n---\n",
        ),
        (
            "--no-str --field texts",
            "- data: '<string length: <1>>'\n---\n",
        ),
        ("--no-str --no-arr --field name", "<string length: <3>>\n---\n"),
    ],
)
def test_lists_and_strings_may_be_left_out(on_graph, options, out):
    make: Any = LONG
    message = make(raw=[1], words=["w"], name="abc", text=text("ab"), texts=[text("x")])
    ran = on_graph(publishing("/it", message), "topic", "echo", "it", "--once", *words(options))
    assert ran == (0, out, "")


@pytest.mark.parametrize(
    ("is_terminal", "out"), [(True, "a\\x1b[2J\nb\n---\n"), (False, "a\x1b[2J\nb\n---\n")]
)
def test_a_string_commands_no_terminal(on_graph, monkeypatch, is_terminal, out):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: is_terminal)
    nodes = publishing("/it", text("a\x1b[2J\nb"))
    assert on_graph(nodes, *words("topic echo it --once --field data")).out == out


def test_messages_are_printed_until_the_time_is_over(on_graph):
    nodes = publishing("/it", *map(text, "abc"), latched=False, period=1.0)
    ran = on_graph(nodes, "topic", "echo", "/it", "--field", "data", "--csv", "--timeout", "1.5")
    assert ran == (0, "a\nb\n", "")


def test_a_topic_that_is_silent_until_the_time_is_over_is_told_by_the_status(on_graph):
    nodes = publishing("/it", text("a"), latched=False, wait=60.0)
    ran = on_graph(nodes, "topic", "echo", "/it", "--timeout", "1.5")
    assert ran == (124, "", "turtleact: no message on topic '/it' within 1.5 s\n")


@pytest.mark.parametrize(("pause", "told"), [(1.5, 2), (0.5, 1)])
def test_a_topic_that_nobody_publishes_for_a_second_is_told_of(on_graph, pause, told):
    @asynccontextmanager
    async def nodes(transport):
        async def come_and_go():
            for data in "ab":
                async with publishing("/it", text(data))(transport):
                    await transport.clock.sleep(1.0)
                await transport.clock.sleep(pause)

        async with anyio.create_task_group() as beside:
            beside.start_soon(come_and_go)
            yield

    command = ["topic", "echo", "/it", "std_msgs/msg/String", "--timeout", "5"]
    ran = on_graph(nodes, *command, "--qos-durability", "transient_local", "--field", "data")
    assert (ran.status, ran.out) == (0, "a\n---\nb\n---\n")
    gone = "turtleact: nobody publishes topic '/it' any more; waiting for a new publisher\n"
    assert ran.err == told * gone


# --- which messages, and as what ------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "out"),
    [
        (["--filter", "m.data > 'b'"], "data: c\n---\n"),
        (["--filter", "m == 'b'", "--field", "data"], "b\n---\n"),
        (["--filter", "False"], ""),
        (["--flow-style", "--once"], "{data: a}\n---\n"),
        (["--raw", "--once"], r"b'\x00\x01\x00\x00\x02\x00\x00\x00a\x00'" + "\n---\n"),
    ],
)
def test_messages_are_picked_by_python_and_printed_as_bytes(on_graph, options, out):
    nodes = publishing("/it", *map(text, "abc"))
    ran = on_graph(nodes, "topic", "echo", "/it", *options, "--timeout", "1")
    assert ran.out == out


@pytest.mark.parametrize(
    ("expression", "problem"),
    [
        ("m.datum", "--filter: AttributeError: 'String' object has no attribute 'datum'; m is "),
        ("1/0", "--filter: ZeroDivisionError: division by zero; m is String(data='a')"),
    ],
)
def test_a_filter_that_fails_is_a_usage_error(on_graph, expression, problem):
    ran = on_graph(publishing("/it", text("a")), "topic", "echo", "/it", "--filter", expression)
    assert (ran.status, ran.out) == (2, "")
    assert ran.err.startswith(f"turtleact: {problem}")


def test_a_type_that_the_topic_has_not_is_refused(on_graph, graphs):
    ran = on_graph(graphs.turtlesim, "topic", "echo", "/turtle1/pose", "std_msgs/msg/String")
    assert (ran.status, ran.err) == (
        1,
        "turtleact: topic '/turtle1/pose': it is of type turtlesim/msg/Pose, not "
        "std_msgs/msg/String; leave out the type or correct it\n",
    )


# --- hz -------------------------------------------------------------------------------------

NUMBER = re.compile(r"\d+(\.\d+)?")


def test_the_rate_is_printed_each_second_as_by_ros2(on_graph, graphs):
    nodes = graphs.in_turn(graphs.turtlesim, graphs.interrupted(4.5))
    out = on_graph(nodes, *arguments_of("hz")).out
    recording = GOLDEN["hz"]["stdout"]
    assert NUMBER.sub("N", out) == NUMBER.sub("N", recording)
    assert out.startswith(
        "average rate: 62.500\n\tmin: 0.016s max: 0.016s std dev: 0.00000s window: "
    )


def test_a_topic_without_a_rate_is_waited_for(on_graph, graphs):
    nodes = graphs.in_turn(graphs.turtlesim, graphs.interrupted(2.5))
    ran = on_graph(nodes, "topic", "hz", "/turtle1/pos")
    assert ran.out == ""
    assert ran.err == (
        "turtleact: topic '/turtle1/pos' is not there yet, did you mean '/turtle1/pose'?; "
        "waiting for it\n"
    )


# --- bw and delay ---------------------------------------------------------------------------


def stamped(seconds):
    header = interface("std_msgs/msg/Header")(interface("builtin_interfaces/msg/Time")(seconds))
    return interface("geometry_msgs/msg/PoseStamped")(header)


def test_the_bandwidth_is_printed_each_second(on_graph, graphs):
    nodes = graphs.in_turn(graphs.turtlesim, graphs.interrupted(2.5))
    ran = on_graph(nodes, "topic", "bw", "/turtle1/pose")
    assert ran.out == (
        "Subscribed to [/turtle1/pose]\n"
        "1.51 KB/s from 63 messages\n\tMessage size mean: 0.02 KB min: 0.02 KB max: 0.02 KB\n"
        "1.50 KB/s from 100 messages\n\tMessage size mean: 0.02 KB min: 0.02 KB max: 0.02 KB\n"
    )


def test_the_delay_is_told_of_the_stamps(on_graph, graphs):
    messages = [stamped(1_700_000_001) for _ in range(3)]
    nodes = publishing("/it", *messages, latched=False, period=1.0, wait=1.5)
    nodes = graphs.in_turn(nodes, graphs.interrupted(5.5))
    ran = on_graph(nodes, "topic", "delay", "/it")
    assert ran.out == (
        "average delay: 0.500\n\tmin: 0.500s max: 0.500s std dev: 0.00000s window: 1\n"
        "average delay: 1.000\n\tmin: 0.500s max: 1.500s std dev: 0.50000s window: 2\n"
        "average delay: 1.500\n\tmin: 0.500s max: 2.500s std dev: 0.81650s window: 3\n"
        "no new messages\n"
    )


def test_messages_without_a_header_have_no_delay(on_graph, graphs):
    ran = on_graph(graphs.turtlesim, "topic", "delay", "/turtle1/pose")
    assert (ran.status, ran.err) == (
        1,
        "turtleact: topic '/turtle1/pose': messages of type turtlesim/msg/Pose have no header, "
        "so their age is unknown\n",
    )


@asynccontextmanager
async def bursting(transport):
    """A node that publishes 30 messages at once, after a second."""
    async with open_node("talker", transport=transport) as node:
        publisher = node.publisher(interface("std_msgs/msg/String"), "/it")

        async def burst():
            await node.clock.sleep(1)
            for number in range(30):
                publisher.publish(text(str(number)))

        async with anyio.create_task_group() as beside:
            beside.start_soon(burst)
            yield
            beside.cancel_scope.cancel()


def test_lost_messages_are_counted(on_graph):
    ran = on_graph(bursting, "topic", "echo", "/it", "--qos-depth", "10", "--timeout", "2")
    assert ran.err == "turtleact: 20 messages were lost: they came too fast\n"
    assert ran.out.count("---\n") == 10


# --- pub ------------------------------------------------------------------------------------


def listening(topic, type_name, heard):
    """A node that keeps what it hears, with the time."""

    @asynccontextmanager
    async def nodes(transport):
        async with open_node("listener", transport=transport) as node:
            subscription = node.subscription(interface(type_name), topic)

            async def listen():
                async for message in subscription:
                    heard.append((node.clock.time(), message))

            async with anyio.create_task_group() as beside:
                beside.start_soon(listen)
                yield
                beside.cancel_scope.cancel()

    return nodes


def test_a_message_is_published_as_by_ros2(on_graph, graphs):
    ran = on_graph(graphs.turtlesim, *arguments_of("pub_once"))
    assert ran == (0, GOLDEN["pub_once"]["stdout"], "")


@pytest.mark.parametrize(
    "said", ["header: auto", "header: {stamp: now}", "{header: auto, pose: {position: {x: 1}}}"]
)
def test_the_time_in_a_header_may_be_that_of_publishing(on_graph, said):
    heard: list[Any] = []
    nodes = listening("/it", "geometry_msgs/msg/PoseStamped", heard)
    on_graph(nodes, "topic", "pub", "-t", "2", "/it", "geometry_msgs/msg/PoseStamped", said)
    stamps = [message.header.stamp for _, message in heard]
    assert [(each.sec, each.nanosec) for each in stamps] == [(START, 0), (START + 1, 0)]


def test_a_type_that_nobody_reads_is_told_and_waited_for(on_graph, graphs):
    nodes = graphs.in_turn(graphs.turtlesim, graphs.interrupted(2))
    command = ["topic", "pub", "--once", "/turtle1/cmd_vel", "std_msgs/msg/String", "data: x"]
    ran = on_graph(nodes, *command)
    assert ran == (
        130,
        "Waiting for at least 1 matching subscription(s)...\n",
        "turtleact: topic '/turtle1/cmd_vel' is of type geometry_msgs/msg/Twist, "
        "so no node receives std_msgs/msg/String\n",
    )


def test_messages_are_published_at_a_rate(on_graph):
    heard: list[Any] = []
    nodes = listening("/it", "std_msgs/msg/String", heard)
    command = words("topic pub -r 4 -t 4 -p 2 it std_msgs/msg/String")
    ran = on_graph(nodes, *command, "data: x")
    assert ran.out == "publisher: beginning loop\n" + "".join(
        f"publishing #{i}: std_msgs.msg.String(data='x')\n\n" for i in (2, 4)
    )
    assert [each for each, _ in heard][:2] == [0.0, 0.25]


def test_a_message_may_come_from_stdin(on_graph, graphs, monkeypatch, stdin_of):
    stdin_of(b"linear: {x: 1}\n")
    out = on_graph(graphs.turtlesim, "topic", "pub", "-1", "--stdin", "/turtle1/cmd_vel").out
    assert "linear=geometry_msgs.msg.Vector3(x=1.0, y=0.0, z=0.0)" in out


def test_a_message_reaches_a_subscription_that_comes_late(on_graph, graphs):
    heard: list[Any] = []
    nodes = graphs.later(3, listening("/it", "std_msgs/msg/String", heard))
    ran = on_graph(nodes, "topic", "pub", "--once", "/it", "std_msgs/msg/String", "data: x")
    assert ran.out.startswith("Waiting for at least 1 matching subscription(s)...\n")
    assert [message.data for _, message in heard] == ["x"]


# --- call -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["service_call", "reset"])
def test_a_service_is_called_as_by_ros2(on_graph, graphs, name):
    ran = on_graph(graphs.turtlesim, *arguments_of(name))
    assert ran == (0, GOLDEN[name]["stdout"], "")


def test_an_action_is_canceled_by_hand_as_by_ros2(on_graph, graphs):
    ran = on_graph(graphs.fibonacci, *arguments_of("cancel_raw_unknown_default"))
    assert ran == (0, GOLDEN["cancel_raw_unknown_default"]["stdout"].rstrip("\n") + "\n\n", "")


def test_a_service_is_called_at_a_rate(on_graph, graphs):
    nodes = graphs.in_turn(graphs.turtlesim, graphs.interrupted(2.25))
    ran = on_graph(nodes, "service", "call", "-r", "2", "/clear")
    assert (ran.status, ran.out.count("response:\n")) == (130, 5)


def test_a_service_that_is_not_there_is_waited_for(on_graph, graphs):
    nodes = graphs.later(3, graphs.turtlesim)
    ran = on_graph(nodes, "service", "call", "/clear", "std_srvs/srv/Empty")
    assert ran.status == 0
    assert ran.out.startswith("waiting for service to become available...\nrequester: making")


# --- as rclpy prints messages ---------------------------------------------------------------
