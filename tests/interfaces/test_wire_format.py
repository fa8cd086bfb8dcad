"""What an endpoint is given to write and read bytes with."""

from __future__ import annotations

import pytest

from turtleact.errors import InvalidMessage
from turtleact.interfaces import (
    GOAL_ID,
    Action,
    FeedbackFormat,
    Message,
    Service,
    WireFormat,
    float64,
    implied,
    int32,
    string,
    type_hash,
)
from turtleact.interfaces.standard import UUID, Time


class Sum(Service, type_name="lab_interfaces/srv/Sum"):
    """Adds up."""

    class Request(Message):
        numbers: list[int32] = []

    class Response(Message):
        total: int32 = 0


STAMP = bytes.fromhex("00010000 01000000 02000000")
REQUEST = Sum.Request(numbers=[1, 2])
RESPONSE = Sum.Response(total=3)


def test_a_message_is_written_and_read():
    time = WireFormat(Time)
    assert time.encode(Time(sec=1, nanosec=2)) == STAMP
    assert time.decode(STAMP) == Time(sec=1, nanosec=2)


def test_a_server_reads_requests_and_writes_responses_and_a_client_the_other_way_round():
    server, client = WireFormat(Sum), WireFormat(Sum, asks=True)
    assert server.decode(client.encode(REQUEST)) == REQUEST
    assert client.decode(server.encode(RESPONSE)) == RESPONSE


@pytest.mark.parametrize("interface", [Time, Sum])
def test_its_hash_is_that_of_the_whole_interface(interface):
    assert WireFormat(interface).type_hash == type_hash(interface)


def test_a_message_of_another_class_is_refused():
    with pytest.raises(InvalidMessage) as caught:
        WireFormat(Sum).encode(REQUEST)
    assert str(caught.value) == (
        "message: expected lab_interfaces/srv/Sum_Response, not lab_interfaces/srv/Sum_Request"
    )


def test_bytes_without_a_header_are_refused():
    class Nothing(Message, type_name="lab_interfaces/msg/Nothing"):
        """No fields."""

    for data in (b"", STAMP[:3]):
        with pytest.raises(InvalidMessage, match="header"):
            WireFormat(Nothing).decode(data)


# --- feedback -------------------------------------------------------------------------------


class Walk(Action, type_name="lab_interfaces/action/Walk"):
    """Its feedback has a value of each alignment."""

    class Feedback(Message):
        steps: list[int32] = []
        way: float64 = 0.0
        place: string = ""


GOAL = bytes(range(16))
FORMAT = FeedbackFormat(Walk)
WALKS = [
    Walk.Feedback(),
    Walk.Feedback(steps=[1, -2], way=2.5),
    Walk.Feedback(steps=[3], way=-0.5, place="h\u00fctte"),
]


def whole(feedback: Walk.Feedback) -> Message:
    """The message around feedback."""
    return implied(Walk).feedback_message(UUID(GOAL), feedback)


@pytest.mark.parametrize("feedback", WALKS)
def test_feedback_is_written_by_itself_as_the_whole_message_is(feedback):
    assert FORMAT.write(GOAL, feedback) == FORMAT.encode(whole(feedback))


@pytest.mark.parametrize("feedback", WALKS)
def test_feedback_is_read_by_itself(feedback):
    data = FORMAT.encode(whole(feedback))
    assert (data[GOAL_ID], FORMAT.read(data)) == (GOAL, feedback)


def test_feedback_is_read_in_the_other_byte_order_too():
    data = "00000000" + GOAL.hex() + "00000001 00000007 4004000000000000 00000002 6100"
    assert FORMAT.read(bytes.fromhex(data)) == Walk.Feedback(steps=[7], way=2.5, place="a")


def test_feedback_that_does_not_fit_is_told_with_its_path_in_the_whole_message():
    with pytest.raises(InvalidMessage, match=r"message\.feedback\.steps\[0\]: "):
        FORMAT.write(GOAL, Walk.Feedback(steps=[1 << 31]))


def test_feedback_that_is_cut_off_is_refused():
    with pytest.raises(InvalidMessage, match=r"these 26 bytes are not of type .*Walk_Feedback"):
        FORMAT.read(FORMAT.write(GOAL, WALKS[1])[:26])
