"""How a body is carried out and how it ends, in both styles, awaited and entered, on every loop."""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Awaitable, Callable
from contextvars import ContextVar
from functools import partial
from typing import Any

import anyio
import anyio.lowlevel
import pytest

from turtleact import GoalStatus, Outcome
from turtleact.errors import (
    LONGEST,
    Abort,
    Cancel,
    InvalidMessage,
)
from turtleact.goals.running import BURST
from turtleact.goals.state import FeedbackLog

from ..lab import (
    ON_ASYNCIO,
    Count,
    awaited,
    feedback,
    goal,
    lab,
    once_canceled,
    result,
    running,
)


async def end_of(body, send, **options):
    """How a goal with this body ends."""
    async with lab(body, **options) as served:
        return await send(served, goal())


async def canceled_end_of(body, send, where=lab, **options):
    """How a goal with this body ends if a client cancels it once it waits."""
    async with (
        where(body, **options) as served,
        running(lambda: send(served, goal())) as sent,
    ):
        await served.client.cancel_all()
        await sent.done.wait()
        return sent.value


def in_both_styles(act: Callable[[], Awaitable[object]]) -> list[Any]:
    """Two bodies that do the same, one of each style: what ``act`` returns is the result."""

    async def coroutine(goal):
        return await act()

    async def generator(goal):
        outcome = await act()
        if outcome is not None:
            yield outcome

    name = getattr(act, "__name__", "act")
    return [
        pytest.param(coroutine, id=f"coroutine-{name}"),
        pytest.param(generator, id=f"generator-{name}"),
    ]


def both_styles(act: Callable[[], Awaitable[object]]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("body", in_both_styles(act))


def ending(end: object, *, waits: bool) -> list[Any]:
    """Bodies of both styles that return or raise something, at once or after a wait."""

    async def act() -> object:
        if waits:
            await anyio.lowlevel.checkpoint()
        if isinstance(end, BaseException):
            raise end
        return end

    return in_both_styles(act)


def matches(outcome: Outcome[Any], status: GoalStatus, reached: Any, reason: str) -> bool:
    """Whether a goal has ended so; the reason is a pattern for its whole text."""
    is_so = (outcome.status, outcome.result) == (status, reached)
    return is_so and re.fullmatch(reason, outcome.reason) is not None


# --- how a body ends ------------------------------------------------------------------------

SUCCEEDED, ABORTED, CANCELED = GoalStatus.SUCCEEDED, GoalStatus.ABORTED, GoalStatus.CANCELED
ABORT = Abort("the pen is empty", result(7))
NO_RESULT = "no result: (the last value yielded must be|the body must return) a Result"
NO_FIT = r"(the pen is empty )?\(its result does not fit: .*"

ENDS = [
    (result(1, 2), SUCCEEDED, result(1, 2), ""),
    (None, ABORTED, result(), NO_RESULT),
    (ABORT, ABORTED, result(7), "the pen is empty"),
    (Abort("the pen is empty"), ABORTED, result(), "the pen is empty"),
    (Abort("the pen is empty", feedback(7)), ABORTED, result(), NO_FIT),
    (ValueError("no pen"), ABORTED, result(), "ValueError: no pen"),
    (Cancel(result(5)), ABORTED, result(), "Cancel.*"),  # nobody has asked for it
]
ENDS_ONCE_CANCELED = [
    (result(1, 2), SUCCEEDED, result(1, 2), ""),
    (None, ABORTED, result(), NO_RESULT),
    (ABORT, ABORTED, result(7), "the pen is empty"),
    (Cancel(), CANCELED, result(), ""),
    (Cancel(result(5)), CANCELED, result(5), ""),
    (Cancel(feedback(5)), CANCELED, result(), NO_FIT),
]


@pytest.mark.parametrize(
    ("body", "end"),
    [
        (each.values[0], end)
        for end in ENDS
        for waits in (False, True)
        for each in ending(end[0], waits=waits)
    ],
)
async def test_a_goal_ends_as_its_body_does(body, end, send):
    _, *expected = end
    assert matches(await end_of(body, send), *expected)


@pytest.mark.parametrize(
    ("body", "end"),
    [
        (each.values[0], end)
        for end in ENDS_ONCE_CANCELED
        for each in in_both_styles(once_canceled(end[0]))
    ],
)
async def test_a_goal_that_is_canceled_ends_as_its_body_does(body, end, send):
    _, *expected = end
    assert matches(await canceled_end_of(body, send), *expected)


@pytest.mark.parametrize("is_failure", [False, True])
async def test_a_failure_of_a_body_is_logged_and_an_abort_is_not(is_failure, caplog):
    end = ValueError("no pen") if is_failure else ABORT
    for each in ending(end, waits=False):
        await end_of(each.values[0], awaited)
    assert len(caplog.records) == 2 * is_failure
    for record in caplog.records:
        assert (record.name, record.levelno) == ("turtleact.server", logging.ERROR)
        assert re.fullmatch(r"the body of /count failed \(goal [0-9a-f]{32}\)", record.getMessage())
        assert record.exc_info is not None
        assert str(record.exc_info[1]) == "no pen"


async def return_feedback(goal):
    return feedback(1)


async def yield_a_goal(goal):
    yield Count.Goal(upto=1)


@pytest.mark.parametrize(
    ("body", "expected", "found"),
    [
        pytest.param(return_feedback, "Count_Result", "Feedback", id="returned"),
        pytest.param(yield_a_goal, "Count_Feedback", "Goal", id="yielded"),
    ],
)
async def test_the_reason_of_a_wrong_type_names_both(send, body, expected, found):
    reason = (await end_of(body, send)).reason
    assert expected in reason
    assert found in reason


async def test_a_result_with_a_value_that_does_not_fit_is_aborted_with_its_path(send):
    async def body(goal):
        return Count.Result(counted=[1, "two"])  # type: ignore[list-item]  # on purpose

    outcome = await end_of(body, send)
    assert outcome.status is GoalStatus.ABORTED
    assert "result.counted[1]" in outcome.reason


# --- behind the result ----------------------------------------------------------------------


async def yield_again(goal):
    yield result(1)
    yield feedback(2)


async def yield_another_result(goal):
    yield result(1)
    yield result(2)


async def fail_behind(goal):
    yield result(1)
    raise ValueError("behind the result")


async def wait_behind(goal):
    yield result(1)
    await anyio.sleep_forever()


async def cancel_behind(goal):
    yield result(1)
    raise await a_cancellation()


async def fail_when_closed(goal):
    try:
        yield result(1)
        yield feedback(2)
    finally:
        raise ValueError("in the clean-up")


async def wait_when_closed(goal):
    try:
        yield result(1)
        yield feedback(2)
    finally:
        await anyio.lowlevel.checkpoint()


async def refuse_to_close(goal):
    try:
        yield result(1)
        yield feedback(2)
    finally:
        yield feedback(3)


async def a_cancellation() -> BaseException:
    """The exception of a cancellation, taken from a scope that has ended."""
    caught: list[BaseException] = []
    with anyio.CancelScope() as scope:
        scope.cancel()
        try:
            await anyio.sleep_forever()
        except anyio.get_cancelled_exc_class() as cancellation:
            caught.append(cancellation)
    return caught.pop()


@pytest.mark.parametrize(
    ("body", "level", "said"),
    [
        (yield_again, logging.WARNING, "yielded Feedback after its result"),
        (yield_another_result, logging.WARNING, "yielded Result after its result"),
        (fail_behind, logging.ERROR, "failed after it had yielded its result"),
        (wait_behind, logging.INFO, "canceled after it had yielded its result"),
        (cancel_behind, logging.INFO, "canceled after it had yielded its result"),
        (fail_when_closed, logging.ERROR, "failed after it had yielded its result"),
        (wait_when_closed, logging.WARNING, "yielded Feedback after its result"),
        (refuse_to_close, logging.ERROR, "failed after it had yielded its result"),
    ],
)
async def test_a_result_stands_whatever_the_body_does_behind_it(body, send, level, said, caplog):
    caplog.set_level(logging.INFO)
    heard: list[object] = []
    async with lab(body) as served:
        sending = partial(send, served, goal(), feedback_callback=heard.append)
        async with running(sending) as sent:
            await served.client.cancel_all()
        assert sent.value == Outcome(GoalStatus.SUCCEEDED, result(1))
    last = caplog.records[-1]
    assert (last.name, last.levelno, heard) == ("turtleact.server", level, [])
    assert said in last.getMessage()


async def fail():
    await anyio.lowlevel.checkpoint()
    raise ValueError("no pen")


# --- partial results ------------------------------------------------------------------------


async def fail_half_way(goal, handle):
    handle.set_partial_result(result(1, 2))
    raise ValueError("no pen")


async def wait_half_way(goal, handle):
    handle.set_partial_result(result(1, 2))
    await anyio.sleep_forever()


async def change_what_was_reached(goal, handle):
    reached = result(1, 2)
    handle.set_partial_result(reached)
    reached.counted.append(3)
    raise Abort("enough")


async def succeed_in_the_end(goal, handle):
    handle.set_partial_result(result(1))
    return result(1, 2)


async def reach_what_does_not_fit(goal, handle):
    with pytest.raises(InvalidMessage, match="Count_Result"):
        handle.set_partial_result(feedback(1))
    return result(1, 2)


@pytest.mark.parametrize(
    ("body", "status", "reason"),
    [
        (fail_half_way, GoalStatus.ABORTED, "ValueError: no pen"),
        (wait_half_way, GoalStatus.CANCELED, ""),
        (change_what_was_reached, GoalStatus.ABORTED, "enough"),
        (succeed_in_the_end, GoalStatus.SUCCEEDED, ""),
        (reach_what_does_not_fit, GoalStatus.SUCCEEDED, ""),
    ],
)
async def test_the_partial_result_of_a_body_is_reported_unless_it_succeeds(
    body, status, reason, send, where
):
    assert await canceled_end_of(body, send, where) == Outcome(status, result(1, 2), reason)


# --- letting the cancellation out -----------------------------------------------------------


async def wait():
    await anyio.sleep_forever()


async def wait_in_a_group():
    async with anyio.create_task_group() as group:
        group.start_soon(anyio.sleep_forever)
        await anyio.sleep_forever()


async def let_a_group_of_cancellations_out():
    try:
        await anyio.sleep_forever()
    except anyio.get_cancelled_exc_class() as cancellation:
        raise BaseExceptionGroup("only", [cancellation]) from None


async def wait_after_a_timeout_of_its_own():
    with anyio.move_on_after(0):
        await anyio.sleep_forever()
    await anyio.sleep_forever()


WAYS_OUT = [
    wait,
    wait_in_a_group,
    let_a_group_of_cancellations_out,
    wait_after_a_timeout_of_its_own,
]


@pytest.mark.parametrize("body", [body for act in WAYS_OUT for body in in_both_styles(act)])
async def test_a_body_that_lets_a_requested_cancellation_out_is_canceled(body, send, caplog):
    assert await canceled_end_of(body, send) == Outcome(GoalStatus.CANCELED, result())
    assert not caplog.records


async def cancel_oneself():
    raise await a_cancellation()


@both_styles(cancel_oneself)
async def test_a_body_that_lets_its_own_cancellation_out_is_aborted(body, send):
    expected = Outcome(GoalStatus.ABORTED, result(), "canceled from within")
    assert await end_of(body, send) == expected


async def cancellation_and_failure_in_a_group():
    try:
        await anyio.sleep_forever()
    except anyio.get_cancelled_exc_class() as cancellation:
        raise BaseExceptionGroup("both", [cancellation, ValueError("no pen")]) from None


@both_styles(cancellation_and_failure_in_a_group)
async def test_a_group_with_a_failure_in_it_is_a_failure(body, send):
    outcome = await canceled_end_of(body, send)
    assert outcome.status is GoalStatus.ABORTED
    assert "ValueError: no pen" in outcome.reason


# --- where a cancellation lands -------------------------------------------------------------


async def test_a_generator_that_swallows_a_cancellation_at_a_yield_goes_on(send):
    async def body(goal):
        try:
            while True:
                yield feedback(1)
        except anyio.get_cancelled_exc_class():
            yield feedback(2)
        yield result(3)

    assert await canceled_end_of(body, send) == Outcome(GoalStatus.SUCCEEDED, result(3))


@pytest.mark.parametrize("style", ["coroutine", "generator"])
async def test_a_body_that_cancels_its_own_goal_is_canceled_at_its_next_wait(send, style):
    log: list[str] = []

    async def coroutine(goal, handle):
        await client_of(handle).cancel_all()
        log.append("asked")
        await anyio.lowlevel.checkpoint()
        log.append("went on")
        return result()

    async def generator(goal, handle):
        await client_of(handle).cancel_all()
        log.append("asked")
        for _ in range(BURST):
            yield feedback(1)
        log.append("went on")

    def client_of(handle):
        return handle.node.action_client(Count, "count")

    outcome = await end_of({"coroutine": coroutine, "generator": generator}[style], send)
    assert (outcome.status, log) == (GoalStatus.CANCELED, ["asked"])


async def test_a_body_that_cancels_its_own_goal_and_ends_has_succeeded(send):
    async def body(goal, handle):
        await handle.node.action_client(Count, "count").cancel_all()
        return result(1)

    assert await end_of(body, send) == Outcome(GoalStatus.SUCCEEDED, result(1))


# --- scopes and groups around a yield -------------------------------------------------------


async def test_a_scope_that_times_out_around_a_yield_ends_there(send):
    async def body(goal):
        with anyio.move_on_after(0) as scope:
            while True:
                yield feedback(1)
        yield result(int(scope.cancelled_caught))

    assert await end_of(body, send) == Outcome(GoalStatus.SUCCEEDED, result(1))


async def test_a_scope_around_a_yield_lets_a_cancel_request_pass(send):
    caught: list[bool] = []

    async def body(goal):
        with anyio.move_on_after(3600) as scope:
            try:
                while True:
                    yield feedback(1)
            finally:
                caught.append(scope.cancelled_caught)

    outcome = await canceled_end_of(body, send)
    assert (outcome.status, caught) == (GoalStatus.CANCELED, [False])


async def native_timeout():
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0):
            await asyncio.sleep(3600)
    return result(1)


@ON_ASYNCIO
@both_styles(native_timeout)
async def test_a_bodys_own_timeout_of_asyncio_is_its_own_affair(body, send):
    assert await end_of(body, send) == Outcome(GoalStatus.SUCCEEDED, result(1))


async def test_a_task_group_around_a_yield_whose_child_fails_aborts_the_goal(send):
    async def body(goal):
        async with anyio.create_task_group() as group:
            group.start_soon(fail)
            while True:
                yield feedback(1)

    expected = Outcome(GoalStatus.ABORTED, result(), "ValueError: no pen")
    assert await end_of(body, send) == expected


# --- a generator is closed on every path ----------------------------------------------------


async def end_with_result(goal):
    yield result()


async def end_without_result(goal):
    yield feedback(1)


async def end_with_failure(goal):
    yield feedback(1)
    raise ValueError


async def end_with_wrong_type(goal):
    yield 7


async def end_canceled(goal):
    while True:
        yield feedback(1)


@pytest.mark.parametrize(
    "steps",
    [
        end_with_result,
        end_without_result,
        end_with_failure,
        end_with_wrong_type,
        end_canceled,
        yield_again,
    ],
)
async def test_a_generator_is_finished_whatever_ended_it(steps, send):
    log: list[str] = []

    async def body(goal):
        inner = steps(goal)
        try:
            async for item in inner:
                yield item
        finally:
            await inner.aclose()
            log.append("finally")

    await canceled_end_of(body, send)
    assert log == ["finally"]


# --- feedback -------------------------------------------------------------------------------


async def published_by_a_generator(goal):
    numbers: list[int] = []
    for number in range(goal.upto):
        numbers.append(number)
        yield Count.Feedback(so_far=numbers)
    yield result()


async def published_by_a_coroutine(goal, handle):
    numbers: list[int] = []
    for number in range(goal.upto):
        numbers.append(number)
        handle.publish_feedback(Count.Feedback(so_far=numbers))
    return result()


STYLES = pytest.mark.parametrize("body", [published_by_a_generator, published_by_a_coroutine])
SNAPSHOTS = [feedback(0), feedback(0, 1), feedback(0, 1, 2)]


@STYLES
async def test_a_reader_sees_what_was_published_not_what_became_of_it(where, body):
    async with where(body) as served, served.client.send_goal(goal()) as handle:
        assert [message async for message in handle] == SNAPSHOTS


@STYLES
async def test_a_listener_hears_what_was_published_in_order(where, body):
    heard: list[object] = []
    async with where(body) as served:
        await served.client.send_goal(goal(), feedback_callback=heard.append)
    assert heard == SNAPSHOTS


@STYLES
async def test_a_listener_that_raises_does_not_reach_the_body(where, body, caplog):
    def listen(message):
        raise ValueError("deaf")

    async with (
        where(body) as served,
        served.client.send_goal(goal(), feedback_callback=listen) as handle,
    ):
        assert (await handle.outcome()).status is GoalStatus.SUCCEEDED
    assert [record.getMessage() for record in caplog.records] == [
        f"the feedback_callback of a goal of /count failed (goal {handle.goal_id.hex()})"
    ] * 3


@pytest.mark.parametrize(
    ("wrong", "problem"),
    [
        pytest.param("done", "Count_Feedback.*'done'", id="another-type"),
        pytest.param(goal(1), "Count_Feedback.*Goal", id="another-message"),
        pytest.param(
            Count.Feedback(so_far=[1, 2**40]), r"feedback\.so_far\[1\]", id="another-value"
        ),
    ],
)
@pytest.mark.parametrize("style", ["coroutine", "generator"])
async def test_wrong_feedback_raises_at_the_publishing_line(style, wrong, problem, send):
    async def coroutine(goal, handle):
        with pytest.raises(InvalidMessage, match=problem):
            handle.publish_feedback(wrong)
        return result(1)

    async def generator(goal):
        with pytest.raises(InvalidMessage, match=problem):
            yield wrong
        yield result(1)

    outcome = await end_of({"coroutine": coroutine, "generator": generator}[style], send)
    assert outcome == Outcome(GoalStatus.SUCCEEDED, result(1))


async def test_a_body_sees_that_it_was_asked_to_cancel(send):
    seen: list[object] = []

    async def body(goal, handle):
        seen.append((handle.status, handle.is_cancel_requested))
        try:
            await anyio.sleep_forever()
        finally:
            seen.append((handle.status, handle.is_cancel_requested))

    await canceled_end_of(body, send)
    assert seen == [(GoalStatus.EXECUTING, False), (GoalStatus.CANCELING, True)]


# --- back-pressure --------------------------------------------------------------------------


async def test_a_client_that_only_awaits_the_result_does_not_hold_the_body_up(send):
    async def body(request):
        for number in range(5 * FeedbackLog.KEPT):
            yield feedback(number)
        yield result(1)

    assert await end_of(body, send) == Outcome(GoalStatus.SUCCEEDED, result(1))


async def test_a_body_that_only_yields_lets_others_run():
    turns: list[int] = []

    async def body(goal):
        for number in range(3 * BURST):
            yield feedback(number)
        yield result(len(turns))

    async def take_turns():
        while True:
            turns.append(1)
            await anyio.lowlevel.checkpoint()

    async with lab(body) as served, anyio.create_task_group() as group:
        group.start_soon(take_turns)
        outcome = await served.client.send_goal(goal())
        group.cancel_scope.cancel()
    assert outcome.counted[0] > 0


# --- the caller's task ----------------------------------------------------------------------

PARENT: ContextVar[str] = ContextVar("PARENT", default="nobody")


async def test_a_body_sees_the_context_of_its_caller(send):
    seen: list[str] = []

    async def body(goal):
        seen.append(PARENT.get())
        await anyio.lowlevel.checkpoint()
        seen.append(PARENT.get())
        return result()

    token = PARENT.set("me")
    await end_of(body, send)
    PARENT.reset(token)
    assert seen == ["me", "me"]


@pytest.mark.parametrize("waits", [False, True], ids=["at once", "after a wait"])
async def test_what_a_body_sets_in_its_context_does_not_reach_the_client(send, waits):
    async def body(goal):
        if waits:
            await anyio.lowlevel.checkpoint()
        PARENT.set("body")
        return result()

    async with lab(body) as served:
        await send(served, goal())
        assert PARENT.get() == "nobody"


# --- a huge exception -----------------------------------------------------------------------


class Huge(Exception):
    def __str__(self) -> str:
        return "a" * 5_000_000


async def abort_hugely(goal):
    raise Huge


async def abort_hugely_after_feedback(goal):
    yield feedback(1)
    raise Huge


@pytest.mark.parametrize("body", [abort_hugely, abort_hugely_after_feedback])
async def test_the_reason_of_a_failure_with_a_huge_text_is_short(body):
    end = await end_of(body, awaited)
    assert len(end.reason) < 2 * LONGEST
    assert "aaaa… (5,000,000 characters)" in end.reason


async def test_an_abort_in_a_task_group_of_the_body_keeps_its_reason_and_result():
    async def body(goal):
        async with anyio.create_task_group() as group:
            group.start_soon(anyio.sleep_forever)
            raise ABORT

    outcome = await end_of(body, awaited)
    assert (outcome.status, outcome.result, outcome.reason) == (ABORTED, result(7), ABORT.reason)
