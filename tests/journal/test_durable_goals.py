"""Servers with a journal: what a goal survives, and what its clients see of it.

A crash is a copy of the journal's files, made while the first server still runs: another process
would find exactly that.
"""

from __future__ import annotations

import shutil
import sqlite3
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import anyio
import pytest

import turtleact
from turtleact import GoalResponse, GoalStatus, Journal, ServerGoalHandle
from turtleact.errors import (
    Abort,
    GoalAborted,
    GoalCanceled,
    GoalRejected,
    InvalidOption,
    ServerUnavailable,
)
from turtleact.goals.observers import GoalObserver
from turtleact.goals.records import GoalRecord
from turtleact.interfaces import Action, Message, int32
from turtleact.journal import read_goals

from ..lab import (
    Count,
    Gate,
    Other,
    feedback,
    goal,
    local_server,
    once_canceled,
    result,
    running,
    settle,
)

ID, OTHER = bytes(range(16)), bytes(range(1, 17))

Handle = ServerGoalHandle[Count.Goal, Count.Result, Count.Feedback]


class Place(NamedTuple):
    """A node with a journal and a client.

    Attributes:
        path: The journal's file.
        journal: The journal.
        node: The node.
        client: A client of ``/count``.
    """

    path: Path
    journal: Journal
    node: turtleact.Node
    client: turtleact.ActionClient[Any, Any, Any]

    def serve(self, execute: Any, name: str = "count", **options: Any) -> Any:
        options = {"on_restart": "resume", **options}
        return self.node.action_server(Count, name, execute, journal=self.journal, **options)

    async def send(self, request: Count.Goal) -> None:
        """Send a goal and leave it."""
        (await self.client.send_goal(request, goal_id=ID).__aenter__()).detach()

    async def crash_with(self, request: Count.Goal) -> Path:
        """Send a goal and leave it, and be killed then."""
        await self.send(request)
        return await self.crash()

    async def crash(self) -> Path:
        """What another process would find if this one were killed now."""
        await self.journal.written()
        copy = self.path.with_name(f"{self.path.stem}x.db")
        for suffix in ("", "-wal", "-shm"):
            part = Path(f"{self.path}{suffix}")
            if part.exists():
                shutil.copy(part, f"{copy}{suffix}")
        return copy


@asynccontextmanager
async def place(path: Path, **options: Any) -> AsyncIterator[Place]:
    async with (
        turtleact.open_journal(path, **options) as journal,
        turtleact.open_node("lab") as node,
    ):
        yield Place(path, journal, node, node.action_client(Count, "count"))


@asynccontextmanager
async def crashed(path: Path, execute: Any, upto: int = 3) -> AsyncIterator[Place]:
    """A place where a server was killed that ran a goal."""
    async with place(path) as here:
        here.serve(execute)
        await here.send(goal(upto))
        await settle()
        copy = await here.crash()
    async with place(copy) as there:
        yield there


@pytest.fixture
def path(tmp_path) -> Path:
    return Path(tmp_path, "goals.db")


def records(path: Path) -> dict[bytes, GoalRecord]:
    return {record.id: record for record in read_goals(path)}


class Resuming:
    """A body that counts on from its newest feedback, a number each time it is let.

    Attributes:
        began: With which number each start began.
        step: Gives leave to count further.
    """

    def __init__(self, free: int = 0) -> None:
        self.began: list[int] = []
        self.step = anyio.Semaphore(free)

    async def generator(
        self, request: Count.Goal, handle: Handle
    ) -> AsyncIterator[Count.Feedback | Count.Result]:
        numbers = self._begin(handle)
        for number in range(len(numbers), request.upto):
            await self.step.acquire()
            numbers.append(number)
            yield feedback(*numbers)
        yield result(*numbers)

    async def coroutine(self, request: Count.Goal, handle: Handle) -> Count.Result:
        numbers = self._begin(handle)
        for number in range(len(numbers), request.upto):
            await self.step.acquire()
            numbers.append(number)
            handle.publish_feedback(feedback(*numbers))
        return result(*numbers)

    def _begin(self, handle: Handle) -> list[int]:
        left = handle.resumed
        numbers = [] if left is None or left.feedback is None else list(left.feedback.so_far)
        self.began.append(len(numbers))
        return numbers


@pytest.fixture(params=["generator", "coroutine"])
def style(request) -> Callable[[Resuming], Any]:
    """The two styles of bodies."""
    return lambda body: getattr(body, request.param)


# --- accepting and ending -----------------------------------------------------------------------


async def test_a_goal_is_on_disk_before_it_is_accepted_and_its_end_before_it_is_announced(path):
    gate = Gate()
    async with place(path) as here:
        here.serve(gate.wait)
        async with here.client.send_goal(goal(), goal_id=ID) as handle:
            assert records(path)[ID].status is GoalStatus.EXECUTING
            gate.opened.set()
            assert await handle.result() == result(3)
            ended = records(path)[ID]
    assert (ended.status, ended.ended > 0) == (GoalStatus.SUCCEEDED, True)


async def test_the_disk_has_a_goal_and_its_end_before_they_are_told(path, monkeypatch):
    log = list[str]()

    class Noting(sqlite3.Connection):
        """Notes each commit for which SQLite waits for the disk."""

        def execute(self, statement: str, *values: Any) -> sqlite3.Cursor:
            is_synced = False
            if statement == "COMMIT":
                ((level,),) = super().execute("PRAGMA synchronous")
                is_synced = level == 2  # FULL
            done = super().execute(statement, *values)
            if is_synced:
                log.append("synced")
            return done

    connect = partial(sqlite3.connect, factory=Noting)
    monkeypatch.setattr(sqlite3, "connect", connect)
    gate = Gate()
    async with place(path) as here:
        here.serve(gate.wait)
        async with here.client.send_goal(goal(), goal_id=ID) as handle:
            log.append("accepted")
            await here.journal.written()
            gate.opened.set()
            await handle.result()
            log.append("ended")
    assert log == ["synced", "accepted", "synced", "ended"]


async def test_feedback_is_on_disk_before_anybody_sees_it(path, style):
    body = Resuming(free=3)
    seen = list[tuple[int, int]]()
    async with place(path) as here:
        here.serve(style(body))

        def look(message: Count.Feedback) -> None:
            seen.append((len(message.so_far), records(path)[ID].feedback_count))

        await here.client.send_goal(goal(3), goal_id=ID, feedback_callback=look)
    assert len(seen) == 3
    assert all(written >= shown for shown, written in seen)


async def test_a_rejected_goal_leaves_no_record(path):
    async with place(path) as here:
        here.serve(Gate().wait, policy="reject")
        async with here.client.send_goal(goal(), goal_id=ID):
            with pytest.raises(GoalRejected, match="busy with goal 000102"):
                await here.client.send_goal(goal(), goal_id=OTHER)
            assert list(records(path)) == [ID]


async def test_a_goal_that_the_callback_rejects_is_never_written(path):
    async with place(path) as here:
        here.serve(Gate().wait, goal_callback=lambda _: GoalResponse.REJECT)
        with pytest.raises(GoalRejected):
            await here.client.send_goal(goal())
    assert not records(path)


async def test_a_sender_cancelled_while_its_goal_is_written_cancels_it(path):
    gate = Gate()
    async with place(path) as here:
        here.serve(gate.wait)
        with anyio.move_on_after(0) as scope:
            await here.client.send_goal(goal(), goal_id=ID)
        assert scope.cancelled_caught
        written = records(path)  # empty if the loop cancels before the goal is sent
        assert [each.status for each in written.values()] in ([], [GoalStatus.CANCELED])


async def test_without_on_restart_a_stopped_server_ends_its_goals(path):
    async with place(path) as here:
        here.serve(Gate().wait, on_restart="abort")
        async with here.client.send_goal(goal(), goal_id=ID) as handle:
            await here.node.aclose()
            with pytest.raises(GoalAborted, match="shutdown"):
                await handle.result()
    assert records(path)[ID].reason == "shutdown"


# --- going on after a restart -------------------------------------------------------------------


async def test_a_goal_goes_on_after_a_crash_with_its_id_and_stamp(path, style):
    body = Resuming(free=2)
    async with place(path) as here:
        here.serve(style(body))
        async with here.client.send_goal(goal(5), goal_id=ID) as handle:
            assert [await anext(handle), await anext(handle)] == [feedback(0), feedback(0, 1)]
            killed, stamp = await here.crash(), handle.stamp
            handle.detach()
            async with place(killed) as there:
                again = Resuming(free=9)
                there.serve(style(again))
                async with there.client.attach(ID) as other:
                    assert await other.result() == result(0, 1, 2, 3, 4)
                    assert other.stamp == stamp
                assert again.began == [2]


async def test_a_partial_result_survives(path):
    async def act(request: Count.Goal, handle: Handle) -> Count.Result:
        if handle.resumed is not None:
            return handle.resumed.partial_result or result()
        handle.set_partial_result(result(7))
        await anyio.sleep_forever()
        return result()

    async with crashed(path, act) as there:
        there.serve(act)
        async with there.client.attach(ID) as other:
            assert await other.result() == result(7)


async def test_a_clean_stop_keeps_goals_and_tells_their_waiters(path):
    body = Resuming(free=1)
    async with place(path) as here:
        server = here.serve(body.generator)
        async with running(lambda: here.client.send_goal(goal(3), goal_id=ID)) as waiting:
            while not any(each.feedback_count for each in records(path).values()):
                await anyio.sleep(0)
            await server.aclose()
            await waiting.done.wait()
        assert isinstance(waiting.error, ServerUnavailable)
        assert "goes on when the server is back" in str(waiting.error)
        left = records(path)[ID]
        assert (left.status, left.is_stopped) == (GoalStatus.EXECUTING, True)
        body.step.release()
        body.step.release()
        here.serve(body.generator)
        async with here.client.attach(ID) as again:
            assert await again.result() == result(0, 1, 2)
    assert body.began == [0, 1]


async def test_a_body_that_succeeds_while_it_is_stopped_has_succeeded(path):
    async def act(request: Count.Goal) -> Count.Result:
        try:
            await anyio.sleep_forever()
        except anyio.get_cancelled_exc_class():
            pass
        return result(1)

    async with place(path) as here:
        server = here.serve(act)
        async with here.client.send_goal(goal(), goal_id=ID) as handle:
            await server.aclose()
            assert await handle.result() == result(1)


class When(GoalObserver):
    """Calls a function once a goal is in some state."""

    def __init__(self, status: GoalStatus, goal_id: bytes, call: Callable[[], object]) -> None:
        self._awaited = (status, goal_id)
        self._call = call

    def goal_changed(self, goal: Any, before: GoalStatus, after: GoalStatus) -> None:
        if (after, goal.id) == self._awaited:
            self._call()


async def test_a_body_that_has_not_begun_when_its_server_stops_never_runs_on(path):
    under_way = set[bytes]()

    async def act(request: Count.Goal, handle: Handle) -> Count.Result:
        under_way.add(handle.goal_id)
        try:
            await anyio.sleep_forever()
        finally:
            under_way.remove(handle.goal_id)
        return result()

    async with place(path) as here, anyio.create_task_group() as group:
        server = here.serve(act)
        close = When(GoalStatus.EXECUTING, ID, partial(group.start_soon, server.aclose))
        local_server(server).observers.add(close)
        with pytest.raises(ServerUnavailable, match="goes on when the server is back"):
            await here.client.send_goal(goal(), goal_id=ID)
        await settle()
        assert not under_way
        assert records(path)[ID].status is GoalStatus.EXECUTING


@pytest.mark.loops("asyncio", "uvloop")  # trio sends the two goals in random order
async def test_a_goal_whose_turn_has_come_does_not_start_when_its_server_stops(path):
    began, accepted = list[int](), anyio.Event()

    async def act(request: Count.Goal) -> Any:
        began.append(request.upto)
        return await once_canceled(result())()

    async with place(path) as here:
        server = here.serve(act, policy="queue")
        local_server(server).observers.add(When(GoalStatus.ACCEPTED, OTHER, accepted.set))
        async with (
            running(lambda: here.client.send_goal(goal(1), goal_id=ID)),
            running(lambda: here.client.send_goal(goal(2), goal_id=OTHER)) as second,
        ):
            await accepted.wait()  # a thread has written it to the journal
            await server.aclose()  # the first goal succeeds, so it is the second one's turn
        await settle()
        assert (type(second.error), began) == (ServerUnavailable, [1])
        assert records(path)[OTHER].status is GoalStatus.ACCEPTED


@pytest.mark.parametrize("waiting", [[], [OTHER]], ids=["", "with a goal that waits"])
async def test_a_server_that_stops_gives_up_its_places_in_a_shared_slot(path, waiting):
    options: Any = {"policy": "queue", "slot": "arm"}
    gate = Gate()
    gate.opened.set()
    async with place(path) as here:
        stopped = here.serve(Gate().wait, **options)
        here.node.action_server(Count, "other", gate.wait, **options)
        other = here.node.action_client(Count, "other")
        for goal_id in (ID, *waiting):
            (await here.client.send_goal(goal(), goal_id=goal_id).__aenter__()).detach()
        async with running(lambda: other.send_goal(goal(7))) as next_one:
            await stopped.aclose()
            with anyio.fail_after(1):
                await next_one.done.wait()
            assert next_one.value == result(7)


async def test_goals_are_aborted_after_a_restart_unless_they_resume(path):
    async with crashed(path, Gate().wait) as there:
        there.serve(Gate().wait, on_restart="abort")
        async with there.client.attach(ID) as other:
            with pytest.raises(GoalAborted, match="its server was restarted"):
                await other.result()


async def test_a_goal_that_was_being_canceled_ends_canceled(path):
    async def act(request: Count.Goal, handle: Handle) -> Count.Result:
        handle.set_partial_result(result(4))
        try:
            await anyio.sleep_forever()
        finally:
            with anyio.CancelScope(shield=True):
                await released.wait()
        return result()

    released = anyio.Event()
    async with place(path) as here:
        here.serve(act)
        async with here.client.send_goal(goal(), goal_id=ID) as handle:
            await settle()
            await handle.cancel()
            killed = await here.crash()
            released.set()
        async with place(killed) as there:
            there.serve(act)
            async with there.client.attach(ID) as other:
                with pytest.raises(GoalCanceled) as canceled:
                    await other.result()
            assert canceled.value.result == result(4)


async def test_a_nested_goal_is_left_to_its_parent(path):
    async def parent(request: Count.Goal, handle: Handle) -> Count.Result:
        child = handle.node.action_client(Count, "child")
        sent: Count.Result = await child.send_goal(goal(1))
        return sent

    gate, again = Gate(), Gate()
    async with place(path) as here:
        here.serve(parent)
        here.serve(gate.wait, "child")
        async with here.client.send_goal(goal(), goal_id=ID) as handle:
            handle.detach()
            await gate.started.wait()
            (nested,) = (each.id for each in records(path).values() if each.is_nested)
            async with place(await here.crash()) as there:
                there.serve(parent)
                there.serve(again.wait, "child")
                again.opened.set()
                async with there.client.attach(ID) as other:
                    assert await other.result() == result(1)
                assert records(there.path)[nested].reason == "its parent starts it again"
                assert again.log.count("begun") == 1


class Clock:
    """A system clock that a test sets back.

    Attributes:
        lag: By how much (s).
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.lag = 0.0
        time_ns = time.time_ns
        monkeypatch.setattr(time, "time_ns", lambda: time_ns() - round(self.lag * 1e9))


@pytest.mark.parametrize("step", [0.0, 3600.0], ids=["", "clock set back"])
async def test_waiting_goals_keep_their_order(path, monkeypatch, step):
    order, clock = list[int](), Clock(monkeypatch)

    async def act(request: Count.Goal, handle: Handle) -> Count.Result:
        order.append(request.upto)
        if handle.resumed is None:
            await anyio.sleep_forever()
        return result()

    async with place(path) as here:
        here.serve(act, policy="queue")
        ids = [bytes([9 - number]) * 16 for number in range(4)]
        async with anyio.create_task_group() as senders:
            for number, goal_id in enumerate(ids):
                handle = await here.client.send_goal(goal(number), goal_id=goal_id).__aenter__()
                handle.detach()
                clock.lag += step
            killed = await here.crash()
            senders.cancel_scope.cancel()
        order.clear()
        async with place(killed) as there:
            there.serve(act, policy="queue")
            async with there.client.attach(ids[-1]) as last:
                await last.result()
            assert order == [0, 1, 2, 3]


async def test_goals_of_a_shared_slot_run_one_at_a_time_after_a_restart(path):
    running_now = list[str]()

    def body(name: str) -> Any:
        async def act(request: Count.Goal, handle: Handle) -> Count.Result:
            running_now.append(name)
            assert running_now == [name]
            if handle.resumed is None:
                await anyio.sleep_forever()
            await anyio.sleep(0)
            running_now.remove(name)
            return result()

        return act

    options = {"policy": "queue", "slot": "arm"}
    async with place(path) as here:
        here.serve(body("count"), **options)
        here.serve(body("other"), "other", **options)
        second = here.node.action_client(Count, "other")
        (await second.send_goal(goal(), goal_id=OTHER).__aenter__()).detach()
        killed = await here.crash_with(goal())
        running_now.clear()
        async with place(killed) as there:
            there.serve(body("count"), **options)  # its goal was second
            there.serve(body("other"), "other", **options)
            async with there.client.attach(ID) as last:
                await last.result()


async def test_a_goal_that_kills_its_server_is_given_up(path):
    body = Resuming()
    async with place(path) as here:
        here.serve(body.generator)
        killed = await here.crash_with(goal(3))
    for crashes in (1, 2):
        async with place(killed) as there:
            there.serve(body.generator)
            async with there.client.attach(ID):
                await there.journal.written()
                assert records(killed)[ID].crashes == crashes
                killed = await there.crash()
    async with place(killed) as there:
        there.serve(body.generator)
        async with there.client.attach(ID) as other:
            with pytest.raises(GoalAborted, match="has crashed 3 times since its newest feedback"):
                await other.result()
    assert body.began == [0, 0, 0]


async def test_feedback_and_clean_stops_forgive_crashes(path):
    body = Resuming()
    async with place(path) as here:
        here.serve(body.coroutine)
        killed = await here.crash_with(goal(3))
    async with place(killed) as there:
        there.serve(body.coroutine)
        async with there.client.attach(ID):
            await there.journal.written()
    assert records(killed)[ID].crashes == 1
    async with place(killed) as there:  # after a clean stop
        there.serve(body.coroutine)
        async with there.client.attach(ID) as handle:
            await there.journal.written()
            assert records(killed)[ID].crashes == 1
            body.step.release()
            await anext(handle)
            assert records(killed)[ID].crashes == 0


async def test_a_goal_of_another_type_is_aborted_and_not_decoded(path):
    class Changed(Action, type_name="lab_interfaces/action/Count"):
        class Goal(Message):
            upto: int32 = 0
            more: int32 = 0

        class Result(Message):
            counted: list[int32] = []

        class Feedback(Message):
            so_far: list[int32] = []

    body: Any = Gate().wait
    async with crashed(path, Gate().wait) as there:
        options: Any = {"journal": there.journal, "on_restart": "resume"}
        there.node.action_server(Changed, "count", body, **options)
        async with there.node.action_client(Changed, "count").attach(ID) as handle:
            with pytest.raises(GoalAborted, match="type lab_interfaces/action/Count has changed"):
                await handle.result()


async def test_goals_of_two_types_under_one_name_are_told_apart(path):
    async def other(request: Other.Goal) -> Other.Result:
        return Other.Result()

    async with crashed(path, Gate().wait, 2) as there:
        there.node.action_server(Other, "count", other, journal=there.journal, on_restart="resume")
        there.serve(Resuming(free=2).generator)
        async with there.client.attach(ID) as handle:
            assert await handle.result() == result(0, 1)


async def test_a_built_in_action_leaves_the_goals_of_another_server_alone(path):
    async with (
        crashed(path, Gate().wait, 2) as there,
        turtleact.open_node("turtle_actions", transport=there.node.transport) as node,
    ):
        body = Resuming()
        options: Any = {"journal": there.journal, "on_restart": "resume"}
        built_in: Any = body.generator
        node.action_server(Count, "count", built_in, on_conflict="withdraw", **options)
        await settle()
        there.serve(Resuming(free=2).generator)
        await settle()
        async with there.client.attach(ID) as handle:
            assert await handle.result() == result(0, 1)
        assert body.began == []


async def test_a_journal_can_end_goals_at_a_clean_stop(path):
    async with place(path, abort_at_close=True) as here:
        server = here.serve(Gate().wait)
        async with here.client.send_goal(goal(), goal_id=ID) as handle:
            await server.aclose()
            with pytest.raises(GoalAborted, match="shutdown"):
                await handle.result()
    assert records(path)[ID].status is GoalStatus.ABORTED


async def test_an_ended_goal_still_answers_after_a_restart(path):
    async def act(request: Count.Goal) -> Count.Result:
        raise Abort("too far", result(2))

    async with place(path) as here:
        here.serve(act)
        with pytest.raises(GoalAborted):
            await here.client.send_goal(goal(), goal_id=ID)
    async with place(path) as there:
        there.serve(act)
        async with there.client.attach(ID) as handle:
            with pytest.raises(GoalAborted) as aborted:
                await handle.result()
        assert (aborted.value.reason, aborted.value.result) == ("too far", result(2))


async def test_an_ended_goal_still_answers_after_the_clock_was_set_back(path, monkeypatch):
    gate, clock = Gate(), Clock(monkeypatch)
    gate.opened.set()
    async with place(path) as here:
        here.serve(gate.wait, result_timeout=60.0)
        assert await here.client.send_goal(goal(), goal_id=ID) == result(3)
    clock.lag = 3600.0
    async with place(path) as there:
        there.serve(gate.wait, result_timeout=60.0)
        clock.lag -= 59.0
        async with there.client.attach(ID) as handle:
            assert await handle.result() == result(3)
    assert gate.log.count("begun") == 1


# --- one id, one goal ---------------------------------------------------------------------------


async def test_an_id_that_is_sent_again_joins_its_goal(path):
    gate = Gate()
    async with place(path) as here:
        here.serve(gate.wait)
        async with (
            here.client.send_goal(goal(), goal_id=ID) as first,
            here.client.send_goal(goal(), goal_id=ID) as second,
        ):
            gate.opened.set()
            assert await first.result() == await second.result() == result(3)
        assert await here.client.send_goal(goal(), goal_id=ID) == result(3)
        assert gate.log.count("begun") == 1


async def test_an_id_that_is_sent_twice_at_once_is_one_goal(path):
    gate = Gate()
    gate.opened.set()
    async with place(path) as here:
        here.serve(gate.wait)
        async with (
            running(lambda: here.client.send_goal(goal(), goal_id=ID)) as first,
            running(lambda: here.client.send_goal(goal(), goal_id=ID)) as second,
        ):
            await first.done.wait()
            await second.done.wait()
        assert (first.value, second.value) == (result(3), result(3))
        assert gate.log.count("begun") == 1


async def test_an_id_of_another_goal_is_rejected(path):
    gate = Gate()
    async with place(path) as here:
        here.serve(gate.wait)
        async with here.client.send_goal(goal(3), goal_id=ID):
            with pytest.raises(GoalRejected, match="belongs to another goal"):
                await here.client.send_goal(goal(4), goal_id=ID)


async def test_a_goal_whose_result_has_expired_is_joined_from_the_file(path):
    gate = Gate()
    gate.opened.set()
    async with place(path) as here:
        here.serve(gate.wait, result_timeout=0.0)
        assert await here.client.send_goal(goal(), goal_id=ID) == result(3)
    async with place(path) as there:
        there.serve(gate.wait, result_timeout=0.0)
        there.serve(gate.wait, "other")
        assert await there.client.send_goal(goal(), goal_id=ID) == result(3)
        with pytest.raises(GoalRejected, match="belongs to another goal"):
            await there.node.action_client(Count, "other").send_goal(goal(), goal_id=ID)
    assert gate.log.count("begun") == 1


# --- options ------------------------------------------------------------------------------------


async def test_on_restart_is_one_of_two_words(path):
    async with place(path) as here:
        with pytest.raises(InvalidOption, match="'on_restart': expected one of abort, resume"):
            here.serve(Gate().wait, on_restart="drop")
