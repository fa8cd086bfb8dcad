"""Pauses goals: the body of a paused goal waits until the goal is resumed.

The body of a paused goal waits at one of these points:

- a generator: at a ``yield``; the server does not resume the generator until the goal is resumed
- a coroutine declared with ``pausable=True``: at ``await handle.checkpoint()``

When the body has reached this point, the server calls ``on_pause``, if there is one, to bring the
robot to rest. A coroutine without ``pausable=True`` continues during a pause, and only ``on_pause``
stops the robot.

The goals that the body has sent are paused with it, in this process or another.

ROS 2 has no state for paused goals, so a pause does not change the state of a goal. A paused goal
keeps its place in the slot, so no waiting goal starts instead. Cancellation, preemption and the
server's shutdown take effect on a paused goal at once.

Source: VDA 5050 ``startPause`` and ``stopPause``, for what users expect of a pause.
"""

from __future__ import annotations

import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from contextvars import Context
from functools import partial
from typing import Any, cast

import anyio
import msgspec

from turtleact.errors import PauseRefused, ServerUnavailable, summary
from turtleact.goals.body import ServerOptions
from turtleact.goals.observers import GoalObserver
from turtleact.goals.running import BodyTask
from turtleact.goals.server import GoalServer, LocalActionServer
from turtleact.goals.state import Goal, GoalStatus
from turtleact.tasks import Background

__all__ = ["PauseRequest", "Pauses"]

logger = logging.getLogger("turtleact.server")

Callback = Callable[[Any], Awaitable[object]]

CLEANING = 5.0
"""How long resuming goals may take after a failed pause (s, event loop time)."""


class PauseRequest(msgspec.Struct, eq=False):
    """A request to pause a goal.

    Attributes:
        length: The total length of the goal's earlier pauses (ns).
        is_open: Whether the goal is to stay paused.
        body: The body that is asked to wait; None if it has not started, or does not wait.
        is_standing: Whether the body waits because of this request.
        is_before_start: Whether the goal was paused before its body started.
        since: When the goal was paused (ns since the epoch); None if it is not paused now.
        children: The goals that were paused because this goal's body has sent them, each with its
            server.
    """

    length: int = 0
    is_open: bool = True
    body: BodyTask | None = None
    is_standing: bool = False
    is_before_start: bool = False
    since: int | None = None
    children: dict[Goal, GoalServer] = {}


class Pauses(GoalObserver):
    """Pauses and resumes the goals of one server.

    While any goal is paused, this object observes the server's goals. The server runs none of this
    code before the first pause.

    Args:
        server: The server.
        options: The server's options, with ``pausable``, ``on_pause`` and ``on_resume``.
    """

    def __init__(self, server: LocalActionServer, options: ServerOptions) -> None:
        self._server = server
        self._on_pause: Callback | None = options.get("on_pause")
        self._on_resume: Callback | None = options.get("on_resume")
        self._stands = server.spec.body.is_generator or options.get("pausable", False)
        self._locks: dict[Goal, anyio.Lock] = {}
        self._orphans: list[Background] = []
        self._requests: dict[Goal, PauseRequest] = {}  # also those of goals that were resumed
        self._start = server.start
        self._aclose, server.aclose = server.aclose, self.aclose

    @property
    def paused(self) -> list[Goal]:
        """The paused goals, in the order in which they were paused."""
        return [goal for goal in self._requests if self.is_paused(goal)]

    def is_paused(self, goal: Goal) -> bool:
        """Whether a goal is paused. A goal that is being canceled or preempted is not."""
        request = self._requests.get(goal)
        return request is not None and request.since is not None and not _is_ending(goal)

    def paused_time(self, goal: Goal) -> float:
        """How long a goal has been paused in total (s, by the graph's clock)."""
        request = self._requests.get(goal)
        if request is None:
            return 0.0
        now = 0 if request.since is None else self._since(request.since)
        return (request.length + now) / 1e9

    async def pause(self, goal: Goal, timeout: float) -> None:
        """Pause a goal and the goals that its body has sent. Return when all of them are paused.

        Pausing a paused goal does nothing. Cancelling: the goal and the goals that its body has
        sent continue.

        Args:
            goal: The goal.
            timeout: How long the body may take to reach a ``yield`` or a checkpoint (s, event loop
                time).

        Raises:
            PauseRefused: if the goal cannot be paused within ``timeout``. In this case, the goal
                continues.
        """
        async with self._switching(goal):
            if self.is_paused(goal):
                return
            self._check(goal)
            if goal.status is GoalStatus.ACCEPTED:
                self.hold(goal)
            else:
                await self._pause(goal, timeout)

    async def resume(self, goal: Goal) -> None:
        """Resume a paused goal and the goals that were paused with it.

        Resuming a goal that is not paused does nothing.

        Raises:
            PauseRefused: if ``on_resume`` fails, and the goal therefore stays paused.
        """
        async with self._switching(goal):
            request = self._requests.get(goal)
            if request is None or request.since is None:
                return
            if not request.is_before_start:
                await self._call(self._on_resume, goal, "on_resume")
            self._end_pause(goal, request)
            self._withdraw(goal, request)
        await self._free(request.children)

    @asynccontextmanager
    async def _switching(self, goal: Goal) -> AsyncIterator[None]:
        """Let only one task at a time pause or resume a goal."""
        lock = self._locks.setdefault(goal, anyio.Lock())
        try:
            async with lock:
                yield
        finally:
            # A released lock belongs to its next waiter at once, so an unlocked one has none.
            if not lock.locked():
                self._locks.pop(goal, None)

    def hold(self, goal: Goal) -> None:
        """Pause a goal whose body has not started, so that the body starts only after `resume`."""
        request = self._open(goal)
        request.is_before_start = True
        if isinstance(goal.body, BodyTask):
            self._close_gate(goal, request, goal.body)
        else:
            self._server.start = self._start_held
        self._begin_pause(goal, request)

    # called while any goal is paused

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:  # noqa: ARG002
        """Forget that a goal is paused, because it is being canceled or has ended."""
        request = self._requests.get(goal)
        if request is None or after <= GoalStatus.EXECUTING:
            return
        self._end_pause(goal, request)
        if after.is_terminal:
            self._withdraw(goal, request)
            self._free_later(goal, request)

    async def aclose(self) -> None:
        """Close the server, and stop the tasks that resume the children of goals that ended."""
        await self._aclose()
        for each in self._orphans:
            await each.aclose(self._server.grace)

    # a request

    def _open(self, goal: Goal) -> PauseRequest:
        """Make a request to pause a goal."""
        if not self._requests:
            self._server.observers.add(self)
        before = self._requests.get(goal)
        request = self._requests[goal] = PauseRequest(0 if before is None else before.length)
        return request

    def _withdraw(self, goal: Goal, request: PauseRequest) -> None:
        """Withdraw a request, so that the body continues."""
        request.is_open = False
        if request.body is not None:
            request.body.gate = request.body.on_child = None
        if goal.ended or not request.length:
            self._requests.pop(goal, None)
            if not self._requests:
                self._server.observers.remove(self)
        goal.changed.fire()

    def _close_gate(self, goal: Goal, request: PauseRequest, body: BodyTask) -> None:
        request.body = body
        body.on_child = partial(self._hold_child, goal, request)
        if self._stands or request.is_before_start:
            body.gate = partial(self.wait_while_paused, goal, request)

    def _start_held(self, goal: Goal, context: Context | None) -> None:
        """Start a goal, whose body waits if the goal was paused before."""
        self._start(goal, context)
        request = self._requests.get(goal)
        if request is not None and request.is_open and isinstance(goal.body, BodyTask):
            self._close_gate(goal, request, goal.body)

    async def wait_while_paused(self, goal: Goal, request: PauseRequest) -> None:
        """Wait until a goal is resumed or is ending. Cancelling: safe."""
        request.is_standing = True
        goal.changed.fire()
        try:
            while request.is_open and not _is_ending(goal):
                await goal.changed.wait()
        finally:
            request.is_standing = False
        if _is_ending(goal):
            if request.body is not None:
                request.body.gate = None
            # A cancel fires the signal and then cancels the body's task, both in one step. asyncio
            # raises the cancellation in the `wait` above. On trio the `wait` has ended by then, and
            # the cancellation would be raised only at the next checkpoint: a body that had not
            # begun would begin.
            await self._server.tasks.checkpoint()

    def _begin_pause(self, goal: Goal, request: PauseRequest) -> None:
        request.since = self._server.now()
        self._server.observers.pause_changed(goal, True)
        goal.changed.fire()

    def _end_pause(self, goal: Goal, request: PauseRequest) -> None:
        if request.since is not None:
            request.length += max(1, self._since(request.since))
            request.since = None
            self._server.observers.pause_changed(goal, False)
            goal.changed.fire()

    def _since(self, moment: int) -> int:
        return max(0, self._server.now() - moment)  # the clock may have been set back

    # pausing a goal that runs

    def _check(self, goal: Goal) -> None:
        if goal.is_ending or not goal.status.is_active:
            raise PauseRefused("it has ended")
        if _is_ending(goal):
            raise PauseRefused("it is being canceled")
        if not self._stands and self._on_pause is None:
            raise PauseRefused(
                "its body cannot be paused: declare it with pausable=True and let it await "
                "handle.checkpoint(), or give the action an on_pause"
            )

    async def _pause(self, goal: Goal, timeout: float) -> None:
        until = anyio.current_time() + timeout
        request, body = self._open(goal), cast("BodyTask", goal.body)
        try:
            # The body is held first: a goal that it sends from now on begins paused.
            self._close_gate(goal, request, body)
            await self._pause_children(body, request, until)
            if self._stands:
                await self._wait_until_it_stands(goal, request, until, timeout)
            await self._bring_to_rest(goal)
            await self._pause_children(body, request, until)  # of a body that is not held
            if _is_ending(goal):
                raise PauseRefused("it is being canceled or has ended")
        except BaseException:
            self._withdraw(goal, request)
            with anyio.move_on_after(CLEANING, shield=True):
                await self._free(request.children)
            raise
        self._begin_pause(goal, request)

    async def _wait_until_it_stands(
        self, goal: Goal, request: PauseRequest, until: float, timeout: float
    ) -> None:
        # A body that waits for its paused children stands still, too, and reaches no `yield`.
        def stands() -> bool:
            sent = () if request.body is None else request.body.children
            return request.is_standing or any(not child.ended for child in sent)

        with anyio.move_on_after(until - anyio.current_time()):
            while not (stands() or _is_ending(goal)):
                await goal.changed.wait()
        if _is_ending(goal):
            raise PauseRefused("it is being canceled or has ended")
        if not stands():
            raise PauseRefused(
                f"its body has not reached a yield or a checkpoint within {timeout:g} s, so the "
                "request was withdrawn"
            )

    async def _bring_to_rest(self, goal: Goal) -> None:
        """Call ``on_pause`` to bring the robot to rest.

        If ``on_pause`` is cancelled and the goal continues, call ``on_resume``, because the robot
        may have stopped already.
        """
        try:
            await self._call(self._on_pause, goal, "on_pause")
        except self._server.tasks.cancelled:
            if not _is_ending(goal):
                with suppress(PauseRefused), anyio.move_on_after(CLEANING, shield=True):
                    await self._call(self._on_resume, goal, "on_resume")
            raise

    async def _call(self, callback: Callback | None, goal: Goal, what: str) -> None:
        if callback is None:
            return
        try:
            await callback(self._server.make_handle(goal))
        except Exception as error:
            problem = "the %s of a goal failed (goal %s)"
            logger.error(problem, what, goal.hex, exc_info=error)
            raise PauseRefused(f"{what} failed: {summary(error)}") from error

    # the goals that the body has sent

    async def _pause_children(self, body: BodyTask, request: PauseRequest, until: float) -> None:
        while fresh := _running_children(body):
            child, server = fresh[0]
            request.children[child] = server
            try:
                await server.pauses.pause(child, max(0.0, until - anyio.current_time()))
            except (PauseRefused, ServerUnavailable) as error:
                del request.children[child]
                if not _is_ending(child):
                    raise _refused(error) from None

    def _hold_child(
        self, goal: Goal, request: PauseRequest, child: Goal, server: GoalServer
    ) -> None:
        """Pause a goal that a body sends while the body is paused or held."""
        if not child.ended and (self._stands or request.since is not None):
            server.pauses.hold(child)
            request.children[child] = server
            goal.changed.fire()

    def _free_later(self, goal: Goal, request: PauseRequest) -> None:
        """Resume the children of a goal that has ended."""
        self._orphans = [each for each in self._orphans if not each.has_ended]
        if any(not child.ended for child in request.children):
            freeing = self._free(request.children)
            name, tasks = f"children of goal {goal.hex}", self._server.tasks
            self._orphans.append(Background(freeing, name, tasks))

    async def _free(self, children: dict[Goal, GoalServer]) -> None:
        for child, server in list(children.items()):
            with suppress(PauseRefused, ServerUnavailable):  # logged already; it stays paused
                await server.pauses.resume(child)


def _running_children(body: BodyTask) -> list[tuple[Goal, GoalServer]]:
    return [
        (child, server)
        for child, server in body.children.items()
        if not (_is_ending(child) or server.pauses.is_paused(child))
    ]


def _refused(error: PauseRefused | ServerUnavailable) -> PauseRefused:
    if isinstance(error, PauseRefused):
        return error
    return PauseRefused(f"a goal that its body has sent: {error}")


def _is_ending(goal: Goal) -> bool:
    """Whether a goal has ended, or is being canceled by a client or its server."""
    is_decided = goal.is_ending or goal.ended != 0
    return is_decided or bool(goal.reason) or goal.status > GoalStatus.EXECUTING
