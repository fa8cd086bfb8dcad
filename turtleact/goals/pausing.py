"""Pauses goals: the body of a paused goal waits until the goal is resumed.

The body of a paused goal waits at one of these points:

- a generator: at a ``yield``; the server does not resume the generator until the goal is resumed
- a coroutine declared with ``pausable=True``: at ``await handle.checkpoint()``

When the body has reached this point, the server calls ``on_pause``, if there is one, to bring the
robot to rest. A coroutine without ``pausable=True`` continues during a pause, and only ``on_pause``
stops the robot.

ROS 2 has no state for paused goals, so a pause does not change the state of a goal. A paused goal
keeps its place in the slot, so no waiting goal starts instead. Cancellation, preemption and the
server's shutdown take effect on a paused goal at once.

Source: VDA 5050 ``startPause`` and ``stopPause``, for what users expect of a pause.
"""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any, Protocol

import anyio

from turtleact.errors import PauseRefused
from turtleact.goals.body import Body, ServerOptions
from turtleact.goals.durable import DurableGoals
from turtleact.goals.observers import Observers
from turtleact.goals.state import Goal, GoalStatus
from turtleact.summaries import loggable, summary
from turtleact.tasks import Background, Signal, Tasks

__all__ = ["Hold", "Pauses"]

logger = logging.getLogger("turtleact.server")

Callback = Callable[[Any], Awaitable[object]]

CLEANING = 5.0
"""How long resuming goals may take after a failed pause (s, event loop time)."""


class Hold:
    """A request to the body of a goal to wait.

    Attributes:
        is_standing: Whether the body waits because of this request.
        is_before_start: Whether the goal was paused before its body started.
        changed: A signal that fires when the body starts to wait, when the body sends a goal, and
            when the request is withdrawn.
    """

    __slots__ = ("changed", "is_before_start", "is_standing")

    def __init__(self, changed: Signal, *, is_before_start: bool = False) -> None:
        self.is_standing = False
        self.is_before_start = is_before_start
        self.changed = changed


class Keeper(Protocol):
    """The interface of `turtleact.goals.execution.Execution` that `Pauses` uses."""

    durable: DurableGoals | None
    observers: Observers

    def make_handle(self, goal: Goal) -> object:
        """Make the handle that ``on_pause`` and ``on_resume`` get."""


class Pauses:
    """Pauses and resumes the goals of one server.

    Args:
        body: The body that the server runs for each goal.
        options: The server's options, with ``pausable``, ``on_pause`` and ``on_resume``.
        keeper: The server's `Execution`, which makes goal handles and has the journal and the
            observers.
        tasks: The functions that start and manage tasks on asyncio or trio.
        now: A function that returns the current time (ns since the epoch).

    Attributes:
        paused: The paused goals, each with the time when it was paused (ns since the epoch).
    """

    def __init__(
        self,
        body: Body,
        options: ServerOptions,
        keeper: Keeper,
        tasks: Tasks,
        now: Callable[[], int],
    ) -> None:
        self._on_pause: Callback | None = options.get("on_pause")
        self._on_resume: Callback | None = options.get("on_resume")
        self._stands = body.is_generator or options.get("pausable", False)
        self._keeper = keeper
        self._observers = keeper.observers
        self._tasks = tasks
        self._now = now
        self._switching: dict[Goal, anyio.Lock] = {}
        self._orphans: list[Background] = []
        self.paused: dict[Goal, int] = {}

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
        async with self._switch(goal):
            if goal.is_paused:
                return
            self._check(goal)
            await self._pause(goal, timeout)

    async def resume(self, goal: Goal) -> None:
        """Resume a paused goal and the goals that its body has sent.

        Resuming a goal that is not paused does nothing.

        Raises:
            PauseRefused: if ``on_resume`` fails, and the goal therefore stays paused.
        """
        async with self._switch(goal):
            if not goal.is_paused:
                return
            if not (isinstance(goal.hold, Hold) and goal.hold.is_before_start):
                await self._call(self._on_resume, goal, "on_resume")
            if goal.is_paused:  # it may have been canceled meanwhile
                self._set(goal, is_paused=False)
                self.let_go(goal)
        for child, pauses in _children(goal):
            await pauses.resume(child)

    async def stand(self, goal: Goal) -> None:
        """If a pause of the goal was requested, wait until the goal may continue. Cancelling: safe.

        If the goal is canceled during the wait, this method raises the cancellation.
        """
        hold = goal.hold
        if not isinstance(hold, Hold):
            return
        hold.is_standing = True
        hold.changed.fire()
        try:
            while goal.hold is hold:
                await hold.changed.wait()
        finally:
            hold.is_standing = False
        # A cancel lets the body go and then cancels its task, both in one step. asyncio raises the
        # cancellation in the `wait` above. On trio the `wait` has ended by then, and the
        # cancellation would be raised only at the next checkpoint: a body that had not begun would
        # begin.
        if _is_ending(goal):
            await self._tasks.checkpoint()

    async def checkpoint(self, goal: Goal) -> None:
        """Let other tasks run, and wait while the goal is paused."""
        await self._tasks.checkpoint()
        while goal.hold is not None:
            await self.stand(goal)

    def paused_time(self, goal: Goal) -> float:
        """How long a goal has been paused in total (s, by the graph's clock)."""
        since = self.paused.get(goal)
        return (goal.paused_ns + (0 if since is None else self._since(since))) / 1e9

    def _since(self, moment: int) -> int:
        return max(0, self._now() - moment)  # the clock may have been set back

    def let_go(self, goal: Goal) -> None:
        """Withdraw the request to wait, so that the body continues."""
        hold, goal.hold = goal.hold, None
        if isinstance(hold, Hold):
            hold.changed.fire()

    def end(self, goal: Goal) -> None:
        """Forget that a goal is paused, because the goal is being canceled or ends."""
        if goal.hold is not None:
            self.let_go(goal)
        if goal.is_paused:
            self._set(goal, is_paused=False)

    def hold(self, goal: Goal) -> None:
        """Pause a goal whose body has not started, so that the body starts only after `resume`."""
        goal.hold = Hold(self._tasks.signal(), is_before_start=True)
        self._set(goal, is_paused=True)

    def _check(self, goal: Goal) -> None:
        if goal.is_decided or not goal.status.is_active:
            raise PauseRefused("it has ended")
        if goal.status is GoalStatus.CANCELING or goal.reason:
            raise PauseRefused("it is being canceled")
        if not self._stands and self._on_pause is None:
            raise PauseRefused(
                "its body cannot be paused: declare it with pausable=True and let it await "
                "handle.checkpoint(), or give the action an on_pause"
            )

    async def _pause(self, goal: Goal, timeout: float) -> None:
        if goal.status is GoalStatus.ACCEPTED:
            self.hold(goal)
            return
        until = anyio.current_time() + timeout
        try:
            # The body is held first: a goal that it sends from now on begins paused (`enter`).
            if self._stands:
                goal.hold = Hold(self._tasks.signal())
            await self._pause_children(goal, until)
            if self._stands:
                await self._wait_until_it_stands(goal, until, timeout)
            await self._bring_to_rest(goal)
            await self._pause_children(goal, until)  # of a body that is not held
            if _is_ending(goal):
                raise PauseRefused("it is being canceled or has ended")
        except BaseException:
            self.let_go(goal)
            # If the goal is being canceled, its children may be canceled, too. Those that are not
            # go on when the goal has ended (`leave`).
            if goal.is_decided or not _is_ending(goal):
                with anyio.move_on_after(CLEANING, shield=True):
                    await self._free(_paused_children(goal))
            raise
        self._set(goal, is_paused=True)

    def enter(self, goal: Goal, parent: Goal) -> None:
        """Make a new goal a child of ``parent``, the goal whose body has sent the new goal.

        If the parent is paused or being paused, the child begins paused, and is resumed with the
        parent.
        """
        goal.enter_parent(parent, self)
        if parent.is_paused or parent.hold is not None:
            self.hold(goal)
            goal.is_paused_by_parent = True
            if isinstance(parent.hold, Hold):
                parent.hold.changed.fire()

    def leave(self, goal: Goal) -> None:
        """Forget that an ending goal is paused. Resume the children that were paused with it."""
        self.end(goal)
        if left := _paused_children(goal):
            self._orphans = [each for each in self._orphans if not each.has_ended]
            freeing = self._free(left)
            self._orphans.append(Background(freeing, f"children of goal {goal.hex}", self._tasks))

    async def aclose(self, grace: float) -> None:
        """Stop the tasks that resume child goals because their paused parent has ended.

        Wait at most ``grace`` seconds (event loop time) for each task.
        """
        for each in self._orphans:
            await each.aclose(grace)

    async def _pause_children(self, goal: Goal, until: float) -> None:
        while fresh := [each for each in _children(goal) if not _stands_or_ends(each[0])]:
            child, pauses = fresh[0]
            if await pauses.pause_unless_ended(child, max(0.0, until - anyio.current_time())):
                child.is_paused_by_parent = True

    async def _free(self, children: list[tuple[Goal, Pauses]]) -> None:
        for child, pauses in children:
            with suppress(PauseRefused):  # logged already; that child stays paused
                await pauses.resume(child)

    async def pause_unless_ended(self, goal: Goal, timeout: float) -> bool:
        """Pause a goal like `pause`, but return False if the goal is ending or has ended.

        Raises:
            PauseRefused: if the goal cannot be paused in time. In this case, the goal continues.
        """
        try:
            await self.pause(goal, timeout)
        except PauseRefused:
            if _is_ending(goal):
                return False
            raise
        return True

    async def _bring_to_rest(self, goal: Goal) -> None:
        """Call ``on_pause`` to bring the robot to rest.

        If ``on_pause`` is cancelled and the goal continues, call ``on_resume``, because the robot
        may have stopped already.
        """
        try:
            await self._call(self._on_pause, goal, "on_pause")
        except self._tasks.cancelled:
            if not _is_ending(goal):
                with suppress(PauseRefused), anyio.move_on_after(CLEANING, shield=True):
                    await self._call(self._on_resume, goal, "on_resume")
            raise

    async def _wait_until_it_stands(self, goal: Goal, until: float, timeout: float) -> None:
        # A body that waits for its paused children stands still, too, and reaches no `yield`.
        hold = goal.hold
        if not isinstance(hold, Hold):  # canceled while its children were being paused
            raise PauseRefused("it is being canceled or has ended")
        with anyio.move_on_after(until - anyio.current_time()):
            while goal.hold is hold and not (hold.is_standing or goal.children):
                await hold.changed.wait()
        if goal.hold is not hold:
            raise PauseRefused("it is being canceled or has ended")
        if not (hold.is_standing or goal.children):
            raise PauseRefused(
                f"its body has not reached a yield or a checkpoint within {timeout:g} s, so the "
                "request was withdrawn"
            )

    async def _call(self, callback: Callback | None, goal: Goal, what: str) -> None:
        if callback is None:
            return
        try:
            await callback(self._keeper.make_handle(goal))
        except Exception as error:
            told = loggable(error)
            logger.error("the %s of a goal failed%s", what, goal.suffix, exc_info=told)
            raise PauseRefused(f"{what} failed: {summary(error)}") from error

    def _set(self, goal: Goal, *, is_paused: bool) -> None:
        goal.is_paused = is_paused
        if is_paused:
            self.paused[goal] = self._now()
        else:
            goal.is_paused_by_parent = False
            goal.paused_ns += self._since(self.paused.pop(goal))
        if self._keeper.durable is not None and not goal.is_decided:
            self._keeper.durable.paused(goal)
        self._observers.pause_changed(goal)
        if goal.listener is not None:
            goal.listener.fire()

    def _switch(self, goal: Goal) -> _Switch:
        return _Switch(self._switching, goal)


def _children(goal: Goal) -> list[tuple[Goal, Pauses]]:
    """Return a goal's children in a new list, since children may end while the caller iterates."""
    return list((goal.children or {}).items())


def _paused_children(goal: Goal) -> list[tuple[Goal, Pauses]]:
    return [each for each in _children(goal) if each[0].is_paused_by_parent]


def _stands_or_ends(goal: Goal) -> bool:
    return goal.is_paused or _is_ending(goal)


def _is_ending(goal: Goal) -> bool:
    """Whether a goal has ended, or is being canceled by a client or its server."""
    return goal.is_decided or bool(goal.reason) or goal.status > GoalStatus.EXECUTING


class _Switch:
    """Lets only one task at a time pause or resume a goal.

    The goal's lock is deleted as soon as no task holds the lock or waits for it.
    """

    def __init__(self, locks: dict[Goal, anyio.Lock], goal: Goal) -> None:
        self._locks = locks
        self._goal = goal
        self._lock = locks.setdefault(goal, anyio.Lock())

    async def __aenter__(self) -> None:
        try:
            await self._lock.acquire()
        finally:
            self._drop_if_unused()

    async def __aexit__(self, *_: object) -> None:
        self._lock.release()
        self._drop_if_unused()

    def _drop_if_unused(self) -> None:
        # A released lock belongs to its next waiter at once, so an unlocked one has none.
        if not self._lock.locked():
            self._locks.pop(self._goal, None)
