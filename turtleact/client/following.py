"""Goals that a server elsewhere holds, each followed until it has ended.

Where the server takes both requests of a goal at once, all that is to be done is done as their
replies come, and no task is made for the goal. What takes waiting has one: a server of which
nothing is known yet, a cancel, feedback that is late, a server that went away.
"""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Final

import anyio

from turtleact.client.followed import Followed, move
from turtleact.client.links import Links
from turtleact.client.requests import Answer, Requests
from turtleact.errors import ServerUnavailable, TurtleactError
from turtleact.goal import Goal, GoalStatus
from turtleact.summaries import summary
from turtleact.tasks import Signal, Tasks

__all__ = ["Following"]

logger = logging.getLogger("turtleact.client")

LATE_FEEDBACK: Final = 1.0
"""Feedback that is behind its goal's result is waited for so long (s)."""


class Following:
    """Follows the goals of one client.

    Args:
        links: The endpoints.
        tasks: Runs what waits for replies.
        now: The time (ns since the epoch).
        cancel: Asks the server to cancel a goal.

    Attributes:
        goals: What is followed, by the ids of the goals.
    """

    def __init__(
        self,
        links: Links,
        tasks: Tasks,
        now: Callable[[], int],
        cancel: Callable[[Goal], Awaitable[object]],
    ) -> None:
        self.goals: dict[bytes, Followed] = {}
        self._links = links
        self._requests = Requests(links)
        self._tasks = tasks
        self._now = now
        self._cancel = cancel
        self._is_open = True

    def send(self, goal: Goal) -> Followed:
        """Send a goal, and follow it."""
        followed = Followed(goal, is_sender=True)
        is_on_its_way = self._requests.begin(followed, partial(self._go_on, followed))
        self.goals[followed.goal_id] = followed
        if not is_on_its_way:
            self._see_to(followed)
        return followed

    def attach(self, goal: Goal) -> None:
        """Follow a goal that somebody else has sent."""
        followed = Followed(goal, is_sender=False)
        self.goals[followed.goal_id] = followed
        self._see_to(followed)

    def signal(self, goal: Goal) -> Signal:
        """The signal that fires at each change of a goal."""
        if goal.listener is None:
            goal.listener = self._tasks.signal()
        return goal.listener  # type: ignore[return-value]  # nobody else puts one there

    def failure(self, error: TurtleactError, *, is_accepted: bool = False) -> TurtleactError:
        """What the user is told where a request has failed: the action's name, and why.

        Of a goal that was accepted no request has been dropped: who lives is asked again.
        """
        if not self._is_open:
            return self._closed()
        if isinstance(error, ServerUnavailable):
            otherwise = "" if is_accepted else error.otherwise
            return ServerUnavailable(self._links.name, error.problem, otherwise=otherwise)
        return error

    def close(self) -> None:
        """Follow no goal any more."""
        self._is_open = False
        for followed in list(self.goals.values()):
            if followed.task is not None:
                followed.task.cancel()
            else:
                self._lose(followed.goal, self._closed())
                self._let_go(followed)

    # as replies come

    def _go_on(self, followed: Followed) -> None:
        """Take up what has come; what takes waiting goes on in a task."""
        if followed.task is None and not self._take_up(followed):
            self._see_to(followed)

    def _take_up(self, followed: Followed) -> bool:
        """Answers whether that is all, for now or for ever."""
        sent, asked = followed.sent, followed.asked
        try:
            if sent is not None:
                if not sent.is_over:
                    return True
                self._requests.accept(followed)
                if followed.goal.listener is not None:
                    followed.goal.listener.fire()
                if followed.is_given_up:
                    return False
            if asked is None or not asked.is_over:
                return True
            answer = self._requests.answer(followed)
        except Exception:
            return False  # the task meets it again, and sees to it
        if answer is None or answer.note.feedback > followed.received:
            return False
        self._conclude(followed.goal, answer)
        self._let_go(followed)
        return True

    # as a task

    def _see_to(self, followed: Followed) -> None:
        name = f"a goal of {self._links.name}"
        followed.task = self._tasks.spawn(self._run(followed), name)

    async def _run(self, followed: Followed) -> None:
        """Send a goal, unless that is done, and see it to its end."""
        goal = followed.goal
        try:
            if followed.asked is not None:  # what comes with a reply may say why it is none
                await self._tasks.checkpoint()
            if not followed.is_accepted:
                await self._requests.send(followed)
                self.signal(goal).fire()
            if followed.is_given_up:
                await self._cancel(goal)
            answer = await self._requests.result(followed)
            if followed.is_sender:
                await self._await_feedback(followed, answer.note.feedback)
            self._conclude(goal, answer)
        except TurtleactError as error:
            self._lose(goal, self.failure(error, is_accepted=followed.is_accepted))
        except self._tasks.cancelled:
            self._lose(goal, self._closed())
            raise
        except Exception as error:
            logger.exception("goal %s of %s cannot be followed", goal.hex, self._links.name)
            self._lose(goal, TurtleactError(f"the goal cannot be followed: {summary(error)}"))
        finally:
            self._let_go(followed)

    async def _await_feedback(self, followed: Followed, count: int) -> None:
        """Wait for the feedback that the result has overtaken."""
        if followed.received >= count:
            return
        with anyio.move_on_after(LATE_FEEDBACK):
            while followed.received < count:
                await self.signal(followed.goal).wait()
        if followed.received < count:
            lost = count - followed.received
            logger.warning("%d feedback messages of goal %s were lost", lost, followed.goal.hex)

    # the end

    def _conclude(self, goal: Goal, answer: Answer) -> None:
        """End a goal as its server has."""
        goal.result, goal.reason = answer.result, answer.note.reason
        goal.ended = self._now()
        move(goal, answer.status)

    def _lose(self, goal: Goal, error: TurtleactError) -> None:
        """End a goal of which nothing more will be heard."""
        if not goal.ended:
            goal.error, goal.status, goal.ended = error, GoalStatus.UNKNOWN, self._now()
            self.signal(goal).fire()

    def _let_go(self, followed: Followed) -> None:
        followed.drop()
        self.goals.pop(followed.goal_id, None)

    def _closed(self) -> ServerUnavailable:
        return ServerUnavailable(self._links.name, "the client was closed")
