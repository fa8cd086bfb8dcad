"""What pages get from the bridge: goals of all actions, trails, the graph and forms."""

from __future__ import annotations

from typing import Any

import pytest

import turtleact
from turtleact import GoalResponse, open_world
from turtleact.interfaces import WireFormat
from turtleact.interfaces.standard import (
    UUID,
    Empty,
    GoalInfo,
    GoalStatusArray,
    GoalStatusMessage,
    SetPen,
    Time,
    TurtlePose,
)
from turtleact.sim.pictures import hue_of
from turtleact.transports import MemoryTransport, QoS, open_zenoh
from turtleact.transports.base import Endpoint, ServiceHandler
from turtleact.web import open_bridge
from turtleact.web.page_history import MOST_ACTIVE, MOST_ENDED

from ..lab import Count, Gate, count, goal, settle
from .line import Line, bridged, line

TYPE = "lab_interfaces/action/Count"
Values = dict[str, Any]


async def watch(client: Line, **args: object) -> Values:
    answer = await client.call("/turtleact/web/watch", args=args)
    assert answer["result"], answer
    values: Values = answer["values"]
    return values


async def goals(client: Line) -> list[Values]:
    """The goals that the bridge knows once all tasks have had their turns."""
    await settle()
    found: list[Values] = (await watch(client))["goals"]
    return found


@pytest.mark.loops("asyncio", "trio")
async def test_a_goal_of_anybody_is_watched_to_its_end():
    gate = Gate()
    async with bridged() as (node, bridge), line(bridge) as client:
        node.action_server(Count, "count", gate.stream)
        assert (await watch(client))["goals"] == []
        async with node.action_client(Count, "count").send_goal(goal(5)) as handle:
            (running,) = await goals(client)
            assert running["id"] == handle.goal_id.hex()
            assert (running["action"], running["type"]) == ("/count", TYPE)
            assert (running["status"], running["has_ended"]) == ("EXECUTING", False)
            assert (running["request"], running["feedback"]) == ({"upto": 5}, {"so_far": [0]})
            gate.opened.set()
            await handle.outcome()
        (ended,) = await goals(client)
        assert (ended["status"], ended["has_ended"]) == ("SUCCEEDED", True)
        assert ended["result"] == {"counted": [5]}
        assert ended["duration"] >= 0.0


async def test_a_page_pauses_and_resumes_goals():
    async def act(goal: Count.Goal, handle: Any) -> Count.Result:
        while True:
            await handle.checkpoint()

    async with bridged() as (node, bridge), line(bridge) as client:
        node.action_server(Count, "count", act, pausable=True)
        await watch(client)
        async with node.action_client(Count, "count").send_goal(goal()) as handle:
            name, seen = "/turtleact/web/set_paused", []
            for is_paused in (True, False, True):
                args = {"id": handle.goal_id.hex(), "is_paused": is_paused}
                seen.append((await goals(client))[0]["is_paused"])
                assert (await client.call(name, args=args))["result"]
                assert handle.is_paused is is_paused
            assert seen == [False, True, False]
            await handle.resume()  # somebody else
            assert not (await goals(client))[0]["is_paused"]
            await handle.pause()
            await handle.cancel()
            await handle.outcome()
            assert not (await goals(client))[0]["is_paused"]
            answer = await client.call(name, args=args)
            assert (answer["result"], "nobody follows" in str(answer["values"])) == (False, True)


async def test_a_page_marks_resumed_goals(tmp_path):
    path, goal_id = tmp_path / "goals.db", bytes(range(16))
    for is_resumed in (False, True):
        async with (
            turtleact.open_journal(path) as journal,
            bridged() as (node, bridge),
            line(bridge) as client,
        ):
            server = node.action_server(
                Count, "count", Gate().wait, journal=journal, on_restart="resume"
            )
            await server.wait_until_serving()
            await watch(client)
            sending = node.action_client(Count, "count").send_goal(goal(), goal_id=goal_id)
            async with sending as handle:
                assert (await goals(client))[0]["is_resumed"] is is_resumed
                assert handle.is_resumed is is_resumed
                handle.detach()


async def test_a_page_is_told_why_a_goal_cannot_be_paused():
    async with bridged() as (node, bridge), line(bridge) as client:
        node.action_server(Count, "count", Gate().wait)
        await watch(client)
        async with node.action_client(Count, "count").send_goal(goal()) as handle:
            await goals(client)
            answer = await client.call(
                "/turtleact/web/set_paused", args={"id": handle.goal_id.hex()}
            )
            assert not answer["result"]
            assert "declare it with pausable=True" in answer["values"]


@pytest.mark.parametrize("type", [{}, {"type": "std_srvs/srv/Trigger"}])
async def test_rosbridge_clients_pause_goals_as_users_of_ros_do(type):
    async with (
        bridged() as (node, bridge),
        line(bridge) as client,
    ):
        node.action_server(Count, "count", count)
        answer = await client.call("/count/pause", args={}, **type)
        values = {"success": True, "message": "0 goals paused"}
        assert (answer["result"], answer["values"]) == (True, values)


async def test_a_goal_that_ended_before_the_first_page_is_shown_while_its_server_holds_it():
    async with bridged() as (node, bridge), line(bridge) as client:
        node.action_server(Count, "count", count)
        async with node.action_client(Count, "count").send_goal(goal(2)) as handle:
            assert handle.goal_id  # a goal without an id is forgotten at its end
            await handle.outcome()
        await watch(client)
        (ended,) = await goals(client)
        assert (ended["status"], ended["result"]) == ("SUCCEEDED", {"counted": [0, 1]})
        assert ended["duration"] is None  # nobody saw its end


async def test_a_rejected_goal_of_a_web_client_is_kept_with_its_reason():
    async with bridged() as (node, bridge), line(bridge) as client:
        gate = Gate()
        node.action_server(Count, "count", gate.wait, policy="reject")
        await watch(client)
        members = {"action": "/count", "action_type": TYPE}
        for id, upto in ("a", 1), ("b", 2):
            client.say("send_action_goal", id=id, args={"upto": upto}, **members)
        assert not (await client.hear())["result"]
        running, rejected = sorted(await goals(client), key=lambda each: str(each["status"]))
        assert (running["status"], running["request"]) == ("EXECUTING", {"upto": 1})
        assert (rejected["status"], rejected["request"]) == ("REJECTED", {"upto": 2})
        assert rejected["reason"]
        gate.opened.set()


async def test_a_server_that_goes_away_leaves_its_goal_unknown():
    transport = MemoryTransport()
    gate = Gate()
    async with bridged(transport) as (_, bridge), line(bridge) as client:
        async with turtleact.open_node("other", transport=transport) as other:
            other.action_server(Count, "count", gate.wait)
            await watch(client)
            client.say("send_action_goal", action="/count", action_type=TYPE)
            await gate.started.wait()
            assert [each["status"] for each in await goals(client)] == ["EXECUTING"]
        (ended,) = await heard_goals(client)
        assert (ended["status"], ended["reason"]) == ("ABORTED", "shutdown")


async def heard_goals(client: Line) -> list[Values]:
    """The goals, when the result of the client's own goal may arrive first."""
    await settle()
    client.say("call_service", id="goals", service="/turtleact/web/watch")
    while (frame := await client.hear()).get("id") != "goals":
        pass
    found: list[Values] = frame["values"]["goals"]
    return found


async def test_a_goal_of_another_process_is_watched(tmp_path):
    """Two sessions, as of two processes; the bridge opens its client only when there is a goal."""
    here = f"unixsock-stream/{tmp_path}/router"
    async with (
        open_zenoh(mode="router", listen=[here]) as first,
        open_zenoh(mode="peer", connect=[here], discovery=0.0) as second,
        turtleact.open_node("robot", transport=first) as robot,
        turtleact.open_node("web", transport=second) as node,
        open_bridge(node) as bridge,
        line(bridge) as client,
    ):
        robot.action_server(Count, "count", count)
        await first.flush()
        await second.explore()
        last = await watch(client)
        await robot.action_client(Count, "count").send_goal(goal(2))
        while not (last["goals"] and last["goals"][0]["has_ended"]):
            last = await watch(client, session=last["session"], since=last["revision"])
        assert last["goals"][0]["status"] == "SUCCEEDED"
        assert last["goals"][0]["result"] == {"counted": [0, 1]}
        assert last["goals"][0]["request"] is None  # nobody here knows it


async def test_goals_of_an_unknown_type_are_shown_until_their_server_is_gone():
    transport = MemoryTransport()
    async with (
        bridged(transport) as (_, bridge),
        turtleact.open_node("other", transport=transport) as other,
        line(bridge) as client,
    ):
        strange = Endpoint("service", "/odd/_action/send_goal", "odd/action/Odd_SendGoal", "/other")
        odd = transport.serve(strange, WireFormat(Empty.Request), ServiceHandler())
        statuses = other.publisher(
            GoalStatusArray, "/odd/_action/status", QoS(durability="transient_local")
        )
        info = GoalInfo(UUID(bytes(range(16))), Time(1, 0))
        statuses.publish(GoalStatusArray([GoalStatusMessage(info, 2)]))
        await watch(client)
        (running,) = await goals(client)
        assert (running["type"], running["status"]) == ("odd/action/Odd", "EXECUTING")
        statuses.publish(GoalStatusArray([]))
        (ended,) = await goals(client)
        assert (ended["status"], ended["reason"]) == ("UNKNOWN", "its server has forgotten it")
        odd.close()


async def test_a_page_gets_what_is_new_and_waits_for_it():
    async with bridged() as (node, bridge), line(bridge) as client:
        node.action_server(Count, "count", count)
        first = await watch(client)
        assert first["is_whole"]
        assert first["graph"]["actions"] == {"/count": TYPE}
        known = {"session": first["session"], "since": first["revision"]}
        client.say("call_service", id="w", service="/turtleact/web/watch", args=known)
        await settle()
        await node.action_client(Count, "count").send_goal(goal(1))
        news = (await client.hear())["values"]
        assert (news["is_whole"], "graph" in news) == (False, False)
        assert [each["status"] for each in news["goals"]] == ["SUCCEEDED"]
        assert news["revision"] > first["revision"]


async def test_a_page_that_has_missed_too_much_gets_everything_and_so_does_a_new_one():
    async with bridged() as (node, bridge), line(bridge) as client:

        def refuse(goal: Count.Goal) -> GoalResponse:
            return GoalResponse.REJECT

        node.action_server(Count, "count", count, goal_callback=refuse)
        first = await watch(client)
        for id in range(2 * MOST_ENDED + MOST_ACTIVE + 1):
            client.say("send_action_goal", id=id, action="/count", action_type=TYPE)
            assert not (await client.hear())["result"]
        known = {"session": first["session"], "since": first["revision"]}
        for news in await watch(client, **known), await watch(client):
            assert (news["is_whole"], len(news["goals"])) == (True, MOST_ENDED)


async def test_a_page_of_a_server_before_this_one_gets_everything():
    async with bridged() as (_, bridge), line(bridge) as client:
        await watch(client)
        assert (await watch(client, session="another", since=99))["is_whole"]


async def test_trails_are_kept_for_the_next_page():
    async with turtleact.open_node("robot") as node, open_bridge(node) as bridge:
        poses = node.publisher(TurtlePose, "turtle1/pose")

        async def set_pen(request: SetPen.Request) -> SetPen.Response:
            return SetPen.Response()

        async def clear(request: Empty.Request) -> Empty.Response:
            return Empty.Response()

        node.service(SetPen, "turtle1/set_pen", set_pen)
        node.service(Empty, "clear", clear)
        node.service(Empty, "reset", clear)
        async with line(bridge) as client:
            assert (await watch(client))["trails"] == {}
            for x in 1.0, 2.0, 3.0:
                poses.publish(TurtlePose(x=x))
            await client.call("/turtle1/set_pen", args={"r": 255, "width": 7})
            poses.publish(TurtlePose(x=4.0))
            poses.publish(TurtlePose(x=5.0))
        async with line(bridge) as another:
            news = await watch(another)
            assert news["graph"]["poses"] == {"/turtle1/pose": "turtlesim/msg/Pose"}
            assert news["graph"]["hues"] == {"/turtle1/pose": hue_of("turtle1")}
            trail = news["trails"]["turtle1"]
            assert trail["is_whole"]
            assert [point[0] for point in trail["points"]] == [1.0, 2.0, 3.0, 4.0]
            assert trail["points"][-1] == [4.0, 0.0, "#ff0000", 7]
            for service in "/clear", "/reset", "/turtleact/web/clear_trails":
                poses.publish(TurtlePose(x=9.0))
                await another.call(service)
                assert (await watch(another))["trails"]["turtle1"]["points"] == []


async def test_a_page_learns_where_the_turtles_of_a_paused_world_are():
    async with (
        open_world(turtles=2, paused=True) as node,
        open_bridge(node) as bridge,
        line(bridge) as client,
    ):
        news = await watch(client)
        while "turtle2" not in news["poses"]:
            news = await watch(client, session=news["session"], since=news["revision"])
        assert news["poses"]["turtle1"] == pytest.approx([5.544, 5.544, 0.0], abs=0.001)
