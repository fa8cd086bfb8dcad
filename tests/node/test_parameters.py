"""The parameters of a node: from code, over the six services, and as events."""

from __future__ import annotations

import logging
from contextlib import asynccontextmanager
from typing import Any, NamedTuple

import anyio
import pytest
from anyio.lowlevel import checkpoint

from turtleact import open_node, parameter
from turtleact.errors import InvalidParameter, TurtleactError
from turtleact.interfaces.standard import Time
from turtleact.interfaces.standard.rcl_interfaces.msg import (
    IntegerRange,
    ParameterDescriptor,
    ParameterEvent,
    ParameterValue,
    SetParametersResult,
)
from turtleact.interfaces.standard.rcl_interfaces.msg import Parameter as Message
from turtleact.interfaces.standard.rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from turtleact.node import Node
from turtleact.node.parameters import Parameter
from turtleact.node.topics import Subscription
from turtleact.tasks import wait_until_idle
from turtleact.tasks.clock import EPOCH, VirtualClock
from turtleact.transports import MemoryTransport

# Only readers of changes wait; all else is plain calls.
pytestmark = pytest.mark.loops("asyncio")


class Desk(NamedTuple):
    """What a test works with.

    Attributes:
        node: Whose parameters they are.
        depth: One of its parameters.
        events: What was told of them.
        changes: The values of ``depth`` after each change.
    """

    node: Node
    depth: Parameter[int]
    events: Subscription[ParameterEvent]
    changes: list[int]

    async def call(self, service: Any, *arguments: object) -> Any:
        words = service.__name__.replace("Parameter", "_parameter").replace("Types", "_types")
        name = words.replace("Atomically", "_atomically").lower()
        client = self.node.service_client(service, f"desk/{name}")
        return await client.call(service.Request(*arguments))

    async def set(self, **values):
        parameters = [Message(name.replace("__", "."), value) for name, value in values.items()]
        return (await self.call(SetParameters, parameters)).results


@asynccontextmanager
async def desk():
    async with open_node("desk", transport=MemoryTransport(VirtualClock())) as node:
        changes: list[int] = []
        events = node.subscription(ParameterEvent, "/parameter_events")
        depth = node.parameter("depth", 5, description="How deep", range=(0, 9, 1))
        depth.on_change(changes.append)
        node.parameter("is_open", False, description="Whether")
        node.parameter("pen.red", 1)
        node.parameter("pen.ink.age", 2)
        yield Desk(node, depth, events, changes)


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
        assert (here.depth.value, here.changes) == (7, [7])


async def test_a_value_that_is_refused_changes_nothing():
    async with desk() as here:
        here.events.drain()
        reason = "Parameter {depth} doesn't comply with integer range. It takes 0 to 9, not 10."
        assert await here.set(depth=integer(10)) == [SetParametersResult(reason=reason)]
        assert (here.depth.value, here.changes, here.events.drain()) == (5, [], [])


async def test_of_several_parameters_each_is_set_for_itself():
    async with desk() as here:
        results = await here.set(depth=integer(7), width=integer(1), is_open=boolean(True))
        assert (here.depth.value, here.node.parameter("is_open").value) == (7, True)
    assert [each.successful for each in results] == [True, False, True]
    assert results[1].reason == "parameter 'width' cannot be set because it was not declared"


async def test_set_atomically_sets_all_or_none():
    async with desk() as here:
        bad = [Message("pen.red", integer(3)), Message("depth", integer(99))]
        result = (await here.call(SetParametersAtomically, bad)).result
        assert not result.successful
        assert here.node.parameter("pen.red").value == 1
        good = [Message("pen.red", integer(3)), Message("depth", integer(9))]
        result = (await here.call(SetParametersAtomically, good)).result
        assert result.successful
        assert (here.node.parameter("pen.red").value, here.changes) == (3, [9])


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ([Message("width")], "One or more parameters were not declared before setting"),
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
        [Message("depth", integer(5))],
        [Message("is_open", boolean(False))],
    ]
    assert {event.node for event in events} == {"/desk"}
    assert events[0].stamp == Time(*divmod(EPOCH, 1_000_000_000))


async def test_each_change_is_an_event():
    async with desk() as here:
        here.events.drain()
        await here.set(depth=integer(6), width=integer(1))
        (event,) = here.events.drain()
    assert event.changed_parameters == [Message("depth", integer(6))]
    assert (event.new_parameters, event.deleted_parameters) == ([], [])


# --- from code ------------------------------------------------------------------------------


async def test_an_assignment_is_seen_by_all():
    async with desk() as here:
        here.events.drain()
        here.depth.value = 7
        read = await here.call(GetParameters, ["depth"])
        (event,) = here.events.drain()
    assert (here.depth.value, here.changes, read.values) == (7, [7], [integer(7)])
    assert event.changed_parameters == [Message("depth", integer(7))]


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("depth", 10, "parameter 'depth': it takes 0 to 9, not 10"),
        ("depth", "deep", "parameter 'depth': expected a whole number, not 'deep'"),
        ("fixed", 2, "parameter 'fixed': it is read-only"),
    ],
)
async def test_what_a_program_cannot_assign_is_an_error(name, value, problem):
    async with desk() as here:
        here.node.parameter("fixed", 1, read_only=True)
        with pytest.raises(InvalidParameter, match=f"^{problem}$"):
            here.node.parameter(name).value = value


async def test_a_node_shows_no_parameters_before_the_first():
    async with open_node("lab") as node:
        before = node.graph().services
        node.parameter("x", 1)
        after = node.graph().services
    assert (len(before), len(after)) == (0, 6)


async def test_a_name_alone_finds_a_parameter():
    async with desk() as here:
        assert here.node.parameter("depth") is here.depth
        with pytest.raises(InvalidParameter, match="it is not declared, did you mean 'depth'"):
            here.node.parameter("dept")


async def test_a_declaration_is_declared_once_on_each_node():
    depth = parameter("depth", 5)
    async with open_node("one") as one, open_node("two") as two:
        one.parameter(depth).value = 6
        assert one.parameter(depth) is one.parameter("depth")
        assert (one.parameter(depth).value, two.parameter(depth).value) == (6, 5)


async def test_another_declaration_of_the_name_is_refused():
    async with desk() as here:
        with pytest.raises(InvalidParameter, match="it is declared already"):
            here.node.parameter(parameter("depth", 5))


# --- validation -----------------------------------------------------------------------------


def odd(value):
    if value % 2 == 0:
        raise ValueError("it must be odd")


@pytest.mark.parametrize(
    ("validate", "reason"),
    [
        (odd, "it must be odd"),
        (lambda value: value % 2 == 1, "the node refuses this value"),
        (lambda value: odd(value) or 1 / 0, "it must be odd"),
    ],
)
async def test_the_nodes_own_check_refuses_with_its_reason(validate, reason):
    async with open_node("desk") as node:
        with pytest.raises(InvalidParameter, match=f"^parameter 'n': {reason}$"):
            node.parameter("n", 2, validate=validate)
        if validate is odd:
            n = node.parameter("n", 1, validate=validate)
            with pytest.raises(InvalidParameter, match=f"^parameter 'n': {reason}$"):
                n.value = 4
            client = node.service_client(SetParameters, "desk/set_parameters")
            response = await client.call(SetParameters.Request([Message("n", integer(4))]))
            assert response.results == [SetParametersResult(reason=reason)]
            n.value = 3
            assert n.value == 3


async def test_a_check_that_fails_refuses_and_is_logged(caplog):
    async with open_node("lab") as node:
        with pytest.raises(
            InvalidParameter, match="its 'validate' failed: ZeroDivisionError: division by zero"
        ):
            node.parameter("n", 2, validate=lambda value: value / 0)
    assert [record.message for record in caplog.records] == ["'validate' of parameter 'n' failed"]


# --- changes --------------------------------------------------------------------------------


async def test_a_hook_that_fails_is_logged_and_hinders_no_other(caplog):
    async with desk() as here:
        here.depth.on_change(lambda value: 1 / 0)
        here.depth.on_change(here.changes.append)
        with caplog.at_level(logging.ERROR):
            here.depth.value = 6
        assert here.changes == [6, 6]
    assert [record.message for record in caplog.records] == ["a hook of parameter 'depth' failed"]


async def test_a_hook_sees_all_values_that_were_set_together():
    async with desk() as here:
        seen = []
        here.depth.on_change(lambda _: seen.append(here.node.parameter("pen.red").value))
        both = [Message("depth", integer(6)), Message("pen.red", integer(3))]
        await here.call(SetParametersAtomically, both)
        assert seen == [3]


async def read_into(values, changes):
    async for value in changes:
        values.append(value)
    values.append("end")


@pytest.mark.loops("asyncio", "uvloop", "trio")
async def test_a_reader_gets_each_value_and_ends_with_the_node():
    values: list[object] = []
    async with anyio.create_task_group() as readers, open_node("desk") as node:
        depth = node.parameter("depth", 5)
        readers.start_soon(read_into, values, depth.changes())
        await wait_until_idle()
        for value in (6, 7):
            depth.value = value
            await wait_until_idle()
        assert values == [6, 7]
    assert values == [6, 7, "end"]


async def test_a_reader_that_lags_behind_gets_the_newest_value():
    async with desk() as here:
        changes = here.depth.changes()
        here.depth.value = 6
        here.depth.value = 7
        assert await anext(changes) == 7


# --- the end --------------------------------------------------------------------------------


async def test_undeclaring_is_an_event_and_ends_readers():
    values: list[object] = []
    async with desk() as here, anyio.create_task_group() as readers:
        here.events.drain()
        readers.start_soon(read_into, values, here.depth.changes())
        await checkpoint()
        here.depth.undeclare()
        here.depth.undeclare()
        (event,) = here.events.drain()
        listed = (await here.call(ListParameters)).result.names
    assert event.deleted_parameters == [Message("depth", integer(5))]
    assert "depth" not in listed
    assert values == ["end"]


async def test_what_is_undeclared_keeps_its_last_value_and_takes_no_other():
    async with desk() as here:
        here.depth.undeclare()
        assert (here.depth.value, here.depth.is_declared) == (5, False)
        with pytest.raises(InvalidParameter, match="it is no longer declared"):
            here.depth.value = 6


async def test_a_name_is_free_once_it_is_undeclared():
    async with desk() as here:
        here.depth.undeclare()
        again = here.node.parameter("depth", "deep")
        assert (again.value, here.depth.value, here.depth.is_declared) == ("deep", 5, False)


async def test_a_closed_node_declares_and_sets_nothing():
    async with desk() as here:
        pass
    assert here.depth.value == 5
    for use in (
        lambda: setattr(here.depth, "value", 6),
        lambda: here.node.parameter("more", 1),
        lambda: here.depth.on_change(print),
        here.depth.changes,
    ):
        with pytest.raises(TurtleactError, match="node '/desk' is closed: open another"):
            use()
    here.depth.undeclare()


async def test_a_first_value_of_the_node_replaces_the_declared_one():
    speed = parameter("speed", 1.0, range=(0.0, 2.0), read_only=True)
    async with open_node("lab") as node:
        node.initial_values |= {"speed": 2, "names": [], "depth": "deep"}
        assert node.parameter(speed).value == 2.0
        assert node.parameter(speed).value == 2.0  # found, not declared again
        assert node.parameter("names", ["a"]).value == []
        with pytest.raises(InvalidParameter, match="parameter 'depth': expected a whole number"):
            node.parameter("depth", 1)
        node.initial_values["far"] = 3.0
        with pytest.raises(InvalidParameter, match=r"parameter 'far': it takes 0.0 to 2.0"):
            node.parameter("far", 1.0, range=(0.0, 2.0))
