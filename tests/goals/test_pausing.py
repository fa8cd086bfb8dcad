"""Pausing and resuming goals, in process and by messages."""

from __future__ import annotations

from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing, asynccontextmanager
from typing import Any

import anyio
import pytest

import turtleact
from turtleact import GoalStatus, ServerGoalHandle
from turtleact.errors import GoalAborted, GoalCanceled, InvalidOption, PauseRefused
from turtleact.interfaces.standard.std_srvs.srv import Trigger
from turtleact.journal import open_journal
from turtleact.transports import MemoryTransport

from ..lab import (
    Count,
    Gate,
    HandClock,
    far_and_near,
    feedback,
    goal,
    lab,
    local_server,
    result,
    running,
    take_turns,
)

ID = bytes(range(16))

Handle = ServerGoalHandle[Count.Goal, Count.Result, Count.Feedback]


class Walker:
    """Bodies that take steps until the test has seen enough.

    Attributes:
        steps: How many were taken.
        log: What the callbacks were told.
    """

    def __init__(self) -> None:
        self.steps = 0
        self.log: list[str] = []

    async def generator(self, request: Count.Goal) -> AsyncGenerator[Any, None]:
        while self.steps < request.upto:
            self.steps += 1
            yield feedback(self.steps)
            await anyio.sleep(0)
        yield result(self.steps)

    async def coroutine(self, request: Count.Goal, handle: Handle) -> Count.Result:
        while self.steps < request.upto:
            self.steps += 1
            await handle.checkpoint()
        return result(self.steps)

    async def blind(self, request: Count.Goal) -> Count.Result:
        await anyio.sleep_forever()
        return result()

    async def on_pause(self, handle: Handle) -> None:
        self.log.append(f"pause at {self.steps}")

    async def on_resume(self, handle: Handle) -> None:
        self.log.append(f"resume at {self.steps}")

    async def stands_still(self) -> bool:
        """Whether no step is taken for many turns of the loop."""
        before = self.steps
        await take_turns()
        return self.steps == before


MANY = 100_000
"""More steps than a test waits for."""

STYLES: dict[str, Any] = {"generator": {}, "coroutine": {"pausable": True}}


@pytest.fixture(params=STYLES)
def style(request) -> str:
    name: str = request.param
    return name


async def test_a_paused_body_stands_still_until_it_is_resumed(where, style):
    walker = Walker()
    async with (
        where(getattr(walker, style), **STYLES[style]) as served,
        served.client.send_goal(goal(MANY)) as handle,
    ):
        await handle.pause()
        assert (handle.is_paused, handle.status) == (True, GoalStatus.EXECUTING)
        assert await walker.stands_still()
        await handle.pause()  # again: nothing happens
        await handle.resume()
        assert not handle.is_paused
        assert not await walker.stands_still()
        await handle.resume()


async def test_the_callbacks_bring_the_robot_to_rest_and_start_it(style):
    walker = Walker()
    options: Any = {"on_pause": walker.on_pause, "on_resume": walker.on_resume, **STYLES[style]}
    async with (
        lab(getattr(walker, style), **options) as served,
        served.client.send_goal(goal(MANY)) as handle,
    ):
        await handle.pause()
        at = walker.steps
        await handle.resume()
    assert walker.log == [f"pause at {at}", f"resume at {at}"]


async def test_another_coroutine_body_refuses_with_a_reason(where):
    async with where(Walker().blind) as served, served.client.send_goal(goal()) as handle:
        with pytest.raises(PauseRefused, match="declare it with pausable=True"):
            await handle.pause()
        assert not handle.is_paused


async def test_a_body_that_does_not_stand_still_in_time_goes_on():
    async def act(request: Count.Goal) -> AsyncIterator[Count.Feedback | Count.Result]:
        yield feedback()
        await gate.wait()
        yield result(1)

    gate = anyio.Event()
    async with lab(act) as served, served.client.send_goal(goal()) as handle:
        await take_turns()
        with pytest.raises(PauseRefused, match=r"a checkpoint within 0\.01 s"):
            await handle.pause(timeout=0.01)
        assert not handle.is_paused
        gate.set()
        assert await handle.result() == result(1)


async def test_a_pause_whose_caller_is_cancelled_is_withdrawn():
    async def act(request: Count.Goal) -> AsyncIterator[Count.Feedback | Count.Result]:
        await gate.wait()
        yield feedback()
        yield result(1)

    gate = anyio.Event()
    async with lab(act) as served, served.client.send_goal(goal()) as handle:
        async with running(handle.pause) as pausing:
            await take_turns()
            pausing.scope.cancel()
        gate.set()
        assert await handle.result() == result(1)


async def test_a_goal_that_has_ended_or_is_being_canceled_is_not_paused():
    walker = Walker()
    async with lab(walker.generator) as served, served.client.send_goal(goal(1)) as handle:
        await handle.result()
        with pytest.raises(PauseRefused, match="it has ended"):
            await handle.pause()

    gate = Gate()
    async with lab(gate.tidy, pausable=True) as served, served.client.send_goal(goal()) as handle:
        await take_turns()
        await handle.cancel()
        with pytest.raises(PauseRefused, match="being canceled"):
            await handle.pause()
        gate.opened.set()


@pytest.mark.parametrize("by", ["cancel", "shutdown", "preempted"])
async def test_a_cancel_a_preemption_and_a_shutdown_reach_a_paused_body_at_once(style, by):
    walker = Walker()
    options: Any = {"policy": "preempt", **STYLES[style]}
    async with (
        lab(getattr(walker, style), **options) as served,
        served.client.send_goal(goal(MANY)) as handle,
    ):
        await handle.pause()
        if by == "cancel":
            await handle.cancel()
        elif by == "shutdown":
            await served.server.aclose()
        else:
            walker.steps = 0
            assert await served.client.send_goal(goal(1)) == result(1)
        with pytest.raises(GoalCanceled if by == "cancel" else GoalAborted, match=by):
            await handle.result()
        assert not handle.is_paused


@pytest.mark.parametrize("is_canceled", [False, True])
async def test_a_waiting_goal_begins_paused_and_never_runs_its_body_if_it_is_canceled(is_canceled):
    gate = Gate()
    async with (
        lab(gate.wait, policy="queue", pausable=True) as served,
        served.client.send_goal(goal()) as first,
        served.client.send_goal(goal()) as second,
    ):
        await second.pause()
        gate.opened.set()
        await first.result()
        await take_turns()
        assert (second.status, gate.log.count("begun")) == (GoalStatus.EXECUTING, 1)
        await (second.cancel() if is_canceled else second.resume())
        ends = GoalStatus.CANCELED if is_canceled else GoalStatus.SUCCEEDED
        assert (await second.outcome()).status is ends
    assert gate.log.count("begun") == 2 - is_canceled


@asynccontextmanager
async def family(parent: Any, options: Any = None, **children: Any) -> AsyncIterator[Any]:
    """The handle of a goal whose body sends goals to other actions of its node."""
    async with lab(parent, **options or {}) as served:
        for name, body in children.items():
            served.node.action_server(Count, name, body)
        async with served.client.send_goal(goal()) as handle:
            await take_turns()
            yield handle


async def test_a_parent_pauses_and_resumes_its_children():
    walker = Walker()

    async def parent(request: Count.Goal, handle: Handle) -> AsyncIterator[Any]:
        client = handle.node.action_client(Count, "child")
        yield await client.send_goal(goal(MANY))

    async with family(parent, child=walker.generator) as handle:
        await handle.pause()
        assert await walker.stands_still()
        await handle.resume()
        assert not await walker.stands_still()


async def test_a_child_that_refuses_refuses_for_its_parent():
    walker = Walker()

    async def parent(request: Count.Goal, handle: Handle) -> AsyncIterator[Any]:
        async with (
            handle.node.action_client(Count, "walk").send_goal(goal(MANY)),
            handle.node.action_client(Count, "blind").send_goal(goal()) as blind,
        ):
            yield await blind.result()

    async with family(parent, walk=walker.generator, blind=walker.blind) as handle:
        with pytest.raises(PauseRefused, match="pausable=True"):
            await handle.pause()
        assert not await walker.stands_still()


async def test_a_rejected_child_is_not_paused():
    walker = Walker()

    async def parent(request: Count.Goal, handle: Handle) -> AsyncIterator[Any]:
        client = handle.node.action_client(Count, "child")
        with pytest.raises(turtleact.GoalRejected):
            await client.send_goal(goal())
        async with aclosing(walker.generator(request)) as steps:
            async for each in steps:
                yield each

    async with lab(parent) as served:
        served.node.action_server(Count, "child", Walker().blind, policy="reject")
        async with (
            served.node.action_client(Count, "child").send_goal(goal()),
            served.client.send_goal(goal(MANY)) as handle,
        ):
            await take_turns()
            await handle.pause()
            assert await walker.stands_still()


async def test_children_may_end_while_they_are_paused_and_resumed():
    walker = Walker()

    async def parent(request: Count.Goal, handle: Handle) -> AsyncIterator[Any]:
        clients = [handle.node.action_client(Count, name) for name in ("short", "long")]
        async with clients[1].send_goal(goal(MANY)) as long, clients[0].send_goal(goal(3)):
            yield await long.result()

    async def slow(handle: Handle) -> None:
        await take_turns()

    async with lab(parent) as served:
        short = Walker()
        served.node.action_server(Count, "short", short.generator, on_resume=slow)
        served.node.action_server(Count, "long", walker.generator, on_pause=slow, on_resume=slow)
        async with served.client.send_goal(goal()) as handle:
            for _ in range(3):
                await take_turns()
                await handle.pause()
                assert await walker.stands_still()
                await handle.resume()
                assert not await walker.stands_still()


async def test_a_parent_that_does_more_than_wait_for_its_children_stands_still_at_its_next_yield():
    walker, steps = Walker(), list[int]()

    async def parent(request: Count.Goal, handle: Handle) -> AsyncIterator[Any]:
        async with handle.node.action_client(Count, "child").send_goal(goal(MANY)):
            while True:
                steps.append(1)
                yield feedback()
                await anyio.sleep(0)

    async with family(parent, child=walker.generator) as handle:
        await handle.pause()
        await take_turns()
        count = len(steps)
        await take_turns()
        assert len(steps) == count
        await handle.resume()
        await take_turns()
        assert len(steps) > count


async def test_a_goal_that_a_paused_body_sends_begins_paused_and_is_resumed_with_it():
    walker = Walker()
    go, sent = anyio.Event(), list[turtleact.ClientGoalHandle[Any, Any]]()

    async def parent(request: Count.Goal, handle: Handle) -> Count.Result:
        await go.wait()
        async with handle.node.action_client(Count, "child").send_goal(goal(3)) as child:
            sent.append(child)
            return await child.result()

    async with family(
        parent, child=walker.generator, options={"on_pause": walker.on_pause}
    ) as handle:
        await handle.pause()
        go.set()
        await take_turns()
        assert (sent[0].is_paused, walker.steps) == (True, 0)
        await handle.resume()
        assert await handle.result() == result(3)


@pytest.mark.parametrize("is_withdrawn", [False, True], ids=["paused", "withdrawn"])
async def test_a_goal_that_a_body_sends_while_it_is_being_paused_stands_still_with_it(is_withdrawn):
    walker, go = Walker(), anyio.Event()

    async def parent(request: Count.Goal, handle: Handle) -> AsyncIterator[Any]:
        await go.wait()
        yield await handle.node.action_client(Count, "child").send_goal(goal(3))

    async def on_pause(handle: Handle) -> None:
        if is_withdrawn:
            raise ValueError("it cannot stop")

    async with family(parent, child=walker.generator, options={"on_pause": on_pause}) as handle:
        async with running(handle.pause) as pausing:
            assert not pausing.done.is_set()
            go.set()
        if is_withdrawn:
            assert "on_pause failed: ValueError: it cannot stop" in str(pausing.error)
        else:
            assert pausing.error is None
        assert handle.is_paused != is_withdrawn
        assert is_withdrawn or not walker.steps
        await handle.resume()
        assert await handle.result() == result(3)


async def test_a_goal_sent_while_its_parent_brakes_is_paused_too():
    walker, go = Walker(), anyio.Event()

    async def parent(request: Count.Goal, handle: Handle) -> Count.Result:
        await go.wait()
        await handle.node.action_client(Count, "child").send_goal(goal(MANY))
        return result()

    async def brake(handle: Handle) -> None:
        go.set()
        await take_turns()

    async with family(parent, child=walker.generator, options={"on_pause": brake}) as handle:
        await handle.pause()
        assert walker.steps > 0
        assert await walker.stands_still()


@pytest.mark.parametrize("was_paused", [False, True], ids=["with its parent", "by itself"])
async def test_what_goes_on_without_its_canceled_parent_is_resumed_unless_paused_by_itself(
    was_paused,
):
    walker, other = Walker(), Walker()
    sent = list[turtleact.ClientGoalHandle[Any, Any]]()

    async def parent(request: Count.Goal, handle: Handle) -> AsyncIterator[Any]:
        client = handle.node.action_client
        async with (
            client(Count, "alone").send_goal(goal(MANY)) as alone,
            client(Count, "other").send_goal(goal(MANY)) as child,
        ):
            alone.detach()
            sent.append(alone)
            yield await child.result()

    async with family(parent, alone=walker.generator, other=other.generator) as handle:
        if was_paused:
            await sent[0].pause()
        await handle.pause()
        assert await walker.stands_still()
        await handle.cancel()
        await handle.outcome()
        await take_turns()
        assert sent[0].is_paused == was_paused
        assert await walker.stands_still() == was_paused
        assert await other.stands_still()


async def test_a_robot_whose_stop_is_cancelled_is_started_again():
    walker = Walker()

    async def brake(handle: Handle) -> None:
        walker.log.append("braking")
        await anyio.sleep_forever()

    async with (
        lab(walker.generator, on_pause=brake, on_resume=walker.on_resume) as served,
        served.client.send_goal(goal(MANY)) as handle,
    ):
        async with running(handle.pause) as pausing:
            pausing.scope.cancel()
        assert walker.log[0] == "braking"
        assert walker.log[1].startswith("resume")
        assert not handle.is_paused
        assert not await walker.stands_still()


async def test_the_time_of_pauses_is_counted():
    clock = HandClock()
    times = list[float]()

    async def act(request: Count.Goal, handle: Handle) -> Count.Result:
        while len(times) < 2:
            await handle.checkpoint()
            if handle.paused_time != (times[-1] if times else 0.0):
                times.append(handle.paused_time)
        return result()

    transport = MemoryTransport(clock)
    async with (
        lab(act, transport=transport, pausable=True) as served,
        served.client.send_goal(goal()) as handle,
    ):
        for seconds in (1.5, 2.0):
            await handle.pause()
            clock.advance(seconds)
            await handle.resume()
            await take_turns()
        await handle.result()
    assert times == [1.5, 3.5]


async def test_the_server_pauses_its_own_goals():
    walker = Walker()
    handles = list[Handle]()

    async def act(request: Count.Goal, handle: Handle) -> AsyncIterator[Any]:
        handles.append(handle)
        async with aclosing(walker.generator(request)) as steps:
            async for each in steps:
                yield each

    async with lab(act) as served, served.client.send_goal(goal(MANY)) as handle:
        await take_turns()
        await handles[0].pause()
        assert (handle.is_paused, handles[0].is_paused) == (True, True)
        await handles[0].resume()
        assert not handle.is_paused


@pytest.mark.parametrize("name", ["on_pause", "on_resume"])
async def test_the_callbacks_are_coroutine_functions(name):
    options: dict[str, Any] = {name: print}
    with pytest.raises(InvalidOption, match=f"'{name}': expected a coroutine function"):
        async with lab(Walker().generator, **options):
            pass


# --- from other processes -----------------------------------------------------------------------


@pytest.mark.parametrize("is_entered", [False, True])
async def test_a_child_in_another_process_is_paused_with_its_parent(is_entered):
    walker = Walker()

    async def parent(request: Count.Goal, handle: Handle) -> AsyncIterator[Any]:
        client = handle.node.action_client(Count, "count")
        if is_entered:
            async with client.send_goal(goal(MANY)) as child:
                yield await child.result()
        else:
            yield await client.send_goal(goal(MANY))

    async with far_and_near() as (far, node):
        far.action_server(Count, "count", walker.generator)
        node.action_server(Count, "parent", parent)
        async with node.action_client(Count, "parent").send_goal(goal()) as handle:
            await take_turns()
            for _ in range(2):
                await handle.pause()
                assert await walker.stands_still()
                await handle.resume()
                assert not await walker.stands_still()
            await handle.pause()
            assert (await handle.cancel()).goals_canceling
            assert (await handle.outcome()).status is GoalStatus.CANCELED


async def test_users_of_ros_pause_all_goals_of_an_action_those_that_wait_too():
    walker = Walker()
    async with (
        lab(walker.generator, policy="queue") as served,
        served.client.send_goal(goal(MANY)) as first,
        served.client.send_goal(goal(MANY)) as second,
    ):
        pause = served.node.service_client(Trigger, "count/pause")
        resume = served.node.service_client(Trigger, "count/resume")
        assert (await pause.call(Trigger.Request())).message == "2 goals paused"
        await first.cancel()
        assert await walker.stands_still()
        assert (second.status, second.is_paused) == (GoalStatus.EXECUTING, True)
        assert (await resume.call(Trigger.Request())).message == "1 goal resumed"
        assert not second.is_paused


async def test_users_of_ros_are_told_what_cannot_be_paused():
    async with lab(Walker().blind) as served, served.client.send_goal(goal(), goal_id=ID):
        pause = served.node.service_client(Trigger, "count/pause")
        answer = await pause.call(Trigger.Request())
        assert not answer.success
        assert answer.message.startswith("0 of 1 goal paused; goal 000102")


async def test_a_client_knows_that_somebody_else_has_paused_its_goal():
    walker = Walker()
    async with far_and_near() as (far, node):
        server = far.action_server(Count, "count", walker.generator)
        async with (
            node.action_client(Count, "count").send_goal(goal(MANY)) as sent,
            node.action_client(Count, "count").attach(sent.goal_id) as attached,
        ):
            for is_paused in (True, False, True):
                switch = local_server(server).pauses
                own = local_server(server).find(sent.goal_id)
                assert own is not None
                await (switch.pause(own, 5.0) if is_paused else switch.resume(own))
                await take_turns()
                assert (sent.is_paused, attached.is_paused) == (is_paused, is_paused)
            async with node.action_client(Count, "count").attach(sent.goal_id) as late:
                late.detach()
                assert late.is_paused
            await sent.cancel()
            await sent.outcome()
            await take_turns()
            assert (sent.is_paused, attached.is_paused) == (False, False)


# --- with a journal -----------------------------------------------------------------------------


async def test_a_goal_is_still_paused_after_a_restart(tmp_path):
    walker = Walker()
    async with open_journal(tmp_path / "goals.db") as journal, turtleact.open_node("lab") as node:
        options: Any = {"journal": journal, "on_restart": "resume"}
        server = node.action_server(Count, "count", walker.generator, **options)
        client = node.action_client(Count, "count")
        async with client.send_goal(goal(MANY), goal_id=ID) as handle:
            await handle.pause()
            await server.aclose()
        walker.steps = MANY - 1
        node.action_server(Count, "count", walker.generator, **options)
        async with client.attach(ID) as again:
            assert again.is_paused
            assert await walker.stands_still()
            await again.resume()
            assert await again.result() == result(MANY)
