"""``bag``: recorded, inspected, and what is said about what is missing."""

import json
import re
import signal
import sys
import time
from contextlib import asynccontextmanager

import anyio
import pytest

from turtleact import open_node, recording
from turtleact.interfaces import encode, get_message
from turtleact.interfaces.standard import ExampleFibonacci as Fibonacci
from turtleact.interfaces.standard.std_msgs.msg import String
from turtleact.recording import Bag
from turtleact.recording.bag_writer import BagWriter, Split
from turtleact.recording.metadata import Offer
from turtleact.recording.schemas import Schema, schema_of
from turtleact.recording.storage import Channel
from turtleact.tasks import Background
from turtleact.tasks.clock import VirtualClock
from turtleact.transports import MemoryTransport

START = 1_800_000_000_000_000_000


@asynccontextmanager
async def talking(transport):
    """A graph on which ``/said`` gets ten messages a second, and ``fibonacci`` is served."""

    async def body(goal):
        return Fibonacci.Result([goal.order])

    async def talk(publisher):
        while True:
            await transport.clock.sleep(0.1)
            publisher.publish(String(data="x"))

    async with open_node("talker", transport=transport) as node:
        node.action_server(Fibonacci, "fibonacci", body)
        running = Background(talk(node.publisher(String, "said")), "talking")
        yield
        await running.aclose()


@pytest.fixture
def bag(tmp_path):
    """A bag with a topic, an action without events, and a service."""
    writer = BagWriter(tmp_path / "run", Split())
    types = {
        "/said": "std_msgs/msg/String",
        "/patrol/_action/feedback": "example_interfaces/action/Fibonacci_FeedbackMessage",
        "/reset/_service_event": "std_srvs/srv/Empty_Event",
    }
    for number, (topic, type_name) in enumerate(types.items()):
        cls = get_message(type_name)
        writer.add(number, Channel(topic=topic, schema=schema_of(cls), offers=(Offer(),)))
        for place in range(number + 1):
            stamp = START + place * 1_500_000_000
            writer.write(number, stamp, stamp, encode(cls()))
    writer.close({"/said": 3})
    return tmp_path / "run"


TOLD = """
Files:             run_0.mcap
Bag size:          3.6 KiB
Storage id:        mcap
ROS Distro:        turtleact
Duration:          3.000000000s
Start:             Jan 15 2027 08:00:00.000000000 (1800000000.000000000)
End:               Jan 15 2027 08:00:03.000000000 (1800000003.000000000)
Messages:          1
Topic information: Topic: /said | Type: std_msgs/msg/String | Count: 1 | Serialization Format: cdr
Services:          1
Service information: Service: /reset | Type: std_srvs/srv/Empty | Event Count: 3 | \
Serialization Format: cdr
Actions:           1
Action information:
  Action: /patrol | Type: example_interfaces/action/Fibonacci | Topics: 2 | Service: 3 | \
Serialization Format: cdr
    Topic: feedback | Count: 2
    Topic: status | Count: 0
    Service: send_goal | Event Count: 0
    Service: cancel_goal | Event Count: 0
    Service: get_result | Event Count: 0

Lost: 3 messages of /said were not recorded.
Missing: the goals and results of /patrol. No service events were published; to record them, \
serve the actions with 'turtleact serve --introspection contents', or call \
configure_introspection on rclpy's ActionServer.
"""


def test_info_is_that_of_ros2_bag_and_says_what_is_missing(turtleact, bag, monkeypatch):
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    size = sum(each.stat().st_size for each in bag.glob("*.mcap"))
    ran = turtleact("bag", "info", str(bag))
    assert ran.status == 0
    told = TOLD.replace("3.6 KiB", f"{size / 1024:.1f} KiB")
    assert ran.out == told.replace("information:\n", "information: \n")
    ran = turtleact("bag", "info", "-v", str(bag / "run_0.mcap"))
    assert "/reset | Type: std_srvs/srv/Empty | Request Count: 3 | Response Count: 0" in ran.out
    assert turtleact("bag", "info", "-t", str(bag)).out.split() == [
        "/patrol/_action/feedback",
        "/reset/_service_event",
        "/said",
    ]


def test_info_says_that_a_file_was_not_closed(turtleact, bag):
    (bag / "metadata.yaml").unlink()
    file = bag / "run_0.mcap"
    file.write_bytes(file.read_bytes()[:-100])
    said = turtleact("bag", "info", str(bag)).out
    assert "\nThe file was not closed: the recorder was killed" in said


def test_something_must_be_recorded(on_graph, tmp_path):
    ran = on_graph(talking, "bag", "record", "-o", str(tmp_path / "run"))
    assert ran.status == 2
    assert "nothing to record: name topics, or give --all" in ran.problem
    ran = on_graph(talking, "bag", "record", "--topics", "-o", str(tmp_path / "run"))
    assert (ran.status, ran.problem) == (2, "Option '--topics' requires an argument.")


def interrupted(nodes, act=lambda: signal.raise_signal(signal.SIGINT), after=1.5):
    """A graph on which something happens after a while (s, in its time): by default, Ctrl-C."""

    @asynccontextmanager
    async def opened(transport):
        async def wait():
            await transport.clock.sleep(after)
            act()

        async with nodes(transport):
            running = Background(wait(), "interrupting")
            yield
            await running.aclose()

    return opened


@pytest.mark.parametrize(
    ("options", "topics"),
    [
        (["/said"], {"/said"}),
        (["--topics", "said", "/other", "--max-bag-size", "100000"], {"/said"}),
        (["--actions", "/fibonacci"], {"/fibonacci/_action/feedback", "/fibonacci/_action/status"}),
        (["-e", "s.id", "--storage-preset-profile", "zstd_fast"], {"/said"}),
    ],
)
def test_a_signal_ends_a_recording_with_status_0(on_graph, tmp_path, options, topics):
    path = tmp_path / "run"
    ran = on_graph(interrupted(talking), "bag", "record", *options, "-o", str(path))
    assert ran.status == 0
    bag = Bag(path)
    assert {each.name for each in bag.info.topics} == topics
    assert bag.info.is_closed
    assert f"turtleact: recording to {path}; Ctrl-C ends it\n" in ran.err
    for topic in topics:
        assert f"turtleact: subscribed to topic '{topic}'\n" in ran.err
    assert f"turtleact: {bag.info.count} message" in ran.err
    assert f" recorded in {path}\n" in ran.err
    if topics == {"/said"}:
        assert " of topics" not in ran.err


@asynccontextmanager
async def asking(transport):
    """A graph on which goals are sent, but the server publishes no service events."""

    async def ask(client):
        while True:
            await client.send_goal(Fibonacci.Goal(order=1))
            await transport.clock.sleep(0.05)

    async with (
        counting(transport, None),
        open_node("asker", transport=transport) as node,
    ):
        running = Background(ask(node.action_client(Fibonacci, "fibonacci")), "asking")
        yield
        await running.aclose()


def test_a_recording_without_goals_says_so_and_counts_as_info_does(on_graph, tmp_path):
    path = tmp_path / "run"
    ran = on_graph(interrupted(asking), "bag", "record", "-a", "-o", str(path))
    assert (
        "turtleact: missing: the goals and results of /fibonacci. No service events were "
        "published; to record them, serve the actions with 'turtleact serve --introspection "
        "contents', or call configure_introspection on rclpy's ActionServer."
    ) in ran.err
    bag = Bag(path)
    told = f"{bag.info.count} messages (0 of topics, {bag.info.count} of actions and services)"
    assert f"turtleact: {told} recorded in {path}\n" in ran.err


def test_a_recording_names_what_was_lost(on_graph, monkeypatch, tmp_path):
    lost = {f"/{number}": number for number in range(1, 9)}
    monkeypatch.setattr(recording.Recording, "lost_by_topic", lost)
    ran = on_graph(interrupted(talking), "bag", "record", "-a", "-o", str(tmp_path / "run"))
    assert "lost: 8 messages of topic '/8'\n" in ran.err
    assert "lost: 1 message of topic '/1'\n" in ran.err


def test_without_the_extra_the_package_is_named(turtleact, tmp_path, monkeypatch):
    ours = ("turtleact.recording", "turtleact.commands.bag")
    # A package has its modules as attributes, too. They come back with the modules.
    monkeypatch.setattr(sys.modules["turtleact"], "recording", recording)
    for name in [each for each in sys.modules if each.startswith(ours)]:
        monkeypatch.delitem(sys.modules, name)
    for name in ["mcap", *[each for each in sys.modules if each.startswith("mcap.")]]:
        monkeypatch.setitem(sys.modules, name, None)
    ran = turtleact("bag", "info", str(tmp_path))
    assert ran.status == 1
    problem = "turtleact bag needs one more package: pip install 'mcap>=1.6,<2'"
    assert ran.err == f"turtleact: {problem}\n"


@pytest.mark.parametrize("line", [["info", "-v"], ["goals"], ["convert", "-o", "cut", "-i"]])
def test_ctrl_c_ends_a_command_that_reads_a_bag(turtleact, bag, tmp_path, monkeypatch, line):
    monkeypatch.chdir(tmp_path)
    read = Bag.messages

    def interrupted(*arguments):
        signal.raise_signal(signal.SIGINT)
        return read(*arguments)

    monkeypatch.setattr(Bag, "messages", interrupted)
    assert turtleact("bag", *line, str(bag)) == (130, "", "turtleact: interrupted\n")
    assert [each.name for each in tmp_path.iterdir()] == ["run"]


# --- playing, goals, converting ------------------------------------------------------------------


@asynccontextmanager
async def counting(transport, introspection="contents"):
    """A graph on which ``fibonacci`` is served, and nothing else."""

    async def body(goal):
        yield Fibonacci.Feedback([1])
        yield Fibonacci.Result([goal.order])

    async with open_node("server", transport=transport) as node:
        node.action_server(Fibonacci, "fibonacci", body, introspection=introspection)
        yield


@pytest.fixture
def goals(tmp_path):
    """A bag with two goals, and a message of ``/said``."""

    async def main():
        transport = MemoryTransport(VirtualClock())  # it stands still
        async with (
            counting(transport),
            open_node("asker", transport=transport) as node,
        ):
            client = node.action_client(Fibonacci, "fibonacci")
            said = node.publisher(String, "/said")
            async with recording.record(node, tmp_path / "goals"):
                await client.send_goal(Fibonacci.Goal(order=7))
                await client.send_goal(Fibonacci.Goal(order=8))
                said.publish(String(data="x"))

    anyio.run(main)
    return str(tmp_path / "goals")


def test_goals_are_listed(turtleact, goals):
    ran = turtleact("bag", "goals", goals)
    heading, first, second = ran.out.splitlines()
    assert " ".join(heading.split()) == "id action state took feedback goal result reason"
    assert first.split(maxsplit=1)[1].split() == [
        *("/fibonacci", "SUCCEEDED", "0.0", "s", "1"),
        *("{order:", "7}", "{sequence:", "[7]}"),
    ]
    assert "{order: 8}" in second
    assert turtleact("bag", "goals", goals, "fibonacci").out == ran.out
    assert turtleact("bag", "goals", goals, "/other").err == "turtleact: the bag has no goals\n"


def test_goals_are_listed_as_json(turtleact, goals):
    first, _ = map(json.loads, turtleact("bag", "goals", "--json", goals).out.splitlines())
    assert first["goal"] == {"order": 7}
    assert first["result"] == {"sequence": [7]}
    assert [each["state"] for each in first["states"]] == ["ACCEPTED", "EXECUTING", "SUCCEEDED"]
    assert (first["state"], first["feedback"], first["reason"]) == ("SUCCEEDED", 1, "")


def test_a_bag_is_played(on_graph, goals):
    ran = on_graph(talking, "bag", "play", goals, "-r", "max")
    assert ran.status == 0
    told = r"playing (.+): 0\.0 s, (\d+) messages \(1 of topics, (\d+) of actions and services\)\n"
    [(path, in_all, of_actions)] = re.findall(told, ran.err)
    assert (path, int(in_all)) == (goals, 1 + int(of_actions))
    count = int(ran.err.split()[-2])
    assert count == Bag(goals).info.count
    ran = on_graph(talking, "bag", "play", goals, "--topics", "/said", "/none", "--rate", "100")
    assert ran.err.endswith("turtleact: played 1 message\n")


def test_the_clock_and_the_quality_of_service_are_played_as_told(on_graph, goals, tmp_path):
    overrides = tmp_path / "qos.yaml"
    overrides.write_text("/said: {reliability: best_effort}\n")
    line = ["bag", "play", goals, "--topics", "/said", "--clock", "--rate", "max"]
    ran = on_graph(talking, *line, "--qos-profile-overrides-path", str(overrides))
    assert (ran.status, ran.err.splitlines()[-1]) == (0, "turtleact: played 1 message")
    ran = on_graph(talking, *line, "--qos-profile-overrides-path", str(tmp_path / "none.yaml"))
    assert ran.status == 2
    assert "none.yaml' cannot be read: No such file" in ran.err


def test_goals_are_sent_again(on_graph, goals):
    line = ["bag", "play", goals, "--actions", "/fibonacci", "--send-actions-as-client"]
    ran = on_graph(counting, *line, "--delay", "3", "--disable-keyboard-controls")
    assert (ran.status, ran.out) == (0, "")
    assert ran.err.endswith(
        "turtleact: 2 goals of '/fibonacci': SUCCEEDED\nturtleact: played 0 messages\n"
    )
    ran = on_graph(counting, *line, "--remap", "/fibonacci:=/other")
    assert ran.status == 1
    assert "2 goals of '/other': " in ran.err
    assert "nobody serves it" in ran.err


def test_what_cannot_be_played_is_said(on_graph, tmp_path):
    writer = BagWriter(tmp_path / "odd", Split())
    writer.add(0, Channel(topic="/odd", schema=Schema("lab_msgs/msg/Odd")))
    writer.close({})
    ran = on_graph(talking, "bag", "play", str(tmp_path / "odd"))
    assert ran.status == 1
    assert "'/odd' was not played: its type lab_msgs/msg/Odd is not known; give" in ran.err


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (
            ["--rate", "fast"],
            "Invalid value for '--rate' / '-r': 'fast' is not a factor above 0, or max",
        ),
        (["--clock", "0"], "Invalid value for '--clock': '0' is not a rate in Hz above zero"),
        (
            ["--start-offset", "1e300"],
            "Invalid value for '--start-offset': '1e300' is not a number of seconds, 0 to "
            "1,000,000,000",
        ),
        (["--remap", "/a"], "--remap takes rules such as /old:=/new, not '/a'"),
    ],
)
def test_options_that_make_no_sense_are_refused(turtleact, options, problem):
    ran = turtleact("bag", "play", "run", *options)
    assert (ran.status, ran.problem) == (2, problem)


def test_a_bag_is_cut(turtleact, bag, tmp_path):
    out = tmp_path / "cut"
    line = ["--start-offset", "1", "--playback-duration", "1", "--exclude-topics", "/said"]
    ran = turtleact("bag", "convert", "-i", str(bag), "-o", str(out), *line)
    assert (ran.status, ran.err) == (0, f"turtleact: 2 messages written to {out}\n")
    ran = turtleact("bag", "convert", "-i", str(bag), "mcap", "-o", str(tmp_path / "all"))
    assert ran.err == f"turtleact: 6 messages written to {tmp_path}/all\n"
