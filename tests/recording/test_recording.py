"""Recording: what is on the graph gets into the bag, and what does not is counted."""

import anyio
import pytest

import turtleact
from turtleact import TurtleactError, open_node, open_world, recording
from turtleact.errors import UsageError
from turtleact.interfaces import WireFormat
from turtleact.interfaces.standard import ExampleFibonacci as Fibonacci
from turtleact.interfaces.standard import TurtlePose
from turtleact.interfaces.standard.std_msgs.msg import Int32, String
from turtleact.recording import BagError, Selection
from turtleact.recording.bag_writer import BagWriter
from turtleact.recording.metadata import read_qos_overrides
from turtleact.tasks import Background
from turtleact.tasks.clock import VirtualClock
from turtleact.transports import MemoryTransport, QoS
from turtleact.transports.base import STATUS_QOS

from .bags import by_rosbags

pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture
async def node():
    async with open_node("lab") as node:
        yield node


async def messages(path, *topics):
    return [each async for each in recording.read(path, topics=topics or None)]


@pytest.mark.loops("asyncio", "trio")
async def test_topics_are_recorded_as_they_appear(tmp_path):
    async with open_node("lab") as node:
        early = node.publisher(String, "early")
        async with recording.record(node, tmp_path / "run", topics=["early", "/late"]) as run:
            early.publish(String(data="1"))
            late = node.publisher(String, "late")
            while run.topics != ["/early", "/late"]:
                await run.wait_changed()
            late.publish(String(data="2"))
            early.publish(String(data="3"))
            node.publisher(String, "other").publish(String(data="4"))
        assert (run.count, run.lost) == (3, 0)
    found = await messages(tmp_path / "run")
    assert [(each.topic, each.value.data) for each in found] == [
        ("/early", "1"),
        ("/late", "2"),
        ("/early", "3"),
    ]


async def test_the_first_message_of_a_later_publisher_of_a_named_topic_is_recorded(node, tmp_path):
    node.subscription(String, "said")
    async with recording.record(node, tmp_path / "run", topics=["said"]) as run:
        late = node.publisher(String, "said", STATUS_QOS)
        late.publish(String(data="first"))
        while run.topics != ["/said"]:
            await run.wait_changed()
    assert (run.count, run.lost) == (1, 0)
    assert [each.value.data for each in await messages(tmp_path / "run")] == ["first"]


async def test_latched_messages_are_recorded(node, tmp_path):
    node.publisher(String, "map", STATUS_QOS).publish(String(data="old"))
    async with recording.record(node, tmp_path / "run", topics=["map"]):
        pass
    [found] = await messages(tmp_path / "run")
    assert found.value == String(data="old")


async def test_an_action_is_recorded_with_its_status_and_feedback(node, tmp_path):
    @turtleact.action(Fibonacci, "fibonacci")
    async def count(goal):
        for number in range(goal.order):
            yield Fibonacci.Feedback([number])
        yield Fibonacci.Result([goal.order])

    node.serve(count)
    node.publisher(String, "other")
    client = node.action_client(Fibonacci, "fibonacci")
    async with recording.record(node, tmp_path / "run", actions=["fibonacci"]) as run:
        await client.send_goal(Fibonacci.Goal(order=3))
        assert set(run.topics) >= {"/fibonacci/_action/feedback", "/fibonacci/_action/status"}
        assert "/other" not in run.topics
    feedback = await messages(tmp_path / "run", "/fibonacci/_action/feedback")
    assert [each.value.feedback.sequence for each in feedback] == [[0], [1], [2]]
    status = await messages(tmp_path / "run", "/fibonacci/_action/status")
    assert [[one.status for one in each.value.status_list] for each in status] == [
        [],
        [1],
        [2],
        [4],
    ]
    theirs = [each for topic, _, each in by_rosbags(tmp_path / "run") if topic.endswith("feedback")]
    assert [each.feedback.sequence.tolist() for each in theirs] == [[0], [1], [2]]


async def test_a_topic_of_two_types_is_named_once(node, tmp_path):
    node.publisher(String, "said")
    node.publisher(Int32, "said")
    async with recording.record(node, tmp_path / "run", topics=["said"]) as run:
        assert run.topics == ["/said"]
    assert len(recording.Bag(tmp_path / "run").info.topics) == 2


async def test_stamps_are_those_of_the_graph(tmp_path):
    transport = MemoryTransport(VirtualClock())
    clock = Background(transport.clock.run(), "the clock")
    async with open_node("lab", transport=transport) as node:
        publisher = node.publisher(String, "said")
        async with recording.record(node, tmp_path / "run", topics=["said"]):
            start = node.clock.now()
            for _ in range(3):
                await node.clock.sleep(0.25)
                publisher.publish(String())
    await clock.aclose()
    found = await messages(tmp_path / "run")
    assert [each.stamp - start for each in found] == [250_000_000, 500_000_000, 750_000_000]


async def test_virtual_time_stands_still_while_a_recording_is_closed(tmp_path):
    async with open_world(speed="max") as node:
        async with recording.record(node, tmp_path / "run"):
            await node.clock.sleep(1)
            before = node.clock.now()
        assert node.clock.now() == before


async def test_in_virtual_time_nothing_is_lost_however_little_may_wait(tmp_path):
    transport = MemoryTransport(VirtualClock())
    async with open_node("lab", transport=transport) as node:
        publisher = node.publisher(String, "said")
        async with recording.record(node, tmp_path / "run", topics=["said"], capacity=1000) as run:
            for number in range(2000):
                publisher.publish(String(data=str(number)))
        assert (run.lost, run.count) == (0, 2000)


async def test_what_does_not_fit_is_dropped_counted_and_said(node, tmp_path, caplog):
    publisher, other = node.publisher(String, "said"), node.publisher(String, "other")
    async with recording.record(node, tmp_path / "run", capacity=1000) as run:
        for _ in range(500):  # the thread waits for messages to gather
            publisher.publish(String(data="x"))
        other.publish(String())
    assert run.lost > 400
    assert run.lost_by_topic["/other"] == 1
    assert run.count + run.lost == 501
    assert caplog.messages[0] == "topic /said: the disk is too slow; messages are lost"
    assert len(await messages(tmp_path / "run")) == run.count
    bag = recording.Bag(tmp_path / "run")
    assert bag.info.custom == {f"lost:{key}": str(each) for key, each in run.lost_by_topic.items()}


async def test_a_full_disk_ends_the_recording(node, tmp_path, monkeypatch):
    def flush(self, *_):
        monkeypatch.undo()  # what waits is written at the end
        raise OSError(28, "No space left on device")

    publisher = node.publisher(String, "said")
    with pytest.raises(BagError, match="cannot be written any more: No space left on device"):  # noqa: PT012  # the end of the block raises
        async with recording.record(node, tmp_path / "run") as run:
            monkeypatch.setattr(BagWriter, "flush", flush)
            publisher.publish(String())
            await run.wait_ended()
            publisher.publish(String())
            assert run.is_over
    assert (run.count, run.lost) == (1, 0)  # the second message came after the end
    assert len(await messages(tmp_path / "run")) == 1


async def test_a_cancelled_recording_is_closed(node, tmp_path):
    publisher = node.publisher(String, "said")
    with anyio.CancelScope() as scope:
        async with recording.record(node, tmp_path / "run"):
            publisher.publish(String(data="x"))
            scope.cancel()
            await anyio.sleep_forever()
    assert recording.Bag(tmp_path / "run").info.is_closed
    assert len(await messages(tmp_path / "run")) == 1


async def test_an_option_that_does_not_exist_is_refused(node, tmp_path):
    with pytest.raises(TypeError, match="record has no option 'topic'"):
        async with recording.record(node, tmp_path / "run", topic=["a"]):  # type: ignore[call-arg]
            pytest.fail("it was opened")
    with pytest.raises(TurtleactError):
        async with recording.record(node, tmp_path / "run", topics=["a b"]):
            pytest.fail("it was opened")


async def test_offers_and_hashes_are_recorded(node, tmp_path):
    node.publisher(TurtlePose, "pose", QoS(depth=3, reliability="best_effort"))
    async with recording.record(node, tmp_path / "run", topics=["pose"]):
        pass
    bag = recording.Bag(tmp_path / "run")
    [channel] = bag.channels()
    assert channel.type_hash == WireFormat(TurtlePose).type_hash
    assert [each.qos for each in channel.offers] == [QoS(depth=3, reliability="best_effort")]


async def test_the_quality_of_service_to_ask_for_can_be_chosen(node, tmp_path):
    node.publisher(String, "/said")
    wanted = QoS(depth=3, reliability="best_effort")
    async with recording.record(node, tmp_path / "run", topics=["/said"], qos={"/said": wanted}):
        ends = node.transport.endpoints("/said")
        assert [each.qos for each in ends if each.kind == "subscription"] == [wanted]


def test_a_file_with_overrides_is_read_as_ros2_bag_does(tmp_path):
    path = tmp_path / "qos.yaml"
    path.write_text(
        "/map: {durability: transient_local, depth: 1, history: keep_last}\n"
        "/scan: {reliability: best_effort, deadline: {sec: 1, nsec: 0}}\n"
    )
    assert read_qos_overrides(path) == {
        "/map": QoS(depth=1, durability="transient_local"),
        "/scan": QoS(reliability="best_effort"),
    }


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("a: [", "is not YAML"),
        ("- /map", "must have names of topics"),
        ("/map: 1", "must have names of topics"),
        ("/map: {deph: 1}", "/map: no policy is called 'deph', only history, depth,"),
        ("/map: {reliability: good}", "reliability: expected reliable or best_effort or"),
    ],
)
def test_a_file_with_other_overrides_is_refused(tmp_path, text, problem):
    path = tmp_path / "qos.yaml"
    path.write_text(text)
    with pytest.raises(UsageError, match=problem):
        read_qos_overrides(path)


ACTION = ("/patrol/_action/feedback", "lab_msgs/action/Patrol_FeedbackMessage")
GOAL = ("/patrol/_action/send_goal/_service_event", "lab_msgs/action/Patrol_SendGoal_Event")
SERVICE = ("/reset/_service_event", "std_srvs/srv/Empty_Event")
TOPIC = ("/pose", "turtlesim/msg/Pose")
HIDDEN = ("/_secret", "std_msgs/msg/String")
ALL = (ACTION, GOAL, SERVICE, TOPIC, HIDDEN)


@pytest.mark.parametrize(
    ("selection", "wanted"),
    [
        (Selection(), ()),
        (Selection(all_topics=True), (TOPIC,)),
        (Selection(all_topics=True, hidden=True), (TOPIC, HIDDEN)),
        (Selection(all_actions=True), (ACTION, GOAL)),
        (Selection(all_services=True), (SERVICE,)),
        (Selection(actions=frozenset({"/patrol"})), (ACTION, GOAL)),
        (Selection(services=frozenset({"/reset"})), (SERVICE,)),
        (Selection(topics=frozenset({"/pose", "/patrol"})), (TOPIC,)),
        (Selection(topics=frozenset({ACTION[0]})), (ACTION,)),
        (Selection(types=frozenset({"turtlesim/msg/Pose"})), (TOPIC,)),
        (Selection(regex="o"), (ACTION, GOAL, TOPIC)),
        (Selection(regex="o", exclude=frozenset({"/patrol"})), (TOPIC,)),
        (Selection(regex="o", exclude=frozenset({ACTION[0]})), (GOAL, TOPIC)),
        (Selection(regex=".", exclude_regex="^/p"), (SERVICE, HIDDEN)),
        (Selection(all_topics=True, exclude_types=frozenset({"turtlesim/msg/Pose"})), ()),
    ],
)
def test_a_selection_is_that_of_ros2_bag(selection, wanted):
    assert tuple(each for each in ALL if selection.wants(*each)) == wanted


def test_a_selection_refuses_a_bad_expression():
    with pytest.raises(TurtleactError, match="'regex': it is not a regular expression"):
        Selection(regex="(")
