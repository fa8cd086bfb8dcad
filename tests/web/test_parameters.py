"""Parameters: the clients' own, and those of the nodes on the graph."""

from __future__ import annotations

from typing import Any

import pytest

import turtleact
from turtleact.errors import InvalidMessage, ServerUnavailable
from turtleact.interfaces import get_interface
from turtleact.web.shared import BridgeState, Limits

SetBool: Any = get_interface("std_srvs/srv/SetBool")


@pytest.fixture
async def node():
    async with turtleact.open_node("lab") as node:
        yield node


@pytest.fixture
async def rosapi(node):
    shared = BridgeState(node, Limits(), cancel_on_disconnect=False)
    yield shared.rosapi
    await shared.aclose()


async def test_a_parameter_is_set_read_and_deleted(rosapi):
    name = {"name": "/speed"}
    assert await rosapi.call("/rosapi/has_param", name) == {"exists": False}
    assert (await rosapi.call("/rosapi/set_param", name | {"value": "1.5"}))["successful"]
    assert await rosapi.call("/rosapi/has_param", name) == {"exists": True}
    assert await rosapi.call("/rosapi/get_param", name) == {"value": "1.5", "successful": True}
    assert await rosapi.call("/rosapi/get_param_names", {}) == {"names": ["/speed"]}
    assert (await rosapi.call("/rosapi/delete_param", name))["successful"]
    assert not (await rosapi.call("/rosapi/delete_param", name))["successful"]
    assert await rosapi.call("/rosapi/get_param_names", {}) == {"names": []}


async def test_a_parameter_that_is_not_set_has_its_default(rosapi):
    assert (await rosapi.call("/rosapi/get_param", ["/speed", "2"]))["value"] == "2"
    assert (await rosapi.call("/rosapi/get_param", ["/speed"]))["value"] == "null"


# those of nodes


@pytest.fixture
async def lamp(node):
    """A node's parameters: those of turtlesim are of these kinds."""
    red = node.parameter("red", 69, description="how much red", range=(0, 255))
    node.parameter("is.on", True, description="whether it is on")
    return red


async def test_a_parameter_of_a_node_is_read(rosapi, lamp):
    assert await rosapi.call("/rosapi/get_param", ["/lab:red"]) == {
        "value": "69",
        "successful": True,
    }
    assert (await rosapi.call("/rosapi/get_param", ["lab:is.on"]))["value"] == "true"
    assert (await rosapi.call("/rosapi/has_param", ["/lab:red"]))["exists"]


async def test_a_parameter_of_a_node_is_set(rosapi, node, lamp):
    assert (await rosapi.call("/rosapi/set_param", ["/lab:red", "7"]))["successful"]
    assert (await rosapi.call("/rosapi/set_param", ["/lab:is.on", "false"]))["successful"]
    assert (lamp.value, node.parameter("is.on").value) == (7, False)


async def test_the_parameters_of_all_nodes_are_listed(rosapi, node, lamp):
    await rosapi.call("/rosapi/set_param", ["/speed", "1"])
    node.service(SetBool, "/other/list_parameters", lambda request: SetBool.Response())
    names = await rosapi.call("/rosapi/get_param_names", {})
    assert names == {"names": ["/speed", "/lab:is.on", "/lab:red"]}


async def test_a_node_that_fails_is_left_out_of_the_list(rosapi, node, lamp, caplog):
    node.service(
        get_interface("rcl_interfaces/srv/ListParameters"), "/b/list_parameters", lambda r: 1 / 0
    )
    names = await rosapi.call("/rosapi/get_param_names", {})
    assert names == {"names": ["/lab:is.on", "/lab:red"]}
    assert "parameters are left out: service '/b/list_parameters'" in caplog.text


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("red", "256", "doesn't comply with integer range"),
        ("red", '"much"', "setting it to {string} is not allowed"),
        ("red", "null", "cannot undeclare a statically typed parameter"),
        ("green", "1", "cannot be set because it was not declared"),
    ],
)
async def test_the_node_says_why_a_parameter_cannot_be_set(rosapi, lamp, name, value, reason):
    values = await rosapi.call("/rosapi/set_param", [f"/lab:{name}", value])
    assert not values["successful"]
    assert reason in values["reason"]
    assert lamp.value == 69


async def test_a_parameter_that_a_node_has_not_does_not_exist(rosapi, lamp):
    assert await rosapi.call("/rosapi/has_param", ["/lab:green"]) == {"exists": False}
    assert (await rosapi.call("/rosapi/get_param", ["/lab:green", "3"]))["value"] == "3"
    assert not (await rosapi.call("/rosapi/delete_param", ["/lab:green"]))["successful"]
    refused = await rosapi.call("/rosapi/delete_param", ["/lab:red"])
    assert refused["reason"] == "cannot undeclare a statically typed parameter"


async def test_a_node_without_parameters_is_an_error(rosapi):
    with pytest.raises(ServerUnavailable, match="/lab/get_parameters"):
        await rosapi.call("/rosapi/get_param", ["/lab:red"])


async def test_a_parameter_is_json(rosapi, lamp):
    with pytest.raises(InvalidMessage, match=r"args.value: expected a value as JSON text"):
        await rosapi.call("/rosapi/set_param", ["/lab:red", "seven"])
    with pytest.raises(InvalidMessage, match=r"args.value: expected true, false, a number, text"):
        await rosapi.call("/rosapi/set_param", ["/lab:red", '{"a": 1}'])
    with pytest.raises(InvalidMessage, match=r"args.value: expected true, false, a number, text"):
        await rosapi.call("/rosapi/set_param", ["/lab:red", '[1, "a"]'])
