"""The two requests of a goal: one that has it taken, and one that waits for its end.

A server of our kind is sent both at once, which saves half of the way: it answers the second one
when the goal has ended, be that at once. One that does not know the goal yet when the second comes
says so, and is asked again, and from then on one after the other; as a server of another kind is
from the start, whose services may be answered in any order.

Source: rcl_action ``action_client.c``, ``rcl_action_process_result_request``.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple, cast

import anyio

from turtleact.client.followed import Followed
from turtleact.client.links import Links
from turtleact.errors import GoalRejected, ServerUnavailable, ServiceTimeout, UnknownGoal
from turtleact.goal import GoalStatus, status_of
from turtleact.goal_note import GoalNote
from turtleact.interfaces import Message
from turtleact.interfaces.stamps import nanoseconds
from turtleact.interfaces.standard import UUID
from turtleact.transports.base import Reply

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

    async def send(self, followed: Followed) -> None:
        """Send a goal, and wait for its acceptance.

        Raises:
            GoalRejected: if it is not taken.
            ServerUnavailable: if nobody serves the action, or its server goes away.
        """
        goal, links = followed.goal, self._links
        request = links.implied.send_goal.Request(
            UUID(cast("bytes", goal.id)), cast("Message", goal.request)
        )
        reply = await self._reply(followed, request)
        self._links.learn(reply)
        response: Any = reply.message
        if not response.accepted:
            raise GoalRejected(GoalNote.read(reply.note).reason)
        goal.stamp = nanoseconds(response.stamp)
        followed.is_accepted = True

    async def result(self, followed: Followed) -> Answer:
        """Wait for the end of a goal.

        Raises:
            UnknownGoal: if the server does not hold it.
            ServerUnavailable: if the server goes away, and does not come back at once.
        """
        goal, lost = followed.goal, list[ServerUnavailable]()
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
            response: Any = reply.message
            status = status_of(response.status)
            self._links.learn(reply)
            if status.is_terminal:
                return Answer(status, response.result, GoalNote.read(reply.note))
            if not is_early:
                name = self._links.name
                raise UnknownGoal(f"'{name}' holds no goal {goal.hex}, or not any more")
            self._knows_late = bool(reply.note)  # else it is not one of ours at all

    async def _reply(self, followed: Followed, request: object) -> Reply:
        """Send a goal, and the request for its result too if the server is known to take both."""
        links = self._links
        if links.is_of_our_kind and not self._knows_late:
            asked = links.ask(request)
            if asked is not None:
                followed.asked = links.get_result.ask(self._question(followed))
                return await asked.reply()
        return await links.send(request)

    async def _end(self, followed: Followed) -> Reply:
        asked, followed.asked = followed.asked, None
        if asked is not None:
            return await asked.reply()
        return await self._links.get_result.call(self._question(followed))

    def _question(self, followed: Followed) -> object:
        return self._links.implied.get_result.Request(UUID(cast("bytes", followed.goal.id)))

    async def _is_back(self) -> bool:
        """Whether the server was out of reach for a moment only."""
        with anyio.move_on_after(BACK_WITHIN):
            await self._links.wait_until_served()
        return self._links.is_served
