"""rosbridge's rules for one connection: every frame that clients send, and what is to be done."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import pytest

from turtleact.web import operations
from turtleact.web.protocol import (
    LONGEST_INTERVAL,
    Adjust,
    Delivery,
    Do,
    Open,
    Protocol,
    Reader,
    Say,
    Shut,
    Writer,
)


def frame(op: str, **members: object) -> str:
    return json.dumps({"op": op, **members})


def told(effects: Sequence[object]) -> list[dict[str, Any]]:
    return [json.loads(effect.frame) for effect in effects if isinstance(effect, Say)]


@pytest.fixture
def protocol():
    return Protocol()


@pytest.fixture
def curious():
    """A client that wants to be told everything."""
    made = Protocol()
    assert made.receive(frame("set_level", level="info", id="lvl1")) == []
    return made


# what passes through

PASSED = [
    pytest.param(
        '{"op":"call_service","id":"call_service:/rosapi/topics:1","service":"/rosapi/topics","args":{}}',
        operations.CallService(
            id="call_service:/rosapi/topics:1", service="/rosapi/topics", args={}
        ),
        id="call-service-roslibpy",
    ),
    pytest.param(
        '{"op":"call_service","id":"call_service:rosapi/topics:u","service":"rosapi/topics","args":{},"timeout":3.5}',
        operations.CallService(
            id="call_service:rosapi/topics:u", service="rosapi/topics", args={}, timeout=3.5
        ),
        id="call-service-roslibjs",
    ),
    pytest.param(
        '{"op":"call_service","service":"/turtle1/rotate_absolute/_action/cancel_goal","args":{}}',
        operations.CallService(service="/turtle1/rotate_absolute/_action/cancel_goal", args={}),
        id="cancel-all",
    ),
    pytest.param(
        '{"op":"send_action_goal","id":"send_action_goal:/fibonacci:14","action":"/fibonacci",'
        '"action_type":"example_interfaces/action/Fibonacci","args":{"order":5},"feedback":true}',
        operations.SendActionGoal(
            id="send_action_goal:/fibonacci:14",
            action="/fibonacci",
            action_type="example_interfaces/action/Fibonacci",
            args={"order": 5},
            feedback=True,
        ),
        id="send-goal",
    ),
    pytest.param(
        '{"op":"cancel_action_goal","id":"send_action_goal:/r:15","action":"/r"}',
        operations.CancelActionGoal(id="send_action_goal:/r:15", action="/r"),
        id="cancel-goal",
    ),
    pytest.param(
        '{"op":"service_response","service":"/add","values":{"sum":3},"result":true,"id":"service_request:/add:3"}',
        operations.ServiceResponse(
            id="service_request:/add:3", service="/add", values={"sum": 3}, result=True
        ),
        id="service-response",
    ),
    pytest.param(
        '{"op":"action_result","id":"a","action":"/js_fib","status":6,"result":false}',
        operations.ActionResult(id="a", action="/js_fib", status=6, result=False),
        id="action-failed",
    ),
    pytest.param(
        '{"op":"action_feedback","id":"a","action":"/js_fib","values":{"sequence":[0,1]}}',
        operations.ActionFeedback(id="a", action="/js_fib", values={"sequence": [0, 1]}),
        id="action-feedback",
    ),
]


@pytest.mark.parametrize(("text", "operation"), PASSED)
def test_what_opens_nothing_is_to_be_done(protocol, text, operation):
    assert protocol.receive(text) == [Do(operation)]


# topics


def test_a_subscription_is_opened(protocol):
    said = (
        '{"op":"subscribe","id":"subscribe:/turtle1/pose:9","type":"turtlesim/Pose",'
        '"topic":"/turtle1/pose","compression":"none","throttle_rate":100,"queue_length":0}'
    )
    delivery = Delivery(0.1, "none")
    reader = Reader("/turtle1/pose", "turtlesim/Pose", delivery, "subscribe:/turtle1/pose:9")
    assert protocol.receive(said) == [Open(reader)]


def test_a_subscription_needs_a_topic_and_nothing_else(protocol):
    assert protocol.receive(frame("subscribe", topic="a")) == [Open(Reader("a", "", Delivery()))]


def test_members_that_are_null_are_left_out(protocol):
    said = frame(
        "subscribe",
        topic="a",
        id=None,
        type=None,
        throttle_rate=None,
        queue_length=None,
        compression=None,
    )
    assert protocol.receive(said) == [Open(Reader("a", "", Delivery()))]


@pytest.mark.parametrize(
    ("members", "delivery"),
    [
        ({"throttle_rate": -5, "queue_length": -5}, Delivery()),
        (
            {"throttle_rate": 1e300, "queue_length": 1e300},
            Delivery(LONGEST_INTERVAL),
        ),
        ({"throttle_rate": math.nan, "queue_length": math.nan}, Delivery()),
        ({"throttle_rate": math.inf}, Delivery(LONGEST_INTERVAL)),
    ],
    ids=["below-zero", "huge", "nan", "infinite"],
)
def test_a_wish_is_taken_as_far_as_it_makes_sense(protocol, members, delivery):
    assert protocol.receive(frame("subscribe", topic="a", **members)) == [
        Open(Reader("a", "", delivery))
    ]


def test_subscriptions_of_one_topic_are_one(protocol):
    protocol.receive(frame("subscribe", topic="a", id="1", throttle_rate=100))
    said = frame("subscribe", topic="a", id="2", throttle_rate=50, compression="cbor")
    assert protocol.receive(said) == [Adjust("a", Delivery(0.05, "cbor"))]


def test_a_subscription_may_be_changed(protocol):
    protocol.receive(frame("subscribe", topic="a", id="1", throttle_rate=50))
    said = frame("subscribe", topic="a", id="1", throttle_rate=100)
    assert protocol.receive(said) == [Adjust("a", Delivery(0.1))]


def test_the_last_of_several_subscriptions_closes_the_topic(protocol):
    protocol.receive(frame("subscribe", topic="a", id="1", throttle_rate=100))
    protocol.receive(frame("subscribe", topic="a", id="2"))
    assert protocol.receive(frame("unsubscribe", topic="a", id="2")) == [Adjust("a", Delivery(0.1))]
    assert protocol.receive(frame("unsubscribe", topic="a", id="1")) == [Shut("reader", "a")]


def test_without_an_id_all_subscriptions_of_a_topic_end(protocol):
    protocol.receive(frame("subscribe", topic="a", id="1"))
    protocol.receive(frame("subscribe", topic="a", id="2"))
    assert protocol.receive(frame("unsubscribe", topic="a")) == [Shut("reader", "a")]


def test_spellings_of_one_topic_are_answered_as_they_were_asked(protocol):
    assert protocol.receive(frame("subscribe", topic="a")) != []
    assert protocol.receive(frame("subscribe", topic="/a")) == [Open(Reader("/a", "", Delivery()))]


def test_a_topic_is_advertised(protocol):
    said = (
        '{"op":"advertise","id":"advertise:/turtle1/cmd_vel:10","type":"geometry_msgs/Twist",'
        '"topic":"/turtle1/cmd_vel","latch":false,"queue_size":100}'
    )
    writer = Writer(
        "/turtle1/cmd_vel", "geometry_msgs/Twist", False, 100, "advertise:/turtle1/cmd_vel:10"
    )
    assert protocol.receive(said) == [Open(writer)]


def test_a_topic_is_advertised_once(protocol):
    said = frame("advertise", topic="a", type="b/C", id="1")
    assert protocol.receive(said) == [Open(Writer("a", "b/C", False, 1, "1"))]
    assert protocol.receive(said) == []
    assert protocol.receive(frame("advertise", topic="a", type="b/C", id="2")) == []
    assert protocol.receive(frame("unadvertise", topic="a", id="1")) == []
    assert protocol.receive(frame("unadvertise", topic="a", id="2")) == [Shut("writer", "a")]


def test_a_latched_topic_keeps_one_message_unless_more_are_asked_for(protocol):
    said = frame("advertise", topic="a", type="b/C", latch=True)
    assert protocol.receive(said) == [Open(Writer("a", "b/C", True, 1))]


def test_a_message_goes_to_the_topic_that_was_advertised(protocol):
    protocol.receive(frame("advertise", topic="a", type="b/C", id="1"))
    said = frame("publish", topic="a", msg={"x": 1}, id="publish:a:11", latch=False)
    assert protocol.receive(said) == [
        Do(operations.Publish(topic="a", msg={"x": 1}, id="publish:a:11"))
    ]


def test_a_message_advertises_its_topic_if_nobody_has(protocol):
    said = frame("publish", topic="a", msg={}, type="b/C")
    publish = operations.Publish(topic="a", msg={}, type="b/C")
    assert protocol.receive(said) == [Open(Writer("a", "b/C", False, 1)), Do(publish)]
    assert protocol.receive(said) == [Do(publish)]
    assert protocol.receive(frame("unadvertise", topic="a")) == [Shut("writer", "a")]


def test_what_could_not_be_opened_can_be_tried_again(protocol):
    said = frame("subscribe", topic="a")
    opened = protocol.receive(said)
    protocol.forget("reader", "a")
    protocol.forget("reader", "a")
    protocol.forget("service", "never there")
    assert protocol.receive(said) == opened


# services and actions

SERVED = [("service", {"service": "/add"}), ("action", {"action": "/add"})]


@pytest.mark.parametrize(("kind", "name"), SERVED)
def test_a_client_serves(protocol, kind, name):
    (effect,) = protocol.receive(frame(f"advertise_{kind}", type="b/C", **name))
    assert isinstance(effect, Open)
    assert effect.what.type == "b/C"


@pytest.mark.parametrize(("kind", "name"), SERVED)
def test_what_is_served_again_takes_the_place_of_the_first(protocol, kind, name):
    protocol.receive(frame(f"advertise_{kind}", type="b/C", **name))
    effects = protocol.receive(frame(f"advertise_{kind}", type="b/D", **name))
    assert effects[0] == Shut(kind, "/add")
    assert effects[1].what.type == "b/D"


@pytest.mark.parametrize(("kind", "name"), SERVED)
def test_a_client_serves_no_more(protocol, kind, name):
    protocol.receive(frame(f"advertise_{kind}", type="b/C", **name))
    assert protocol.receive(frame(f"unadvertise_{kind}", **name)) == [Shut(kind, "/add")]
    assert protocol.receive(frame(f"unadvertise_{kind}", **name)) == []


# how much


@pytest.mark.parametrize(
    "said",
    [
        frame("subscribe", topic="x"),
        frame("advertise", topic="x", type="b/C"),
        frame("publish", topic="x", type="b/C"),
        frame("advertise_service", service="x", type="b/C"),
        frame("advertise_action", action="x", type="b/C"),
        frame("subscribe", topic="0", id="another"),
    ],
)
def test_a_client_may_open_so_much_and_no_more(said):
    protocol = Protocol(most_opened=3)
    protocol.receive(frame("set_level", level="error"))
    for topic in range(3):
        assert protocol.receive(frame("subscribe", topic=f"{topic}", id="1")) != []
    (answer,) = told(protocol.receive(said))
    assert answer["msg"] == "3 subscriptions and advertisements are open: close some first"


CYCLES = [
    [
        frame("subscribe", topic="a", id="1"),
        frame("subscribe", topic="a", id="2"),
        frame("unsubscribe", topic="a"),
    ],
    [
        frame("subscribe", topic="a", id="1"),
        frame("subscribe", topic="a", id="2"),
        frame("unsubscribe", topic="a", id="1"),
        frame("unsubscribe", topic="a", id="2"),
    ],
    [
        frame("advertise", topic="a", type="b", id="1"),
        frame("advertise", topic="a", type="b", id="2"),
        frame("unadvertise", topic="a"),
    ],
    [frame("advertise", topic="a", type="b", id="1"), frame("unadvertise", topic="a", id="1")],
    [frame("publish", topic="a"), frame("unadvertise", topic="a")],
    [
        frame("advertise_service", service="a", type="b"),
        frame("advertise_service", service="a", type="b"),
        frame("unadvertise_service", service="a"),
    ],
    [frame("advertise_action", action="a", type="b"), frame("unadvertise_action", action="a")],
]


@pytest.mark.parametrize("cycle", CYCLES)
def test_what_was_closed_is_not_counted_any_more(cycle):
    protocol = Protocol(most_opened=3)
    for _ in range(5):
        for said in cycle:
            protocol.receive(said)
    opened = [protocol.receive(frame("subscribe", topic=f"{number}")) for number in range(4)]
    assert [len(effects) for effects in opened] == [1, 1, 1, 0]


# what a client is told

MISTAKES = [
    pytest.param("[" * 100_001, "more than 100000 objects and lists", id="too-many"),
    pytest.param("nonsense", "JSON is malformed", id="no-json"),
    pytest.param("", "Input data was truncated", id="empty"),
    pytest.param("[]", "Expected `object`, got `array`", id="no-object"),
    pytest.param("{}", "missing required field `op`", id="no-op"),
    pytest.param('{"op":"fragment"}', "Invalid value 'fragment'", id="unknown-op"),
    pytest.param('{"op":"subscribe"}', "missing required field `topic`", id="no-topic"),
    pytest.param('{"op":"subscribe","topic":3}', "Expected `str`, got `int`", id="no-text"),
    pytest.param('{"op":"call_service","service":"a","args":3}', "Expected", id="no-args"),
    pytest.param('{"op":"publish","topic":"a","msg":[]}', "Expected `object | null`", id="no-msg"),
    pytest.param("[" * 100_000, "not understood", id="deep"),
    pytest.param(
        '{"op":"publish","topic":"a","msg":{"a":' + "[" * 40_000 + "]" * 40_000 + "}}",
        "too deep",
        id="deep-value",
    ),
    pytest.param(
        '{"op":"publish","topic":"a","msg":{"a":' + "9" * 5000 + "}}",
        "out of range",
        id="long-number",
    ),
    pytest.param('{"op":"unsubscribe","topic":"\\ud800"}', "half a surrogate", id="half-topic"),
    pytest.param('{"op":"\\udfff"}', "half a surrogate", id="half-op"),
    pytest.param('{"op":"\\ud800"', "half a surrogate", id="half-cut"),
    pytest.param('{"op":"\ud800"}', "half a surrogate", id="half-raw"),
    pytest.param('{"op":"x","id":"\\ud83d\\ude00"}', "Invalid value 'x'", id="whole-pair"),
    pytest.param(b"\x00\xff", "binary frames are not supported", id="binary"),
    pytest.param(
        '{"op":"subscribe","topic":"a","compression":"zip"}',
        "no compression 'zip'",
        id="compression",
    ),
    pytest.param(
        '{"op":"unsubscribe","topic":"a"}', "'a' has no such subscription", id="unsubscribe"
    ),
    pytest.param(
        '{"op":"unadvertise","topic":"a"}', "'a' has no such advertisement", id="unadvertise"
    ),
    pytest.param(
        '{"op":"unadvertise_service","service":"a"}', "service 'a' is not advertised", id="service"
    ),
    pytest.param(
        '{"op":"unadvertise_action","action":"a"}', "action 'a' is not advertised", id="action"
    ),
    pytest.param('{"op":"set_level","level":"loud"}', "no level 'loud'", id="level"),
]


@pytest.mark.parametrize(("said", "problem"), MISTAKES)
def test_a_client_that_asked_for_it_is_told_its_mistake(curious, said, problem):
    (answer,) = told(curious.receive(said))
    assert answer["op"] == "status"
    assert problem in answer["msg"]


@pytest.mark.parametrize(("said", "problem"), [case for case in MISTAKES if case.id != "level"])
def test_a_client_that_did_not_ask_for_it_is_told_nothing(protocol, said, problem):
    assert protocol.receive(said) == []


def test_a_mistake_is_told_under_the_id_of_the_frame(curious):
    (answer,) = told(curious.receive('{"op":"nope","id":"n:1"}'))
    assert answer["id"] == "n:1"


def test_what_pythons_json_writes_is_read(protocol):
    (effect, _) = protocol.receive('{"op":"publish","topic":"a","type":"b/C","msg":{"x":NaN}}')
    assert effect == Open(Writer("a", "b/C", False, 1))


@pytest.mark.parametrize(
    ("level", "heard"),
    [
        ("none", []),
        ("error", ["error"]),
        ("warning", ["error", "warning"]),
        ("info", ["error", "warning"]),
    ],
)
def test_a_level_says_how_much_is_told(protocol, level, heard):
    protocol.receive(frame("set_level", level=level))
    answers = told(protocol.receive("[]")) + told(protocol.receive(frame("unsubscribe", topic="a")))
    assert [answer["level"] for answer in answers] == heard


def test_a_level_can_be_taken_back(curious):
    curious.receive(frame("set_level"))
    assert curious.receive("[]") == []
