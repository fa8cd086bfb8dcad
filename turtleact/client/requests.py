"""The two requests of a goal: one that has it taken, and one that waits for its end.

A server of our kind is sent both at once, which saves half of the way: it answers the second one
when the goal has ended, be that at once. One that does not know the goal yet when the second comes
says so, and is asked again, and from then on one after the other; as a server of another kind is
from the start, whose services may be answered in any order.

Source: rcl_action ``action_client.c``, ``rcl_action_process_result_request``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple, cast

import anyio

from turtleact.client.followed import Followed
from turtleact.client.links import Links
from turtleact.errors import GoalRejected, ServerUnavailable, ServiceTimeout, UnknownGoal
from turtleact.goal import GoalStatus, status_of
from turtleact.goal_note import GoalNote
from turtleact.interfaces import nanoseconds
from turtleact.interfaces.standard import UUID
from turtleact.transports.base import Asked, Reply

__all__ = ["Answer", "Requests"]

BACK_WITHIN: Final = 0.5
"""A server that has gone and is back after so long was only out of reach (s)."""

ATTEMPTS: Final = 3
"""So many times the result of a goal is asked for, if its server seems to be back."""


class Answer(NamedTuple):
    """How a goal has ended.

    Attributes:
        status: SUCCEEDED, CANCELED or ABORTED.
        result: The result.
        note: What the server says beside it.
    """

    status: GoalStatus
    result: Any
    note: GoalNote


class Requests:
    """Sends the requests of one client's goals.

    Args:
        links: The endpoints.
    """

    def __init__(self, links: Links) -> None:
        self._links = links
        self._knows_late = False  # it knew nothing of a goal when it was asked for the end

    def begin(self, followed: Followed, told: Callable[[], object]) -> bool:
        """Send a goal, and the request for its result too, to a server known to take both at once.

        Args:
            followed: The goal.
            told: Called when either is over, if both are on their way.

        Returns:
            Whether they are; else `send` is to be awaited.

        Raises:
            InvalidMessage: if a value does not fit its type; nothing was sent.
        """
        links = self._links
        if self._knows_late or not links.is_of_our_kind:
            return False
        sent = followed.sent = links.ask(self._order(followed))
        if sent is None:
            return False
        asked = followed.asked = links.get_result.ask(self._question(followed))
        if asked is None:
            return False
        sent.tell(told)
        asked.tell(told)
        return True

    async def send(self, followed: Followed) -> None:
        """Send a goal, unless `begin` has, and wait for its acceptance.

        Raises:
            GoalRejected: if it is not taken.
            ServerUnavailable: if nobody serves the action, or its server goes away.
        """
        sent, followed.sent = followed.sent, None
        reply = await (self._links.send(self._order(followed)) if sent is None else sent.reply())
        self._accept(followed, reply)

    def accept(self, followed: Followed) -> None:
        """Note what the server has said to a goal, once it has; raises as `send`, each time."""
        self._accept(followed, cast("Asked", followed.sent).take())
        followed.sent = None

    def answer(self, followed: Followed) -> Answer | None:
        """What has come of the early request for a goal's end; None if it is to be asked again.

        Raises as the request does, each time.
        """
        return self._answer(followed, cast("Asked", followed.asked).take(), is_early=True)

    async def result(self, followed: Followed) -> Answer:
        """Wait for the end of a goal.

        Raises:
            UnknownGoal: if the server does not hold it.
            ServerUnavailable: if the server goes away, and does not come back at once.
        """
        lost = list[ServerUnavailable]()
        while True:
            try:
                is_early = followed.asked is not None
                reply = await self._end(followed)
            except ServiceTimeout:  # the goal takes longer than the transport waits
                continue
            except ServerUnavailable as error:
                lost.append(error)
                if len(lost) == ATTEMPTS or not await self._is_back():
                    raise lost[0] from None
                continue
            answer = self._answer(followed, reply, is_early=is_early)
            if answer is not None:
                return answer

    def _accept(self, followed: Followed, reply: Reply) -> None:
        self._links.learn(reply)
        response: Any = reply.message
        if not response.accepted:
            raise GoalRejected(GoalNote.read(reply.note).reason)
        followed.goal.stamp = nanoseconds(response.stamp)
        followed.is_accepted = True

    def _answer(self, followed: Followed, reply: Reply, *, is_early: bool) -> Answer | None:
        response: Any = reply.message
        status = status_of(response.status)
        self._links.learn(reply)
        if status.is_terminal:
            return Answer(status, response.result, GoalNote.read(reply.note))
        if not is_early:
            name, goal = self._links.name, followed.goal
            raise UnknownGoal(f"'{name}' holds no goal {goal.hex}, or not any more")
        self._knows_late = bool(reply.note)  # else it is not one of ours at all
        return None

    async def _end(self, followed: Followed) -> Reply:
        asked, followed.asked = followed.asked, None
        if asked is not None:
            return await asked.reply()
        return await self._links.get_result.call(self._question(followed))

    def _order(self, followed: Followed) -> object:
        goal: Any = followed.goal.request
        return self._links.implied.send_goal.Request(UUID(followed.goal_id), goal)

    def _question(self, followed: Followed) -> object:
        return self._links.implied.get_result.Request(UUID(followed.goal_id))

    async def _is_back(self) -> bool:
        """Whether the server was out of reach for a moment only."""
        with anyio.move_on_after(BACK_WITHIN):
            await self._links.wait_until_served()
        return self._links.is_served
