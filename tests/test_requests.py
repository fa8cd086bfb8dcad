"""In which order the two requests of a goal are sent, and what comes of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from turtleact import GoalStatus
from turtleact.client.followed import Followed
from turtleact.client.requests import Requests
from turtleact.errors import GoalRejected, ServerUnavailable, ServiceTimeout, UnknownGoal
from turtleact.goal import Goal
from turtleact.goal_note import GoalNote
from turtleact.interfaces import implied
from turtleact.transports.base import Reply

from .lab import Count, goal, result

IMPLIED = implied(Count)
ACCEPTED = Reply(IMPLIED.send_goal.Response(accepted=True))
REJECTED = Reply(IMPLIED.send_goal.Response(accepted=False), GoalNote("no").write())
GONE = ServerUnavailable("/count", "the server went away")


def ended(status: GoalStatus, note: str = "{}") -> Reply:
    return Reply(IMPLIED.get_result.Response(status=int(status), result=result(7)), note)


SUCCEEDED = ended(GoalStatus.SUCCEEDED)
FOREIGN = ended(GoalStatus.SUCCEEDED, "")
UNKNOWN = ended(GoalStatus.UNKNOWN)


class Server:
    """Answers as it is told; notes how it was asked.

    Args:
        answers: To the requests, in the order of their waiting.
        is_near: Whether nothing can be sent without waiting.
    """

    def __init__(self, *answers: Reply | Exception, is_near: bool = False) -> None:
        self.answers = list(answers)
        self.story: list[str] = []
        self.name = "/count"
        self.implied = IMPLIED
        self.is_served = True
        self.is_of_our_kind = False
        self._send_goal = Calls(self, "send", is_near)
        self.send, self.ask = self._send_goal.call, self._send_goal.ask
        self.get_result = Calls(self, "result", is_near)

    def learn(self, reply: Reply) -> None:
        self.is_of_our_kind = bool(reply.note)

    async def wait_until_served(self) -> None:
        """It is served already."""


class Calls:
    """One of its services."""

    def __init__(self, server: Server, name: str, is_near: bool) -> None:
        self.server = server
        self.name = name
        self.is_near = is_near

    async def call(self, request: object) -> Reply:
        return await self._sent(self.name).reply()

    def ask(self, request: object) -> Asked | None:
        return None if self.is_near else self._sent(f"{self.name} early")

    def _sent(self, how: str) -> Asked:
        self.server.story.append(how)
        return Asked(self.server, self.name)


class Asked:
    """A request to it."""

    def __init__(self, server: Server, name: str) -> None:
        self.server = server
        self.name = name
        self.told: Callable[[], object] | None = None

    def tell(self, told: Callable[[], object]) -> None:
        self.told = told

    async def reply(self) -> Reply:
        answer = self.server.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def drop(self) -> None:
        self.server.story.append(f"{self.name} dropped")


async def ask(requests: Requests) -> Any:
    """Have one goal done; how it ended."""
    followed = Followed(Goal(goal(), 0, id=bytes(16)), is_sender=True)
    try:
        requests.begin(followed, lambda: None)
        await requests.send(followed)
        return await requests.result(followed)
    finally:
        followed.drop()


def of(server: Any) -> Requests:
    return Requests(server)


ONE_BY_ONE = ["send", "result"]
TOGETHER = ["send early", "result early"]


async def test_a_stranger_is_asked_one_by_one():
    server = Server(ACCEPTED, FOREIGN, ACCEPTED, FOREIGN)
    requests = of(server)
    assert (await ask(requests)).result == (await ask(requests)).result == result(7)
    assert server.story == ONE_BY_ONE * 2


async def test_a_server_of_our_kind_is_asked_both_at_once_from_the_second_goal_on():
    server = Server(ACCEPTED, SUCCEEDED, ACCEPTED, SUCCEEDED)
    requests = of(server)
    for _ in range(2):
        assert (await ask(requests)).status is GoalStatus.SUCCEEDED
    assert server.story == ONE_BY_ONE + TOGETHER


async def test_one_that_a_stranger_has_replaced_is_asked_one_by_one_again():
    server = Server(ACCEPTED, SUCCEEDED, ACCEPTED, FOREIGN, ACCEPTED, FOREIGN)
    requests = of(server)
    for _ in range(3):
        await ask(requests)
    assert server.story == ONE_BY_ONE + TOGETHER + ONE_BY_ONE


async def test_one_that_does_not_know_the_goal_yet_is_asked_again_and_never_early_any_more():
    server = Server(ACCEPTED, SUCCEEDED, ACCEPTED, UNKNOWN, SUCCEEDED, ACCEPTED, SUCCEEDED)
    requests = of(server)
    for _ in range(3):
        assert (await ask(requests)).status is GoalStatus.SUCCEEDED
    assert server.story == [*ONE_BY_ONE, *TOGETHER, "result", *ONE_BY_ONE]


async def test_what_was_asked_early_of_a_rejected_goal_is_dropped():
    server = Server(ACCEPTED, SUCCEEDED, REJECTED)
    requests = of(server)
    await ask(requests)
    with pytest.raises(GoalRejected, match="no"):
        await ask(requests)
    assert server.story == [*ONE_BY_ONE, *TOGETHER, "result dropped"]


async def test_who_sends_both_at_once_is_told_of_either_reply():
    server = Server(ACCEPTED, SUCCEEDED)
    requests = of(server)
    await ask(requests)
    followed = Followed(Goal(goal(), 0, id=bytes(16)), is_sender=True)
    told: list[int] = []
    assert requests.begin(followed, lambda: told.append(1))
    for early in (followed.sent, followed.asked):
        assert isinstance(early, Asked)
        assert early.told is not None
        early.told()
    assert told == [1, 1]


async def test_where_sending_takes_waiting_one_is_sent_after_the_other():
    server = Server(ACCEPTED, SUCCEEDED, ACCEPTED, SUCCEEDED, is_near=True)
    requests = of(server)
    for _ in range(2):
        await ask(requests)
    assert server.story == ONE_BY_ONE * 2


async def test_where_only_asking_for_the_end_takes_waiting_the_goal_is_sent_once():
    server = Server(ACCEPTED, SUCCEEDED, ACCEPTED, SUCCEEDED)
    server.get_result.is_near = True
    requests = of(server)
    for _ in range(2):
        await ask(requests)
    assert server.story == [*ONE_BY_ONE, "send early", "result"]


async def test_a_goal_that_the_server_does_not_hold_is_an_error():
    with pytest.raises(UnknownGoal, match="'/count' holds no goal"):
        await ask(of(Server(ACCEPTED, UNKNOWN)))


async def test_a_result_that_takes_longer_than_a_call_is_asked_for_again():
    server = Server(ACCEPTED, ServiceTimeout("/count", 600), SUCCEEDED)
    await ask(of(server))
    assert server.story == [*ONE_BY_ONE, "result"]


async def test_a_server_that_is_back_is_asked_again_three_times_at_most():
    server = Server(ACCEPTED, GONE, GONE, GONE)
    with pytest.raises(ServerUnavailable, match="went away"):
        await ask(of(server))
    assert server.story == [*ONE_BY_ONE, "result", "result"]
