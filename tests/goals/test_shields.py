"""A cancel waits for a shielded section that it finds a body in, on every loop."""

from __future__ import annotations

from typing import Any

import anyio
import anyio.lowlevel
import pytest

import turtleact
from turtleact import GoalStatus
from turtleact.errors import GoalAborted

from ..lab import Count, Gate, feedback, goal, lab, result, running, settle, take_turns


class Section:
    """A body with a shielded section, and what it has been through.

    Attributes:
        opened: Set it to let the body go on inside the section.
        log: What has happened, in order.
    """

    def __init__(self) -> None:
        self.opened = anyio.Event()
        self.log: list[str] = []

    async def first(self, request: Count.Goal) -> Any:
        """The section comes first."""
        await self.shielded()
        return await self.unshielded()

    async def later(self, request: Count.Goal) -> Any:
        """The section comes after a wait."""
        await take_turns()
        await self.shielded()
        return await self.unshielded()

    async def stream(self, request: Count.Goal):
        """A generator."""
        yield feedback(1)
        await self.shielded()
        yield feedback(2)
        await self.unshielded()

    async def clean_up(self, request: Count.Goal) -> Any:
        """The section is the clean-up of another cancellation."""
        try:
            with anyio.CancelScope() as scope:
                scope.cancel()
                await anyio.lowlevel.checkpoint()
        finally:
            await self.shielded()
        return await self.unshielded()

    async def shielded(self) -> None:
        with anyio.CancelScope(shield=True):
            try:
                await self.opened.wait()
                self.log.append("shielded over")
            except BaseException:
                self.log.append("shield broken")
                raise

    async def unshielded(self) -> Any:
        try:
            await anyio.sleep_forever()
        except anyio.get_cancelled_exc_class():
            self.log.append("canceled")
            raise


BODIES = pytest.mark.parametrize("body", ["first", "later", "stream", "clean_up"])


async def cancel_within(served, section: Section, sent, ask) -> None:
    """Have the goal canceled while its body is shielded, then let the body go on."""
    await settle()
    await ask()
    await settle()
    assert section.log == []
    section.opened.set()
    await sent.done.wait()
    assert section.log == ["shielded over", "canceled"]


@BODIES
@pytest.mark.parametrize("times", [1, 2])
async def test_cancel_requests_wait_for_the_end_of_a_shielded_section(send, body, times):
    section = Section()
    async with (
        lab(getattr(section, body)) as served,
        running(lambda: send(served, goal())) as sent,
    ):

        async def ask():
            for _ in range(times):
                await served.client.cancel_all()

        await cancel_within(served, section, sent, ask)
        assert sent.value.status is GoalStatus.CANCELED


async def test_a_preempted_body_is_let_out_of_its_shielded_section(send):
    section = Section()

    async def act(request: Count.Goal) -> Any:
        return result() if request.upto == 2 else await section.first(request)

    async with (
        lab(act, policy="preempt") as served,
        running(lambda: send(served, goal())) as sent,
        running(lambda: send(served, goal(2))) as newer,
    ):
        await settle()
        assert section.log == []
        section.opened.set()
        await newer.done.wait()
        assert section.log == ["shielded over", "canceled"]
        assert sent.value.status is GoalStatus.ABORTED
        assert newer.value.status is GoalStatus.SUCCEEDED


@BODIES
async def test_a_scope_of_the_caller_waits_for_the_shielded_section(send, body):
    section = Section()
    async with (
        lab(getattr(section, body)) as served,
        running(lambda: send(served, goal())) as sent,
    ):

        async def cancel_caller():
            sent.scope.cancel()

        await cancel_within(served, section, sent, cancel_caller)


async def test_a_shield_of_the_caller_holds_nothing_up(send):
    section = Section()
    section.opened.set()

    async def shielded_send():
        with anyio.CancelScope(shield=True):
            return await send(served, goal())

    async with lab(section.first) as served, running(shielded_send) as sent:
        await served.client.cancel_all()
        await sent.done.wait()
        assert sent.value.status is GoalStatus.CANCELED


async def test_a_body_that_ends_in_its_shielded_section_has_ended_well(send):
    opened = anyio.Event()

    async def act(request: Count.Goal) -> Count.Result:
        with anyio.CancelScope(shield=True):
            await opened.wait()
        return result(1)

    async with lab(act) as served, running(lambda: send(served, goal())) as sent:
        await served.client.cancel_all()
        opened.set()
        await sent.done.wait()
        assert sent.value == turtleact.Outcome(GoalStatus.SUCCEEDED, result(1))
        await settle()
        await served.client.send_goal(goal())  # no cancellation has been left over


async def test_a_cancel_waits_for_the_shielded_section_of_a_child():
    """The child runs in the parent's own task where it is awaited on asyncio."""
    section = Section()
    async with turtleact.open_node("home") as node:
        client = node.action_client(Count, "child")

        async def parent(request: Count.Goal) -> Any:
            return await client.send_goal(request)

        node.action_server(Count, "child", section.first)
        node.action_server(Count, "count", parent)
        outer = node.action_client(Count, "count")
        async with outer.send_goal(goal()) as handle:
            await settle()
            await handle.cancel()
            await settle()
            assert (section.log, handle.status) == ([], GoalStatus.CANCELING)
            section.opened.set()
            assert (await handle.outcome()).status is GoalStatus.CANCELED
        assert section.log == ["shielded over", "canceled"]


# --- what others see --------------------------------------------------------------------------


async def test_a_goal_whose_caller_was_canceled_is_canceling_while_it_cleans_up(send):
    gate = Gate()
    seen: list[GoalStatus] = []
    async with lab(gate.tidy) as served, running(lambda: send(served, goal())) as sent:
        sent.scope.cancel()
        await settle()
        seen += [each.status for each in served.active]
        gate.opened.set()
        await sent.done.wait()
    assert seen == [GoalStatus.CANCELING]


# --- one inside the other ---------------------------------------------------------------------

DEEP = 400
"""Deeper than Python's stack would hold."""


@pytest.mark.parametrize("way", ["awaited", "entered"])
@pytest.mark.parametrize("waits", ["at the bottom", "on the way down", "never"])
async def test_a_body_may_await_its_own_action_as_deep_as_it_likes(way, waits):
    opened = anyio.Event()

    async def act(request: Count.Goal) -> Any:
        if request.upto == 0:
            if waits == "at the bottom":
                await opened.wait()
            return result(0)
        if waits == "on the way down":
            await anyio.lowlevel.checkpoint()
        if way == "awaited":
            return await served.client.send_goal(goal(request.upto - 1))
        async with served.client.send_goal(goal(request.upto - 1)) as handle:
            return await handle.result()

    async with lab(act) as served:
        async with served.client.send_goal(goal(DEEP)) as handle:
            await settle()
            opened.set()
            assert await handle.result() == result(0)
        assert served.active == []


async def test_a_deep_failure_reaches_the_top():
    async def act(request: Count.Goal) -> Any:
        if request.upto == 0:
            raise turtleact.Abort("the bottom")
        return await served.client.send_goal(goal(request.upto - 1))

    async with lab(act) as served:
        with pytest.raises(GoalAborted):
            await served.client.send_goal(goal(DEEP))
        assert served.active == []
