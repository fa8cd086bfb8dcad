"""Playing: the same messages at the same distances, and the same goals with new ids."""

from functools import partial
from random import Random
from typing import Any

import anyio
import anyio.lowlevel
import pytest

import turtleact
from turtleact import InvalidOption, QoS, TurtleactError, open_node, open_world, recording
from turtleact.interfaces import encode, int32, nanoseconds
from turtleact.interfaces.standard import ExampleFibonacci as Fibonacci
from turtleact.interfaces.standard import Twist, Vector3
from turtleact.interfaces.standard.rosgraph_msgs.msg import Clock
from turtleact.interfaces.standard.std_msgs.msg import String
from turtleact.recording import Bag, BagError, Selection
from turtleact.recording.bag_writer import BagWriter, Output, Split, convert
from turtleact.recording.schemas import Schema
from turtleact.recording.storage import Channel
from turtleact.tasks import Background
from turtleact.tasks.clock import VirtualClock
from turtleact.transports import MemoryTransport
from turtleact.transports.base import STATUS_QOS

from ..registry import isolated_registry
from .bags import POSE, START, STEP, by_rosbags, channel, fill, message, opened, write_bag


@pytest.fixture
async def node():
    """A node in virtual time."""
    transport = MemoryTransport(VirtualClock())
    clock = Background(transport.clock.run(), "the clock")
    async with open_node("lab", transport=transport) as node:
        yield node
    await clock.aclose()


def write(path, *stamped, topic="/said"):
    """A bag with strings at these times (s)."""
    writer = BagWriter(path, Split())
    writer.add(0, channel(topic, String))
    for second in stamped:
        stamp = START + round(second * 1e9)
        writer.write(0, stamp, stamp, encode(String(data=str(second))))
    writer.close({})
    return path


async def heard(node, path, **options):
    """What is played on ``/said``, with the time since the start (s)."""
    found = []
    begun = node.clock.time()
    subscription = node.subscription(String, "/said")
    subscription.taker = lambda message: found.append(
        (round(node.clock.time() - begun, 5), float(message.data))
    )
    played = await recording.play(node, path, **options)
    assert played.messages == len(found)
    return found


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, [(0, 0), (1, 1), (4, 4)]),
        ({"rate": 2}, [(0, 0), (0.5, 1), (2, 4)]),
        ({"rate": "max"}, [(0, 0), (0, 1), (0, 4)]),
        ({"start_offset": 0.5}, [(0.5, 1), (3.5, 4)]),
        ({"start_offset": 0.5, "duration": 1}, [(0.5, 1)]),
        ({"topics": ["/said"]}, [(0, 0), (1, 1), (4, 4)]),
        ({"topics": ["/other"]}, []),
        ({"selection": Selection(regex="s.id", exclude=frozenset({"/said"}))}, []),
    ],
)
async def test_messages_come_as_far_apart_as_recorded(node, tmp_path, options, expected):
    path = write(tmp_path / "run", 0, 1, 4)
    assert await heard(node, path, **options) == expected


async def test_topics_can_be_renamed(node, tmp_path):
    path = write(tmp_path / "run", 0, topic="/other")
    assert len(await heard(node, path, remap={"/other": "/said"})) == 1


async def test_a_loop_starts_over(node, tmp_path):
    path = write(tmp_path / "run", 0, 1)
    found = []
    node.subscription(String, "/said").taker = lambda message: found.append(node.clock.time())
    with anyio.CancelScope() as scope:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(partial(recording.play, node, path, loop=True, rate=10))
            while len(found) < 5:
                await node.clock.sleep(0.1)
            scope.cancel()
    assert len(found) >= 5


@pytest.mark.parametrize(
    ("rate", "expected"), [(1, [0, 0.25, 0.5, 0.75]), (2, [0, 0.5]), ("max", [0])]
)
async def test_the_time_in_the_bag_is_published(node, tmp_path, rate, expected):
    path, told = write(tmp_path / "run", 0, 0.9), []
    node.subscription(Clock, "/clock").taker = lambda message: told.append(message.clock)
    await recording.play(node, path, rate=rate, clock=4)
    assert [(nanoseconds(each) - START) / 1e9 for each in told] == expected


async def test_the_times_that_a_bag_has_are_not_published_beside_those_of_the_player(
    node, tmp_path
):
    path = write(tmp_path / "run", 0, 1, topic="/clock")
    assert (await recording.play(node, path, rate="max", clock=4)).messages == 0


async def test_the_quality_of_service_of_topics_can_be_chosen(node, tmp_path):
    path, seen = write(tmp_path / "run", 0, 1), list[QoS]()
    node.subscription(String, "/said").taker = lambda _: seen.extend(
        each.qos for each in node.transport.endpoints("/said") if each.kind == "publisher"
    )
    wanted = QoS(depth=3, reliability="best_effort")
    await recording.play(node, path, rate="max", qos={"/said": wanted})
    assert seen == [wanted, wanted]


async def test_a_loop_over_nothing_ends(node, tmp_path):
    path = write(tmp_path / "run", 0)
    assert (await recording.play(node, path, topics=[], loop=True)).messages == 0


async def test_what_was_latched_is_latched_again(node, tmp_path, monkeypatch):
    node.publisher(String, "/said", STATUS_QOS).publish(String(data="1"))
    async with recording.record(node, tmp_path / "run", topics=["/said"]):
        pass
    offered = []
    advertise = MemoryTransport.advertise

    def note(self, endpoint, *rest):
        offered.append(endpoint.qos)
        return advertise(self, endpoint, *rest)

    monkeypatch.setattr(MemoryTransport, "advertise", note)
    await recording.play(node, tmp_path / "run", rate="max")
    assert offered == [STATUS_QOS]


async def test_a_type_that_is_not_known_is_said(node, tmp_path):
    writer = BagWriter(tmp_path / "run", Split())
    writer.add(0, Channel(topic="/said", schema=Schema("lab_msgs/msg/Odd")))
    writer.write(0, START, START, b"\0\1\0\0")
    writer.close({})
    played = await recording.play(node, tmp_path / "run")
    assert played.messages == 0
    assert played.skipped == {"/said": "its type lab_msgs/msg/Odd is not known"}


@pytest.mark.parametrize("rate", [0, -1, "fast", None])
async def test_a_rate_is_above_zero(node, tmp_path, rate):
    with pytest.raises(InvalidOption, match="expected a number above zero or 'max'"):
        await recording.play(node, write(tmp_path / "run"), rate=rate)


async def test_an_option_that_does_not_exist_is_refused(node, tmp_path):
    options: Any = {"speed": 2}
    with pytest.raises(TypeError, match="play has no option 'speed'"):
        await recording.play(node, tmp_path, **options)


# --- the turtle ----------------------------------------------------------------------------------


async def poses(path):
    return [each.data async for each in recording.read(path, topics=["/turtle1/pose"])]


async def test_cmd_vel_drives_the_turtle_to_the_same_poses_to_the_last_bit(tmp_path):
    async with open_world(speed="max") as node, recording.record(node, tmp_path / "first"):
        driver = node.publisher(Twist, "/turtle1/cmd_vel")
        chance = Random(13)
        for _ in range(15):
            await node.clock.sleep(chance.random())
            twist = Twist(Vector3(x=chance.random() * 2), Vector3(z=chance.random() * 2 - 1))
            driver.publish(twist)
        await node.clock.sleep(2)
    async with open_world(speed="max") as node, recording.record(node, tmp_path / "second"):
        await recording.play(node, tmp_path / "first", topics=["/turtle1/cmd_vel"])
        await node.clock.sleep(3)
    first, second = await poses(tmp_path / "first"), await poses(tmp_path / "second")
    assert len(first) > 500
    assert len(set(first)) > 100
    assert second[: len(first)] == first


# --- goals ---------------------------------------------------------------------------------------


async def count(goal, handle):
    for number in range(goal.order):
        await handle.node.clock.sleep(1)
        yield Fibonacci.Feedback([number])
    yield Fibonacci.Result([goal.order])


def refuse(goal):
    if goal.order < 0:
        raise turtleact.Reject("negative")
    return turtleact.GoalResponse.ACCEPT


async def record_goals(node, path, introspection: Any = "contents"):
    node.action_server(
        Fibonacci, "fibonacci", count, introspection=introspection, goal_callback=refuse
    )
    client = node.action_client(Fibonacci, "fibonacci", introspection=introspection)
    async with recording.record(node, path, actions=["fibonacci"]):
        await client.send_goal(Fibonacci.Goal(order=2))
        async with client.send_goal(Fibonacci.Goal(order=9)) as goal:
            await node.clock.sleep(1.5)
            await goal.cancel()
            await goal.outcome()
        with pytest.raises(turtleact.GoalRejected):
            await client.send_goal(Fibonacci.Goal(order=-1))


async def test_goals_are_sent_again_with_new_ids(node, tmp_path):
    await record_goals(node, tmp_path / "first")
    async with recording.record(node, tmp_path / "second"):
        played = await recording.play(node, tmp_path / "first", send_goals=True)
    assert played.messages == 0
    assert played.goals["/fibonacci", "SUCCEEDED"] == 1
    assert played.goals["/fibonacci", "CANCELED"] == 1
    assert played.goals.total() == 3
    assert played.failed == 1  # the server rejects one, again
    first = await recording.goals(tmp_path / "first")
    second = await recording.goals(tmp_path / "second")
    assert [each.status for each in second][-3:] == [each.status for each in first]
    assert [each.goal for each in second][-3:] == [each.goal for each in first]
    assert not {each.id for each in first} & {each.id for each in second[-3:]}


async def test_without_a_server_the_reason_is_counted(node, tmp_path):
    await record_goals(node, tmp_path / "first")
    async with open_node("other") as other:
        played = await recording.play(other, tmp_path / "first", send_goals=True, rate="max")
    assert played.goals.total() == played.failed == 3
    assert all("/fibonacci" in reason for _, reason in played.goals)


async def test_a_goal_with_other_fields_is_counted_and_not_sent(node, tmp_path):
    await record_goals(node, tmp_path / "first")
    with isolated_registry():

        class Renamed(turtleact.Action, type_name=Fibonacci.type_name):
            class Goal(turtleact.Message):
                length: int32 = 0

        played = await recording.play(node, tmp_path / "first", send_goals=True, rate="max")
    assert played.goals == {("/fibonacci", "the recorded goal has other fields"): 3}
    assert played.failed == 3


@pytest.mark.parametrize("introspection", ["off", "metadata"])
async def test_goals_that_are_not_in_the_bag_are_counted(node, tmp_path, introspection):
    await record_goals(node, tmp_path / "first", introspection)
    played = await recording.play(node, tmp_path / "first", send_goals=True, rate="max")
    [((action, reason), number)] = played.goals.items()
    assert (action, number, played.failed) == ("/fibonacci", 2, 2)
    assert reason.startswith("not sent, because the recording does not have the goal itself")


async def test_goals_from_before_the_recording_are_not_missed(node, tmp_path):
    await record_goals(node, tmp_path / "first")
    client = node.action_client(Fibonacci, "fibonacci", introspection="contents")
    async with recording.record(node, tmp_path / "second", actions=["fibonacci"]):
        await node.clock.sleep(1)
        await client.send_goal(Fibonacci.Goal(order=2))
    played = await recording.play(node, tmp_path / "second", send_goals=True, rate="max")
    assert played.goals == {("/fibonacci", "SUCCEEDED"): 1}
    assert played.failed == 0


@pytest.mark.parametrize("option", ["start_offset", "duration"])
@pytest.mark.parametrize("seconds", [1e300, -1.0, float("nan")])
async def test_times_that_make_no_sense_are_refused(node, tmp_path, option, seconds):
    path = write(tmp_path / "run", 0.0)
    options: Any = {option: seconds}
    with pytest.raises(InvalidOption, match=rf"'{option}': expected 0 to 1,000,000,000 seconds"):
        await recording.play(node, path, **options)


async def test_a_file_of_no_sensible_duration_is_not_begun(node, tmp_path):
    with pytest.raises(InvalidOption, match="'max_duration': expected 0 to 1,000,000,000 seconds"):
        async with recording.record(node, tmp_path / "run", max_duration=1e300):
            pytest.fail("it began")
    assert not (tmp_path / "run").exists()


# --- converting ----------------------------------------------------------------------------------


def test_bags_are_merged_and_cut(tmp_path):
    first = write_bag(tmp_path / "first", 100)
    other = write(tmp_path / "other", 0.01, 0.02, 0.5)
    whole = Output(path=tmp_path / "whole", split=Split(compression="zstd_fast"))
    part = Output(
        path=tmp_path / "part.mcap",
        selection=Selection(topics=frozenset({"/said", "/turtle1/pose"})),
        start=START + 5 * STEP,
        end=START + 20 * STEP,
    )
    assert convert([first, other], [whole, part]) == [103, 10]
    stamps = [stamp for _, stamp, _ in by_rosbags(tmp_path / "whole")]
    assert stamps == sorted(stamps)
    assert len(stamps) == 103
    found = by_rosbags(tmp_path / "part.mcap")
    assert next(stamp for _, stamp, _ in found) == START + 5 * STEP
    assert {topic for topic, _, _ in found} == {"/said", "/turtle1/pose"}
    assert type(POSE()) is POSE


def test_a_missing_bag_is_said_and_nothing_stays_open(tmp_path):
    first = write(tmp_path / "first.mcap", 0)
    with pytest.raises(BagError, match="it does not exist"):
        convert([first, tmp_path / "other"], [Output(path=tmp_path / "whole")])
    assert not (tmp_path / "whole").exists()


def test_a_disk_that_is_full_ends_a_conversion(tmp_path, monkeypatch):
    first = write_bag(tmp_path / "first", 100)

    def write(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(BagWriter, "write", write)
    outputs = [Output(path=tmp_path / "part"), Output(path=tmp_path / "part.mcap")]
    with pytest.raises(TurtleactError, match="it cannot be written: No space left on device"):
        convert([first], outputs)
    assert [each.name for each in tmp_path.iterdir()] == ["first"]


def test_an_output_that_exists_is_left_alone_and_no_other_output_is_left(tmp_path):
    first = write_bag(tmp_path / "first", 100)
    there = write_bag(tmp_path / "there", 100)
    with pytest.raises(TurtleactError, match="it exists already"):
        convert([first], [Output(path=tmp_path / "new"), Output(path=there)])
    assert not (tmp_path / "new").exists()
    assert Bag(there).info.count == 100


def with_a_damaged_chunk(path):
    """Write a bag of ten chunks with ten messages each, and damage the sixth."""
    writer = opened(path)
    for first in range(0, 100, 10):
        fill(writer, 10, first)
        writer.flush()
    writer.close({})
    content = bytearray(path.read_bytes())
    content[content.index(message(55)) + 6] ^= 0xFF
    path.write_bytes(content)
    return path


def test_the_messages_around_a_damaged_chunk_can_be_copied(tmp_path):
    path = with_a_damaged_chunk(tmp_path / "run.mcap")
    before = Output(path=tmp_path / "before", end=START + 49 * STEP)
    assert convert([path], [before]) == [50]
    behind = Output(path=tmp_path / "behind", start=START + 60 * STEP)
    assert convert([path], [behind]) == [40]
    with pytest.raises(BagError, match="is damaged"):
        convert([path], [Output(path=tmp_path / "whole")])
    assert not (tmp_path / "whole").exists()


async def test_goals_of_a_type_that_is_not_known_are_said(node, tmp_path):
    writer = BagWriter(tmp_path / "run", Split())
    topic = "/odd/_action/send_goal/_service_event"
    writer.add(0, Channel(topic=topic, schema=Schema("lab_msgs/action/Odd_SendGoal_Event")))
    writer.write(0, START, START, b"\0\1\0\0")
    writer.close({})
    played = await recording.play(node, tmp_path / "run", send_goals=True)
    assert list(played.skipped) == ["/odd"]
    assert "unknown interface 'lab_msgs/action/Odd'" in played.skipped["/odd"]
