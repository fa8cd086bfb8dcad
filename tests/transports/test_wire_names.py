"""Keys, tokens and gids, against those that rclpy and rmw_zenoh_cpp were seen to use."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.transports import QoS
from turtleact.transports.base import Endpoint, EndpointKind, TimePolicies
from turtleact.transports.rmw_zenoh.wire import (
    Token,
    all_tokens,
    data_key,
    dds_type,
    endpoint_token,
    gid_of,
    node_token,
    parse_token,
    ros_type,
)

ZID = "98275667e4e3dc738dba56cbae78e500"
STATUS_QOS = QoS(depth=1, durability="transient_local")
STATUS_HASH = "RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e"

# Recorded from a node of rclpy 9.1 on rmw_zenoh_cpp 0.6.7.
NODE = f"@ros2_lv/0/{ZID}/0/0/NN/%/%sim%a/turtle_node"
SEND_GOAL = (
    f"@ros2_lv/0/{ZID}/0/3/SS/%/%sim%a/turtle_node/"
    "%sim%a%turtle1%rotate_absolute%_action%send_goal/"
    "turtlesim::action::dds_::RotateAbsolute_SendGoal_/"
    "RIHS01_0b9b876a15971456fbad2c7f0665c9879a41bb3fcba31a9015180a830f0ca84f/::,10:,:,:,,"
)
STATUS = (
    f"@ros2_lv/0/{ZID}/0/7/MP/%/%sim%a/turtle_node/"
    "%sim%a%turtle1%rotate_absolute%_action%status/"
    f"action_msgs::msg::dds_::GoalStatusArray_/{STATUS_HASH}/:1:,1:,:,:,,"
)
FEEDBACK = (
    "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/1/MP/%/%/fib_server/"
    "%fibonacci%_action%feedback/example_interfaces::action::dds_::Fibonacci_FeedbackMessage_/"
    "RIHS01_c1de71afd52e49a89c53d8262366884185bc0a02f78ce051c4e46b0a7fe59bb2/::,10:,:,:,,"
)
FEEDBACK_GID = bytes.fromhex("f53cfc0b31c2798f0d6b0b1826573f4a")

send_goal = Endpoint(
    "service",
    "/sim/a/turtle1/rotate_absolute/_action/send_goal",
    "turtlesim/action/RotateAbsolute_SendGoal",
    "/sim/a/turtle_node",
    type_hash="RIHS01_0b9b876a15971456fbad2c7f0665c9879a41bb3fcba31a9015180a830f0ca84f",
)
status = Endpoint(
    "publisher",
    "/sim/a/turtle1/rotate_absolute/_action/status",
    "action_msgs/msg/GoalStatusArray",
    "/sim/a/turtle_node",
    STATUS_QOS,
    STATUS_HASH,
)


def with_gid(endpoint: Endpoint, token: str) -> Endpoint:
    fields = {name: getattr(endpoint, name) for name in endpoint.__struct_fields__}
    return Endpoint(**{**fields, "gid": gid_of(token)})


def swapped(chunk: int, text: str, token: str = STATUS) -> str:
    """A token with another chunk."""
    chunks = token.split("/")
    chunks[chunk] = text
    return "/".join(chunks)


def seen(token: str) -> Endpoint:
    read = parse_token(token)
    assert read is not None
    assert read.endpoint is not None
    return read.endpoint


# data


@pytest.mark.parametrize(
    ("endpoint", "key"),
    [
        (
            Endpoint(
                "client",
                "/fibonacci/_action/send_goal",
                "example_interfaces/action/Fibonacci_SendGoal",
                "/n",
                type_hash="RIHS01_d1",
            ),
            "0/fibonacci/_action/send_goal/"
            "example_interfaces::action::dds_::Fibonacci_SendGoal_/RIHS01_d1",
        ),
        (
            status,
            "0/sim/a/turtle1/rotate_absolute/_action/status/"
            f"action_msgs::msg::dds_::GoalStatusArray_/{STATUS_HASH}",
        ),
    ],
    ids=["service", "topic"],
)
def test_a_data_key_is_that_of_rmw_zenoh(endpoint, key):
    assert data_key(0, endpoint) == key


def test_the_domain_is_the_first_part_of_a_key():
    assert data_key(42, status).startswith("42/sim/a/")
    assert all_tokens(42) == "@ros2_lv/42/**"


# tokens


def test_the_token_of_a_node_is_that_of_rmw_zenoh():
    assert node_token(0, ZID, 0, "/sim/a/turtle_node") == NODE


def test_a_node_in_the_root_namespace_has_an_empty_one():
    token = node_token(0, ZID, 4, "/lab")
    assert token == f"@ros2_lv/0/{ZID}/4/4/NN/%/%/lab"
    assert parse_token(token) == Token(ZID, "/lab")


@pytest.mark.parametrize(
    ("number", "endpoint", "token"), [(3, send_goal, SEND_GOAL), (7, status, STATUS)]
)
def test_the_token_of_an_endpoint_is_that_of_rmw_zenoh(number, endpoint, token):
    assert endpoint_token(0, ZID, 0, number, endpoint) == token


@pytest.mark.parametrize(
    ("token", "read"),
    [
        (NODE, Token(ZID, "/sim/a/turtle_node")),
        (SEND_GOAL, Token(ZID, "/sim/a/turtle_node", with_gid(send_goal, SEND_GOAL))),
        (STATUS, Token(ZID, "/sim/a/turtle_node", with_gid(status, STATUS))),
    ],
    ids=["node", "service", "topic"],
)
def test_a_token_of_rmw_zenoh_is_read(token, read):
    assert parse_token(token) == read


NAMES = st.from_regex(r"(/[a-z][a-z0-9_]{0,8}){1,4}", fullmatch=True)


@given(
    kind=st.sampled_from(["publisher", "subscription", "service", "client"]),
    name=NAMES,
    node=NAMES,
    depth=st.integers(1, 10**9 - 1),
    durability=st.sampled_from(["volatile", "transient_local"]),
    reliability=st.sampled_from(["reliable", "best_effort"]),
)
def test_what_is_written_is_read_as_it_was(kind, name, node, depth, durability, reliability):
    qos = QoS(depth=depth, durability=durability, reliability=reliability)
    written: EndpointKind = kind
    endpoint = Endpoint(written, name, "lab_interfaces/msg/Number", node, qos, "RIHS01_ab")
    token = endpoint_token(0, ZID, 1, 2, endpoint)
    assert parse_token(token) == Token(ZID, node, with_gid(endpoint, token))


def test_a_token_of_a_newer_peer_has_more_chunks():
    newer = f"{STATUS}/backends:cpu"
    assert seen(newer) == with_gid(status, newer)


def test_a_hash_that_an_older_peer_does_not_know_is_shown_as_it_is():
    assert seen(swapped(11, "TypeHashNotSupported")).type_hash == "TypeHashNotSupported"


@pytest.mark.parametrize(
    ("chunk", "qos"),
    [
        (":,:,:,:,,", QoS(depth=42)),
        ("2::,5:,:,:,,", QoS(depth=5, reliability="best_effort")),
        ("0:0:0,0:1,0:1,0:0,1,0", QoS(depth=42)),
        ("4:4:2,7:,:,:,,", QoS(depth=7)),
        ("", QoS(depth=42)),
        ("x:y:z", QoS(depth=42)),
        ("::,-3", QoS(depth=42)),
        ("::,²", QoS(depth=42)),
        ("::,1" + "0" * 30, QoS(depth=42)),
    ],
)
def test_an_odd_quality_of_service_is_the_default_where_it_says_nothing(chunk, qos):
    assert seen(swapped(12, chunk)).qos == qos


@pytest.mark.parametrize(
    ("chunk", "times"),
    [
        ("::,10:,:,:,,", TimePolicies()),
        ("::,10:,:10,0:,,", TimePolicies(lifespan=10 * 10**9)),
        (
            "::,10:0,500000000:10,0:3,2,1",
            TimePolicies(
                deadline=5 * 10**8,
                lifespan=10 * 10**9,
                liveliness="manual_by_topic",
                lease=2 * 10**9 + 1,
            ),
        ),
        ("::,10:9223372036,854775807:,:1,9223372036,854775807", TimePolicies()),
        ("::,10:x,y:-1,²:9,,", TimePolicies(liveliness="unknown")),
        ("::,10:1:2", TimePolicies(deadline=10**9, lifespan=2 * 10**9)),
        ("", TimePolicies()),
    ],
)
def test_the_policies_in_time_are_those_of_rmw_zenoh_or_infinite(chunk, times):
    assert seen(swapped(12, chunk)).times == times


@pytest.mark.parametrize(
    "token",
    [
        "",
        "0/turtle1/pose",
        "@ros2_lv/0/a",
        "@ros2_lv/0/a/0/0/NN/%/%",
        "@ros2_lv/0/a/0/0/NN/%/%/",
        "@ros2_lw/0/a/0/0/NN/%/%/lab",
        "@ros2_lv/0/a/0/1/XX/%/%/lab/%t/T/H/Q",
        STATUS.rpartition("/")[0],
        swapped(9, ""),
        swapped(10, ""),
        swapped(11, ""),
        swapped(9, "a" * 10_000),
    ],
)
def test_what_is_no_token_is_none(token):
    assert parse_token(token) is None


@given(st.text(st.sampled_from("@ros2_lv/0NMPS%:,aé"), max_size=120))
def test_any_text_is_a_token_or_none(text):
    parse_token(text)
    parse_token(f"@ros2_lv/0/a/0/0/{text}")


# gids


def test_a_gid_is_that_of_rmw_zenoh():
    assert gid_of(FEEDBACK) == FEEDBACK_GID
    assert seen(FEEDBACK).gid == FEEDBACK_GID


# types


@pytest.mark.parametrize(
    ("ros", "dds"),
    [
        ("example_interfaces/srv/AddTwoInts", "example_interfaces::srv::dds_::AddTwoInts_"),
        ("pkg/action/Fibonacci_SendGoal", "pkg::action::dds_::Fibonacci_SendGoal_"),
        ("std_msgs/msg/String", "std_msgs::msg::dds_::String_"),
    ],
)
def test_a_type_has_a_name_in_ros_and_one_in_dds(ros, dds):
    assert (dds_type(ros), ros_type(dds)) == (dds, ros)


@pytest.mark.parametrize("name", ["", "String", "std_msgs::msg::dds_::String", "a::b_", "::"])
def test_a_foreign_name_of_a_type_stays_as_it_is(name):
    assert ros_type(name) == name
