"""What a node says about the types that it uses, as rcl does: by hash alone, with sources."""

from __future__ import annotations

from contextlib import asynccontextmanager
from typing import Any

import pytest

from turtleact import open_node
from turtleact.interfaces import implied, interface_source, type_hash
from turtleact.interfaces.standard import Fibonacci, GoalStatusArray, Point
from turtleact.interfaces.standard.rcl_interfaces.msg import Parameter
from turtleact.interfaces.standard.type_description_interfaces.srv import GetTypeDescription
from turtleact.interfaces.type_hash import structure_hash
from turtleact.node.learning import offer_descriptions
from turtleact.transports import MemoryTransport

pytestmark = pytest.mark.loops("asyncio")


async def fibonacci(goal):
    return Fibonacci.Result()


@asynccontextmanager
async def asking():
    """A function that asks the node ``/lab`` for the type with a hash."""
    transport = MemoryTransport()
    async with open_node("lab", transport=transport) as lab:
        lab.publisher(Parameter, "parameter")
        lab.action_server(Fibonacci, "fibonacci", fibonacci)
        offer_descriptions(transport, "/lab")
        client = lab.service_client(GetTypeDescription, "/lab/get_type_description")

        async def ask(type_hash: str, **fields: Any) -> Any:
            return await client.call(GetTypeDescription.Request(type_hash=type_hash, **fields))

        yield ask


@pytest.mark.parametrize(
    "known", [Parameter, GoalStatusArray, implied(Fibonacci).get_result, Fibonacci]
)
async def test_a_type_in_use_is_described_by_its_hash_alone(known):
    async with asking() as ask:
        response = await ask(type_hash(known), type_name="something/msg/Else")
        assert response.type_description.type_description.type_name == known.type_name
        assert structure_hash(response.type_description) == type_hash(known)


async def test_a_type_that_is_known_here_but_not_used_by_the_node_is_not_described():
    async with asking() as ask:
        response = await ask(type_hash(Point), type_name=Point.type_name)
        assert not response.successful
        assert response.failure_reason == "Type not currently in use by this node"


@pytest.mark.parametrize("malformed", ["", "RIHS01_0", "RIHS02_" + "0" * 64])
async def test_a_hash_that_is_none_is_refused_in_rcls_words(malformed):
    async with asking() as ask:
        response = await ask(malformed, type_name=Parameter.type_name)
        assert (response.successful, response.failure_reason) == (
            False,
            "Failed to parse type hash",
        )


async def test_an_action_comes_with_its_text_and_what_ros_derives_comes_without():
    async with asking() as ask:
        response = await ask(type_hash(Fibonacci))
        sources = {each.type_name: each for each in response.type_sources}
        assert len(sources) == 16
        assert response.type_sources[0].encoding == "action"
        assert response.type_sources[0].raw_file_contents == interface_source(Fibonacci.type_name)
        goal = sources[f"{Fibonacci.type_name}_Goal"]
        assert (goal.encoding, goal.raw_file_contents) == ("implicit", "")
        assert sources["unique_identifier_msgs/msg/UUID"].encoding == "msg"


async def test_sources_are_left_out_unless_asked_for():
    async with asking() as ask:
        response = await ask(type_hash(Parameter), include_type_sources=False)
        assert response.successful
        assert not response.type_sources
