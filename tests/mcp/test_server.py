"""Actions as tools: lists, calls, progress, cancellation, reasons, confirmation, limits."""

from __future__ import annotations

import base64
import functools
import json

import anyio
import jsonschema
import pytest
from mcp import MCPError
from mcp.types import ElicitResult, ToolListChangedNotification

from turtleact import QoS, open_world
from turtleact.interfaces.standard import Fibonacci, Point
from turtleact.interfaces.standard.example_interfaces.srv import AddTwoInts
from turtleact.mcp import Limits, open_mcp
from turtleact.sim.pictures import to_png

from .line import FOREVER, MODES, client_of, connect, open_lab, serve, text_of

SQUARE = [{"x": x, "y": y} for x, y in ((5, 5), (7, 5), (7, 7), (5, 7), (5, 5))]


# tools


@pytest.mark.parametrize("mode", MODES)
async def test_an_offered_action_is_a_tool_with_schemas(mode):
    async with connect(mode) as (_, client):
        tools = {tool.name: tool for tool in (await client.list_tools()).tools}
        count = tools["count"]
        assert count.input_schema["required"] == ["order"]
        assert "sequence" in count.output_schema["properties"]["result"]["properties"]
        assert "/count" in count.description
        for tool in tools.values():
            jsonschema.Draft202012Validator.check_schema(tool.input_schema)


async def test_nothing_is_offered_that_is_not_named():
    async with connect(actions=()) as (_, client):
        names = {tool.name for tool in (await client.list_tools()).tools}
        assert "count" not in names
        reply = await client.call_tool("count", {"order": 1})
        assert reply.is_error
        assert "there is no tool 'count'" in text_of(reply)


async def test_read_only_offers_only_what_changes_nothing():
    async with connect(actions="all", topics="all", read_only=True) as (_, client):
        tools = (await client.list_tools()).tools
        assert {tool.name for tool in tools} == {"list_goals", "read_topic", "take_picture"}
        assert all(tool.annotations.read_only_hint for tool in tools)
        assert (await client.call_tool("count", {"order": 1})).is_error


# calls


@pytest.mark.loops("asyncio", "trio")
@pytest.mark.parametrize("mode", MODES)
async def test_a_call_reports_progress_that_grows_and_gives_the_result(mode):
    told = []

    async def hear(progress, total, message):
        told.append((progress, message))

    async with connect(mode) as (_, client):
        reply = await client.call_tool("count", {"order": 6}, progress_callback=hear)
    assert reply.structured_content["result"] == {"sequence": [0, 1, 2, 3, 4, 5]}
    numbers = [number for number, _ in told]
    assert len(numbers) == 6
    assert numbers == sorted(set(numbers))
    assert told[-1][1] == "partial_sequence: [5]"


async def test_fast_feedback_is_thinned_out_and_the_newest_is_told():
    told = []

    async def hear(progress, total, message):
        told.append(progress)

    async with connect(limits=Limits(progress_rate=0.001)) as (_, client):
        await client.call_tool("count", {"order": 500}, progress_callback=hear)
    assert len(told) < 200
    assert told == sorted(set(told))
    assert told[-1] == 500


@pytest.mark.loops("asyncio", "trio")
@pytest.mark.parametrize("mode", MODES)
async def test_a_cancelled_call_cancels_its_goal_and_waits_for_its_end(mode):
    async with connect(mode) as (lab, client):
        async with anyio.create_task_group() as calling:
            calling.start_soon(client.call_tool, "count", {"order": 0})
            await lab.started.wait()
            calling.cancel_scope.cancel()
        status = "EXECUTING"
        while status in ("EXECUTING", "CANCELING"):
            [goal] = (await client.call_tool("list_goals", {})).structured_content["goals"]
            status = goal["status"]
        assert status == "CANCELED"
        assert lab.ended == ["cancelled"]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"order": 1001}, "the goal was rejected: the order is more than 1000"),
        ({"order": -1}, "the goal was aborted: the arm is stuck at joint 3"),
        ({"order": "3"}, "goal.order: expected a whole number (int32), got '3'"),
        ({"ordr": 3}, "goal: unknown field 'ordr', did you mean 'order'?"),
    ],
)
async def test_a_reason_reaches_the_model_word_for_word(arguments, text):
    async with connect() as (_, client):
        reply = await client.call_tool("count", arguments)
        assert reply.is_error
        assert text_of(reply) == text


@pytest.mark.loops("asyncio", "trio")
async def test_a_flood_of_goals_meets_a_limit_that_says_what_to_do():
    async with connect(limits=Limits(goals=1)) as (lab, client):
        async with anyio.create_task_group() as calling:
            calling.start_soon(client.call_tool, "count", {"order": 0})
            await lab.started.wait()
            reply = await client.call_tool("count", {"order": 1})
            calling.cancel_scope.cancel()
        assert "which is the limit: wait until one has ended" in text_of(reply)
        assert not (await client.call_tool("count", {"order": 1})).is_error


# servers that come and go


@pytest.mark.loops("asyncio", "trio")
async def test_a_server_that_goes_ends_its_calls_with_the_reason():
    replies = []
    async with open_lab(actions=["/again"]) as (lab, node, server), client_of(server) as client:
        action = serve(node, lab, "/again")

        async def call():
            replies.append(await client.call_tool("again", {"order": 0}))

        async with anyio.create_task_group() as calling:
            calling.start_soon(call)
            await lab.started.wait()
            await action.aclose()
        assert text_of(replies[0]) == "the goal was aborted: shutdown"
        gone = await client.call_tool("again", {"order": 1})
        assert "the server of its action may have gone" in text_of(gone)
        serve(node, lab, "/again")
        assert not (await client.call_tool("again", {"order": 1})).is_error


async def test_an_older_client_is_told_when_the_tools_change():
    changed = anyio.Event()

    async def hear(message):
        if isinstance(message, ToolListChangedNotification):
            changed.set()

    async with (
        open_lab(actions="all") as (lab, node, server),
        client_of(server, mode="legacy", message_handler=hear) as client,
    ):
        await client.list_tools()
        serve(node, lab, "/again")
        await changed.wait()
        assert "again" in {tool.name for tool in (await client.list_tools()).tools}


@pytest.mark.loops("asyncio", "trio")
async def test_a_newer_client_that_listens_is_told_when_the_tools_change():
    async with (
        open_lab(actions="all") as (lab, node, server),
        client_of(server) as client,
        client.listen(tools_list_changed=True) as events,
    ):
        serve(node, lab, "/again")
        assert type(await anext(aiter(events))).__name__ == "ToolsListChanged"


# goals of others, services, topics, pictures


async def test_a_goal_can_be_cancelled_by_its_id():
    async with (
        open_lab() as (lab, node, server),
        client_of(server) as client,
        sender(node).send_goal(zero()) as handle,
    ):
        await lab.started.wait()
        [goal] = (await client.call_tool("list_goals", {})).structured_content["goals"]
        assert goal | {"accepted": ""} == {
            "goal_id": handle.goal_id.hex(),
            "action": "/count",
            "status": "EXECUTING",
            "accepted": "",
        }
        reply = await client.call_tool("cancel_goal", {"goal_id": goal["goal_id"]})
        assert reply.structured_content["status"] == "CANCELED"


async def test_all_goals_can_be_cancelled_at_once():
    async with (
        open_lab() as (lab, node, server),
        client_of(server) as client,
        sender(node).send_goal(zero()),
        sender(node).send_goal(zero()),
    ):
        await lab.started.wait()
        reply = await client.call_tool("cancel_all_goals", {})
    assert [goal["status"] for goal in reply.structured_content["goals"]] == ["CANCELED"] * 2


@pytest.mark.loops("asyncio", "trio")
async def test_a_goal_can_be_paused_and_resumed():
    async with (
        open_lab() as (lab, node, server),
        client_of(server) as client,
        sender(node).send_goal(Fibonacci.Goal(FOREVER)) as handle,
    ):
        await lab.started.wait()
        arguments = {"goal_id": handle.goal_id.hex()}
        reply = await client.call_tool("pause_goal", arguments)
        assert reply.is_error is False, text_of(reply)
        assert handle.is_paused
        await client.call_tool("resume_goal", arguments)
        assert not handle.is_paused


@pytest.mark.parametrize(
    ("tool", "arguments", "text"),
    [
        ("cancel_goal", {"goal_id": "ab" * 16}, "no server of an offered action holds"),
        ("cancel_goal", {"goalid": "ab"}, "did you mean 'goal_id'?"),
        ("cancel_goal", {"goal_id": 3}, "cancel_goal.goal_id: expected text, got 3"),
        ("cancel_goal", {}, "cancel_goal.goal_id: it is missing"),
        ("list_goals", {"x": ""}, "it takes nothing"),
        ("take_picture", {}, "no world of turtles is on this graph"),
        ("read_topic", {"topic": "/places"}, "topic '/places' is not offered"),
    ],
)
async def test_the_other_tools_say_what_is_wrong(tool, arguments, text):
    async with connect(topics=["/place"]) as (_, client):
        reply = await client.call_tool(tool, arguments)
        assert reply.is_error
        assert text in text_of(reply)


async def test_an_allowed_service_is_a_tool():
    async with open_lab(services=["/add"]) as (_, node, server), client_of(server) as client:
        node.service(AddTwoInts, "/add", lambda r: AddTwoInts.Response(r.a + r.b))
        reply = await client.call_tool("add", {"a": 2, "b": 3})
        assert reply.structured_content == {"sum": 5}


async def test_a_topic_can_be_read_but_no_tool_writes_one():
    offer = {"topics": ["/place"]}
    async with open_lab(**offer) as (_, node, server), client_of(server) as client:
        place = node.publisher(Point, "/place", QoS(durability="transient_local"))
        place.publish(Point(x=4.0))
        reply = await client.call_tool("read_topic", {"topic": "/place"})
        assert reply.structured_content == {"x": 4.0, "y": 0.0, "z": 0.0}
        read = await client.read_resource("ros://topic/place")
        assert json.loads(read.contents[0].text)["x"] == 4.0
        assert not [t for t in (await client.list_tools()).tools if "publish" in t.name]


async def test_a_resource_that_is_not_there_is_an_error():
    async with connect() as (_, client):
        with pytest.raises(MCPError, match="there is no resource ros://nothing"):
            await client.read_resource("ros://nothing")


async def test_goals_are_a_resource():
    async with connect() as (_, client):
        uris = [str(each.uri) for each in (await client.list_resources()).resources]
        assert uris == ["ros://goals", "ros://world.png"]
        read = await client.read_resource("ros://goals")
        assert json.loads(read.contents[0].text) == {"goals": []}
        templates = (await client.list_resource_templates()).resource_templates
        assert [each.name for each in templates] == ["topic"]


# confirmation


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("action", "is_error"), [("accept", False), ("decline", True)])
async def test_the_user_is_asked_before_a_goal(mode, action, is_error):
    asked = []

    async def answer(_, params):
        asked.append(params.message)
        return ElicitResult(action=action, content={})

    options = {"elicitation_callback": answer}
    async with connect(mode, client=options, confirm=True) as (_, client):
        reply = await client.call_tool("count", {"order": 2})
    assert asked == ['Send this goal to /count?\n{"order": 2}']
    assert reply.is_error is is_error
    if is_error:
        assert "the user did not confirm this (decline)" in text_of(reply)


async def test_a_client_that_cannot_ask_its_user_sends_nothing():
    async with connect(confirm=True) as (lab, client):
        reply = await client.call_tool("count", {"order": 2})
        assert "the client cannot ask its user" in text_of(reply)
        assert not lab.started.is_set()


@pytest.mark.loops("asyncio", "trio")
async def test_a_confirmation_is_good_for_one_call_with_the_same_arguments():
    async def answer(_, params):
        raise AssertionError("the test answers itself")

    async with connect(client={"elicitation_callback": answer}, confirm=True) as (_, client):
        ask = functools.partial(client.session.call_tool, "count", allow_input_required=True)
        asked = await ask({"order": 2})
        given = {
            "input_responses": {"confirm": ElicitResult(action="accept", content={})},
            "request_state": asked.request_state,
        }
        other = await ask({"order": 3}, **given)
        assert "does not belong to this call" in text_of(other)
        again = await ask({"order": 2}, **given)
        assert "was used before" in text_of(again)


# a world


async def test_a_client_that_knows_only_the_schemas_drives_a_square_and_sees_it(tmp_path):
    async with (
        open_world(speed="max") as node,
        open_mcp(node, actions=["/patrol"]) as server,
        client_of(server) as client,
    ):
        [patrol] = [tool for tool in (await client.list_tools()).tools if tool.name == "patrol"]
        told = []

        async def hear(progress, total, message):
            told.append(progress)

        [places] = patrol.input_schema["required"]
        arguments = {places: SQUARE}
        jsonschema.validate(arguments, patrol.input_schema)
        reply = await client.call_tool("patrol", arguments, progress_callback=hear)
        assert reply.structured_content["result"]["reached"] == 5
        assert len(told) >= 5
        [picture] = (await client.call_tool("take_picture", {})).content
        world = node.snapshot()
    assert picture.mime_type == "image/png"
    assert base64.b64decode(picture.data) == to_png(world)


def sender(node):
    """A client of the lab's action that is not a model."""
    return node.action_client(Fibonacci, "/count")


def zero():
    """A goal that runs until it is canceled."""
    return Fibonacci.Goal(0)
