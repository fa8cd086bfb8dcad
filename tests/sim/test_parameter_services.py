"""The parameter services, in rclcpp's words."""

from __future__ import annotations

from contextlib import asynccontextmanager
from typing import Any, NamedTuple

import pytest

from turtleact.clock import EPOCH, VirtualClock
from turtleact.errors import InvalidOption
from turtleact.interfaces.standard import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    IntegerRange,
    ListParameters,
    Parameter,
    ParameterDescriptor,
    ParameterEvent,
    ParameterValue,
    SetParameters,
    SetParametersAtomically,
    SetParametersResult,
    Time,
)
from turtleact.node import Node, open_node
from turtleact.sim.parameter_services import Parameters
from turtleact.topics import Subscription
from turtleact.transports import MemoryTransport


class Desk(NamedTuple):
    """What a test works with.

    Attributes:
        node: Whose parameters they are.
        parameters: What is tested.
        events: What was told of them.
        changes: The values of ``depth`` after each change.
    """

    node: Node
    parameters: Parameters
    events: Subscription[ParameterEvent]
    changes: list[int]

    async def call(self, service: Any, *arguments: object) -> Any:
        words = service.__name__.replace("Parameter", "_parameter").replace("Types", "_types")
        name = words.replace("Atomically", "_atomically").lower()
        client = self.node.service_client(service, f"desk/{name}")
        return await client.call(service.Request(*arguments))

    async def set(self, **values):
        parameters = [Parameter(name.replace("__", "."), value) for name, value in values.items()]
        return (await self.call(SetParameters, parameters)).results


@asynccontextmanager
async def desk():
    async with open_node("desk", transport=MemoryTransport(VirtualClock())) as node:
        changes: list[int] = []
        events = node.subscription(ParameterEvent, "/parameter_events")
        parameters = Parameters(node, lambda: changes.append(parameters["depth"]))
        parameters.declare("depth", 5, "How deep", (0, 9))
        parameters.declare("is_open", False, "Whether")
        parameters.declare("pen.red", 1, "Red")
        parameters.declare("pen.ink.age", 2, "Age")
        yield Desk(node, parameters, events, changes)


def integer(value):
    return ParameterValue(2, integer_value=value)


def boolean(value):
    return ParameterValue(1, bool_value=value)


async def test_values_are_given_in_the_order_of_the_names():
    async with desk() as here:
        read = await here.call(GetParameters, ["is_open", "depth"])
        types = await here.call(GetParameterTypes, ["is_open", "depth"])
    assert read.values == [boolean(False), integer(5)]
    assert types.types == [1, 2]


@pytest.mark.parametrize(
    ("service", "field"),
    [
        (GetParameters, "values"),
        (GetParameterTypes, "types"),
        (DescribeParameters, "descriptors"),
    ],
)
async def test_of_a_parameter_that_is_not_declared_nothing_is_said_nor_of_its_company(
    service, field
):
    async with desk() as here:
        response = await here.call(service, ["depth", "width"])
    assert len(getattr(response, field)) == 0


async def test_a_parameter_is_described():
    async with desk() as here:
        described = await here.call(DescribeParameters, ["depth", "is_open"])
    assert described.descriptors == [
        ParameterDescriptor("depth", 2, "How deep", integer_range=[IntegerRange(0, 9, 1)]),
        ParameterDescriptor("is_open", 1, "Whether"),
    ]


ALL = ["depth", "is_open", "pen.ink.age", "pen.red"]


@pytest.mark.parametrize(
    ("prefixes", "depth", "names", "groups"),
    [
        ([], 0, ALL, ["pen.ink", "pen"]),
        ([], 1, ["depth", "is_open"], []),
        ([], 2, ["depth", "is_open", "pen.red"], ["pen"]),
        (["pen"], 0, ["pen.ink.age", "pen.red"], ["pen.ink", "pen"]),
        (["pen"], 1, ["pen.red"], ["pen"]),
        (["pen.red", "depth"], 0, ["depth", "pen.red"], ["pen"]),
        (["pe"], 0, [], []),
    ],
)
async def test_parameters_are_listed_by_prefix_and_depth(prefixes, depth, names, groups):
    async with desk() as here:
        result = (await here.call(ListParameters, prefixes, depth)).result
    assert (result.names, result.prefixes) == (names, groups)


async def test_a_parameter_is_set_and_its_owner_told():
    async with desk() as here:
        assert await here.set(depth=integer(7)) == [SetParametersResult(successful=True)]
        assert (here.parameters["depth"], here.changes) == (7, [7])


REFUSED = [
    (integer(10), "Parameter {depth} doesn't comply with integer range."),
    (integer(-1), "Parameter {depth} doesn't comply with integer range."),
    (
        boolean(True),
        "Wrong parameter type, parameter {depth} is of type {integer}, setting it to {bool} is not"
        " allowed.",
    ),
    (
        ParameterValue(99),
        "Wrong parameter type, parameter {depth} is of type {integer}, setting it to"
        " {unknown type 99} is not allowed.",
    ),
    (ParameterValue(), "cannot undeclare a statically typed parameter"),
]


@pytest.mark.parametrize(("value", "reason"), REFUSED, ids=[reason[:30] for _, reason in REFUSED])
async def test_what_a_parameter_cannot_be_is_refused_in_rclcpps_words(value, reason):
    async with desk() as here:
        assert await here.set(depth=value) == [SetParametersResult(reason=reason)]
        assert (here.parameters["depth"], here.changes) == (5, [])


async def test_of_several_parameters_each_is_set_for_itself():
    async with desk() as here:
        results = await here.set(depth=integer(7), width=integer(1), is_open=boolean(True))
        assert (here.parameters["depth"], here.parameters["is_open"]) == (7, True)
    assert [each.successful for each in results] == [True, False, True]
    assert results[1].reason == "parameter 'width' cannot be set because it was not declared"


async def test_set_atomically_sets_all_or_none():
    async with desk() as here:
        bad = [Parameter("pen.red", integer(3)), Parameter("depth", integer(99))]
        result = (await here.call(SetParametersAtomically, bad)).result
        assert not result.successful
        assert here.parameters["pen.red"] == 1
        good = [Parameter("pen.red", integer(3)), Parameter("depth", integer(9))]
        result = (await here.call(SetParametersAtomically, good)).result
        assert result.successful
        assert (here.parameters["pen.red"], here.changes) == (3, [9])


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ([Parameter("width")], "One or more parameters were not declared before setting"),
        ([], "parameter list cannot be empty, this might be due to"),
    ],
)
async def test_set_atomically_says_what_is_wrong_with_the_list(parameters, reason):
    async with desk() as here:
        result = (await here.call(SetParametersAtomically, parameters)).result
    assert not result.successful
    assert result.reason.startswith(reason)


async def test_each_declaration_is_an_event():
    async with desk() as here:
        events = here.events.drain()
    declared = [event.new_parameters for event in events]
    assert declared[:2] == [
        [Parameter("depth", integer(5))],
        [Parameter("is_open", boolean(False))],
    ]
    assert {event.node for event in events} == {"/desk"}
    assert events[0].stamp == Time(*divmod(EPOCH, 1_000_000_000))


async def test_each_change_is_an_event():
    async with desk() as here:
        here.events.drain()
        await here.set(depth=integer(6), width=integer(1))
        (event,) = here.events.drain()
    assert event.changed_parameters == [Parameter("depth", integer(6))]
    assert (event.new_parameters, event.deleted_parameters) == ([], [])


async def test_a_parameter_is_declared_once_and_within_its_bounds():
    async with desk() as here:
        with pytest.raises(InvalidOption, match="this parameter is declared already"):
            here.parameters.declare("depth", 1, "Again")
        with pytest.raises(InvalidOption, match="doesn't comply with integer range"):
            here.parameters.declare("height", 10, "Too high", (0, 9))
