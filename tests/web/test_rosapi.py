"""What clients ask of the graph, of its interfaces and of parameters."""

from __future__ import annotations

from typing import Any

import pytest

import turtleact
from turtleact.errors import InvalidMessage, ServerUnavailable, UnknownInterface
from turtleact.interfaces import get_interface
from turtleact.interfaces.standard import Point, Twist
from turtleact.transports import MemoryTransport
from turtleact.web.directory import Directory
from turtleact.web.rosapi import LONGEST_PARAMETER, MOST_PARAMETERS, Rosapi

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
        yield Rosapi(web, Directory(web.transport))


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
    assert rosapi.call(f"/rosapi/{service}", args) == values
    assert rosapi.call(f"rosapi/{service}", list(args.values())) == values


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
    values = rosapi.call(f"/rosapi/{service}", {"type": type_name})
    assert [each["type"] for each in values["typedefs"]] == described


@pytest.mark.parametrize("service", [service for service, _, _ in DETAILS])
async def test_a_type_that_is_not_known_is_an_error(rosapi, service):
    with pytest.raises(UnknownInterface, match=r"a/[a-z]+/Nope"):
        rosapi.call(f"/rosapi/{service}", {"type": "a/Nope"})


async def test_rosapi_lists_all_interfaces(rosapi):
    assert "geometry_msgs/msg/Twist" in rosapi.call("/rosapi/interfaces", {})["interfaces"]


async def test_topics_come_with_the_full_text_of_their_types(rosapi):
    values = rosapi.call("/rosapi/topics_and_raw_types", {})
    assert values["typedefs_full_text"][0].startswith("Vector3 linear\nVector3 angular\n====")
    assert "\nMSG: geometry_msgs/Vector3\nfloat64 x" in values["typedefs_full_text"][0]
    assert values["typedefs_full_text"][1] == "float64 x\nfloat64 y\nfloat64 z"


async def test_a_text_that_is_not_known_is_a_comment(rosapi, monkeypatch):
    monkeypatch.setattr(rosapi, "_topics", lambda: {"topics": ["/t"], "types": ["a/msg/Nope"]})
    values = rosapi.call("/rosapi/topics_and_raw_types", {})
    assert values["typedefs_full_text"][0] == "# unknown interface 'a/msg/Nope'"


async def test_by_the_topics_with_their_texts_a_client_sees_that_it_is_ros_2(rosapi):
    values = rosapi.call("/rosapi/topics_and_raw_types", {})
    assert (values["topics"][-1], values["types"][-1]) == ("/rosout", "rcl_interfaces/msg/Log")
    assert "\nstring msg" in values["typedefs_full_text"][-1]
    assert "/rosout" not in rosapi.call("/rosapi/topics", {})["topics"]


async def test_rosout_is_told_of_once(rosapi, monkeypatch):
    listed = {"topics": ["/rosout"], "types": ["rcl_interfaces/msg/Log"]}
    monkeypatch.setattr(rosapi, "_topics", lambda: listed)
    assert rosapi.call("/rosapi/topics_and_raw_types", {})["topics"] == ["/rosout"]


@pytest.mark.parametrize("service", ["/add", "rosapi", "/rosapi/", "/other/topics"])
async def test_what_is_not_rosapis_is_left_to_the_graph(rosapi, service):
    assert rosapi.call(service, {}) is None


async def test_what_rosapi_has_not_is_an_error(rosapi):
    with pytest.raises(ServerUnavailable, match="did you mean 'topics'"):
        rosapi.call("/rosapi/topic", {})


async def test_an_argument_that_is_no_text_is_an_error(rosapi):
    with pytest.raises(InvalidMessage, match=r"args.topic: expected text, got a int"):
        rosapi.call("/rosapi/topic_type", {"topic": 3})


async def test_arguments_may_be_left_out(rosapi):
    assert rosapi.call("/rosapi/topics_for_type", None) == {"topics": []}


# parameters


async def test_a_parameter_is_set_read_and_deleted(rosapi):
    name = {"name": "/speed"}
    assert rosapi.call("/rosapi/has_param", name) == {"exists": False}
    assert rosapi.call("/rosapi/set_param", name | {"value": "1.5"})["successful"]
    assert rosapi.call("/rosapi/has_param", name) == {"exists": True}
    assert rosapi.call("/rosapi/get_param", name) == {"value": "1.5", "successful": True}
    assert rosapi.call("/rosapi/get_param_names", {}) == {"names": ["/speed"]}
    assert rosapi.call("/rosapi/delete_param", name)["successful"]
    assert not rosapi.call("/rosapi/delete_param", name)["successful"]
    assert rosapi.call("/rosapi/get_param_names", {}) == {"names": []}


async def test_a_parameter_that_is_not_set_has_its_default(rosapi):
    assert rosapi.call("/rosapi/get_param", ["/speed", "2"])["value"] == "2"
    assert rosapi.call("/rosapi/get_param", ["/speed"])["value"] == "null"


async def test_there_is_an_end_to_parameters(rosapi):
    for number in range(MOST_PARAMETERS):
        assert rosapi.call("/rosapi/set_param", [f"{number}", "1"])["successful"]
    assert not rosapi.call("/rosapi/set_param", ["one more", "1"])["successful"]
    assert rosapi.call("/rosapi/set_param", ["1", "2"])["successful"]
    assert not rosapi.call("/rosapi/set_param", ["1", "x" * LONGEST_PARAMETER])["successful"]
