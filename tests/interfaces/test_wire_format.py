"""What an endpoint is given to write and read bytes with."""

from __future__ import annotations

import pytest

from turtleact.errors import InvalidInterface, InvalidMessage
from turtleact.interfaces import Message, Service, WireFormat, int32, type_hash
from turtleact.interfaces.standard import Time


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


def test_the_class_is_looked_up_once_and_only_when_needed():
    asked = []

    def find() -> type[Time]:
        asked.append(1)
        return Time

    time = WireFormat(find)
    assert asked == []
    time.decode(time.encode(Time()))
    assert time.type_hash
    assert asked == [1]


def test_a_message_of_another_class_is_refused():
    with pytest.raises(InvalidMessage) as caught:
        WireFormat(Sum).encode(REQUEST)
    assert str(caught.value) == ("message: expected lab_interfaces/srv/Sum_Response, not Request")


def test_a_value_that_does_not_fit_is_refused_by_its_path():
    with pytest.raises(InvalidMessage, match="sec"):
        WireFormat(Time).encode(Time(sec="one"))  # type: ignore[arg-type]  # that is the test


def test_bytes_that_hold_no_message_are_refused():
    with pytest.raises(InvalidMessage, match="nanosec"):
        WireFormat(Time).decode(STAMP[:8])


def test_a_class_without_a_name_has_no_hash():
    class Bare(Message):
        number: int32 = 0

    with pytest.raises(InvalidInterface):
        _ = WireFormat(Bare).type_hash
