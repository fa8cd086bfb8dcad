"""One client's connection: topics and services both ways, what is told, what is bounded."""

from __future__ import annotations

import base64
import json
import math
from typing import Any

import anyio
import cbor2
import pytest

import turtleact
from turtleact import QoS, testing
from turtleact.errors import ServerUnavailable, ServiceError
from turtleact.interfaces import Message, Service, decode, get_interface, int32, string, uint8
from turtleact.interfaces.standard import Point, Twist, Vector3
from turtleact.web import Limits

from ..lab import Running, running, settle
from .line import Line, bridged, line

Log: Any = get_interface("rcl_interfaces/msg/Log")
LATCHED = QoS(depth=2, durability="transient_local")


class Add(Service, type_name="lab_interfaces/srv/AddInts"):
    class Request(Message):
        a: int32 = 0
        b: int32 = 0

    class Response(Message):
        sum: int32 = 0


class Pixels(Message, type_name="lab_interfaces/msg/Pixels"):
    data: list[uint8] = []
    name: string = ""


def add(request: Add.Request) -> Add.Response:
    return Add.Response(sum=request.a + request.b)


async def subscribe(client: Line, topic: str, **members: object) -> None:
    """Subscribe, and wait until that has happened."""
    client.say("subscribe", topic=topic, **members)
    assert await client.hears_nothing()


# topics to the client


async def test_a_topic_that_is_not_there_yet_is_read_once_it_is():
    async with bridged() as (node, bridge), line(bridge) as client:
        await subscribe(client, "/here", type="geometry_msgs/msg/Point")
        node.publisher(Point, "here").publish(Point(x=1.0))
        assert (await client.hear())["msg"]["x"] == 1.0


async def test_rosout_may_be_read_before_anybody_logs_without_saying_its_type():
    async with bridged() as (node, bridge), line(bridge) as client:
        await subscribe(client, "/rosout", compression="none")
        node.publisher(Log, "/rosout").publish(Log(msg="hello"))
        assert (await client.hear())["msg"]["msg"] == "hello"


async def test_every_client_gets_every_message():
    async with bridged() as (node, bridge), line(bridge) as one, line(bridge) as other:
        publisher = node.publisher(Point, "here")
        await subscribe(one, "/here")
        await subscribe(other, "here", compression="cbor")
        for number in range(3):
            publisher.publish(Point(x=float(number)))
        assert [(await one.hear())["msg"]["x"] for _ in range(3)] == [0.0, 1.0, 2.0]
        frames = [cbor2.loads(await other.hear_raw()) for _ in range(3)]
        assert [frame["msg"]["x"] for frame in frames] == [0.0, 1.0, 2.0]


async def test_many_clients_are_one_subscription_to_the_graph():
    async with bridged() as (node, bridge), line(bridge) as one, line(bridge) as other:
        node.publisher(Point, "here")
        await subscribe(one, "/here")
        await subscribe(other, "/here")
        assert kinds(node, "/here") == ["publisher", "subscription"]
        one.say("unsubscribe", topic="/here")
        assert await one.hears_nothing()
        assert kinds(node, "/here") == ["publisher", "subscription"]
        other.say("unsubscribe", topic="/here")
        assert await other.hears_nothing()
        assert kinds(node, "/here") == ["publisher"]


def kinds(node: turtleact.Node, name: str) -> list[str]:
    return [e.kind for e in node.transport.endpoints() if e.name == name]


@pytest.mark.parametrize("compression", ["png", "cbor-raw"])
async def test_a_topic_comes_in_the_compression_that_is_asked_for(compression):
    async with bridged() as (node, bridge), line(bridge) as client:
        publisher = node.publisher(Pixels, "pixels")
        await subscribe(client, "/pixels", compression=compression)
        publisher.publish(Pixels(data=[1, 2], name="é"))
        if compression == "png":
            frame = await client.hear()
            assert frame["op"] == "png"
            assert base64.b64decode(frame["data"]).startswith(b"\x89PNG")
        else:
            frame = cbor2.loads(await client.hear_raw())
            assert frame["msg"].keys() == {"secs", "nsecs", "bytes"}
            assert decode(Pixels, frame["msg"]["bytes"]).name == "é"


async def test_a_latched_message_reaches_each_late_client():
    async with bridged() as (node, bridge), line(bridge) as one, line(bridge) as other:
        node.publisher(Point, "here", LATCHED).publish(Point(x=7.0))
        for client in (one, other):
            client.say("subscribe", topic="/here")
            assert (await client.hear())["msg"]["x"] == 7.0


def test_a_topic_comes_no_more_often_than_asked_for():
    async def publish():
        async with bridged() as (node, bridge), line(bridge) as client:
            publisher = node.publisher(Point, "here")
            await subscribe(client, "/here", throttle_rate=100)
            for number in range(19):
                publisher.publish(Point(x=float(number)))
                await anyio.sleep(0.035)
            await anyio.sleep(1)
            heard = []
            client.say("call_service", service="/rosapi/get_ros_version")
            while (frame := await client.hear())["op"] == "publish":
                heard.append(frame["msg"]["x"])
            return heard

    for backend in ("asyncio", "trio"):
        assert testing.run(publish, backend=backend) == [0, 3, 6, 9, 12, 15, 18]


@pytest.mark.parametrize(
    "members",
    [
        {"id": "1"},
        {"id": "2", "throttle_rate": -5, "queue_length": None},
        {"id": "2", "throttle_rate": None, "type": None, "compression": None},
    ],
)
async def test_the_smallest_throttle_rate_of_a_clients_subscriptions_holds(members):
    async with bridged() as (node, bridge), line(bridge) as client:
        publisher = node.publisher(Point, "here")
        await subscribe(client, "/here", id="1", throttle_rate=1e300)
        publisher.publish(Point(x=1.0))
        await client.hear()
        publisher.publish(Point(x=2.0))
        await settle()
        await subscribe(client, "/here", **members)
        publisher.publish(Point(x=3.0))
        assert (await client.hear())["msg"]["x"] == 3.0


async def test_the_newest_compression_of_a_clients_subscriptions_holds():
    async with bridged() as (node, bridge), line(bridge) as client:
        publisher = node.publisher(Point, "here")
        await subscribe(client, "/here", id="1", compression="png")
        await subscribe(client, "/here", id="2", compression="cbor")
        publisher.publish(Point(x=1.0))
        assert cbor2.loads(await client.hear_raw())["msg"]["x"] == 1.0
        client.say("unsubscribe", topic="/here", id="2")
        assert await client.hears_nothing()
        publisher.publish(Point(x=2.0))
        assert (await client.hear())["op"] == "png"


# topics from the client


async def test_a_client_publishes():
    async with bridged() as (node, bridge), line(bridge) as client:
        heard = node.subscription(Twist, "turtle1/cmd_vel")
        client.say(
            "advertise", id="advertise:1", type="geometry_msgs/Twist", topic="/turtle1/cmd_vel"
        )
        client.say("publish", topic="/turtle1/cmd_vel", msg={"linear": {"x": 2}}, id="publish:2")
        assert await anext(heard) == Twist(linear=Vector3(x=2.0))
        client.say("unadvertise", topic="/turtle1/cmd_vel", id="advertise:1")
        assert await client.hears_nothing()
        assert node.count_publishers("turtle1/cmd_vel") == 0


async def test_a_latched_message_of_a_client_reaches_late_readers():
    async with bridged() as (node, bridge), line(bridge) as client:
        client.say("advertise", type="geometry_msgs/Point", topic="/here", latch=True)
        client.say("publish", topic="/here", msg={"x": 1})
        assert await client.hears_nothing()
        assert await anext(node.subscription(Point, "here", LATCHED)) == Point(x=1.0)


async def test_what_a_client_had_open_is_closed_when_it_goes():
    async with bridged() as (node, bridge):
        node.publisher(Point, "here")
        async with line(bridge) as client:
            await subscribe(client, "/here")
            client.say("advertise", type="geometry_msgs/Point", topic="/there")
            client.say("advertise_service", type="lab_interfaces/AddInts", service="/add")
            client.say("advertise_action", type="lab_interfaces/Count", action="/count")
            assert await client.hears_nothing()
            assert kinds(node, "/there") == ["publisher"]
        assert kinds(node, "/here") == ["publisher"]
        assert [e.name for e in node.transport.endpoints()] == ["/here"]


# services


async def test_a_client_calls_a_service():
    async with bridged() as (node, bridge), line(bridge) as client:
        node.service(Add, "add", add)
        client.say("call_service", id="c:1", service="/add", args={"a": 1, "b": 2})
        assert await client.hear() == {
            "op": "service_response",
            "service": "/add",
            "values": {"sum": 3},
            "result": True,
            "id": "c:1",
        }


@pytest.mark.parametrize(
    ("members", "problem"),
    [
        ({"service": "/nope"}, "service '/nope': no server answers"),
        ({"service": "no name"}, "invalid name: "),
        (
            {"service": "/add", "type": "lab_interfaces/Ad"},
            "unknown interface 'lab_interfaces/srv/Ad'",
        ),
        (
            {"service": "/add", "type": "std_srvs/SetBool"},
            "it is served as lab_interfaces/srv/AddInts",
        ),
        ({"service": "/add", "args": {"c": 1}}, "args: unknown field 'c'"),
        ({"service": "/add", "args": [1, 2, 3]}, "args: 3 values for 2 fields"),
        (
            {"service": "/add", "args": {"a": 1.5}},
            "args.a: expected a whole number (int32), got 1.5",
        ),
        ({"service": "/rosapi/topic"}, "rosapi has no such service, did you mean 'topics'?"),
        ({"service": "/rosapi/topic_type", "args": {"topic": 3}}, "args.topic: expected text"),
    ],
)
async def test_a_call_that_fails_says_why(members, problem):
    async with bridged() as (node, bridge), line(bridge) as client:
        node.service(Add, "add", add)
        answer = await client.call(**members)
        assert answer["result"] is False
        assert problem in answer["values"]


def test_a_call_ends_after_the_time_that_the_client_gives_it():
    async def call():
        async def wait(request: Add.Request) -> Add.Response:
            await anyio.sleep_forever()
            raise AssertionError

        async with bridged() as (node, bridge), line(bridge) as client:
            node.service(Add, "add", wait)
            return await client.call("/add", timeout=3.5)

    for backend in ("asyncio", "trio"):
        answer = testing.run(call, backend=backend)
        assert (answer["result"], answer["values"]) == (
            False,
            "service '/add': no response within 3.5 s",
        )


async def test_a_client_that_goes_cancels_its_calls():
    canceled = anyio.Event()
    called = anyio.Event()

    async def wait(request: Add.Request) -> Add.Response:
        called.set()
        try:
            await anyio.sleep_forever()
        finally:
            canceled.set()
        raise AssertionError

    async with bridged() as (node, bridge):
        node.service(Add, "add", wait)
        async with line(bridge) as client:
            client.say("call_service", service="/add")
            await called.wait()
        await canceled.wait()


async def test_a_client_may_have_so_many_calls_under_way():
    release = anyio.Event()

    async def wait(request: Add.Request) -> Add.Response:
        await release.wait()
        return Add.Response(sum=request.a)

    async with bridged(limits=Limits(calls=2)) as (node, bridge), line(bridge) as client:
        node.service(Add, "add", wait)
        for number in range(3):
            client.say("call_service", service="/add", args=[number], id=number)
        answer = await client.hear()
        assert (answer["id"], answer["values"]) == (2, "2 calls are under way: wait for some")
        release.set()
        assert {(await client.hear())["id"] for _ in range(2)} == {0, 1}
        assert (await client.call("/add", args=[5]))["values"] == {"sum": 5}


# a client that serves


async def test_a_client_serves_a_service():
    async with bridged() as (node, bridge), line(bridge) as client:
        client.say("advertise_service", type="lab_interfaces/AddInts", service="/add")
        assert await client.hears_nothing()
        caller = node.service_client(Add, "add")
        async with running(lambda: caller.call(Add.Request(a=1, b=2))) as call:
            asked = await client.hear()
            assert asked == {
                "op": "call_service",
                "id": "service_request:/add:1",
                "service": "/add",
                "args": {"a": 1, "b": 2},
            }
            client.say(
                "service_response", id=asked["id"], service="/add", values={"sum": 3}, result=True
            )
        assert call.value == Add.Response(sum=3)


@pytest.mark.parametrize(
    ("answer", "problem"),
    [
        ({"result": False, "values": "too much"}, "too much"),
        ({"result": True, "values": {"summ": 3}}, "unknown field 'summ'"),
        ({"result": True, "values": "text"}, "response: expected fields such as"),
    ],
)
async def test_a_client_that_fails_to_serve_is_told_of(answer, problem, caplog):
    async with bridged() as (node, bridge), line(bridge) as client:
        client.say("advertise_service", type="lab_interfaces/AddInts", service="/add")
        assert await client.hears_nothing()
        async with running(lambda: node.service_client(Add, "add").call(Add.Request())) as call:
            asked = await client.hear()
            client.say("service_response", id=asked["id"], service="/add", **answer)
        assert isinstance(call.error, ServiceError)
        assert problem in str(call.error)


async def test_who_calls_a_client_that_goes_is_told(caplog):
    async with bridged() as (node, bridge):
        caller = node.service_client(Add, "add")
        call: Running[Any] = Running(lambda: caller.call(Add.Request()))
        async with anyio.create_task_group() as group, line(bridge) as client:
            client.say("advertise_service", type="lab_interfaces/AddInts", service="/add")
            assert await client.hears_nothing()
            group.start_soon(call.run)
            await client.hear()
        assert isinstance(call.error, ServerUnavailable | ServiceError)
        with pytest.raises(ServerUnavailable):
            await caller.call(Add.Request())


# mistakes

MISTAKES = [
    ({"op": "subscribe", "topic": "/nope"}, "topic '/nope' is not on the graph: give its type"),
    ({"op": "subscribe", "topic": "no name", "type": "geometry_msgs/Point"}, "invalid name"),
    (
        {"op": "subscribe", "topic": "/here", "type": "turtlesim/Pose"},
        "is one of geometry_msgs/msg/Point, not of turtlesim/msg/Pose",
    ),
    ({"op": "advertise", "topic": "/there", "type": "a/Nope"}, "unknown interface 'a/msg/Nope'"),
    ({"op": "publish", "topic": "/nope", "msg": {}}, "topic '/nope' is not on the graph"),
    ({"op": "publish", "topic": "/here", "msg": {"x": "1"}}, "msg.x: expected a number"),
    (
        {"op": "advertise_service", "service": "/s", "type": "a/Nope"},
        "unknown interface 'a/srv/Nope'",
    ),
    ({"op": "advertise_action", "action": "a//b", "type": "lab_interfaces/Count"}, "invalid name"),
    (
        {"op": "cancel_action_goal", "action": "/a", "id": "g"},
        "nobody has sent a goal of the id 'g'",
    ),
    ({"op": "action_result", "id": "x", "result": True}, "no request has the id 'x'"),
]


@pytest.mark.parametrize(("said", "problem"), MISTAKES)
async def test_a_client_that_wants_to_know_is_told_its_mistake(said, problem):
    async with bridged() as (node, bridge), line(bridge) as client:
        node.publisher(Point, "here")
        client.say("set_level", level="info")
        client.say_raw(json.dumps(said | {"id": said.get("id", "m:1")}))
        answer = await client.hear()
        assert (answer["op"], answer["id"]) == ("status", said.get("id", "m:1"))
        assert problem in answer["msg"]
        assert await client.hears_nothing()


async def test_a_topic_of_several_types_is_read_once_its_type_is_said():
    async with bridged() as (node, bridge), line(bridge) as client:
        node.publisher(Pixels, "here")
        publisher = node.publisher(Point, "here")
        client.say("set_level", level="error")
        client.say("subscribe", topic="/here")
        assert (
            "has the types geometry_msgs/msg/Point, lab_interfaces" in (await client.hear())["msg"]
        )
        await subscribe(client, "/here", type="geometry_msgs/Point")
        publisher.publish(Point())
        assert (await client.hear())["op"] == "publish"


MALFORMED = [
    ("[" * 100_000, "not understood: "),
    ("nonsense", "JSON is malformed"),
    ("", "Input data was truncated"),
    ("[]", "Expected `object`, got `array`"),
    ("{}", "missing required field `op`"),
    ('{"op":"fragment"}', "Invalid value 'fragment'"),
    ('{"op":"subscribe"}', "missing required field `topic`"),
    ('{"op":"subscribe","topic":3}', "Expected `str`, got `int`"),
    ('{"op":"call_service","service":"a","args":3}', "Expected"),
    ('{"op":"publish","topic":"a","msg":[]}', "Expected `object | null`"),
    ('{"op":"publish","topic":"a","msg":{"a":' + "9" * 5000 + "}}", "out of range"),
    ('{"op":"unsubscribe","topic":"\\ud800"}', "not understood: "),
    (b"\x00\xff", "binary frames are not supported"),
    ('{"op":"subscribe","topic":"a","compression":"zip"}', "no compression 'zip'"),
    ('{"op":"unsubscribe","topic":"a"}', "'a' has no such subscription"),
    ('{"op":"unadvertise","topic":"a"}', "'a' has no such advertisement"),
    ('{"op":"unadvertise_service","service":"a"}', "service 'a' is not advertised"),
    ('{"op":"unadvertise_action","action":"a"}', "action 'a' is not advertised"),
    ('{"op":"set_level","level":"loud"}', "no level 'loud'"),
    (" " * 200_000, "too long a message"),
]


@pytest.mark.parametrize(("said", "problem"), MALFORMED, ids=[problem for _, problem in MALFORMED])
async def test_a_frame_that_makes_no_sense_is_told_of(said, problem):
    limits = Limits(message_size=150_000)
    async with bridged(limits=limits) as (_, bridge), line(bridge) as client:
        client.say("set_level", level="info")
        client.say_raw(said)
        answer = await client.hear()
        assert answer["op"] == "status"
        assert problem in answer["msg"]
        assert await client.hears_nothing()


@pytest.mark.parametrize(
    ("level", "heard"),
    [("none", []), ("error", ["error"]), ("warning", ["error", "warning"])],
)
async def test_a_level_says_how_much_is_told(level, heard):
    async with bridged() as (_, bridge), line(bridge) as client:
        client.say("set_level", level="info")
        client.say("set_level", level=level)
        client.say_raw("[]")
        client.say("unsubscribe", topic="a")
        assert [(await client.hear())["level"] for _ in heard] == heard
        assert await client.hears_nothing()


async def test_an_unknown_level_is_told_though_the_client_has_asked_for_nothing_yet():
    async with bridged() as (_, bridge), line(bridge) as client:
        client.say("set_level", level="loud")
        assert "no level 'loud'" in (await client.hear())["msg"]


async def test_what_pythons_json_writes_is_read():
    async with bridged() as (node, bridge), line(bridge) as client:
        heard = node.subscription(Point, "here")
        client.say_raw('{"op":"publish","topic":"/here","msg":{"x":NaN, "y": 1, "z":-Infinity}}')
        point = await anext(heard)
        assert math.isnan(point.x)
        assert point.y == 1.0


# how much a client may open


@pytest.mark.parametrize(
    "members",
    [
        {"op": "subscribe", "topic": "/x", "type": "geometry_msgs/Point"},
        {"op": "subscribe", "topic": "/t0", "id": "another"},
        {"op": "advertise", "topic": "/x", "type": "geometry_msgs/Point"},
        {"op": "publish", "topic": "/x", "type": "geometry_msgs/Point"},
        {"op": "advertise_service", "service": "/x", "type": "lab_interfaces/AddInts"},
        {"op": "advertise_action", "action": "/x", "type": "lab_interfaces/Count"},
    ],
)
async def test_a_client_may_open_so_much_and_no_more(members):
    async with bridged(limits=Limits(opened=3)) as (_, bridge), line(bridge) as client:
        client.say("set_level", level="error")
        for number in range(3):
            client.say("subscribe", topic=f"/t{number}", type="geometry_msgs/Point", id="1")
        client.say(**members)
        problem = "3 subscriptions and advertisements are open: close some first"
        assert (await client.hear())["msg"] == problem


CYCLES: list[list[dict[str, Any]]] = [
    [
        {"op": "subscribe", "topic": "/a", "type": "geometry_msgs/Point", "id": "1"},
        {"op": "subscribe", "topic": "/a", "id": "2"},
        {"op": "unsubscribe", "topic": "/a"},
    ],
    [
        {"op": "advertise", "topic": "/a", "type": "geometry_msgs/Point", "id": "1"},
        {"op": "advertise", "topic": "/a", "type": "geometry_msgs/Point", "id": "2"},
        {"op": "unadvertise", "topic": "/a", "id": "1"},
        {"op": "unadvertise", "topic": "/a", "id": "2"},
    ],
    [
        {"op": "advertise_service", "service": "/a", "type": "lab_interfaces/AddInts"},
        {"op": "advertise_service", "service": "/a", "type": "lab_interfaces/AddInts"},
        {"op": "unadvertise_service", "service": "/a"},
    ],
    [
        {"op": "advertise_action", "action": "/a", "type": "lab_interfaces/Count"},
        {"op": "unadvertise_action", "action": "/a"},
    ],
    [{"op": "subscribe", "topic": "/a", "type": "a/Nope"}],
]


@pytest.mark.parametrize("cycle", CYCLES)
async def test_what_was_closed_or_could_not_be_opened_is_not_counted(cycle):
    async with bridged(limits=Limits(opened=3)) as (node, bridge), line(bridge) as client:
        before = len(node.transport.endpoints())
        for _ in range(5):
            for said in cycle:
                client.say(**said)
        assert await client.hears_nothing()
        await settle()
        assert len(node.transport.endpoints()) == before
        client.say("set_level", level="error")
        for number in range(4):
            client.say("subscribe", topic=f"/t{number}", type="geometry_msgs/Point")
        assert "3 subscriptions and advertisements are open" in (await client.hear())["msg"]
        assert await client.hears_nothing()


# readers that do not read


def test_a_client_that_takes_nothing_is_let_go(caplog):
    async def stall():
        async with bridged() as (node, bridge), line(bridge) as one, line(bridge) as other:
            publisher = node.publisher(Point, "here")
            await subscribe(one, "/here")
            await subscribe(other, "/here")
            one.gate = anyio.Event()
            for number in range(100):
                publisher.publish(Point(x=float(number)))
                await anyio.sleep(0.016)
                assert (await other.hear())["msg"]["x"] == number
            await anyio.sleep(1)
            assert one.over.is_set()
            assert one.aborted
            return bridge.statistics().connections

    for backend in ("asyncio", "trio"):
        caplog.clear()
        assert testing.run(stall, backend=backend) == 1
        assert "a web client was disconnected: it read nothing for 2 s" in caplog.text


def test_a_slow_client_that_reads_is_kept():
    async def read():
        async with bridged() as (node, bridge), line(bridge) as client:
            publisher = node.publisher(Point, "here")
            await subscribe(client, "/here")
            client.gate = anyio.Event()
            publisher.publish(Point(x=1.0))
            await anyio.sleep(1.9)
            client.gate.set()
            return (await client.hear())["msg"]["x"], await client.hears_nothing()

    for backend in ("asyncio", "trio"):
        assert testing.run(read, backend=backend) == (1.0, True)


async def test_a_client_whose_line_breaks_is_gone():
    async with bridged() as (_, bridge), line(bridge) as client:
        assert await client.hears_nothing()
        client.is_broken = True
        client.say("call_service", service="/rosapi/topics")
        await client.over.wait()
        assert bridge.statistics().connections == 0


# the end


async def test_a_bridge_that_closes_sends_what_must_arrive_and_a_close_frame():
    async with bridged() as (node, bridge), line(bridge) as client:
        publisher = node.publisher(Point, "here")
        await subscribe(client, "/here")
        client.gate = anyio.Event()
        for _ in range(3):
            publisher.publish(Point())
        client.say("call_service", service="/rosapi/topics")
        await settle()
        async with anyio.create_task_group() as group:
            group.start_soon(bridge.aclose)
            await settle()
            publisher.publish(Point())
            await settle()
            client.gate.set()
        heard = [await client.hear() for _ in range(2)]
        assert [frame["op"] for frame in heard] == ["publish", "service_response"]
        with pytest.raises(anyio.EndOfStream):
            await client.hear_raw()
        assert (client.closed["type"], client.closed["code"]) == ("websocket.close", 1001)


def test_a_bridge_waits_for_a_client_that_takes_nothing_no_longer_than_it_must(caplog):
    async def close():
        async with bridged() as (_, bridge), line(bridge) as client:
            assert await client.hears_nothing()
            client.gate = anyio.Event()
            client.say("call_service", service="/rosapi/topics")
            await anyio.sleep(0.1)
            began = anyio.current_time()
            await bridge.aclose()
            return anyio.current_time() - began

    for backend in ("asyncio", "trio"):
        assert 1.5 < testing.run(close, backend=backend) < 2.5


# the memory of a client


async def test_a_client_that_reads_none_of_its_answers_is_disconnected(caplog):
    async with bridged(limits=Limits(memory=20_000)) as (_, bridge), line(bridge) as client:
        assert await client.hears_nothing()
        client.gate = anyio.Event()
        for _ in range(10):
            client.say("call_service", service="/rosapi/interfaces")
        with anyio.fail_after(10.0):
            await client.over.wait()
        assert client.aborted
    assert "too much data waits for it" in caplog.text


async def test_beyond_its_memory_a_client_loses_messages_of_topics():
    limits = Limits(memory=10_000)
    async with bridged(limits=limits) as (node, bridge), line(bridge) as client:
        publisher = node.publisher(Pixels, "pixels")
        client.say("subscribe", topic="/pixels")
        assert await client.hears_nothing()
        client.gate = anyio.Event()
        for _ in range(20):
            publisher.publish(Pixels(name="x" * 1000))
        await settle()
        assert bridge.statistics().dropped > 0
        assert bridge.statistics().connections == 1
