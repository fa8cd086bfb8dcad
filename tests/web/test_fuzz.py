"""Whatever a client says, its connection stays, others notice nothing, and nothing is left open."""

from __future__ import annotations

import json
from typing import Any

import anyio
from hypothesis import given, settings
from hypothesis import strategies as st

from turtleact import testing
from turtleact.interfaces.standard import Twist

from ..lab import Count, count
from .line import bridged, line

OPERATIONS = [
    "set_level",
    "advertise",
    "unadvertise",
    "publish",
    "subscribe",
    "unsubscribe",
    "call_service",
    "advertise_service",
    "unadvertise_service",
    "service_response",
    "send_action_goal",
    "cancel_action_goal",
    "advertise_action",
    "unadvertise_action",
    "action_feedback",
    "action_result",
    "status",
    "fragment",
    "auth",
]
NAMES = [
    "/here",
    "here",
    "/count",
    "/count/_action/status",
    "/count/_action/cancel_goal",
    "/count/_action/get_result",
    "/rosapi/topics",
    "/rosapi/topic_type",
    "/rosapi/set_param",
    "/served",
    "",
    "/",
    "no name",
    "\x00",
    "\ud800",
]
TYPES = [
    "geometry_msgs/Twist",
    "geometry_msgs/msg/Twist",
    "lab_interfaces/action/Count",
    "lab_interfaces::action::dds_::Count_",
    "lab_interfaces/action/Count_GetResult",
    "action_msgs/srv/CancelGoal",
    "std_srvs/SetBool",
    "a/Nope",
    "",
    "/",
]

anything: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4)
    ),
    max_leaves=8,
)
name = st.sampled_from(NAMES)
values = (
    anything
    | st.just({"linear": {"x": 1, "y": None}})
    | st.just({"upto": 2})
    | st.just({"goal_id": {"uuid": "AAAAAAAAAAAAAAAAAAAAAA=="}})
)
members: st.SearchStrategy[dict[str, Any]] = st.fixed_dictionaries(
    {"op": st.sampled_from(OPERATIONS)},
    optional={
        "id": st.sampled_from(["1", "2", 3, 1.5, None, [], "action_goal:/served:1"]),
        "topic": name | anything,
        "service": name | anything,
        "action": name | anything,
        "type": st.sampled_from(TYPES) | anything,
        "action_type": st.sampled_from(TYPES) | anything,
        "msg": values,
        "args": values,
        "values": values,
        "result": st.booleans() | anything,
        "status": st.integers(-1, 8) | anything,
        "feedback": st.booleans() | anything,
        "latch": st.booleans() | anything,
        "level": st.sampled_from(["info", "none", "loud"]) | anything,
        "compression": st.sampled_from(["none", "png", "cbor", "cbor-raw", "zip"]) | anything,
        "throttle_rate": st.floats() | st.integers(),
        "queue_length": st.floats() | st.integers(),
        "timeout": st.floats(),
    },
)
frame = members.map(json.dumps) | anything.map(json.dumps) | st.text() | st.binary()
cut = st.tuples(members.map(json.dumps), st.integers(0, 200)).map(lambda pair: pair[0][: pair[1]])


@settings(max_examples=100)
@given(frames=st.lists(frame | cut, max_size=40), backend=st.sampled_from(["asyncio", "trio"]))
def test_a_client_may_say_what_it_likes(frames, backend):
    async def listen() -> None:
        async with bridged() as (node, bridge):
            node.action_server(Count, "count", count)
            node.publisher(Twist, "here")
            before = node.transport.endpoints()
            async with line(bridge) as client, line(bridge) as other:
                for each in frames:
                    client.say_raw(each)
                await anyio.sleep(1)
                assert not client.over.is_set()
                client.say("call_service", id="the end", service="/rosapi/get_ros_version")
                while True:
                    heard = await client.hear_raw()
                    if isinstance(heard, str) and json.loads(heard).get("id") == "the end":
                        break
                assert await other.hears_nothing()
            await anyio.sleep(100)  # a client that is asked to cancel has half a minute
            left = [each for each in node.transport.endpoints() if each.kind != "client"]
            assert left == [each for each in before if each.kind != "client"]
            assert bridge.statistics().goals == 0

    testing.run(listen, backend=backend)
