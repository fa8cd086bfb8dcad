"""Actions both ways: goals that clients send, and goals that clients serve."""

from __future__ import annotations

from functools import partial
from typing import Any

import anyio
import pytest

from turtleact import GoalAborted, GoalResponse, Reject, testing

from ..lab import Count, Gate, Running, count, feedback, goal, result, running, settle
from .line import Line, bridged, line

TYPE = "lab_interfaces/action/Count"


def send(client: Line, id: str = "g:1", upto: int = 3, **members: object) -> None:
    members = {"action": "/count", "action_type": TYPE, "args": {"upto": upto}} | members
    client.say("send_action_goal", id=id, **members)


def of(frame: dict[str, object]) -> tuple[object, ...]:
    return frame["op"], frame["values"], frame.get("status"), frame.get("result")


# goals that clients send


async def test_a_goal_is_told_of_by_feedback_and_one_result():
    async with bridged() as (node, bridge), line(bridge) as client:
        node.action_server(Count, "count", count)
        send(client, "send_action_goal:/count:14", upto=2, feedback=True)
        heard = [await client.hear() for _ in range(3)]
        goal_id = heard[0]["goal_id"]
        assert len(bytes.fromhex(goal_id)) == 16
        common = {"action": "/count", "id": "send_action_goal:/count:14", "goal_id": goal_id}
        assert heard == [
            {"op": "action_feedback", "values": {"so_far": [0]}, **common},
            {"op": "action_feedback", "values": {"so_far": [0, 1]}, **common},
            {
                "op": "action_result",
                "values": {"counted": [0, 1]},
                "status": 4,
                "result": True,
                **common,
            },
        ]
        assert await client.hears_nothing()


@pytest.mark.parametrize(
    "members",
    [
        {"action": "count"},
        {"action_type": "lab_interfaces/Count"},
        {"action_type": "lab_interfaces::action::dds_::Count_"},
        {"args": [3]},
    ],
)
async def test_a_goal_is_understood_as_it_is_spelled(members):
    async with bridged() as (node, bridge), line(bridge) as client:
        node.action_server(Count, "count", count)
        send(client, **members)
        frame = await client.hear()
        assert frame["values"] == {"counted": [0, 1, 2]}
        assert frame["action"] == members.get("action", "/count")


async def test_a_goal_is_canceled_by_its_sender():
    gate = Gate()
    async with bridged() as (node, bridge), line(bridge) as client:
        node.action_server(Count, "count", gate.wait)
        send(client)
        await gate.started.wait()
        client.say("cancel_action_goal", id="g:1", action="/count")
        assert of(await client.hear()) == ("action_result", {"counted": []}, 5, True)
        assert await client.hears_nothing()


def reject(_goal: object) -> GoalResponse:
    raise Reject("not today")


@pytest.mark.parametrize(
    ("members", "values"),
    [
        ({}, "Action goal was rejected: not today"),
        ({"action": "/nope"}, "No action server available"),
        (
            {"action_type": "example_interfaces/Fibonacci", "args": {}},
            "No action server available: it is served as lab_interfaces/action/Count, not as ",
        ),
        ({"action_type": "a/Nope"}, "unknown interface 'a/action/Nope'"),
        ({"args": {"up": 3}}, "goal: unknown field 'up', did you mean 'upto'?"),
        ({"action": "no name"}, "invalid name"),
    ],
)
async def test_a_goal_that_is_not_taken_has_one_result_all_the_same(members, values):
    async with bridged() as (node, bridge), line(bridge) as client:
        node.action_server(Count, "count", count, goal_callback=reject)
        send(client, **members)
        frame = await client.hear()
        assert (frame["status"], frame["result"]) == (0, False)
        assert frame["values"].startswith(values)
        assert await client.hears_nothing()


async def test_an_id_that_is_in_use_is_refused():
    gate = Gate()
    async with bridged() as (node, bridge), line(bridge) as client:
        node.action_server(Count, "count", gate.wait)
        send(client)
        send(client)
        assert (await client.hear())["values"] == (
            "a goal of the id 'g:1' is under way: use another id"
        )
        gate.opened.set()
        assert (await client.hear())["status"] == 4
        send(client)
        assert (await client.hear())["status"] == 4


async def test_goals_need_no_id():
    async with bridged() as (node, bridge), line(bridge) as client:
        node.action_server(Count, "count", count)
        for _ in range(2):
            client.say("send_action_goal", action="/count", action_type=TYPE, args={"upto": 1})
        for _ in range(2):
            frame = await client.hear()
            assert "id" not in frame
            assert frame["status"] == 4


# several clients


async def test_a_cancel_means_ones_own_goal_first():
    gate = Gate()
    async with bridged() as (node, bridge), line(bridge) as one, line(bridge) as other:
        node.action_server(Count, "count", gate.wait)
        send(one)
        send(other)
        await settle()
        other.say("cancel_action_goal", id="g:1", action="/count")
        assert (await other.hear())["status"] == 5
        assert await one.hears_nothing()
        gate.opened.set()
        assert (await one.hear())["status"] == 4


async def test_another_client_cancels_a_goal_whose_id_is_unique():
    gate = Gate()
    async with bridged() as (node, bridge), line(bridge) as one, line(bridge) as other:
        node.action_server(Count, "count", gate.wait)
        send(one)
        await gate.started.wait()
        other.say("cancel_action_goal", id="g:1", action="/count")
        assert (await one.hear())["status"] == 5
        assert await other.hears_nothing()


async def test_a_goal_goes_on_when_its_client_goes_and_can_be_canceled_by_another():
    gate = Gate()
    async with bridged() as (node, bridge):
        node.action_server(Count, "count", gate.wait)
        async with line(bridge) as client:
            send(client, feedback=True)
            await gate.started.wait()
        await settle()
        assert gate.log == ["begun"]
        assert bridge.statistics().goals == 1
        async with line(bridge) as other:
            other.say("cancel_action_goal", id="g:1", action="/count")
            assert await other.hears_nothing()
            await settle()
        assert gate.log == ["begun", "canceled", "over"]
        assert bridge.statistics().goals == 0


async def test_a_client_can_take_its_goals_along():
    gate = Gate()
    async with bridged(cancel_on_disconnect=True) as (node, bridge):
        node.action_server(Count, "count", gate.wait)
        async with line(bridge) as client:
            send(client)
            await gate.started.wait()
        await settle()
        assert gate.log == ["begun", "canceled", "over"]


async def test_a_client_whose_bridge_is_closed_is_told_that_it_will_not_hear_of_its_goal():
    gate = Gate()
    async with bridged() as (node, bridge), line(bridge) as client:
        node.action_server(Count, "count", gate.wait)
        send(client, feedback=True)
        await gate.started.wait()
        await bridge.aclose()
        problem = "The server is closing: you will not hear of this goal any more"
        assert of(await client.hear()) == ("action_result", problem, 0, False)
        gate.opened.set()
        assert client.closed["code"] == 1001


def test_a_client_that_is_slow_loses_feedback_and_no_result():
    async def read():
        async def chatter(goal: Count.Goal):
            for number in range(goal.upto):
                yield feedback(number)
                await anyio.sleep(0.001)
            yield result(goal.upto)

        async with bridged() as (node, bridge), line(bridge) as client:
            node.action_server(Count, "count", chatter)
            assert await client.hears_nothing()
            send(client, upto=500, feedback=True)
            client.gate = anyio.Event()
            await anyio.sleep(1)
            client.gate.set()
            heard = [await client.hear()]
            while heard[-1]["op"] != "action_result":
                heard.append(await client.hear())
            return [frame["values"] for frame in heard]

    for backend in ("asyncio", "trio"):
        values = testing.run(read, backend=backend)
        assert values[-1] == {"counted": [500]}
        assert values[-2] == {"so_far": [499]}
        assert len(values) < 300


# goals that clients serve


async def serve(client: Line) -> None:
    client.say("advertise_action", type="lab_interfaces/Count", action="/count")
    assert await client.hears_nothing()


async def test_a_client_serves_an_action():
    async with bridged() as (node, bridge), line(bridge) as client:
        await serve(client)
        seen: list[Count.Feedback] = []
        sending = partial(
            node.action_client(Count, "count").send_goal, goal(6), feedback_callback=seen.append
        )
        async with running(sending) as sent:
            asked = await client.hear()
            assert asked == {
                "op": "send_action_goal",
                "id": "action_goal:/count:1",
                "action": "/count",
                "action_type": TYPE,
                "args": {"upto": 6},
                "feedback": True,
            }
            common = {"id": asked["id"], "action": "/count"}
            client.say("action_feedback", values={"so_far": [1]}, **common)
            client.say("action_result", values={"counted": [1, 2]}, status=4, result=True, **common)
        assert sent.value == result(1, 2)
        assert seen == [feedback(1)]


@pytest.mark.parametrize(
    ("answer", "status", "counted", "reason"),
    [
        ({"result": True, "values": {"counted": [1]}}, "SUCCEEDED", [1], ""),
        ({"result": False, "status": 6}, "ABORTED", [], ""),
        ({"result": False, "values": "no more"}, "ABORTED", [], "no more"),
        ({"result": True, "status": 6, "values": {"counted": [1]}}, "ABORTED", [1], ""),
        (
            {"result": True, "status": 5, "values": {"counted": [1]}},
            "ABORTED",
            [1],
            "the client canceled it without being asked",
        ),
        (
            {"result": True, "values": {"count": [1]}},
            "ABORTED",
            [],
            "the client's result does not fit: result: ",
        ),
    ],
)
async def test_a_goal_ends_as_its_client_says(answer, status, counted, reason):
    async with bridged() as (node, bridge), line(bridge) as client:
        await serve(client)
        async with node.action_client(Count, "count").send_goal(goal()) as handle:
            asked = await client.hear()
            client.say(**{"op": "action_result", "id": asked["id"]} | answer)
            outcome = await handle.outcome()
        assert (outcome.status.name, outcome.result.counted) == (status, counted)
        assert outcome.reason.startswith(reason)


@pytest.mark.parametrize(
    ("answer", "status"),
    [
        ({"result": True, "status": 5, "values": {"counted": [1]}}, "CANCELED"),
        ({"result": True, "status": 4, "values": {"counted": [1]}}, "SUCCEEDED"),
        ({"result": True, "status": 6, "values": {"counted": [1]}}, "ABORTED"),
    ],
)
async def test_a_client_is_asked_to_cancel_and_says_how_it_ends(answer, status):
    async with bridged() as (node, bridge), line(bridge) as client:
        await serve(client)
        async with node.action_client(Count, "count").send_goal(goal()) as handle:
            asked = await client.hear()
            await handle.cancel()
            assert await client.hear() == {
                "op": "cancel_action_goal",
                "id": asked["id"],
                "action": "/count",
            }
            client.say("action_feedback", id=asked["id"], values={"so_far": [9]})
            client.say("action_result", id=asked["id"], action="/count", **answer)
            outcome = await handle.outcome()
        assert (outcome.status.name, outcome.result.counted) == (status, [1])
        assert handle.last_feedback == feedback(9)


def test_a_client_that_does_not_cancel_is_waited_for_no_longer_than_half_a_minute():
    async def cancel():
        async with bridged() as (node, bridge), line(bridge) as client:
            await serve(client)
            async with node.action_client(Count, "count").send_goal(goal()) as handle:
                await client.hear()
                await handle.cancel()
                began = anyio.current_time()
                outcome = await handle.outcome()
            return outcome.status.name, round(anyio.current_time() - began)

    for backend in ("asyncio", "trio"):
        assert testing.run(cancel, backend=backend) == ("CANCELED", 30)


async def test_the_goals_of_a_client_that_goes_are_aborted():
    async with bridged() as (node, bridge):
        sent: Running[Any] = Running(partial(node.action_client(Count, "count").send_goal, goal()))
        async with anyio.create_task_group() as group, line(bridge) as client:
            await serve(client)
            group.start_soon(sent.run)
            await client.hear()
        assert isinstance(sent.error, GoalAborted)


async def test_an_action_that_is_withdrawn_aborts_its_goals_while_the_client_stays():
    async with bridged() as (node, bridge), line(bridge) as client:
        await serve(client)
        async with node.action_client(Count, "count").send_goal(goal()) as handle:
            await client.hear()
            client.say("unadvertise_action", action="/count")
            assert (await handle.outcome()).status.name == "ABORTED"
        assert await client.hears_nothing()


async def test_feedback_that_does_not_fit_is_told_of_and_ends_nothing():
    async with bridged() as (node, bridge), line(bridge) as client:
        client.say("set_level", level="error")
        await serve(client)
        async with node.action_client(Count, "count").send_goal(goal()) as handle:
            asked = await client.hear()
            client.say("action_feedback", id=asked["id"], values={"far": 1})
            assert "feedback: unknown field 'far'" in (await client.hear())["msg"]
            client.say("action_result", id=asked["id"], values={"counted": [1]}, result=True)
            assert (await handle.result()).counted == [1]
            client.say("action_feedback", id=asked["id"], values={"so_far": [1]})
            assert await client.hears_nothing()
