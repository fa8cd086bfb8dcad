"""Goals that are followed by the replies to two requests sent at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import anyio
import pytest

from turtleact import GoalStatus
from turtleact.client.following import Following
from turtleact.errors import ServerUnavailable
from turtleact.goal import Goal
from turtleact.interfaces import implied
from turtleact.tasks import current_tasks
from turtleact.transports.base import Reply

from .lab import Count, goal, result, settle

IMPLIED = implied(Count)
ACCEPTED = Reply(IMPLIED.send_goal.Response(accepted=True), "{}")
SUCCEEDED = Reply(
    IMPLIED.get_result.Response(status=int(GoalStatus.SUCCEEDED), result=result(7)), "{}"
)
NO_ANSWER = ServerUnavailable("/count", "no answer")
GONE = ServerUnavailable("/count", "the server went away")
UNCLEAR = ServerUnavailable("/count", "the server went away", otherwise="dropped it")


class Early:
    """A request that was sent early."""

    is_over = False
    came: Reply | Exception

    def __init__(self) -> None:
        self.is_dropped = False
        self._told: Callable[[], object] = lambda: None

    def come(self, what: Reply | Exception) -> None:
        """Be over."""
        self.came, self.is_over = what, True
        self._told()

    def tell(self, told: Callable[[], object]) -> None:
        self._told = told

    def take(self) -> Reply:
        assert self.is_over
        if isinstance(self.came, Exception):
            raise self.came
        return self.came

    async def reply(self) -> Reply:
        return self.take()

    def drop(self) -> None:
        self.is_dropped = True


class Server:
    """A server that takes both requests at once, and is away when it is asked again."""

    name = "/count"
    implied = IMPLIED
    is_of_our_kind = True
    is_served = False

    def __init__(self) -> None:
        self.sent, self.asked = Early(), Early()
        self.get_result = self
        self._early = [self.asked, self.sent]

    def ask(self, _request: object) -> Early:
        return self._early.pop()

    def learn(self, _reply: Reply) -> None:
        """It is known already."""

    async def wait_until_served(self) -> None:
        await anyio.sleep_forever()


def follow(server: Any) -> tuple[Following, Goal]:
    async def cancel(_goal: Goal) -> None:
        """Nothing is canceled here."""

    following = Following(server, current_tasks(), lambda: 1, cancel)
    return following, following.send(Goal(goal(), 0, id=bytes(16))).goal


async def test_a_goal_ends_with_the_reply_to_the_second_request():
    server = Server()
    following, sent = follow(server)
    server.sent.come(ACCEPTED)
    assert not sent.ended
    server.asked.come(SUCCEEDED)
    assert (sent.status, sent.result) == (GoalStatus.SUCCEEDED, result(7))
    assert following.goals == {}


async def test_a_result_that_comes_first_waits_for_the_acceptance():
    server = Server()
    _, sent = follow(server)
    server.asked.come(SUCCEEDED)
    assert not sent.ended
    server.sent.come(ACCEPTED)
    assert sent.status is GoalStatus.SUCCEEDED


async def test_why_a_request_has_failed_is_asked_once_all_is_known_that_came_with_it(monkeypatch):
    monkeypatch.setattr("turtleact.client.requests.BACK_WITHIN", 0.0)
    server = Server()
    _, sent = follow(server)
    server.sent.come(ACCEPTED)
    server.asked.come(NO_ANSWER)
    server.asked.came = GONE
    await settle()
    assert isinstance(sent.error, ServerUnavailable)
    assert sent.error.problem == GONE.problem


@pytest.mark.parametrize("is_accepted", [True, False])
async def test_only_a_goal_not_accepted_yet_may_have_been_dropped(is_accepted, monkeypatch):
    monkeypatch.setattr("turtleact.client.requests.BACK_WITHIN", 0.0)
    server = Server()
    _, sent = follow(server)
    server.sent.come(ACCEPTED if is_accepted else UNCLEAR)
    server.asked.come(UNCLEAR)
    await settle()
    assert isinstance(sent.error, ServerUnavailable)
    assert sent.error.problem == UNCLEAR.problem
    assert sent.error.otherwise == ("" if is_accepted else "dropped it")


@pytest.mark.parametrize("is_accepted", [True, False])
async def test_a_client_that_is_closed_drops_both(is_accepted):
    server = Server()
    following, sent = follow(server)
    if is_accepted:
        server.sent.come(ACCEPTED)
    following.close()
    assert sent.ended
    assert server.asked.is_dropped
    assert server.sent.is_dropped is not is_accepted
