"""What rclpy's services, clients and actions publish about their calls."""

from typing import Any

import pytest

from turtleact.rclpy.action import ActionClient, ActionServer
from turtleact.rclpy.exceptions import InvalidHandle
from turtleact.rclpy.messages import interface_class
from turtleact.rclpy.qos import QoSProfile, qos_profile_system_default
from turtleact.rclpy.services import ServiceIntrospectionState

AddTwoInts = interface_class("example_interfaces/srv/AddTwoInts")
Fibonacci = interface_class("example_interfaces/action/Fibonacci")
Info = interface_class("service_msgs/msg/ServiceEventInfo")
KINDS = [
    Info.REQUEST_SENT,
    Info.REQUEST_RECEIVED,
    Info.RESPONSE_SENT,
    Info.RESPONSE_RECEIVED,
]


def add(request, response):
    response.sum = request.a + request.b
    return response


def configure(node, state, *ends):
    for end in ends:
        end.configure_introspection(node.get_clock(), qos_profile_system_default, state)


@pytest.fixture
def ends(node):
    return node.create_service(AddTwoInts, "add", add), node.create_client(AddTwoInts, "add")


@pytest.fixture
def events(node):
    heard: list[Any] = []
    topic = "add/_service_event"
    node.create_subscription(AddTwoInts.Event, topic, heard.append, QoSProfile(depth=10))
    return heard


def call(executor, client):
    executor.spin_until_future_complete(client.call_async(AddTwoInts.Request(a=2, b=3)), 2)


def hear(executor, events, number):
    while len(events) < number:
        executor.spin_once(timeout_sec=2)


@pytest.mark.parametrize(("state", "length"), [("METADATA", 0), ("CONTENTS", 1)])
def test_both_ends_publish_who_called_when_and_perhaps_what(
    node, executor, ends, events, state, length
):
    configure(node, ServiceIntrospectionState[state], *ends)
    call(executor, ends[1])
    hear(executor, events, 4)
    assert [event.info.event_type for event in events] == KINDS
    assert len({(bytes(e.info.client_gid), e.info.sequence_number) for e in events}) == 1
    assert [len(event.request) for event in events] == [length, length, 0, 0]
    assert [len(event.response) for event in events] == [0, 0, length, length]
    if length:
        assert (events[0].request[0].b, events[3].response[0].sum) == (3, 5)


def test_events_can_be_switched_off_at_either_end(node, executor, ends, events):
    configure(node, ServiceIntrospectionState.METADATA, *ends)
    configure(node, ServiceIntrospectionState.OFF, ends[0])
    call(executor, ends[1])
    hear(executor, events, 2)
    assert [event.info.event_type for event in events] == [KINDS[0], KINDS[3]]


def test_a_destroyed_end_leaves_the_topic(node, ends):
    configure(node, ServiceIntrospectionState.METADATA, *ends)
    assert node.count_publishers("add/_service_event") == 2
    node.destroy_client(ends[1])
    assert node.count_publishers("add/_service_event") == 1


@pytest.mark.parametrize("index", range(4), ids=["service", "client", "server", "action client"])
def test_a_destroyed_entity_cannot_publish_events(node, ends, index):
    actions = ActionServer(node, Fibonacci, "count", print), ActionClient(node, Fibonacci, "count")
    entity = (*ends, *actions)[index]
    entity.destroy()
    with pytest.raises(InvalidHandle):
        configure(node, ServiceIntrospectionState.METADATA, entity)
    topics = ("add/_service_event", "count/_action/send_goal/_service_event")
    assert [node.count_publishers(topic) for topic in topics] == [0, 0]


def test_an_action_publishes_the_calls_of_its_services(node, executor):
    def execute(goal_handle):
        goal_handle.succeed()
        return Fibonacci.Result(sequence=[1])

    server = ActionServer(node, Fibonacci, "count", execute)
    client = ActionClient(node, Fibonacci, "count")
    heard: list[Any] = []
    kind = Fibonacci.Impl.GetResultService.Event
    node.create_subscription(kind, "count/_action/get_result/_service_event", heard.append, 10)
    configure(node, ServiceIntrospectionState.CONTENTS, server, client)
    sent = client.send_goal_async(Fibonacci.Goal(order=1))
    executor.spin_until_future_complete(sent, 2)
    asked = sent.result().get_result_async()
    hear(executor, heard, 4)
    assert asked.done()
    assert [event.info.event_type for event in heard] == KINDS
    assert list(heard[2].response[0].result.sequence) == [1]
