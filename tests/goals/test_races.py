"""Two sides act at nearly the same moment, in every order: one legal history, and all are answered.

Each race is run many times over. Before it acts, each side lets others run for a number of turns.
All pairs of numbers occur, so that either side comes first, last, or in the middle of the other.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterator
from random import Random
from typing import Any

import anyio
import pytest

from turtleact import CancelResponse, GoalResponse, Outcome
from turtleact.errors import (
    GoalAborted,
    GoalCanceled,
    GoalRejected,
    ServerUnavailable,
    UnknownGoal,
)
from turtleact.goals.state import TRANSITIONS, CancelCode, GoalStatus
from turtleact.tasks import current_tasks

from ..lab import (
    ON_TRIO,
    TURNS,
    Count,
    Lab,
    Send,
    awaited,
    feedback,
    goal,
    hand_lab,
    lab,
    result,
    running,
    take_turns,
)

MOST_TURNS = 8
ROUNDS = 2
REPEATS = ROUNDS * MOST_TURNS**2
ACCEPTED, CANCELING = GoalStatus.ACCEPTED, GoalStatus.CANCELING
SUCCEEDED, CANCELED, ABORTED = GoalStatus.SUCCEEDED, GoalStatus.CANCELED, GoalStatus.ABORTED

LEGAL = {(old, new) for (old, _), new in TRANSITIONS.items()}


def interleavings() -> Iterator[tuple[int, int]]:
    """How many turns each side takes before it acts: each pair of numbers, in random order."""
    numbers = range(MOST_TURNS)
    pairs = list(itertools.product(numbers, numbers)) * ROUNDS
    Random(2).shuffle(pairs)
    yield from pairs


async def turns(number: int) -> None:
    """Let others run, so many times."""
    tasks = current_tasks()
    for _ in range(number):
        await tasks.checkpoint()


async def together(*sides: Callable[[], Coroutine[Any, Any, Any]]) -> None:
    """Run all sides to their ends."""
    async with anyio.create_task_group() as group:
        for side in sides:
            group.start_soon(side)


class Track:
    """Bodies that run for a number of turns, and who of them runs when.

    Args:
        clean_up: How many turns their clean-up takes, shielded.

    Attributes:
        begun: How many have begun.
        cleaned: How many have had their whole clean-up.
        running: How many run.
        most: How many have run at a time.
    """

    def __init__(self, clean_up: int = 0) -> None:
        self._clean_up = clean_up
        self.begun = self.cleaned = self.running = self.most = 0

    async def coroutine(self, goal: Count.Goal) -> Count.Result:
        self._begin()
        try:
            await turns(goal.upto)
            return result(goal.upto)
        finally:
            await self._end()

    async def generator(self, goal: Count.Goal) -> AsyncIterator[Count.Feedback | Count.Result]:
        self._begin()
        try:
            yield feedback(goal.upto)
            await turns(goal.upto)
            yield result(goal.upto)
        finally:
            await self._end()

    def _begin(self) -> None:
        self.begun += 1
        self.running += 1
        self.most = max(self.most, self.running)

    async def _end(self) -> None:
        try:
            with anyio.CancelScope(shield=True):
                await turns(self._clean_up)
            self.cleaned += 1
        finally:
            self.running -= 1


class Histories:
    """Follows the goals of a server from state to state."""

    def __init__(self, served: Lab) -> None:
        self._served = served
        self._states: dict[bytes, list[GoalStatus]] = {}
        served.node.on_transition(self._note)

    def _note(self, handle: Any, old: GoalStatus, new: GoalStatus) -> None:
        states = self._states.setdefault(handle.goal_id, [])
        assert old is (states[-1] if states else GoalStatus.UNKNOWN)
        states.append(new)

    def __len__(self) -> int:
        return len(self._states)

    def check(self, number: int) -> None:
        """So many goals, each from its acceptance to its end by legal steps, and none is left."""
        assert len(self._states) == number
        for states in self._states.values():
            assert states[0] is ACCEPTED
            assert states[-1].is_terminal
            assert all(step in LEGAL for step in itertools.pairwise(states))
        assert self._served.active == []


async def outcome_of(sending: Awaitable[Count.Result]) -> Outcome[Count.Result]:
    """How a goal ends that is awaited."""
    try:
        return Outcome(SUCCEEDED, await sending)
    except GoalCanceled as end:
        return Outcome(CANCELED, end.result, end.reason)
    except GoalAborted as end:
        return Outcome(ABORTED, end.result, end.reason)


@pytest.fixture(params=["coroutine", "generator"])
def style(request) -> str:
    name: str = request.param
    return name


async def race_with_a_cancel(
    track: Track, style: str, send: Send
) -> Counter[tuple[GoalStatus, CancelCode]]:
    """Goals that end as they are canceled: how they end, and what who cancels is answered."""
    seen = Counter[tuple[GoalStatus, CancelCode]]()
    async with lab(getattr(track, style)) as served:
        histories = Histories(served)
        for number, (until_end, until_cancel) in enumerate(interleavings(), 1):
            goal_id = number.to_bytes(16, "big")
            ends: list[Outcome[Count.Result]] = []
            codes: list[CancelCode] = []

            async def run(upto=until_end, goal_id=goal_id, ends=ends):
                ends.append(await send(served, goal(upto), goal_id=goal_id))

            async def cancel(wait=until_cancel, goal_id=goal_id, codes=codes):
                await turns(wait)
                codes.append(CancelCode((await served.local.cancel(goal_id, 0)).return_code))

            await together(run, cancel)
            seen[ends[0].status, codes[0]] += 1
        histories.check(REPEATS)
    return seen


async def test_a_goal_that_is_canceled_as_it_ends_is_canceled_or_was_too_late(send, style):
    seen = await race_with_a_cancel(Track(), style, send)
    ends = {(CANCELED, CancelCode.NONE), (SUCCEEDED, CancelCode.GOAL_TERMINATED)}
    not_yet_sent = {(SUCCEEDED, CancelCode.UNKNOWN_GOAL_ID)}
    assert ends <= seen.keys() <= ends | not_yet_sent


@ON_TRIO  # on asyncio a cancel breaks into a shield that it finds the body in
async def test_a_shielded_clean_up_is_whole_whenever_the_cancel_comes(send, style):
    track = Track(clean_up=3)
    seen = await race_with_a_cancel(track, style, send)
    assert track.cleaned == track.begun
    assert {(CANCELED, CancelCode.NONE), (SUCCEEDED, CancelCode.NONE)} <= seen.keys()


async def test_a_goal_that_is_preempted_as_it_ends_has_succeeded_or_is_aborted(send, style):
    track, seen = Track(), Counter[object]()
    async with lab(getattr(track, style), policy="preempt") as served:
        histories = Histories(served)
        for until_end, until_send in interleavings():
            ends: dict[str, Outcome[Count.Result]] = {}

            async def run(upto=until_end, ends=ends):
                ends["first"] = await send(served, goal(upto))

            async def preempt(wait=until_send, ends=ends):
                await turns(wait)
                ends["second"] = await send(served, goal(1))

            await together(run, preempt)
            seen[ends["first"].status, ends["second"].status] += 1
            reasons = [end.reason for end in ends.values() if end.status is not SUCCEEDED]
            assert all(reason.startswith("preempted by goal ") for reason in reasons)
        histories.check(2 * REPEATS)
    assert track.most == 1
    assert seen.keys() >= {(SUCCEEDED, SUCCEEDED), (ABORTED, SUCCEEDED)}


@pytest.mark.parametrize("asks", [False, True])
async def test_a_goal_that_is_sent_as_its_server_closes_is_answered(send, style, asks):
    async def take(goal):
        await turns(2)
        return GoalResponse.ACCEPT

    track, seen = Track(), Counter[object]()
    options: dict[str, Any] = {"goal_callback": take} if asks else {}
    body = getattr(track, style)
    for until_close, until_send in interleavings():
        async with lab(body, **options) as served:

            async def run(wait=until_send, served=served):
                await turns(wait)
                try:
                    end = await send(served, goal(2))
                except (ServerUnavailable, GoalRejected) as error:
                    seen[type(error)] += 1
                else:
                    seen[end.status] += 1
                    assert end.reason == ("" if end.status is SUCCEEDED else "shutdown")

            async def close(wait=until_close, served=served):
                await turns(wait)
                await served.server.aclose()
                assert (track.running, served.active) == (0, [])

            await together(run, close)
    ends = {SUCCEEDED, ABORTED, ServerUnavailable}
    assert seen.keys() == (ends | {GoalRejected} if asks else ends)
    assert seen.total() == REPEATS
    assert track.cleaned == track.begun <= seen[SUCCEEDED] + seen[ABORTED]


@pytest.mark.parametrize("asks", [False, True])
async def test_of_two_cancels_at_once_each_is_answered_and_one_takes_effect(style, asks):
    async def agree(handle):
        await turns(2)
        return CancelResponse.ACCEPT

    track, seen = Track(), Counter[object]()
    options: dict[str, Any] = {"cancel_callback": agree} if asks else {}
    async with lab(getattr(track, style), **options) as served:
        histories = Histories(served)
        for waits in interleavings():
            async with served.client.send_goal(goal(10 * MOST_TURNS)) as handle:
                codes: list[CancelCode] = []

                async def cancel(wait, handle=handle, codes=codes):
                    await turns(wait)
                    response = await handle.cancel()
                    codes.append(CancelCode(response.return_code))
                    assert len(response.goals_canceling) == (codes[-1] is CancelCode.NONE)

                await together(lambda: cancel(waits[0]), lambda: cancel(waits[1]))  # noqa: B023
                assert (await handle.outcome()).status is CANCELED
            seen[tuple(codes)] += 1
        histories.check(REPEATS)
    assert (track.running, track.cleaned) == (0, track.begun)
    assert seen.keys() == {
        (CancelCode.NONE, CancelCode.NONE),
        (CancelCode.NONE, CancelCode.GOAL_TERMINATED),
    }


async def test_who_attaches_as_a_result_expires_gets_the_same_or_hears_that_it_is_unknown():
    clock, served_for_now = hand_lab(Track().coroutine, result_timeout=1.0)
    seen = Counter[object]()
    async with served_for_now as served:
        for until_expiry, until_attach in interleavings():
            async with served.client.send_goal(goal(2)) as handle:
                await handle.result()

            async def expire(wait=until_expiry):
                await turns(wait)
                clock.advance(1.0)
                await outcome_of(served.client.send_goal(goal(0), goal_id=b"later".ljust(16)))

            async def attach(wait=until_attach, goal_id=handle.goal_id):
                await turns(wait)
                try:
                    other = await served.client.attach(goal_id)
                except UnknownGoal:
                    seen["unknown"] += 1
                else:
                    await turns(wait)
                    assert await other.outcome() == Outcome(SUCCEEDED, result(2))
                    seen["attached"] += 1

            await together(expire, attach)
            clock.advance(1.0)
    assert seen.keys() == {"attached", "unknown"}


async def test_a_block_that_is_left_as_its_goal_ends_leaves_nothing_behind(style):
    track, seen = Track(), Counter[object]()
    async with lab(getattr(track, style)) as served:
        histories = Histories(served)
        for until_end, until_leave in interleavings():
            async with served.client.send_goal(goal(until_end)) as handle:
                await turns(until_leave)
            assert track.running == 0
            seen[handle.status] += 1
        histories.check(REPEATS)
    assert seen.keys() == {SUCCEEDED, CANCELED}


async def test_a_waiter_who_is_canceled_as_the_goal_ends_leaves_nothing_behind(send, style):
    track, seen = Track(), Counter[object]()
    async with lab(getattr(track, style)) as served:
        histories = Histories(served)
        for until_end, until_cancel in interleavings():
            scope = anyio.CancelScope()
            ends: list[Outcome[Count.Result]] = []

            async def run(upto=until_end, scope=scope, ends=ends):
                with scope:
                    ends.append(await send(served, goal(upto)))

            async def cancel(wait=until_cancel, scope=scope):
                await turns(wait)
                scope.cancel()

            await together(run, cancel)
            assert track.running == 0
            seen[ends[0].status if ends else "canceled"] += 1
        histories.check(len(histories))
    assert seen.keys() == {SUCCEEDED, "canceled"}


# --- not races, but found with them -----------------------------------------------------------


@ON_TRIO  # on asyncio a cancel breaks into a shield that it finds the body in
async def test_a_clean_up_goes_on_if_others_cancel_a_goal_that_its_waiter_has_left(style):
    track = Track(clean_up=2 * TURNS)
    async with (
        lab(getattr(track, style)) as served,
        running(lambda: awaited(served, goal(10 * TURNS))) as waiter,
    ):
        waiter.scope.cancel()
        await turns(MOST_TURNS)
        await served.client.cancel_all()
        await waiter.done.wait()
    assert track.cleaned == track.begun == 1


@ON_TRIO  # on asyncio a cancel breaks into a shield that it finds the body in
async def test_a_parent_that_is_canceled_as_it_waits_for_a_child_waits_on():
    track = Track(clean_up=2 * TURNS)

    async def parent(goal, handle):
        try:
            async with handle.node.action_client(Count, "child").send_goal(goal):
                await turns(MOST_TURNS)
        finally:
            running_at_its_end.append(track.running)

    running_at_its_end: list[int] = []
    async with lab(parent) as served:
        served.node.action_server(Count, "child", track.coroutine)
        async with served.client.send_goal(goal(10 * TURNS)) as handle:
            await turns(TURNS)
            assert track.running == 1
            await handle.cancel()
            await handle.outcome()
    assert running_at_its_end == [0]


async def test_the_reason_of_a_goal_left_behind_while_it_is_canceled_is_the_shutdown():
    track = Track(clean_up=2 * TURNS)
    async with (
        lab(track.coroutine, grace=0) as served,
        served.client.send_goal(goal(10 * TURNS)) as handle,
    ):
        await turns(MOST_TURNS)
        await handle.cancel()
        await served.server.aclose()
        assert await handle.outcome() == Outcome(ABORTED, result(), "shutdown")
        await take_turns()


async def test_a_cancel_callback_is_not_asked_of_a_goal_that_has_ended_meanwhile():
    async def agree(handle):
        asked.append(handle.status)
        await turns(TURNS)
        return CancelResponse.ACCEPT

    asked: list[GoalStatus] = []
    async with (
        lab(Track().coroutine, cancel_callback=agree) as served,
        served.client.send_goal(goal(10 * TURNS)),
        served.client.send_goal(goal(TURNS // 2)) as quick,
    ):
        response = await served.client.cancel_all()
        assert (quick.status, len(response.goals_canceling)) == (SUCCEEDED, 1)
        assert asked == [GoalStatus.EXECUTING]
