"""Which goals a server takes, which it lets go, and what becomes of them when it is closed."""

from __future__ import annotations

import gc
import logging
import re
import threading

import anyio
import anyio.lowlevel
import pytest

import turtleact
from turtleact import CancelResponse, GoalResponse, GoalStatus, Outcome
from turtleact.errors import (
    Abort,
    Cancel,
    GoalAborted,
    GoalCanceled,
    GoalRejected,
    InvalidGoal,
    Reject,
    ServerUnavailable,
    TurtleactError,
)
from turtleact.goals.state import CancelCode
from turtleact.interfaces.standard import CancelGoal
from turtleact.tasks import current_tasks
from turtleact.transports import MemoryTransport

from ..lab import (
    Count,
    Gate,
    HandClock,
    answering,
    count,
    feedback,
    goal,
    hand_lab,
    lab,
    once_canceled,
    result,
    running,
    settle,
)

SECOND = 1_000_000_000
SHUTDOWN = Outcome(GoalStatus.ABORTED, result(), "shutdown")


def nanoseconds(stamp) -> int:
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def ids(response: CancelGoal.Response) -> list[bytes]:
    return [bytes(info.goal_id.uuid) for info in response.goals_canceling]


# --- taking a goal --------------------------------------------------------------------------


def accept(request):
    return GoalResponse.ACCEPT


@pytest.mark.parametrize("waits", [False, True])
@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (GoalResponse.REJECT, "the goal_callback rejected it"),
        (Reject("3 is too far"), "3 is too far"),
        (ValueError("no idea"), "the goal_callback failed: ValueError: no idea"),
        (True, "the goal_callback answered True, not a GoalResponse"),
        (None, "the goal_callback answered None, not a GoalResponse"),
    ],
)
async def test_a_goal_that_is_not_accepted_is_rejected(where, answer, reason, waits, caplog):
    async with where(count, goal_callback=answering(answer, waits=waits)) as served:
        for send in (
            served.client.send_goal,
            lambda sent: served.client.send_goal(sent).__aenter__(),
        ):
            with pytest.raises(GoalRejected) as caught:
                await send(goal())
            assert (caught.value.reason, served.active) == (reason, [])
    if isinstance(answer, ValueError):
        record = caplog.records[0]
        assert (record.name, record.levelno) == ("turtleact.server", logging.ERROR)
        assert record.getMessage() == "the goal_callback of /count failed; the goal is rejected"
        assert "no idea" in str(record.exc_info)


async def test_a_goal_that_is_canceled_while_it_is_put_to_the_callback_never_begins():
    gate, asking = Gate(), anyio.Event()

    async def callback(request):
        asking.set()
        await anyio.sleep_forever()

    async with lab(gate.wait, goal_callback=callback) as served:
        async with running(lambda: served.client.send_goal(goal())) as sent:
            await asking.wait()
            sent.scope.cancel()
        await settle()
        assert (served.active, gate.log) == ([], [])


@pytest.mark.parametrize(
    ("request_", "problem"),
    [
        pytest.param(Count.Goal(upto=2**40), r"^goal\.upto: ", id="value"),
        pytest.param(Count.Goal(upto="far"), r"^goal\.upto: ", id="type"),  # type: ignore[arg-type]
        pytest.param(feedback(1), "Count_Goal", id="message"),
        pytest.param("far", "Count_Goal", id="no-message"),
        pytest.param(None, "Count_Goal", id="nothing"),
    ],
)
@pytest.mark.parametrize("callback", [None, answering(GoalResponse.ACCEPT)])
async def test_a_goal_that_does_not_fit_its_type_is_invalid(where, request_, problem, callback):
    gate = Gate()
    async with where(gate.wait, goal_callback=callback) as served:
        with pytest.raises(InvalidGoal, match=problem):
            await served.client.send_goal(request_)
        with pytest.raises(InvalidGoal, match=problem):
            await served.client.send_goal(request_).__aenter__()
        assert (served.active, gate.log) == ([], [])


# --- ids and stamps -------------------------------------------------------------------------


async def test_both_sides_know_a_goal_by_one_stamp():
    seen: list[object] = []

    async def body(request, handle):
        seen.append(handle.stamp)
        return result()

    clock, laboratory = hand_lab(body)
    clock.advance(1.5)
    async with laboratory as served, served.client.send_goal(goal()) as handle:
        await handle.result()
        assert seen == [handle.stamp]
        assert nanoseconds(handle.stamp) == clock.now()


async def test_an_id_is_refused_while_its_goal_is_active(where):
    gate = Gate()
    async with where(gate.wait) as served, served.client.send_goal(goal(), goal_id=b"1" * 16):
        with pytest.raises(GoalRejected, match=f"still holds a goal with the id {'31' * 16}"):
            await served.client.send_goal(goal(), goal_id=b"1" * 16)
        assert len(served.active) == 1


async def test_an_id_is_refused_while_its_result_is_kept_and_taken_afterwards():
    clock, laboratory = hand_lab(count)
    async with laboratory as served:
        await served.client.send_goal(goal(), goal_id=b"1" * 16)
        clock.advance(9.9)
        with pytest.raises(GoalRejected, match="still holds"):
            await served.client.send_goal(goal(), goal_id=b"1" * 16)
        clock.advance(0.1)
        assert await served.client.send_goal(goal(), goal_id=b"1" * 16) == result(0, 1, 2)


# --- letting a goal go ----------------------------------------------------------------------


@pytest.mark.parametrize("waits", [False, True])
@pytest.mark.parametrize("answer", [CancelResponse.REJECT, ValueError("no idea"), True])
async def test_a_goal_that_the_callback_does_not_let_go_goes_on(where, answer, waits, caplog):
    gate = Gate()
    async with (
        where(gate.wait, cancel_callback=answering(answer, waits=waits)) as served,
        served.client.send_goal(goal(7)) as handle,
    ):
        response = await handle.cancel()
        assert (response.return_code, ids(response)) == (CancelCode.REJECTED, [])
        assert handle.status is GoalStatus.EXECUTING
        gate.opened.set()
        assert await handle.result() == result(7)
    if isinstance(answer, ValueError):
        told = "the cancel_callback of /count failed; the goal continues"
        assert ("turtleact.server", logging.ERROR, told) in caplog.record_tuples


class Asked:
    """A cancel_callback that lets go of some goals, by their number, and counts."""

    def __init__(self, *let_go: int) -> None:
        self.let_go = let_go
        self.log: list[int] = []

    async def __call__(self, handle):
        self.log.append(handle.request.upto)
        await anyio.lowlevel.checkpoint()
        return CancelResponse(1 + (handle.request.upto in self.let_go))


async def test_each_goal_is_asked_for_once():
    asked = Asked(2)
    async with (
        lab(Gate().wait, cancel_callback=asked) as served,
        running(lambda: served.client.send_goal(goal(1))) as first,
        running(lambda: served.client.send_goal(goal(2))) as second,
    ):
        response = await served.client.cancel_all()
        await second.done.wait()
        assert (asked.log, response.return_code) == ([1, 2], CancelCode.NONE)
        assert isinstance(second.error, GoalCanceled)
        assert not first.done.is_set()
        asked.let_go = (1,)
        await served.client.cancel_all()
    assert isinstance(first.error, GoalCanceled)


async def test_a_goal_that_is_canceling_already_is_listed_again_and_not_asked_for(where):
    asked, gate = Asked(3), Gate()
    async with (
        where(gate.tidy, cancel_callback=asked) as served,
        served.client.send_goal(goal(3)) as handle,
    ):
        await settle()
        await handle.cancel()
        response = await handle.cancel()
        assert (response.return_code, ids(response)) == (CancelCode.NONE, [handle.goal_id])
        assert asked.log == [3]
        gate.opened.set()


@pytest.mark.parametrize("kept", [10.0, 0])
async def test_a_goal_that_ends_while_it_is_asked_for_is_answered_as_terminated(where, kept):
    gate = Gate()

    async def callback(handle):
        gate.opened.set()
        await settle()
        return CancelResponse.ACCEPT

    async with (
        where(gate.wait, cancel_callback=callback, result_timeout=kept) as served,
        served.client.send_goal(goal(7)) as handle,
    ):
        response = await handle.cancel()
        assert (response.return_code, ids(response)) == (CancelCode.GOAL_TERMINATED, [])
        assert await handle.result() == result(7)


async def test_a_goal_that_has_ended_is_answered_as_terminated_while_its_result_is_kept():
    clock, laboratory = hand_lab(count)
    async with laboratory as served, served.client.send_goal(goal()) as handle:
        await handle.result()
        assert (await handle.cancel()).return_code == CancelCode.GOAL_TERMINATED
        clock.advance(10)
        assert (await handle.cancel()).return_code == CancelCode.UNKNOWN_GOAL_ID


async def test_canceling_before_a_time_means_the_goals_accepted_at_or_before_it(where):
    clock = HandClock()
    async with (
        where(Gate().wait, transport=MemoryTransport(clock)) as served,
        served.client.send_goal(goal(1)) as first,
    ):
        clock.advance(1)
        async with served.client.send_goal(goal(2)) as second:
            clock.advance(1)
            async with served.client.send_goal(goal(3)) as third:
                response = await served.client.cancel_before(second.stamp)
                assert ids(response) == [first.goal_id, second.goal_id]
                assert third.status is GoalStatus.EXECUTING


# --- closing --------------------------------------------------------------------------------


@pytest.mark.parametrize("style", ["wait", "stream"])
async def test_a_closed_server_aborts_the_goals_that_run(where, style):
    gate = Gate()
    async with (
        where(getattr(gate, style)) as served,
        served.client.send_goal(goal()) as handle,
    ):
        await gate.started.wait()
        await served.server.aclose()
        assert (await handle.outcome(), gate.log[1:]) == (SHUTDOWN, ["canceled", "over"])


async def test_a_server_that_is_closed_within_a_canceled_scope_waits_too():
    gate = Gate()
    async with lab(gate.wait) as served, running(lambda: served.client.send_goal(goal())):
        with anyio.CancelScope() as scope:
            scope.cancel()
            await served.server.aclose()
        assert gate.log[-1] == "over"


@pytest.mark.parametrize("was_canceled", [False, True])
async def test_closing_a_server_twice_lets_a_body_finish_its_clean_up(was_canceled):
    gate = Gate()
    async with lab(gate.tidy) as served, served.client.send_goal(goal()) as handle:
        await settle()
        if was_canceled:
            await handle.cancel()
        async with running(served.server.aclose), running(served.server.aclose):
            gate.opened.set()
        ends = GoalStatus.CANCELED if was_canceled else GoalStatus.ABORTED
        assert ((await handle.outcome()).status, gate.log[1:]) == (ends, ["cleaned up"])


async def set_a_partial_result(request, handle):
    handle.set_partial_result(result(7))
    await anyio.sleep_forever()


@pytest.mark.parametrize(
    ("body", "outcome"),
    [
        (once_canceled(result(7)), Outcome(GoalStatus.SUCCEEDED, result(7))),
        (
            once_canceled(Abort("up", result(7))),
            Outcome(GoalStatus.ABORTED, result(7), "up"),
        ),
        (once_canceled(Cancel(result(7))), Outcome(GoalStatus.ABORTED, result(7), "shutdown")),
        (
            once_canceled(ValueError("no")),
            Outcome(GoalStatus.ABORTED, result(), "ValueError: no"),
        ),
        (set_a_partial_result, Outcome(GoalStatus.ABORTED, result(7), "shutdown")),
    ],
)
async def test_what_a_body_says_at_the_shutdown_counts(where, body, outcome):
    async with where(body) as served, served.client.send_goal(goal()) as handle:
        await settle()
        await served.server.aclose()
        assert await handle.outcome() == outcome


class Stubborn:
    """A body that ignores its cancellation until it is let go."""

    def __init__(self) -> None:
        self.gate = Gate()

    async def body(self, request, handle):
        with anyio.CancelScope(shield=True):
            while not self.gate.opened.is_set():
                try:
                    await self.gate.opened.wait()
                except anyio.get_cancelled_exc_class():
                    self.gate.log.append("ignored")
        self.gate.log.append("ended")
        return result(7)


async def test_a_body_that_ignores_its_cancellation_is_given_up(caplog):
    stubborn = Stubborn()
    async with (
        lab(stubborn.body, grace=0.01) as served,
        served.client.send_goal(goal()) as handle,
        running(served.server.aclose) as closing,
    ):
        assert (await handle.outcome(), served.active) == (SHUTDOWN, [])
        await settle()
        assert closing.done.is_set() is current_tasks().can_let_go
        stubborn.gate.opened.set()
        await closing.done.wait()
        await settle()
        assert (await handle.outcome(), stubborn.gate.log[-1]) == (SHUTDOWN, "ended")
    given_up, *waiting = caplog.messages
    assert re.fullmatch(
        r"the body of /count ignores its cancellation at "
        rf"{re.escape(__file__)}:\d+ in Stubborn\.body, so it is given up \(goal [0-9a-f]{{32}}\)",
        given_up,
    )
    trios = ["the server of /count waits until its bodies end: trio cannot abandon a task"]
    assert waiting == ([] if current_tasks().can_let_go else trios)


async def test_a_closed_server_takes_no_more_goals(where):
    async with where(count) as served:
        await served.client.send_goal(goal())
        await served.server.aclose()
        with pytest.raises(ServerUnavailable, match="action '/count': no server answers"):
            await served.client.send_goal(goal())
        with pytest.raises(ServerUnavailable):
            await served.client.send_goal(goal()).__aenter__()


async def test_a_body_that_sends_a_goal_while_its_server_closes_is_refused():
    seen: list[BaseException] = []

    async def body(request, handle):
        client = handle.node.action_client(Count, "count")
        await client.wait_for_server()
        try:
            await anyio.sleep_forever()
        finally:
            try:
                await client.send_goal(goal())
            except (GoalRejected, ServerUnavailable) as refusal:
                seen.append(refusal)

    async with lab(body) as served, served.client.send_goal(goal()):
        await settle()
        await served.server.aclose()
    assert len(seen) == 1


# --- memory ---------------------------------------------------------------------------------

GOALS = 2_000


async def stay_flat(send) -> int:
    """How many objects more there are after many goals than after a few."""
    for _ in range(20):
        await send()
    gc.collect()
    before = len(gc.get_objects())
    for _ in range(GOALS):
        await send()
    gc.collect()
    return len(gc.get_objects()) - before


@pytest.mark.parametrize("way", ["awaited", "entered", "given id", "failing"])
async def test_many_goals_leave_nothing_behind(way, caplog):
    caplog.set_level(logging.CRITICAL)

    async def fail(request):
        raise Abort("on purpose")

    clock, laboratory = hand_lab(fail if way == "failing" else count)
    async with laboratory as served:
        number = iter(range(1, 10 * GOALS))

        async def send():
            if way == "entered":
                async with served.client.send_goal(goal()) as handle:
                    await handle.result()
                    assert handle.goal_id
            elif way == "given id":
                await served.client.send_goal(goal(), goal_id=next(number).to_bytes(16, "big"))
            elif way == "failing":
                with pytest.raises(GoalAborted):
                    await served.client.send_goal(goal())
            else:
                await served.client.send_goal(goal())
            clock.advance(1)

        assert await stay_flat(send) < GOALS // 10
        clock.advance(10)
        assert not served.local.held()


async def test_two_servers_of_one_node_do_not_share_goals():
    async with turtleact.open_node("lab") as node:
        for name in ("one", "two"):
            node.action_server(Count, name, Gate().wait)
        one, two = (node.action_client(Count, name) for name in ("one", "two"))
        async with one.send_goal(goal()) as handle:
            assert ids(await two.cancel_all()) == []
            assert handle.status is GoalStatus.EXECUTING


# --- use from elsewhere ---------------------------------------------------------------------


async def test_feedback_from_another_thread_is_refused_and_changes_nothing():
    refusals: list[BaseException] = []

    async def body(request, handle):
        def publish() -> None:
            try:
                handle.publish_feedback(feedback(1))
            except TurtleactError as refusal:
                refusals.append(refusal)

        thread = threading.Thread(target=publish)
        thread.start()
        thread.join()
        handle.publish_feedback(feedback(2))
        return result()

    async with lab(body) as served, served.client.send_goal(goal()) as handle:
        assert [message async for message in handle] == [feedback(2)]
    (refusal,) = refusals
    assert "the goal handle of action '/count' belongs to another event loop" in str(refusal)
    assert "anyio.from_thread" in str(refusal)
