"""Definitions as flat fields: the same from a class and from what a node says about it."""

from __future__ import annotations

from typing import Any

import pytest

import turtleact
from turtleact.doctor.snapshot import described_fields, own_fields
from turtleact.interfaces import get_interface, implied, load_interface, type_hash
from turtleact.interfaces.standard import GoalStatusArray, Point
from turtleact.node.type_descriptions import GET_TYPE_DESCRIPTION, TYPE_HASH, offer_descriptions
from turtleact.transports import MemoryTransport

from ..lab import Count


def test_fields_are_flat_with_their_types():
    assert own_fields(Point) == {"x": "float64", "y": "float64", "z": "float64"}


def test_lists_and_the_parts_of_services_are_in_the_path():
    assert own_fields(implied(Count).send_goal) == {
        "request.goal_id.uuid[]": "uint8[16]",
        "request.goal.upto": "int32",
        "response.accepted": "bool",
        "response.stamp.sec": "int32",
        "response.stamp.nanosec": "uint32",
    }


def test_bounds_belong_to_the_type():
    text = "string<=5 short\nstring[<=3] few\nint8[2] two\nwstring[] wide\n"
    mixed: Any = load_interface(text, type_name="lab_interfaces/msg/Mixed")
    assert own_fields(mixed) == {
        "short": "string<=5",
        "few[]": "string[<=3]",
        "two[]": "int8[2]",
        "wide[]": "wstring[]",
    }


@pytest.mark.parametrize("known", [Point, GoalStatusArray, implied(Count).get_result])
async def test_a_node_describes_a_type_as_it_is_here(known):
    service: Any = get_interface(GET_TYPE_DESCRIPTION)
    async with turtleact.open_node("asker", transport=MemoryTransport()) as node:
        offer_descriptions(node.transport, "/lab")
        client = node.service_client(service, "/lab/get_type_description")
        response: Any = await client.call(service.Request(type_name=known.type_name))
        assert described_fields(response.type_description) == own_fields(known)
        for wrong in (("x/msg/Y", ""), (known.type_name, "RIHS01_0")):
            refused: Any = await client.call(service.Request(*wrong))
            assert not refused.successful
            assert refused.failure_reason


def test_the_hash_that_is_written_down_is_that_of_the_service():
    assert type_hash(get_interface(GET_TYPE_DESCRIPTION)) == TYPE_HASH
