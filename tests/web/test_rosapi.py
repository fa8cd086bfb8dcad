"""What clients ask of the graph, of its interfaces and of parameters."""

from __future__ import annotations

from typing import Any

import pytest

import turtleact
from turtleact.interfaces import get_interface
from turtleact.interfaces.standard import Point, Twist
from turtleact.transports import MemoryTransport
from turtleact.web.shared import BridgeState, Limits

from ..lab import Count, HandClock, count

SetBool: Any = get_interface("std_srvs/srv/SetBool")


@pytest.fixture
async def rosapi():
    clock = HandClock()
    clock.advance(2.5)
    transport = MemoryTransport(clock)
    async with (
        turtleact.open_node("robot", namespace="/lab", transport=transport) as robot,
        turtleact.open_node("web", transport=transport) as web,
    ):
        robot.publisher(Point, "/here")
        robot.subscription(Twist, "/go")
        robot.service(SetBool, "/pen", lambda request: SetBool.Response())
        robot.action_server(Count, "/count", count)
        shared = BridgeState(web, Limits(), cancel_on_disconnect=False)
        yield shared.rosapi
        await shared.aclose()


ANSWERS = [
    (
        "topics",
        {},
        {
            "topics": ["/go", "/here"],
            "types": ["geometry_msgs/msg/Twist", "geometry_msgs/msg/Point"],
        },
    ),
    ("topics_for_type", {"type": "geometry_msgs/Point"}, {"topics": ["/here"]}),
    ("topic_type", {"topic": "/here"}, {"type": "geometry_msgs/msg/Point"}),
    ("topic_type", {"topic": "here"}, {"type": "geometry_msgs/msg/Point"}),
    ("topic_type", {"topic": "/nope"}, {"type": ""}),
    ("topic_type", {"topic": "/count/_action/status"}, {"type": "action_msgs/msg/GoalStatusArray"}),
    ("services", {}, {"services": ["/pen"]}),
    ("services_for_type", {"type": "std_srvs/SetBool"}, {"services": ["/pen"]}),
    ("service_type", {"service": "/pen"}, {"type": "std_srvs/srv/SetBool"}),
    (
        "service_type",
        {"service": "/count/_action/cancel_goal"},
        {"type": "action_msgs/srv/CancelGoal"},
    ),
    ("service_node", {"service": "/pen"}, {"node": "/lab/robot"}),
    ("service_node", {"service": "/nope"}, {"node": ""}),
    ("service_providers", {"service": "/pen"}, {"providers": ["/lab/robot"]}),
    ("nodes", {}, {"nodes": ["/lab/robot", "/web"]}),
    (
        "node_details",
        {"node": "/lab/robot"},
        {"subscribing": ["/go"], "publishing": ["/here"], "services": ["/pen"]},
    ),
    ("publishers", {"topic": "/here"}, {"publishers": ["/lab/robot"]}),
    ("subscribers", {"topic": "/here"}, {"subscribers": []}),
    ("action_servers", {}, {"action_servers": ["/count"]}),
    ("action_type", {"action": "/count"}, {"type": "lab_interfaces/action/Count"}),
    ("action_type", {"action": "/nope"}, {"type": ""}),
    ("get_ros_version", {}, {"version": 2, "distro": "jazzy"}),
    (
        "get_time",
        {},
        {
            "time": {
                "sec": 1_700_000_002,
                "nanosec": 500_000_000,
                "secs": 1_700_000_002,
                "nsecs": 500_000_000,
            }
        },
    ),
]


@pytest.mark.parametrize(("service", "args", "values"), ANSWERS)
async def test_rosapi_tells(rosapi, service, args, values):
    assert await rosapi.call(f"/rosapi/{service}", args) == values
    assert await rosapi.call(f"rosapi/{service}", list(args.values())) == values


DETAILS = [
    ("message_details", "geometry_msgs/Twist", ["geometry_msgs/Twist", "geometry_msgs/Vector3"]),
    ("service_request_details", "std_srvs/SetBool", ["std_srvs/SetBool_Request"]),
    ("service_response_details", "std_srvs/srv/SetBool", ["std_srvs/SetBool_Response"]),
    ("action_goal_details", "lab_interfaces/Count", ["lab_interfaces/Count_Goal"]),
    ("action_result_details", "lab_interfaces/Count", ["lab_interfaces/Count_Result"]),
    ("action_feedback_details", "lab_interfaces/Count", ["lab_interfaces/Count_Feedback"]),
]


@pytest.mark.parametrize(("service", "type_name", "described"), DETAILS)
async def test_rosapi_describes_types(rosapi, service, type_name, described):
    values = await rosapi.call(f"/rosapi/{service}", {"type": type_name})
    assert [each["type"] for each in values["typedefs"]] == described


async def test_topics_come_with_the_full_text_of_their_types(rosapi):
    values = await rosapi.call("/rosapi/topics_and_raw_types", {})
    assert values["typedefs_full_text"][0].startswith("geometry_msgs/Vector3 linear\n")
    assert "\nMSG: geometry_msgs/Vector3\nfloat64 x" in values["typedefs_full_text"][0]
    assert values["typedefs_full_text"][1] == "float64 x\nfloat64 y\nfloat64 z"


async def test_by_the_topics_with_their_texts_a_client_sees_that_it_is_ros_2(rosapi):
    values = await rosapi.call("/rosapi/topics_and_raw_types", {})
    assert (values["topics"][-1], values["types"][-1]) == ("/rosout", "rcl_interfaces/msg/Log")
    assert "\nstring msg" in values["typedefs_full_text"][-1]
    assert "/rosout" not in (await rosapi.call("/rosapi/topics", {}))["topics"]


async def test_arguments_may_be_left_out(rosapi):
    assert await rosapi.call("/rosapi/topics_for_type", None) == {"topics": []}
