"""A goal sent inside a body is its child: whose place it takes, and how ends travel both ways."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from typing import Any, NamedTuple

import anyio
import anyio.lowlevel
import pytest

import turtleact
from turtleact import GoalStatus
from turtleact.errors import (
    Abort,
    GoalAborted,
    GoalCanceled,
    GoalError,
    GoalRejected,
    ServerUnavailable,
)
from turtleact.goals.state import Goal

from ..lab import (
    ON_ASYNCIO,
    Count,
    Lab,
    Running,
    count,
    goal,
    lab,
    local_server,
    result,
    running,
    settle,
)
from .test_action_client import Busy, cancel_at_each_point, take
from .test_policies import (
    CANCELED,
    ID,
    SHUTDOWN,
    Stage,
    beside,
    is_idle,
    preempted,
    sending,
    succeeded,
)


async def await_child(client):
    return await client.send_goal(goal(1))


async def enter_child(client):
    async with client.send_goal(goal(1)) as handle:
        return await handle.result()


async def read_child(client):
    async with client.send_goal(goal(1)) as handle:
        async for _ in handle:
            pass
        return await handle.result()


async def group_child(client):
    async with anyio.create_task_group() as group:
        for _ in range(2):
            group.start_soon(await_child, client)
    return result(1)


CHILDREN = pytest.mark.parametrize(
    "nest",
    [
        pytest.param(await_child, id="awaited-child"),
        pytest.param(enter_child, id="entered-child"),
        pytest.param(read_child, id="read-child"),
        pytest.param(group_child, id="children-in-a-group"),
    ],
)
ONE_CHILD = pytest.mark.parametrize(
    "nest",
    [pytest.param(await_child, id="awaited-child"), pytest.param(enter_child, id="entered-child")],
)
ONE_PLACE = pytest.mark.parametrize(
    "options",
    [
        pytest.param({"policy": "reject"}, id="reject"),
        pytest.param({"policy": "queue"}, id="queue"),
        pytest.param({"policy": "preempt"}, id="preempt"),
        pytest.param({"max_active": 1}, id="max-active"),
    ],
)


class Home(NamedTuple):
    """Two actions of one node."""

    parent: Lab
    child: Lab


@asynccontextmanager
async def home(
    parent: Callable[..., object],
    child: Callable[..., object],
    options: dict[str, Any] | None = None,
    slot: str | None = None,
    **others: Any,
) -> AsyncIterator[Home]:
    """Serve a parent, which gets the client of the child's action, and a child.

    Args:
        parent: Its body.
        child: Its body.
        options: How the parent's server treats goals; the child's too, if they share a slot.
        slot: That slot.
        others: How the child's server treats goals besides.
    """
    theirs = {} if options is None else options
    shared = {} if slot is None else theirs | {"slot": slot}
    async with turtleact.open_node("home") as node:
        client = node.action_client(Count, "child")

        async def body(request):
            return await parent(client, request)  # type: ignore[misc]  # a coroutine function

        server = node.action_server(Count, "count", body, **theirs | shared)
        outer = Lab(node, server, node.action_client(Count, "count"), local_server(server))
        yield Home(outer, beside(outer, "child", child, **shared | others))


def nesting(nest, log: list[str] | None = None):
    """A parent that sends its child in a certain way, and notes its own end."""

    async def parent(client, request):
        try:
            return await nest(client)
        finally:
            if log is not None:
                log.append("parent over")

    return parent


# --- places ---------------------------------------------------------------------------------


@CHILDREN
@ONE_PLACE
async def test_a_child_of_another_action_runs_in_the_place_of_its_parent(send, nest, options):
    async with home(nesting(nest), count, options, "turtle1") as (parent, _):
        assert (await send(parent, goal())).status is GoalStatus.SUCCEEDED
        await settle()
        assert is_idle(parent)


async def test_others_wait_while_a_child_runs(send):
    stage = Stage()

    async def parent(client, request):
        stage.log.append("parent begun")
        return await client.send_goal(goal(1))

    async with (
        home(parent, stage.act, {"policy": "queue"}, "turtle1") as (outer, inner),
        sending(send, outer, 9),
        sending(send, inner, 2),
        sending(send, outer, 9),
    ):
        assert stage.log == ["parent begun", "1 begun"]
        stage.open(1, 2)
    assert stage.log == [
        *("parent begun", "1 begun", "1 over"),
        *("2 begun", "2 over"),
        *("parent begun", "1 begun", "1 over"),
    ]


async def detach_child(client):
    async with client.send_goal(goal(1)) as handle:
        handle.detach()
    return result(1)


@pytest.mark.parametrize("options", [{"policy": "queue"}, {"max_active": 1}])
async def test_a_detached_child_keeps_the_place_of_its_parent(send, options):
    stage = Stage()
    async with home(nesting(detach_child, stage.log), stage.act, options, "turtle1") as (
        outer,
        inner,
    ):
        assert await send(outer, goal()) == succeeded(1)
        async with sending(send, inner, 2):
            assert "2 begun" not in stage.log
            stage.open(1, 2)
        assert is_idle(outer)
    assert stage.log[-4:] == ["1 begun", "1 over", "2 begun", "2 over"] or stage.log == [
        *("1 begun", "parent over", "1 over"),  # begun at once, on asyncio
        *("2 begun", "2 over"),
    ]


async def test_a_detached_child_is_named_as_the_one_that_keeps_a_place(send):
    stage = Stage()
    reject = {"policy": "reject"}
    async with home(nesting(detach_child), stage.act, reject, "turtle1") as (outer, _):
        await send(outer, goal())
        with pytest.raises(GoalRejected, match=r"busy with goal .* of /child"):
            await send(outer, goal())
        stage.open(1)
        await settle()
        assert await send(outer, goal()) == succeeded(1)


async def test_a_detached_child_is_preempted_by_a_goal_that_comes_after_its_parents_end(send):
    stage = Stage()
    preempt = {"policy": "preempt"}
    async with home(nesting(detach_child), stage.act, preempt, "turtle1") as (outer, inner):
        await send(outer, goal())
        async with sending(send, inner, 2):
            stage.open(2)
        assert is_idle(outer)
    assert stage.log[-2:] == ["2 begun", "2 over"]


async def test_a_detached_child_is_preempted_with_its_parent(send):
    stage = Stage()

    async def parent(client, request):
        await detach_child(client)
        await anyio.sleep_forever()

    preempt = {"policy": "preempt"}
    async with home(parent, stage.act, preempt, "turtle1") as (outer, inner):
        async with sending(send, outer, 9), sending(send, inner, 2) as (two,):
            await settle()
            try:
                assert "2 begun" in stage.log
            finally:
                stage.open(1, 2)
        assert two.value == succeeded(2)
        assert is_idle(outer)


async def test_siblings_run_side_by_side_in_the_place_of_their_parent(send):
    stage = Stage()

    async def parent(client, request):
        async with anyio.create_task_group() as group:
            for number in (1, 2):
                group.start_soon(client.send_goal(goal(number)).__aenter__)
        return result()

    queue = {"policy": "queue"}
    async with home(parent, stage.act, queue, "turtle1") as (outer, _):
        assert (await send(outer, goal())).status is GoalStatus.SUCCEEDED
        await settle()
        assert sorted(stage.log) == ["1 begun", "2 begun"]
        stage.open(1, 2)
        await settle()
        assert is_idle(outer)


async def test_a_child_of_an_action_without_a_slot_hands_the_place_on(send):
    """Parent, in the slot, sends to one outside, which sends to a child in the slot."""

    async def middle(request, handle):
        return await handle.node.action_client(Count, "child").send_goal(goal(1))

    async def parent(client, request):
        outside = outer.node.action_client(Count, "outside")
        return await outside.send_goal(goal(1))

    async with home(parent, count, {"policy": "queue"}, "turtle1") as (outer, _):
        beside(outer, "outside", middle)
        assert await send(outer, goal()) == succeeded(0)
        await settle()
        assert is_idle(outer)


async def test_a_goal_sent_after_the_end_of_the_body_waits_like_any_other(send):
    stage, ended = Stage(), anyio.Event()
    async with anyio.create_task_group() as group:

        async def straggle(client):
            await ended.wait()
            await client.send_goal(goal(2))

        async def parent(client, request):
            group.start_soon(straggle, client)
            return result(1)

        async with home(parent, stage.act, {"policy": "queue"}, "turtle1") as (outer, inner):
            assert await send(outer, goal()) == succeeded(1)
            async with sending(send, inner, 3):
                ended.set()
                await settle()
                assert stage.log == ["3 begun"]
                stage.open(2, 3)
            await settle()
    assert stage.log == ["3 begun", "3 over", "2 begun", "2 over"]


async def test_a_goal_sent_to_its_own_action_after_the_end_of_the_body_is_taken(send):
    ended, outcomes = anyio.Event(), []
    async with anyio.create_task_group() as group:

        async def straggle(node):
            await ended.wait()
            outcomes.append(await node.action_client(Count, "count").send_goal(goal(2)))

        async def body(request, handle):
            if request.upto == 1:
                group.start_soon(straggle, handle.node)
            return result(request.upto)

        async with lab(body, policy="reject") as served:
            assert await send(served, goal(1)) == succeeded(1)
            ended.set()
            await settle()
    assert outcomes == [result(2)]


# --- deadlocks ------------------------------------------------------------------------------


async def recurse(request, handle):
    """A body that sends goals to its own action, until the number is used up."""
    if not request.upto:
        return result(0)
    client = handle.node.action_client(Count, "count")
    return await client.send_goal(goal(request.upto - 1))


OWN_PARENT = r"a deadlock: it would wait for its own parent, goal [0-9a-f]{32} of /count$"


@ONE_PLACE
@ONE_CHILD
async def test_a_goal_that_would_wait_for_its_own_parent_is_rejected(send, nest, options):
    refusals: list[GoalRejected] = []

    async def body(request, handle):
        with pytest.raises(GoalRejected, match=OWN_PARENT) as caught:
            await nest(handle.node.action_client(Count, "count"))
        refusals.append(caught.value)
        return result(7)

    async with lab(body, **options) as served:
        assert await send(served, goal()) == succeeded(7)
        assert is_idle(served)
    assert len(refusals) == 1


@ONE_PLACE
@pytest.mark.parametrize("slot", [None, "turtle1"])
async def test_a_goal_that_would_wait_for_a_far_parent_is_rejected(send, options, slot):
    """The child in between has the place of its parent, or none."""

    async def middle(request, handle):
        with pytest.raises(GoalRejected, match=OWN_PARENT):
            await handle.node.action_client(Count, "count").send_goal(goal())
        return result(7)

    async with home(nesting(await_child), middle, options, slot) as (outer, _):
        assert await send(outer, goal()) == succeeded(7)
        assert is_idle(outer)


async def test_with_a_free_place_a_goal_may_be_sent_to_its_own_action(send):
    async with lab(recurse, max_active=2) as served:
        assert await send(served, goal(1)) == succeeded(0)


async def test_a_family_that_has_taken_every_place_is_refused_another(send):
    async with lab(recurse, max_active=2) as served:
        outcome = await send(served, goal(2))
        assert "a deadlock" in outcome.reason
        assert is_idle(served)


async def test_a_child_may_wait_for_the_place_of_a_stranger(send):
    stage = Stage()

    async def body(request, handle):
        if request.upto == 1:
            return await handle.node.action_client(Count, "count").send_goal(goal(3))
        return await stage.act(request)

    async with lab(body, max_active=2) as served:
        async with sending(send, served, 2), sending(send, served, 1) as (one,):
            assert stage.log == ["2 begun"]
            stage.open(2, 3)
        assert one.value == succeeded(3)


async def test_of_two_parents_that_would_wait_for_each_other_one_is_refused(send):
    together = anyio.Event()

    async def body(request, handle):
        if not request.upto:
            return result(0)
        await together.wait()
        return await handle.node.action_client(Count, "count").send_goal(goal(0))

    async with lab(body, max_active=2) as served:
        async with sending(send, served, 1, 2) as sent:
            together.set()
        ends = {each.value.status for each in sent}
        assert ends == {GoalStatus.SUCCEEDED, GoalStatus.ABORTED}
        assert is_idle(served)


# --- a parent is canceled -------------------------------------------------------------------


class Slow(Stage):
    """Children that wait, also in their clean-up."""

    def __init__(self) -> None:
        super().__init__(1, 2, 3)


async def by_a_client(outer: Lab) -> None:
    await outer.client.cancel_all()


async def by_shutdown(outer: Lab) -> None:
    await outer.server.aclose()


async def by_preemption(outer: Lab) -> None:
    async with outer.client.send_goal(goal(9), goal_id=ID) as handle:
        await handle.outcome()


ENDINGS = pytest.mark.parametrize(
    ("cancel", "outcome"),
    [
        pytest.param(by_a_client, CANCELED, id="by-a-client"),
        pytest.param(by_shutdown, SHUTDOWN, id="by-shutdown"),
        pytest.param(by_preemption, preempted(ID), id="by-preemption"),
    ],
)


@CHILDREN
@ENDINGS
@pytest.mark.parametrize("slot", [None, "turtle1"])
async def test_a_child_has_ended_before_the_clean_up_of_its_parent_goes_on(
    send, nest, cancel, outcome, slot
):
    stage = Slow()
    ends: list[GoalStatus] = []
    inner_nest = nesting(nest, stage.log)

    async def parent(client, request):
        return result(9) if request.upto == 9 else await inner_nest(client, request)

    async with home(parent, stage.act, {"policy": "preempt"}, slot) as (outer, _):
        outer.node.on_transition(
            lambda handle, old, new: (
                ends.append(new) if handle.request.upto == 1 and new.is_terminal else None
            )
        )
        async with sending(send, outer, 5) as (sent,), running(partial(cancel, outer)):
            await settle()
            assert set(stage.log) == {"1 begun"}
            stage.wash(1)
        await settle()
        assert is_idle(outer)
    assert stage.log[-2:] == ["1 over", "parent over"]
    assert sent.value == outcome
    assert set(ends) == {GoalStatus.CANCELED}


@ONE_CHILD
async def test_a_child_has_ended_when_a_scope_of_its_parent_is_left(send, nest):
    stage = Slow()
    scopes: list[anyio.CancelScope] = []

    async def parent(client, request):
        with anyio.CancelScope() as scope:
            scopes.append(scope)
            await nest(client)
        stage.log.append("went on")
        return result(7)

    async with home(parent, stage.act) as (outer, inner):
        async with sending(send, outer, 5) as (sent,):
            scopes[0].cancel()
            await settle()
            assert stage.log == ["1 begun"]
            stage.wash(1)
        assert (sent.value, inner.active) == (succeeded(7), [])
    assert stage.log == ["1 begun", "1 over", "went on"]


async def test_a_child_that_waits_for_its_turn_is_canceled_with_its_parent(send):
    stage = Stage(1)

    async def parent(client, request):
        return await client.send_goal(goal(2))

    async with (
        home(parent, stage.act, policy="queue") as (outer, inner),
        sending(send, inner, 1),
        sending(send, outer, 5) as (sent,),
    ):
        assert len(inner.active) == 2
        await outer.client.cancel_all()
        await sent.done.wait()
        assert len(inner.active) == 1
        stage.open(1)
        stage.wash(1)
    assert (sent.value, stage.log) == (CANCELED, ["1 begun", "1 over"])


@ENDINGS
async def test_a_cancel_flows_down_three_levels_the_lowest_ends_first(send, cancel, outcome):
    stage = Slow()

    async def middle(request, handle):
        try:
            return await handle.node.action_client(Count, "lowest").send_goal(goal(1))
        finally:
            stage.log.append("middle over")

    upper = nesting(await_child, stage.log)

    async def parent(client, request):
        return result(9) if request.upto == 9 else await upper(client, request)

    shared: dict[str, Any] = {"policy": "preempt"}
    async with home(parent, middle, shared, "turtle1") as (outer, _):
        beside(outer, "lowest", stage.act, slot="turtle1", **shared)
        async with sending(send, outer, 5) as (sent,), running(partial(cancel, outer)):
            await settle()
            assert stage.log == ["1 begun"]
            stage.wash(1)
        await settle()
        assert is_idle(outer)
    assert (sent.value, stage.log[1:]) == (outcome, ["1 over", "middle over", "parent over"])


async def test_a_parent_can_send_goals_in_its_clean_up(send):
    stage = Stage()

    async def parent(client, request):
        try:
            await anyio.sleep_forever()
        finally:
            with anyio.CancelScope(shield=True):
                await client.send_goal(goal(1))
            stage.log.append("parent over")

    async with (
        home(parent, stage.act, {"policy": "preempt"}, "turtle1") as (outer, inner),
        sending(send, outer, 5),
        sending(send, inner, 2),
    ):
        await settle()
        assert stage.log == ["1 begun"]
        stage.open(1, 2)
    assert stage.log == ["1 begun", "1 over", "parent over", "2 begun", "2 over"]


async def test_a_parent_ends_and_its_child_is_not_its_affair_once_detached(send):
    stage = Stage()

    async def parent(client, request):
        await detach_child(client)
        await anyio.sleep_forever()

    async with home(parent, stage.act) as (outer, inner):
        async with sending(send, outer, 5) as (sent,):
            await outer.client.cancel_all()
        assert sent.value == CANCELED
        assert [each.status for each in inner.active] == [GoalStatus.EXECUTING]
        stage.open(1)
        await settle()
    assert stage.log == ["1 begun", "1 over"]


# --- a child ends ---------------------------------------------------------------------------


async def abort(request):
    await take(2)
    raise Abort("no pen", result(7))


async def abort_at_once(request):
    raise Abort("no pen", result(7))


@ONE_CHILD
@pytest.mark.parametrize("child", [abort, abort_at_once])
async def test_a_childs_abort_reaches_the_parent(send, nest, child):
    async def parent(client, request):
        with pytest.raises(GoalAborted) as caught:
            await nest(client)
        await anyio.lowlevel.checkpoint()
        assert (caught.value.reason, caught.value.result) == ("no pen", result(7))
        return result(1)

    async with home(parent, child) as (outer, _):
        assert await send(outer, goal()) == succeeded(1)


async def cancel_the_child(inner: Lab) -> None:
    await inner.client.cancel_all()


async def close_the_child(inner: Lab) -> None:
    await inner.server.aclose()


async def preempt_the_child(inner: Lab) -> None:
    async with inner.client.send_goal(goal(9), goal_id=ID):
        await settle()


@ONE_CHILD
@pytest.mark.parametrize(
    ("end", "error", "reason"),
    [
        (cancel_the_child, GoalCanceled, ""),
        (close_the_child, GoalAborted, "shutdown"),
        (preempt_the_child, GoalAborted, f"preempted by goal {ID.hex()} of /child"),
    ],
)
async def test_a_child_ended_by_others_does_not_cancel_its_parent(send, nest, end, error, reason):
    seen: list[GoalError] = []
    stage = Stage()

    async def parent(client, request):
        try:
            await nest(client)
        except GoalError as failed:
            seen.append(failed)
        for _ in range(3):
            await anyio.lowlevel.checkpoint()
        return result(7)

    async with home(parent, stage.act, policy="preempt") as (outer, inner):
        async with sending(send, outer, 5) as (sent,):
            await end(inner)
        assert sent.value == succeeded(7)
    assert [(type(each), each.reason) for each in seen] == [(error, reason)]


@ONE_CHILD
async def test_a_childs_end_that_a_parent_does_not_catch_aborts_it(send, nest):
    stage = Stage()
    async with home(nesting(nest), stage.act) as (outer, inner):
        async with sending(send, outer, 5) as (sent,):
            await inner.client.cancel_all()
        assert sent.value.status is GoalStatus.ABORTED
        assert "GoalCanceled" in sent.value.reason


# --- memory ---------------------------------------------------------------------------------

LINKS = 50


def count_goals() -> int:
    gc.collect()
    return sum(type(each) is Goal for each in gc.get_objects())


def relay(numbers: list[int], callback: Callable[[object], object] | None):
    """A body that sends the next goal of a chain, lets go of it, and ends."""

    async def body(request, handle):
        await take(2)  # the one before has ended meanwhile
        if not request.upto:
            numbers.append(count_goals())
            return result()
        client = handle.node.action_client(Count, "ab"[request.upto % 2])
        sending = client.send_goal(goal(request.upto - 1), feedback_callback=callback)
        async with sending as following:
            following.detach()
        return result()

    return body


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({"max_active": 10}, id="max-active"),
        pytest.param({"policy": "queue", "slot": "turtle1"}, id="slot"),
        pytest.param({"policy": "queue"}, id="two-queues"),
    ],
)
@pytest.mark.parametrize(
    "callback",
    [
        None,
        pytest.param(
            lambda message: None,
        ),
    ],
    ids=["plain", "feedback-callback"],
)
async def test_a_chain_of_detached_goals_keeps_no_goal_that_has_ended(options, callback):
    numbers: list[int] = []
    async with turtleact.open_node("home") as node:
        for name in "ab":
            node.action_server(Count, name, relay(numbers, callback), **options, result_timeout=0.0)
        before = count_goals()
        async with node.action_client(Count, "b").send_goal(goal(LINKS)) as first:
            first.detach()
        del first
        await take(20 * LINKS)
    assert numbers[0] - before < 5


# --- canceled at every point ----------------------------------------------------------------

SLOTS = {
    "no-slot": ({}, None),
    "queue": ({"policy": "queue"}, "turtle1"),
    "preempt": ({"policy": "preempt"}, "turtle1"),
    "max-active": ({"max_active": 2}, "turtle1"),
}
"""How servers treat goals, and the slot that they share, if any."""

WAYS = [await_child, enter_child, read_child, group_child]


def families(name: str, **turned_by: int) -> pytest.MarkDecorator:
    """Each value of an argument with each way to nest and with each slot, but not with all pairs.

    Args:
        name: The argument.
        turned_by: Its values, and how far the ways are turned against the slots for each. The tests
            have different turns, so together they see every way with every slot.
    """
    return pytest.mark.parametrize(
        (name, "nest", "options", "slot"),
        [
            pytest.param(value, WAYS[number - turn], *SLOTS[slot], id=f"{value}-{slot}")
            for value, turn in turned_by.items()
            for number, slot in enumerate(SLOTS)
        ],
    )


FAILURES = (GoalAborted, GoalCanceled, GoalRejected, ServerUnavailable)


class Household:
    """A parent and a child that wait as often as can be, and strangers beside them."""

    def __init__(self, nest, style: str) -> None:
        self.nest = nest
        self.busy = Busy()
        self.child = getattr(self.busy, style)
        self.active = 0

    async def parent(self, client, request):
        self.active += 1
        try:
            await take(1)
            answer = await self.nest(client)
            await take(1)
            return answer
        finally:
            self.active -= 1

    def is_over(self, outer: Lab, inner: Lab) -> bool:
        held = [*outer.active, *inner.active]
        slots = [each.local.slot for each in (outer, inner)]
        idle = all(each.is_empty for each in slots if each)
        return (held, self.active, self.busy.active, idle) == ([], 0, 0, True)


async def visit(outer: Lab, inner: Lab) -> None:
    """A parent, and strangers at both doors."""

    async def call(client):
        with contextlib.suppress(*FAILURES):
            await client.send_goal(goal())

    async with anyio.create_task_group() as group:
        for client in (outer.client, inner.client, outer.client):
            group.start_soon(call, client)


@families("style", body=0, stream=1)
async def test_a_family_canceled_by_a_scope_at_any_point_leaves_nothing(nest, options, slot, style):
    await cancel_everywhere(Household(nest, style), options, slot, native=False)


@ON_ASYNCIO
@families("style", body=2, stream=3)
async def test_a_family_canceled_as_a_task_at_any_point_leaves_nothing(nest, options, slot, style):
    await cancel_everywhere(Household(nest, style), options, slot, native=True)


async def cancel_everywhere(house: Household, options, slot, *, native: bool) -> None:
    async with home(house.parent, house.child, options, slot) as (outer, inner):
        await cancel_at_each_point(
            lambda: visit(outer, inner),
            outer.client,
            lambda: house.is_over(outer, inner),
            native=native,
        )


async def end_everywhere(nest, options, slot, end) -> None:
    """Have a family ended by others at each point."""
    for turns in range(40):
        house = Household(nest, "body")
        async with home(house.parent, house.child, options, slot) as places:
            visitors: Running[None] = Running(partial(visit, *places))
            async with anyio.create_task_group() as group:
                group.start_soon(visitors.run)
                await take(turns)
                was_over = visitors.done.is_set()
                await end(places)
            await settle()
            assert house.is_over(*places), f"after {turns} turns"
        if was_over:
            return


@families("which", parent=0, child=1)
async def test_goals_canceled_by_id_at_any_point_leave_nothing(nest, options, slot, which):
    await end_everywhere(nest, options, slot, lambda at: getattr(at, which).client.cancel_all())


@families("which", parent=2, child=3)
async def test_a_server_closed_at_any_point_answers_a_family(nest, options, slot, which):
    await end_everywhere(nest, options, slot, lambda at: getattr(at, which).server.aclose())
