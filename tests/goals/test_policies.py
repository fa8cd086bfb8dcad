"""What becomes of a goal while another runs: each policy, shared slots, and every way out."""

from __future__ import annotations

import contextlib
import sys
from collections import defaultdict
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from contextvars import ContextVar
from functools import partial
from typing import Any

import anyio
import pytest

from turtleact import CancelResponse, GoalResponse, GoalStatus, Outcome
from turtleact.errors import (
    Abort,
    Cancel,
    GoalAborted,
    GoalCanceled,
    GoalRejected,
    InvalidOption,
    ServerUnavailable,
)
from turtleact.goals.state import CancelCode

from ..lab import (
    ON_ASYNCIO,
    ON_TRIO,
    Count,
    Lab,
    Running,
    Send,
    answering,
    awaited,
    count,
    feedback,
    goal,
    lab,
    local_server,
    once_canceled,
    result,
    running,
    settle,
    take_turns,
)
from .test_action_client import (
    Busy,
    await_it,
    cancel_after,
    cancel_at_each_point,
    cancel_it,
    leave_it,
    take,
)
from .test_local_server import ids

ID = bytes(range(16))
CANCELED = Outcome(GoalStatus.CANCELED, result())
SHUTDOWN = Outcome(GoalStatus.ABORTED, result(), "shutdown")

QUEUES = pytest.mark.parametrize(
    "options",
    [
        pytest.param({"policy": "queue"}, id="queue"),
        pytest.param({"max_active": 1}, id="max-active"),
    ],
)
WAITING = pytest.mark.parametrize(
    "options",
    [
        pytest.param({"policy": "queue"}, id="queue"),
        pytest.param({"max_active": 1}, id="max-active"),
        pytest.param({"policy": "preempt"}, id="preempt"),
    ],
)


def succeeded(number: int) -> Outcome[Count.Result]:
    return Outcome(GoalStatus.SUCCEEDED, result(number))


class Stage:
    """A body whose goals are told apart by their number, and end when they are let.

    Attributes:
        log: What has happened, in order.
        slow: The goals whose clean-up waits until it is let.
    """

    def __init__(self, *slow: int) -> None:
        self.log: list[str] = []
        self.slow = slow
        self._doors: defaultdict[int, anyio.Event] = defaultdict(anyio.Event)
        self._washed: defaultdict[int, anyio.Event] = defaultdict(anyio.Event)

    def open(self, *numbers: int) -> None:
        for number in numbers:
            self._doors[number].set()

    def wash(self, *numbers: int) -> None:
        for number in numbers:
            self._washed[number].set()

    async def act(self, request: Count.Goal) -> Count.Result:
        number = request.upto
        self.log.append(f"{number} begun")
        try:
            await self._doors[number].wait()
        finally:
            if number in self.slow:
                with anyio.CancelScope(shield=True):
                    await self._washed[number].wait()
            self.log.append(f"{number} over")
        return result(number)


@asynccontextmanager
async def sending(send: Send, served: Lab, *numbers: int) -> AsyncIterator[list[Running[Any]]]:
    """Send goals one after the other, each well under way before the next; await all at last."""
    async with AsyncExitStack() as stack:
        yield [
            await stack.enter_async_context(running(partial(send, served, goal(number))))
            for number in numbers
        ]


def beside(served: Lab, name: str, body: Any, **options: Any) -> Lab:
    """Another action of the same node."""
    server = served.node.action_server(Count, name, body, **options)
    return Lab(served.node, server, served.node.action_client(Count, name), local_server(server))


def is_idle(served: Lab) -> bool:
    """Whether a server holds nothing any more, its slot neither."""
    slot = served.local.slot
    if slot is None:  # a server that has closed has let go of it
        return not served.server.is_open and served.active == []
    return served.active == [] and slot.is_empty


# --- parallel -------------------------------------------------------------------------------


async def test_in_parallel_every_goal_starts(send):
    stage = Stage()
    async with lab(stage.act) as served, sending(send, served, 1, 2, 3) as sent:
        assert stage.log == ["1 begun", "2 begun", "3 begun"]
        stage.open(1, 2, 3)
    assert [each.value for each in sent] == [succeeded(1), succeeded(2), succeeded(3)]


async def test_at_most_max_active_goals_run(send):
    stage = Stage()
    async with lab(stage.act, max_active=2) as served, sending(send, served, 1, 2, 3, 4) as sent:
        assert stage.log == ["1 begun", "2 begun"]
        stage.open(2)
        await settle()
        assert stage.log[2:] == ["2 over", "3 begun"]
        stage.open(1, 3, 4)
    assert [each.value for each in sent] == [succeeded(number) for number in (1, 2, 3, 4)]


@pytest.mark.parametrize(
    ("options", "running_"),
    [({"max_active": 2, "queue_limit": 1}, 2), ({"policy": "queue", "queue_limit": 2}, 1)],
)
async def test_over_the_limit_of_the_queue_a_goal_is_rejected(send, options, running_):
    stage = Stage()
    async with lab(stage.act, **options) as served, sending(send, served, 1, 2, 3, 4) as sent:
        *_, last = sent
        assert isinstance(last.error, GoalRejected)
        assert last.error.reason == f"the queue is full ({3 - running_} waiting)"
        assert len(served.active) == 3
        stage.open(1, 2, 3)
    assert "4 begun" not in stage.log


async def test_once_one_has_left_the_queue_a_goal_is_taken_again(send):
    stage = Stage()
    async with (
        lab(stage.act, policy="queue", queue_limit=1) as served,
        sending(send, served, 1, 2) as sent,
    ):
        sent[1].scope.cancel()
        await settle()
        async with sending(send, served, 3) as (third,):
            stage.open(1, 3)
    assert third.value == succeeded(3)


# --- reject ---------------------------------------------------------------------------------


async def test_while_one_runs_another_is_rejected(send):
    stage = Stage()
    async with lab(stage.act, policy="reject") as served, sending(send, served, 1, 2) as sent:
        (active,) = served.active
        assert isinstance(sent[1].error, GoalRejected)
        assert sent[1].error.reason == f"busy with goal {active.hex} of /count"
        stage.open(1)
    assert (sent[0].value, stage.log) == (succeeded(1), ["1 begun", "1 over"])


async def test_the_id_of_a_goal_that_was_rejected_is_free():
    stage = Stage()
    async with lab(stage.act, policy="reject") as served:
        async with sending(awaited, served, 1):
            with pytest.raises(GoalRejected, match="busy"):
                await served.client.send_goal(goal(2), goal_id=ID)
            stage.open(1, 3)
        assert await served.client.send_goal(goal(3), goal_id=ID) == result(3)


# --- queues ---------------------------------------------------------------------------------


@QUEUES
async def test_goals_run_one_after_the_other_in_their_order(send, options):
    stage = Stage()
    async with lab(stage.act, **options) as served, sending(send, served, 1, 2, 3) as sent:
        stage.open(3, 2, 1)
    assert stage.log == ["1 begun", "1 over", "2 begun", "2 over", "3 begun", "3 over"]
    assert [each.value for each in sent] == [succeeded(1), succeeded(2), succeeded(3)]


@QUEUES
async def test_the_next_goal_begins_after_the_clean_up_of_the_one_before(send, options):
    stage = Stage(1)
    async with lab(stage.act, **options) as served, sending(send, served, 1, 2):
        stage.open(1, 2)
        await settle()
        assert stage.log == ["1 begun"]
        stage.wash(1)
    assert stage.log == ["1 begun", "1 over", "2 begun", "2 over"]


@QUEUES
@pytest.mark.parametrize("failure", [Abort("on purpose"), ValueError("no idea")])
async def test_the_next_goal_begins_however_the_one_before_has_ended(send, options, failure):
    async def body(request):
        await take(3)
        if request.upto == 1:
            raise failure
        return result(request.upto)

    async with lab(body, **options) as served, sending(send, served, 1, 2) as sent:
        pass
    assert sent[0].value.status is GoalStatus.ABORTED
    assert sent[1].value == succeeded(2)


SENDER: ContextVar[int] = ContextVar("SENDER", default=0)


async def test_a_goal_that_has_waited_runs_in_the_context_of_its_sender(send):
    gate = anyio.Event()

    async def body(request):
        await gate.wait()
        return result(SENDER.get())

    async def send_as(number):
        SENDER.set(number)
        return await send(served, goal())

    async with lab(body, policy="queue") as served:
        async with running(partial(send_as, 1)) as one, running(partial(send_as, 2)) as two:
            gate.set()
        assert (one.value, two.value) == (succeeded(1), succeeded(2))


MANY = sys.getrecursionlimit() + 100
"""More goals than calls can be nested."""


@QUEUES
@pytest.mark.parametrize("style", ["coroutine", "generator"])
async def test_a_long_queue_of_goals_that_never_wait_is_worked_off(options, style):
    stage = Stage()

    async def coroutine(request):
        return await stage.act(request) if request.upto == 1 else result()

    async def generator(request):
        yield await coroutine(request)

    body = coroutine if style == "coroutine" else generator
    async with lab(body, **options) as served:
        async with AsyncExitStack() as stack:
            handles = [
                await stack.enter_async_context(served.client.send_goal(goal(1 if not n else 0)))
                for n in range(MANY)
            ]
            assert [each.status for each in handles[1:]] == [GoalStatus.ACCEPTED] * (MANY - 1)
            stage.open(1)
            assert (await handles[-1].outcome()).status is GoalStatus.SUCCEEDED
            assert all(each.status is GoalStatus.SUCCEEDED for each in handles)
        assert is_idle(served)


# --- a waiting goal is canceled -------------------------------------------------------------


@asynccontextmanager
async def one_waits(stage: Stage, send: Send, **options: Any) -> AsyncIterator[tuple[Any, ...]]:
    """Goal 1 runs, in a clean-up if it must, and goal 2 waits."""
    async with lab(stage.act, **options) as served, sending(send, served, 1, 2) as (one, two):
        yield served, one, two
        stage.open(1)
        stage.wash(1)
    assert "2 begun" not in stage.log
    assert stage.log[-1] == "1 over"


@WAITING
async def test_a_waiting_goal_that_is_canceled_by_id_is_canceled_at_once(send, options):
    async with one_waits(Stage(1), send, **options) as (served, _, two):
        waiting = served.active[1]
        handle = await served.client.attach(waiting.id)
        response = await handle.cancel()
        assert (response.return_code, ids(response)) == (CancelCode.NONE, [waiting.id])
        assert handle.status is GoalStatus.CANCELED
        assert (await handle.cancel()).return_code == CancelCode.GOAL_TERMINATED
    assert two.value == CANCELED


@WAITING
async def test_a_waiting_goal_that_is_canceled_with_all_is_canceled_at_once(send, options):
    async with one_waits(Stage(1), send, **options) as (served, _, two):
        first, second = served.active
        response = await served.client.cancel_all()
        assert ids(response) == [first.id, second.id]
        assert (first.status, second.status) == (GoalStatus.CANCELING, GoalStatus.CANCELED)
    assert two.value == CANCELED


@WAITING
async def test_a_waiting_goal_is_canceled_with_the_one_who_waits_for_it(send, options):
    async with one_waits(Stage(1), send, **options) as (served, one, two):
        waiting = served.active[1]
        two.scope.cancel()
        await two.done.wait()
        assert (waiting.status, len(served.active)) == (GoalStatus.CANCELED, 1)
    assert one.value.status is not GoalStatus.CANCELED


async def test_a_waiting_goal_that_was_detached_begins_in_its_turn():
    stage = Stage()
    async with lab(stage.act, policy="queue") as served, sending(awaited, served, 1):
        async with served.client.send_goal(goal(2)) as handle:
            handle.detach()
        stage.open(1, 2)
        assert await handle.result() == result(2)


async def test_a_goal_in_the_middle_of_the_queue_is_passed_over(send):
    stage = Stage()
    async with lab(stage.act, policy="queue") as served, sending(send, served, 1, 2, 3) as sent:
        sent[1].scope.cancel()
        await settle()
        stage.open(1, 3)
    assert stage.log == ["1 begun", "1 over", "3 begun", "3 over"]


async def test_a_cancel_callback_may_keep_a_goal_waiting(send):
    stage = Stage()
    async with (
        lab(stage.act, policy="queue", cancel_callback=answering(CancelResponse.REJECT)) as served,
        sending(send, served, 1, 2) as sent,
    ):
        assert (await served.client.cancel_all()).return_code == CancelCode.REJECTED
        stage.open(1, 2)
    assert sent[1].value == succeeded(2)


async def test_a_goal_whose_turn_comes_while_the_callback_is_asked_is_canceled_in_its_body(send):
    stage, asked, answer = Stage(), anyio.Event(), anyio.Event()

    async def let_go_later(handle):
        asked.set()
        await answer.wait()
        return CancelResponse.ACCEPT

    async with (
        lab(stage.act, policy="queue", cancel_callback=let_go_later) as served,
        sending(send, served, 1, 2) as sent,
    ):
        handle = await served.client.attach(served.active[1].id)
        async with running(handle.cancel):
            await asked.wait()
            stage.open(1)
            await settle()
            assert handle.status is GoalStatus.EXECUTING
            answer.set()
    assert stage.log == ["1 begun", "1 over", "2 begun", "2 over"]
    assert sent[1].value == CANCELED


# --- preempt --------------------------------------------------------------------------------


def preempted(by: bytes, partial: Count.Result | None = None) -> Outcome[Count.Result]:
    reason = f"preempted by goal {by.hex()} of /count"
    return Outcome(GoalStatus.ABORTED, partial or result(), reason)


async def test_a_new_goal_has_the_one_that_runs_aborted(send):
    stage = Stage()
    async with (
        lab(stage.act, policy="preempt") as served,
        sending(send, served, 1) as (one,),
        served.client.send_goal(goal(2), goal_id=ID) as two,
    ):
        await one.done.wait()
        assert one.value == preempted(ID)
        stage.open(2)
        assert await two.result() == result(2)
    assert stage.log == ["1 begun", "1 over", "2 begun", "2 over"]


async def test_the_newest_of_those_that_wait_wins(send):
    stage = Stage(1)
    async with (
        lab(stage.act, policy="preempt") as served,
        sending(send, served, 1, 2) as (one, two),
        served.client.send_goal(goal(3), goal_id=ID) as three,
    ):
        await two.done.wait()
        assert two.value == preempted(ID)
        stage.wash(1)
        stage.open(3)
        assert await three.result() == result(3)
        assert one.value.status is GoalStatus.ABORTED
    assert stage.log == ["1 begun", "1 over", "3 begun", "3 over"]


async def test_a_goal_keeps_the_reason_of_the_one_that_preempted_it_first():
    stage = Stage(1)
    async with lab(stage.act, policy="preempt") as served, sending(awaited, served, 1) as (one,):
        async with (
            served.client.send_goal(goal(2), goal_id=ID),
            served.client.send_goal(goal(3)) as three,
        ):
            stage.wash(1)
            stage.open(3)
            await three.result()
        assert one.value == preempted(ID)


async def test_preempting_a_goal_that_is_canceling_leaves_its_end_alone(send):
    stage = Stage(1)
    async with lab(stage.act, policy="preempt") as served, sending(send, served, 1) as (one,):
        await served.client.cancel_all()
        async with sending(send, served, 2) as (two,):
            assert stage.log == ["1 begun"]
            stage.wash(1)
            stage.open(2)
    assert (one.value, two.value) == (CANCELED, succeeded(2))
    assert stage.log == ["1 begun", "1 over", "2 begun", "2 over"]


async def test_a_goal_that_is_canceled_while_it_gives_way_is_canceled(send):
    stage = Stage(1)
    async with lab(stage.act, policy="preempt") as served, sending(send, served, 1, 2) as sent:
        first = served.active[0]
        response = await served.local.cancel(first.id, 0)
        assert (ids(response), first.status) == ([first.id], GoalStatus.CANCELING)
        stage.wash(1)
        stage.open(2)
    assert [each.value for each in sent] == [CANCELED, succeeded(2)]


@ON_TRIO  # on asyncio it is `Task.cancel`, which no scope of anyio holds up
async def test_preempting_a_goal_that_is_about_to_succeed_leaves_its_end_alone(send):
    stage = Stage(1)
    async with lab(stage.act, policy="preempt") as served, sending(send, served, 1) as (one,):
        stage.open(1)
        await settle()  # in its clean-up, with its result at hand
        async with sending(send, served, 2) as (two,):
            assert stage.log == ["1 begun"]
            stage.wash(1)
            stage.open(2)
    assert (one.value, two.value) == (succeeded(1), succeeded(2))


@pytest.mark.parametrize(
    ("end", "outcome"),
    [
        (result(1), succeeded(1)),
        (
            Abort("up", result(7)),
            Outcome(GoalStatus.ABORTED, result(7), "up"),
        ),
        (Cancel(result(7)), preempted(ID, result(7))),
    ],
)
async def test_what_a_preempted_body_says_counts(send, end, outcome):
    async def body(request):
        return result(request.upto) if request.upto == 2 else await once_canceled(end)()

    async with lab(body, policy="preempt") as served, sending(send, served, 1) as (one,):
        assert await served.client.send_goal(goal(2), goal_id=ID) == result(2)
    assert one.value == outcome


async def test_a_preempted_generator_is_canceled_at_its_yield(send):
    log: list[str] = []

    async def body(request):
        log.append(f"{request.upto} begun")
        try:
            while request.upto == 1:
                yield feedback()
        finally:
            log.append(f"{request.upto} over")
        yield result(request.upto)

    async with lab(body, policy="preempt") as served, sending(send, served, 1, 2) as sent:
        pass
    assert log == ["1 begun", "1 over", "2 begun", "2 over"]
    assert [each.value.status for each in sent] == [GoalStatus.ABORTED, GoalStatus.SUCCEEDED]


async def test_of_many_goals_sent_at_once_the_last_one_runs():
    stage = Stage()
    async with lab(stage.act, policy="preempt") as served:
        async with AsyncExitStack() as stack:
            handles = [
                await stack.enter_async_context(served.client.send_goal(goal(number)))
                for number in range(1, 11)
            ]
            stage.open(10)
            assert await handles[-1].result() == result(10)
            outcomes = [await each.outcome() for each in handles[:-1]]
        assert outcomes == [preempted(handles[1].goal_id)] + [
            preempted(later.goal_id) for later in handles[2:]
        ]
        assert is_idle(served)
    assert stage.log[-2:] == ["10 begun", "10 over"]
    begun, over = stage.log[:-2:2], stage.log[1:-2:2]  # each clean-up ends before the next begins
    assert [each.split()[0] for each in begun] == [each.split()[0] for each in over]


async def test_a_client_that_gives_up_its_place_leaves_it_to_the_next(send):
    stage = Stage(1)
    async with lab(stage.act, policy="preempt") as served, sending(send, served, 1, 2) as sent:
        sent[1].scope.cancel()
        await settle()
        async with sending(send, served, 3) as (three,):
            stage.wash(1)
            stage.open(3)
    assert three.value == succeeded(3)


# --- given a place, not yet started ---------------------------------------------------------


@asynccontextmanager
async def half_started(stage: Stage, **options: Any) -> AsyncIterator[tuple[Lab, Any]]:
    """Goal 2 has been given the place of goal 1 in this very turn; its body has not begun."""
    async with lab(stage.act, **options) as served:
        async with served.client.send_goal(goal(1)), served.client.send_goal(goal(2)) as two:
            await settle()
            first = served.active[0]
            stage.open(1)
            stage.wash(1)
            while not first.ended:
                await take(1)
            slot = served.local.slot
            assert slot is not None
            assert slot.holds(served.active[-1])
            assert two.status is GoalStatus.ACCEPTED
            yield served, two
            await two.outcome()
        await settle()
        assert is_idle(served)


@ON_ASYNCIO
@WAITING
@pytest.mark.parametrize("turns", range(3))
@pytest.mark.parametrize("outcome", [CANCELED, SHUTDOWN], ids=["canceled", "closed"])
async def test_a_goal_ended_when_it_was_given_its_place_ends_so(options, turns, outcome):
    stage = Stage(1)
    async with half_started(stage, **options) as (served, two):
        await take(turns)
        await (two.cancel() if outcome is CANCELED else served.server.aclose())
    assert await two.outcome() == outcome
    assert stage.log.count("2 begun") == stage.log.count("2 over")


@ON_ASYNCIO
@pytest.mark.parametrize("turns", range(3))
async def test_a_goal_preempted_when_it_was_given_its_place_is_aborted(turns):
    stage = Stage(1)
    async with half_started(stage, policy="preempt") as (served, two):
        await take(turns)
        async with served.client.send_goal(goal(3), goal_id=ID) as three:
            stage.open(3)
            assert await three.result() == result(3)
    assert await two.outcome() == preempted(ID)
    assert stage.log[-2:] == ["3 begun", "3 over"]


# --- slots ----------------------------------------------------------------------------------


async def test_actions_of_one_slot_share_one_place(send):
    stage = Stage()
    shared: dict[str, Any] = {"policy": "queue", "slot": "turtle1"}
    async with lab(stage.act, **shared) as served:
        other = beside(served, "other", stage.act, **shared)
        async with sending(send, served, 1), sending(send, other, 2), sending(send, served, 3):
            assert stage.log == ["1 begun"]
            stage.open(1, 2, 3)
    assert stage.log == ["1 begun", "1 over", "2 begun", "2 over", "3 begun", "3 over"]


async def test_the_holder_of_a_slot_is_named_with_its_action(send):
    stage = Stage()
    shared: dict[str, Any] = {"policy": "reject", "slot": "turtle1"}
    async with lab(stage.act, **shared) as served:
        other = beside(served, "other", stage.act, **shared)
        async with sending(send, other, 1):
            with pytest.raises(GoalRejected, match=r"busy with goal [0-9a-f]{32} of /other$"):
                await send(served, goal(2))
            stage.open(1)


async def test_a_goal_of_another_action_preempts_in_a_slot(send):
    stage = Stage()
    shared: dict[str, Any] = {"policy": "preempt", "slot": "turtle1"}
    async with lab(stage.act, **shared) as served:
        other = beside(served, "other", stage.act, **shared)
        async with sending(send, served, 1) as (one,), sending(send, other, 2):
            assert one.value.reason.startswith("preempted by goal ")
            assert one.value.reason.endswith(" of /other")
            stage.open(2)
    assert stage.log == ["1 begun", "1 over", "2 begun", "2 over"]


@pytest.mark.parametrize(
    "options",
    [{"policy": "reject"}, {"policy": "queue", "queue_limit": 3}, {"max_active": 1}],
)
async def test_a_slot_with_other_rules_is_refused(options):
    async with lab(count, policy="queue", slot="turtle1") as served:
        with pytest.raises(
            InvalidOption, match=r"'turtle1' is already used with .*: policy='queue'"
        ):
            served.node.action_server(Count, "other", count, slot="turtle1", **options)
        assert served.node.graph().actions.keys() == {"/count"}


@pytest.mark.parametrize("options", [{}, {"policy": "parallel"}])
async def test_a_slot_without_a_policy_is_refused(options):
    with pytest.raises(InvalidOption, match=r"option 'slot': needs a policy other than"):
        async with lab(count, slot="turtle1", **options):
            pass


# --- closing --------------------------------------------------------------------------------


@WAITING
async def test_a_server_that_closes_aborts_those_that_wait_without_a_start(send, options):
    stage = Stage(1)
    async with (
        lab(stage.act, **options) as served,
        sending(send, served, 1, 2) as sent,
        running(served.server.aclose),
    ):
        assert sent[1].value == SHUTDOWN
        stage.wash(1)
    assert sent[0].value.status is GoalStatus.ABORTED
    assert stage.log == ["1 begun", "1 over"]


async def test_a_node_that_closes_starts_none_of_those_that_wait(send):
    stage = Stage()
    shared: dict[str, Any] = {"policy": "queue", "slot": "turtle1"}
    async with lab(stage.act, **shared) as served:
        other = beside(served, "other", stage.act, **shared)
        async with sending(send, served, 1), sending(send, other, 2), sending(send, served, 3):
            await served.node.aclose()
    assert stage.log == ["1 begun", "1 over"]


@pytest.mark.parametrize("policy", ["queue", "preempt"])
async def test_the_place_of_a_server_that_closes_goes_to_the_other_of_its_slot(send, policy):
    stage = Stage(1)
    shared: dict[str, Any] = {"policy": policy, "slot": "turtle1"}
    async with lab(stage.act, **shared) as served:
        other = beside(served, "other", stage.act, **shared)
        async with sending(send, served, 1), sending(send, other, 2) as (two,):
            async with running(served.server.aclose):
                assert stage.log == ["1 begun"]
                stage.wash(1)
            await settle()
            assert stage.log == ["1 begun", "1 over", "2 begun"]
            stage.open(2)
        assert two.value == succeeded(2)
        assert is_idle(other)


async def test_a_server_that_closes_leaves_the_others_of_its_slot_alone(send):
    stage = Stage()
    shared: dict[str, Any] = {"policy": "queue", "slot": "turtle1"}
    async with lab(stage.act, **shared) as served:
        other = beside(served, "other", stage.act, **shared)
        async with (
            sending(send, other, 1) as (one,),
            sending(send, served, 2) as (two,),
            sending(send, other, 3) as (three,),
        ):
            await served.server.aclose()
            stage.open(1, 3)
    assert [one.value, two.value, three.value] == [succeeded(1), SHUTDOWN, succeeded(3)]
    assert stage.log == ["1 begun", "1 over", "3 begun", "3 over"]


# --- callbacks that send goals --------------------------------------------------------------


class Errands:
    """Callbacks that send a goal each, in a task of their own."""

    def __init__(self, group: Any) -> None:
        self.group = group
        self.served: Lab
        self.outcomes: list[Any] = []

    def run(self) -> None:
        self.group.start_soon(self.send)

    async def send(self) -> None:
        try:
            self.outcomes.append(await awaited(self.served, goal(9)))
        except GoalRejected as refusal:
            self.outcomes.append(refusal)

    def on_feedback(self, message: object) -> None:
        self.run()

    def on_transition(self, handle: Any, old: GoalStatus, new: GoalStatus) -> None:
        if handle.request.upto == 1:
            self.run()

    def on_goal(self, request: Count.Goal) -> GoalResponse:
        if request.upto == 1:
            self.run()
        return GoalResponse.ACCEPT


async def say_something(request):
    await take(2)
    yield feedback(request.upto)
    await take(2)
    yield result(request.upto)


@pytest.mark.parametrize(("by", "times"), [("feedback", 1), ("hook", 3), ("goal", 1)])
async def test_a_goal_sent_by_a_callback_is_not_a_child(send, by, times):
    async with anyio.create_task_group() as group:
        errands = Errands(group)
        options: dict[str, Any] = {"goal_callback": errands.on_goal} if by == "goal" else {}
        async with lab(say_something, policy="queue", **options) as served:
            errands.served = served
            if by == "hook":
                served.node.on_transition(errands.on_transition)
            listen = errands.on_feedback if by == "feedback" else None
            assert await send(served, goal(1), feedback_callback=listen) == succeeded(1)
            await settle()
            async with sending(send, served, 2):
                pass  # behind the errands
    assert errands.outcomes == [succeeded(9)] * times


async def test_a_goal_sent_by_a_hook_is_not_a_child_of_the_one_that_caused_the_change():
    async with anyio.create_task_group() as group:
        errands = Errands(group)

        async def parent(request, handle):
            if request.upto == 5:
                await handle.node.action_client(Count, "other").send_goal(goal(1))
            return result(request.upto)

        async with lab(parent, policy="queue") as served:
            errands.served = served
            beside(served, "other", say_something)
            served.node.on_transition(errands.on_transition)
            assert await served.client.send_goal(goal(5)) == result(5)
            await settle()
    assert errands.outcomes == [succeeded(9)] * 3


# --- canceled at every point ----------------------------------------------------------------

SHARED = pytest.mark.parametrize(
    "options",
    [
        pytest.param({"policy": "reject"}, id="reject"),
        pytest.param({"policy": "queue"}, id="queue"),
        pytest.param({"max_active": 2}, id="max-active"),
        pytest.param({"policy": "queue", "queue_limit": 1}, id="queue-limit"),
        pytest.param({"policy": "preempt"}, id="preempt"),
    ],
)
STYLES = pytest.mark.parametrize("style", ["body", "stream"])


async def quietly(call, client):
    with contextlib.suppress(GoalAborted, GoalCanceled, GoalRejected, ServerUnavailable):
        await call(client)


async def crowd(client):
    """Four callers at once, each in its own way."""
    async with anyio.create_task_group() as group:
        for call in (await_it, leave_it, cancel_it, await_it):
            group.start_soon(quietly, call, client)


async def cancel_everywhere(call, style, options, *, native) -> None:
    """Cancel a call at each point while others wait too."""
    busy = Busy()
    async with lab(getattr(busy, style), **options) as served:
        await cancel_at_each_point(
            lambda: call(served.client),
            served.client,
            lambda: is_idle(served) and busy.active == 0,
            native=native,
        )


@SHARED
@STYLES
async def test_a_crowd_canceled_by_a_scope_at_any_point_leaves_nothing_behind(style, options):
    await cancel_everywhere(crowd, style, options, native=False)


@ON_ASYNCIO
@SHARED
@STYLES
async def test_a_crowd_canceled_as_a_task_at_any_point_leaves_nothing_behind(style, options):
    await cancel_everywhere(crowd, style, options, native=True)


@SHARED
@STYLES
@pytest.mark.parametrize("call", [await_it, leave_it, cancel_it])
async def test_one_of_a_crowd_canceled_at_any_point_does_not_hold_the_others_up(
    call, style, options
):
    for turns in range(40):
        busy = Busy()
        async with lab(getattr(busy, style), **options) as served:
            async with anyio.create_task_group() as group:
                group.start_soon(crowd, served.client)
                await take(turns // 4)
                was_on = await cancel_after(turns, lambda: quietly(call, served.client), False)
            assert (is_idle(served), busy.active) == (True, 0), f"after {turns} turns"
        if not was_on:
            return


@SHARED
@STYLES
async def test_a_server_closed_at_any_point_answers_a_crowd(style, options):
    for turns in range(100):
        busy, bystander = Busy(), Busy()
        shared = {**options, "slot": "turtle1"}
        async with lab(getattr(busy, style), **shared) as served:
            other = beside(served, "other", getattr(bystander, style), **shared)
            async with anyio.create_task_group() as group:
                visitors: Running[None] = Running(partial(crowd, served.client))
                group.start_soon(visitors.run)
                group.start_soon(crowd, other.client)
                await take(turns)
                was_over = visitors.done.is_set()
                await served.server.aclose()
                assert (served.active, busy.active) == ([], 0), f"after {turns} turns"
            assert (is_idle(other), bystander.active) == (True, 0), f"after {turns} turns"
            assert await other.client.send_goal(goal()) == result(1), f"after {turns} turns"
        if was_over:
            return
    pytest.fail("the crowd never went away")


@SHARED
async def test_never_more_goals_run_than_have_places(options):
    most, now = 0, 0

    async def body(request):
        nonlocal most, now
        now += 1
        most = max(most, now)
        try:
            await take(3)
        finally:
            try:
                with anyio.CancelScope(shield=True):
                    await take(3)
            finally:
                now -= 1
        return result()

    async with lab(body, **options) as served, anyio.create_task_group() as group:
        for _ in range(10):
            group.start_soon(crowd, served.client)
            await take(2)
    await take_turns()
    assert (most, now) == (options.get("max_active", 1), 0)
