"""What a client sees of a goal, its own or that of others, and how it cancels one."""

from __future__ import annotations

import uuid
from functools import partial

import anyio
import pytest

import turtleact
from turtleact import CancelResponse, GoalStatus
from turtleact.errors import (
    Abort,
    GoalAborted,
    GoalCanceled,
    InvalidName,
    UnknownGoal,
)
from turtleact.goals.client_handle import FeedbackReceived, Outcome, StatusChanged
from turtleact.goals.state import CancelCode, FeedbackLog
from turtleact.transports import MemoryTransport

from ..lab import (
    TURNS,
    Count,
    Gate,
    HandClock,
    answering,
    apart,
    count,
    feedback,
    goal,
    lab,
    once_canceled,
    result,
    running,
    settle,
    take_turns,
)

KEPT = FeedbackLog.KEPT
MANY = 5 * KEPT
ID = bytes(range(16))


async def many(request):
    for number in range(MANY):
        yield feedback(number)
    yield result(MANY)


async def fail(request):
    yield feedback(1)
    raise Abort("no pen")


class Cleaning(Gate):
    """A generator body that gives feedback before its cancellation and after it."""

    async def stream(self, goal):
        yield feedback(1)
        try:
            await anyio.sleep_forever()
        finally:
            yield feedback(2)
            yield feedback(3)


def short(event):
    """An event in a word, or as the numbers of its feedback."""
    match event:
        case StatusChanged(status=status):
            assert event.kind == "status"
            return status.name
        case FeedbackReceived(feedback=message):
            assert event.kind == "feedback"
            return message.so_far[-1]
        case _:
            return event.kind


async def told(handle):
    return [short(event) async for event in handle.events()]


# --- events -----------------------------------------------------------------------------------


READ = pytest.mark.parametrize("is_late", [False, True], ids=["early", "late"])


async def read(handle, is_late, act=None):
    """Read all events while the goal runs, or after its end; meanwhile something is done."""
    if is_late:
        if act is not None:
            await settle()
            await act()
        await handle.outcome()
        return await told(handle)
    async with running(lambda: told(handle)) as reader:
        await settle()
        if act is not None:
            await act()
    return reader.value


async def cancel(served, handle):
    await handle.cancel()


async def close(served, handle):
    await served.server.aclose()


async def preempt(served, handle):
    async with served.client.send_goal(goal()):
        await settle()


@READ
@pytest.mark.parametrize(
    ("body", "act", "expected"),
    [
        (count, None, ["EXECUTING", 0, 1, 2, "SUCCEEDED"]),
        (fail, None, ["EXECUTING", 1, "ABORTED"]),
        (Cleaning().stream, cancel, ["EXECUTING", 1, "CANCELING", 2, 3, "CANCELED"]),
        (once_canceled(result(7)), cancel, ["EXECUTING", "CANCELING", "SUCCEEDED"]),
        (None, close, ["EXECUTING", 0, "ABORTED"]),
        (None, preempt, ["EXECUTING", 0, "ABORTED"]),
    ],
)
async def test_the_events_of_a_goal_tell_its_whole_story(where, is_late, body, act, expected):
    options = {"policy": "preempt"} if act is preempt else {}
    async with (
        where(body or Gate().stream, **options) as served,
        served.client.send_goal(goal()) as handle,
    ):
        events = await read(handle, is_late, act and partial(act, served, handle))
        assert events == ["accepted", *expected, "result"]


@READ
async def test_the_events_of_a_goal_that_waits_for_its_turn(is_late):
    gate = Gate()
    async with (
        lab(gate.stream, policy="queue") as served,
        served.client.send_goal(goal()) as _,
        served.client.send_goal(goal()) as handle,
        served.client.send_goal(goal()) as canceled,
    ):

        async def act():
            assert handle.status is GoalStatus.ACCEPTED
            gate.opened.set()

        canceling = ["accepted", "CANCELING", "CANCELED", "result"]
        assert await read(canceled, is_late, canceled.cancel) == canceling
        whole = ["accepted", "EXECUTING", 0, "SUCCEEDED", "result"]
        assert await read(handle, is_late, act) == whole


async def test_each_event_bears_what_there_is_to_know(where):
    async with where(count) as served, served.client.send_goal(goal(1), goal_id=ID) as handle:
        assert [event async for event in handle.events()] == [
            turtleact.Accepted(ID, handle.stamp),
            StatusChanged(GoalStatus.EXECUTING),
            FeedbackReceived(feedback(0)),
            StatusChanged(GoalStatus.SUCCEEDED),
            turtleact.ResultReceived(Outcome(GoalStatus.SUCCEEDED, result(0))),
        ]


async def test_events_of_which_feedback_was_missed_come_in_order():
    async def body(request, handle):
        handle.publish_feedback(feedback(-1))
        try:
            await anyio.sleep_forever()
        finally:
            for number in range(MANY):
                handle.publish_feedback(feedback(number))

    async with lab(body) as served, served.client.send_goal(goal()) as handle:
        await settle()
        await handle.cancel()
        await handle.outcome()
        events = await told(handle)
        read = events[3:-2]
        assert events[:3] == ["accepted", "EXECUTING", "CANCELING"]
        assert events[-2:] == ["CANCELED", "result"]
        assert read == list(range(MANY - len(read), MANY))
        assert handle.missed == 1 + MANY - len(read)


async def test_events_lose_nothing_to_a_sender_that_reads_them():
    async with lab(many) as served, served.client.send_goal(goal()) as handle:
        expected = ["accepted", "EXECUTING", *range(MANY), "SUCCEEDED", "result"]
        assert (await told(handle), handle.missed) == (expected, 0)


async def test_an_iteration_that_is_over_stays_so():
    async with lab(count) as served, served.client.send_goal(goal(0)) as handle:
        events = handle.events()
        assert [short(event) async for event in events][-1] == "result"
        with pytest.raises(StopAsyncIteration):
            await anext(events)


async def test_a_second_iteration_tells_all_but_the_feedback_again():
    async with lab(count) as served, served.client.send_goal(goal(2)) as handle:
        await told(handle)
        assert await told(handle) == ["accepted", "EXECUTING", "SUCCEEDED", "result"]


async def test_events_and_feedback_are_read_from_one_stream():
    async with lab(count) as served, served.client.send_goal(goal(2)) as handle:
        assert await anext(aiter(handle)) == feedback(0)
        assert await told(handle) == ["accepted", "EXECUTING", 1, "SUCCEEDED", "result"]
        assert [message async for message in handle] == []


async def test_two_readers_of_events_share_the_feedback_and_each_hear_the_rest():
    gate = Gate()
    async with lab(gate.stream) as served, served.client.send_goal(goal()) as handle:
        async with running(lambda: told(handle)) as one, running(lambda: told(handle)) as other:
            await settle()
            gate.opened.set()
        both = [one.value, other.value]
        assert sorted(map(len, both)) == [4, 5]
        assert sum(events.count(0) for events in both) == 1
        for events in both:
            assert [event for event in events if event] == [
                "accepted",
                "EXECUTING",
                "SUCCEEDED",
                "result",
            ]


async def test_canceling_who_waits_for_an_event_loses_nothing():
    gate = Gate()
    async with lab(gate.stream) as served, served.client.send_goal(goal()) as handle:
        events = handle.events()
        seen = [short(await anext(events)) for _ in range(3)]
        async with running(lambda: anext(events)) as waiter:
            assert not waiter.done.is_set()
            waiter.scope.cancel()
        gate.opened.set()
        seen += [short(event) async for event in events]
        assert seen == ["accepted", "EXECUTING", 0, "SUCCEEDED", "result"]


# --- taking hold of a goal of others ----------------------------------------------------------


@pytest.mark.parametrize("goal_id", [ID, ID.hex(), uuid.UUID(bytes=ID)], ids=type)
async def test_a_goal_that_runs_can_be_taken_hold_of(goal_id):
    gate = Gate()
    async with lab(gate.wait) as served, served.client.send_goal(goal(7), goal_id=ID) as sent:
        other = served.node.action_client(Count, "count")
        handle = await other.attach(goal_id)
        assert (handle.goal_id, handle.stamp, handle.status) == (ID, sent.stamp, sent.status)
        gate.opened.set()
        assert await handle.result() == result(7)


async def test_a_goal_that_waits_can_be_taken_hold_of():
    gate = Gate()
    async with (
        lab(gate.stream, policy="queue") as served,
        served.client.send_goal(goal()) as _,
        served.client.send_goal(goal(7), goal_id=ID) as _,
        served.client.attach(ID) as handle,
    ):
        assert handle.status is GoalStatus.ACCEPTED
        gate.opened.set()
        assert await told(handle) == ["accepted", "EXECUTING", 0, "SUCCEEDED", "result"]


async def test_a_goal_that_was_never_held_is_unknown(where):
    async with where(count) as served:
        with pytest.raises(UnknownGoal, match=rf"'/count' holds no goal {ID.hex()}$"):
            await served.client.attach(ID)
        with pytest.raises(UnknownGoal):
            await served.client.attach(ID).__aenter__()


async def test_what_is_no_goal_id_is_refused():
    async with lab(count) as served:
        with pytest.raises(InvalidName, match="a goal id has"):
            served.client.attach(b"1")


async def test_who_takes_hold_of_an_awaited_goal_gets_its_feedback_from_then_on():
    first, second = anyio.Event(), anyio.Event()

    async def body(request):
        yield feedback(0)
        await first.wait()
        yield feedback(1)
        await second.wait()
        yield feedback(2)
        yield result(3)

    async with (
        lab(body) as served,
        running(lambda: served.client.send_goal(goal(), goal_id=ID)) as sent,
    ):
        async with served.client.attach(ID) as handle:
            first.set()
            async with running(lambda: told(handle)) as reader:
                second.set()
            assert reader.value == ["accepted", "EXECUTING", 1, 2, "SUCCEEDED", "result"]
        await sent.done.wait()
        assert sent.value == result(3)


async def test_leaving_a_goal_of_others_lets_it_go_on(where):
    gate = Gate()
    async with where(gate.wait) as served, served.client.send_goal(goal(7), goal_id=ID) as sent:
        async with served.client.attach(ID):
            pass
        with pytest.raises(ValueError, match="mine"):
            async with served.client.attach(ID):
                raise ValueError("mine")
        await settle()
        assert sent.status is GoalStatus.EXECUTING
        gate.opened.set()
        assert await sent.result() == result(7)


async def test_a_goal_of_others_can_be_canceled(where):
    async with (
        where(Gate().wait) as served,
        served.client.send_goal(goal(), goal_id=ID) as sent,
        served.client.attach(ID) as handle,
    ):
        assert (await handle.cancel()).return_code == CancelCode.NONE
        with pytest.raises(GoalCanceled):
            await handle.result()
        assert sent.status is GoalStatus.CANCELED


async def test_the_failure_of_a_goal_of_others_is_told(where):
    async with where(fail) as served, served.client.send_goal(goal(), goal_id=ID):
        handle = await served.client.attach(ID)
        assert (await handle.outcome()).reason == "no pen"
        with pytest.raises(GoalAborted, match="no pen"):
            await handle.result()


async def test_an_observer_that_never_reads_on_holds_nobody_up_and_keeps_the_newest():
    async with (
        lab(many) as served,
        served.client.send_goal(goal(), goal_id=ID) as sent,
        served.client.attach(ID) as lazy,
        served.client.attach(ID) as idle,
    ):
        reading = aiter(lazy)
        assert await sent.result() == result(MANY)
        rest = [message.so_far[0] async for message in reading]
        assert rest == list(range(MANY - len(rest), MANY))
        assert KEPT <= len(rest) < 2 * KEPT
        assert (lazy.missed, idle.missed) == (MANY - len(rest), 0)


async def test_an_observer_that_reads_ahead_does_not_make_the_sender_lose_anything():
    async with lab(many) as served, served.client.send_goal(goal(), goal_id=ID) as sent:
        reading = aiter(sent)
        observer = await served.client.attach(ID)
        async with running(lambda: told(observer)) as beside:
            for _ in range(MANY // TURNS):
                await take_turns()
            assert not beside.done.is_set()
            assert [message.so_far[0] async for message in reading] == list(range(MANY))
        assert sent.missed == 0


async def test_an_observer_that_is_left_does_not_end_the_reading_of_the_sender():
    async with lab(many) as served, served.client.send_goal(goal(), goal_id=ID) as sent:
        reading = aiter(sent)
        await anext(reading)
        observer = await served.client.attach(ID)
        async for _ in observer:
            break
        await settle()
        rest = [message.so_far[0] async for message in reading]
        assert (rest, sent.missed) == (list(range(1, MANY)), 0)


# --- results ----------------------------------------------------------------------------------


async def test_sender_and_observers_all_get_one_answer_before_and_after_the_end():
    gate = Gate()
    async with lab(gate.wait) as served, served.client.send_goal(goal(7), goal_id=ID) as sent:
        handles = [sent, *[await served.client.attach(ID) for _ in range(5)]]
        answers = []

        async def ask(handle):
            answers.append(await handle.result())

        async with anyio.create_task_group() as group:
            for handle in handles * 2:
                group.start_soon(ask, handle)
            await settle()
            assert answers == []
            gate.opened.set()
        late = [await handle.result() for handle in handles]
        assert answers + late == [result(7)] * 18


@pytest.mark.parametrize(
    ("where", "timeout"), [(lab, 0), (lab, 0.001), (lab, None), (apart, None), (apart, 10.0)]
)
async def test_a_result_is_kept_from_the_end_on(where, timeout):
    gate, clock = Gate(), HandClock()
    laboratory = where(gate.wait, transport=MemoryTransport(clock), result_timeout=timeout)
    async with laboratory as served, served.client.send_goal(goal(7), goal_id=ID) as sent:
        clock.advance(100)
        assert not (await served.client.attach(ID)).done
        gate.opened.set()
        await sent.result()
        clock.advance(0.99 * (timeout or 0) if timeout is not None else 1e9)
        if timeout != 0:
            async with served.client.attach(ID) as kept:
                assert (kept.done, await kept.result()) == (True, result(7))
        clock.advance(0.01 * (timeout or 0))
        if timeout is not None:
            with pytest.raises(UnknownGoal):
                await served.client.attach(ID)


# --- canceling without waiting ----------------------------------------------------------------


async def test_a_goal_can_be_canceled_without_waiting(where):
    gate = Gate()
    async with where(gate.wait) as served, served.client.send_goal(goal()) as handle:
        await settle()
        handle.cancel_nowait()
        assert (await handle.outcome()).status is GoalStatus.CANCELED
        assert gate.log == ["begun", "canceled", "over"]


@pytest.mark.parametrize("waits", [False, True])
async def test_the_cancel_callback_may_refuse_who_does_not_wait(where, waits):
    gate, refuse = Gate(), answering(CancelResponse.REJECT, waits=waits)
    async with (
        where(gate.wait, cancel_callback=refuse) as served,
        served.client.send_goal(goal(7)) as handle,
    ):
        await settle()
        handle.cancel_nowait()
        await take_turns()
        await settle()
        assert handle.status is GoalStatus.EXECUTING
        gate.opened.set()
        assert await handle.result() == result(7)


async def test_the_cancel_callback_is_asked_once_at_a_time():
    asked = []

    async def ask(handle):
        asked.append(handle.goal_id)
        await anyio.sleep_forever()

    async with (
        lab(Gate().wait, cancel_callback=ask) as served,
        served.client.send_goal(goal(), goal_id=ID) as handle,
    ):
        handle.cancel_nowait()
        handle.cancel_nowait()
        await settle()
        assert asked == [ID]
        handle.detach()


async def test_canceling_without_waiting_after_the_end_asks_nobody_and_changes_nothing():
    asked: list[object] = []
    async with (
        lab(count, cancel_callback=asked.append) as served,
        served.client.send_goal(goal(1)) as handle,
    ):
        await handle.result()
        handle.cancel_nowait()
        await settle()
        assert (await handle.outcome(), asked) == (Outcome(GoalStatus.SUCCEEDED, result(0)), [])
