"""Opens an action server: puts the plain server and the options that the user has chosen together.

Each option replaces steps of the server and calls what it replaced. The order matters: the later an
option comes, the further outside it is. Two options are in this module: `Callbacks` asks the user's
functions whether to accept a goal and whether to cancel a goal, and `SlotUser` lets the goals wait
for a place in a slot. The journal and pauses have modules of their own.
"""

from __future__ import annotations

import inspect
import logging
from collections import Counter
from collections.abc import Callable
from contextvars import Context, copy_context
from inspect import isawaitable
from typing import Any, Final, get_args

import anyio
import msgspec

from turtleact.errors import GoalRejected, InvalidOption, Reject, summary, text_of
from turtleact.goals.body import ServerOptions
from turtleact.goals.durable import DurableGoals
from turtleact.goals.pausing import Pauses
from turtleact.goals.policies import Decision, Rules, Slot, Slots
from turtleact.goals.records import OnRestart
from turtleact.goals.running import BodyRunner
from turtleact.goals.server import LocalActionServer, ServerSpec
from turtleact.goals.service_server import Introspection
from turtleact.goals.state import CancelResponse, Goal, GoalRequest, GoalResponse
from turtleact.tasks import GRACE, Tasks

__all__ = ["PlaceRequest", "open_server"]

logger = logging.getLogger("turtleact.server")


def open_server(
    spec: ServerSpec,
    options: ServerOptions,
    tasks: Tasks,
    now: Callable[[], int],
    slots: Slots[PlaceRequest],
) -> tuple[LocalActionServer, DurableGoals | None]:
    """Make a server that runs its bodies in tasks of the event loop.

    With a journal, the result has the `DurableGoals` that restore the goals of an earlier process.

    Args:
        spec: The action, its name and its body.
        options: The user's options.
        tasks: The functions that start and manage tasks on asyncio or trio.
        now: Returns the current time (ns since the epoch).
        slots: The slots of the node, of which the options may name one.

    Raises:
        InvalidOption: if the value of an option is not allowed.
    """
    _check(options)
    kept, grace = options.get("result_timeout", 10.0), options.get("grace", GRACE)
    server = LocalActionServer(spec, tasks, now, kept, grace)
    BodyRunner(server)
    server.slot_name = options.get("slot") or ""
    policy = options.get("policy", "parallel")
    rules = Rules(policy, options.get("max_active"), options.get("queue_limit"))
    slot = slots.find(rules, options.get("slot"))
    if slot is not None:
        SlotUser(server, slot)
    if options.get("on_client_lost") == "cancel":
        _cancel_goals_of_lost_clients(server)
    consider = None
    if options.get("goal_callback") is not None or options.get("cancel_callback") is not None:
        callbacks = Callbacks(server, options)
        consider = callbacks.consider if options.get("goal_callback") is not None else None
    durable = None
    if options.get("journal") is not None:
        durable = DurableGoals(server, options, consider, starts_at_once=slot is None)
    server.pauses = Pauses(server, options)
    return server, durable


_CHOICES: Final = {
    "on_client_lost": ("keep", "cancel"),
    "on_restart": get_args(OnRestart),
    "introspection": get_args(Introspection),
}


def _check(options: ServerOptions) -> None:
    """Check the values of a server's options; the other modules check the rest."""
    for name, choices in _CHOICES.items():
        given = options.get(name)
        if given is not None and given not in choices:
            raise InvalidOption(name, f"expected one of {', '.join(choices)}, not {given!r}")
    kept, grace = options.get("result_timeout"), options.get("grace", GRACE)
    if kept is not None and not _is_time(kept):
        problem = f"expected a number of seconds, 0 or more, or None for ever, not {kept!r}"
        raise InvalidOption("result_timeout", problem)
    if not _is_time(grace):
        raise InvalidOption("grace", f"expected a number of seconds, 0 or more, not {grace!r}")
    for name in ("on_pause", "on_resume"):
        callback = options.get(name)
        if callback is not None and not inspect.iscoroutinefunction(callback):
            raise InvalidOption(name, f"expected a coroutine function, not {callback!r}")


def _is_time(given: object) -> bool:
    return isinstance(given, int | float) and not isinstance(given, bool) and 0 <= given < 1e9


class Callbacks:
    """Calls the ``goal_callback`` and the ``cancel_callback`` of one server.

    A callback is a function or a coroutine function. If a callback fails, the request is rejected
    and the failure is logged.

    When the server closes, the calls that have not returned yet are cancelled.

    Args:
        server: The server.
        options: The server's options, with ``goal_callback`` and ``cancel_callback``.
    """

    def __init__(self, server: LocalActionServer, options: ServerOptions) -> None:
        self._server = server
        self._goal_callback: Any = options.get("goal_callback")
        self._cancel_callback: Any = options.get("cancel_callback")
        self._open: set[anyio.CancelScope] = set()
        self._is_closed = False
        self._deciding: Counter[object] = Counter()  # goals not decided yet, counted by sender
        self._lost: set[object] = set()  # those of these senders that have gone
        if self._goal_callback is not None:
            server.admit = self.admit
            if options.get("on_client_lost") == "cancel":
                self._client_lost, server.client_lost = server.client_lost, self.client_lost
        if self._cancel_callback is not None:
            server.may_cancel = self.may_cancel
        self._aclose, server.aclose = server.aclose, self.aclose

    async def admit(self, request: GoalRequest) -> Goal:
        """Ask the ``goal_callback``, and accept the goal if the callback agrees.

        Raises:
            InvalidGoal: if the request does not fit the action.
            GoalRejected: if the goal is rejected, or its client has disconnected in the meantime.
        """
        return self._server.accept(await self.consider(request))

    async def consider(self, request: GoalRequest) -> GoalRequest:
        """Ask the ``goal_callback``, and return the checked request. The errors are as above."""
        message, sender = self._server.check_goal(request.message), request.sender
        self._deciding[sender] += 1
        try:
            await self._ask(message)
            if sender in self._lost:
                raise GoalRejected("its client has gone")
        finally:
            self._deciding[sender] -= 1
            if not self._deciding[sender]:
                del self._deciding[sender]
                self._lost.discard(sender)
        return msgspec.structs.replace(request, message=message)

    async def may_cancel(self, goal: Goal) -> bool:
        """Ask the ``cancel_callback`` whether to cancel a goal."""
        try:
            answer = await self._answer(self._cancel_callback(self._server.make_handle(goal)))
        except Exception as error:
            problem = "the cancel_callback of %s failed; the goal continues"
            logger.error(problem, self._server.name, exc_info=error)
            return False
        return answer is CancelResponse.ACCEPT

    def client_lost(self, sender: object) -> None:
        """Reject the goals of a client that is gone, if they are not decided yet."""
        if sender in self._deciding:
            self._lost.add(sender)
        self._client_lost(sender)

    async def aclose(self) -> None:
        """Cancel the callbacks that have not returned yet, and close the server."""
        self._server.is_open = False
        self._is_closed = True
        for scope in tuple(self._open):
            scope.cancel()
        await self._aclose()

    async def _ask(self, message: object) -> None:
        """Ask the ``goal_callback`` about a goal message; raise GoalRejected unless it agrees."""
        try:
            answer = await self._answer(self._goal_callback(message))
        except Reject as verdict:
            raise GoalRejected(text_of(verdict.reason)) from None
        except Exception as error:
            problem = "the goal_callback of %s failed; the goal is rejected"
            logger.error(problem, self._server.name, exc_info=error)
            raise GoalRejected(f"the goal_callback failed: {summary(error)}") from None
        if answer is GoalResponse.REJECT:
            raise GoalRejected("the goal_callback rejected it")
        if answer is _CLOSED:
            self._server.check_open()
        if answer is not GoalResponse.ACCEPT:
            raise GoalRejected(f"the goal_callback answered {answer!r}, not a GoalResponse")

    async def _answer(self, given: object) -> object:
        """Return the callback's answer; await the answer if it is awaitable."""
        if not isawaitable(given):
            return given
        tasks = self._server.tasks
        with anyio.CancelScope() as scope:
            self._open.add(scope)
            if self._is_closed:  # for example a cancel request, which a closing server still takes
                scope.cancel()
            try:
                return await given
            except tasks.cancelled:
                if scope.cancel_called or tasks.is_canceled():
                    raise
                # Nobody cancelled the caller. The callback awaited a task that was cancelled, which
                # is a failure of the callback.
                raise RuntimeError("it waited for something that was canceled") from None
            finally:
                self._open.remove(scope)
        return _CLOSED


_CLOSED = object()


def _cancel_goals_of_lost_clients(server: LocalActionServer) -> None:
    """Let a server cancel the goals of clients that have gone."""

    def client_lost(sender: object) -> None:
        for goal in server.table.active:
            if goal.sender == sender:
                server.request_cancel(goal)

    server.client_lost = client_lost


class PlaceRequest:
    """A goal's request for a place in a slot. The server cancels a waiting goal with `cancel`.

    Attributes:
        goal: The goal.
        action: The fully qualified name of the goal's action.
        context: The sender's context, in which the body will run.
    """

    __slots__ = ("_server", "action", "context", "goal")

    def __init__(self, server: LocalActionServer, goal: Goal) -> None:
        self._server = server
        self.goal = goal
        self.action = server.name
        self.context: Context = copy_context()

    @property
    def label(self) -> str:
        """The goal's name, as in "busy with <name>"."""
        return f"goal {self.goal.hex} of {self.action}"

    def start(self) -> None:
        """Start the goal when its turn has come, unless the goal has ended meanwhile."""
        # The slot has given the place in the loop's turn before this one. A cancel, an eviction or
        # the end of the server may have come in between; each of them decides the goal's end.
        if self.goal.body is self and not self.goal.is_ending:
            self.goal.body = None
            self._server.start(self.goal, self.context)

    def cancel(self) -> None:
        """End the goal, which has not yet got a place in the slot."""
        self._server.end_canceled(self.goal)

    def evict(self, reason: str) -> None:
        """Cancel the goal for ``reason``: end it if it still waits, otherwise cancel its body."""
        self._server.evict(self.goal, reason)


class SlotUser:
    """Gives the goals of one server places in a slot.

    Args:
        server: The server.
        slot: The slot, which several servers may share.

    Attributes:
        server: The server, as passed to the constructor.
    """

    def __init__(self, server: LocalActionServer, slot: Slot[PlaceRequest]) -> None:
        self.server = server
        self._slot = server.slot = slot
        self._begin, server.begin = server.begin, self.begin
        self._retire, server.retire = server.retire, self.retire

    def begin(self, goal: Goal) -> None:
        """Request a place for a goal: the goal starts, waits or is rejected."""
        request = PlaceRequest(self.server, goal)
        verdict = self._slot.enter(request)
        if verdict.decision is Decision.REJECT:
            self.server.table.forget(goal)
            raise GoalRejected(verdict.reason)
        if verdict.decision is Decision.START:
            self._begin(goal)
            return
        goal.body = request
        self.server.show(goal)
        if goal.is_ending:  # an observer has cancelled it
            return
        for each in verdict.evicted:
            each.evict(verdict.reason)

    def retire(self, goal: Goal) -> None:
        """Let a goal go, and start the goal that gets its place."""
        self._retire(goal)
        following, overdue = self._slot.leave(goal), self._slot.overdue()
        if overdue is not None:
            for each in overdue.evicted:
                each.evict(overdue.reason)
        # The next goal gets the place before observers hear of the end, but starts only later: it
        # must not run inside the step of the body that has just ended.
        if following is not None:
            self.server.tasks.call_soon(following.start)
