"""How goals elsewhere are followed: in which order requests go out, and what their replies do."""

from __future__ import annotations

from typing import Any

import anyio
import pytest

from turtleact import GoalStatus
from turtleact.errors import GoalRejected, ServerUnavailable, ServiceTimeout, UnknownGoal
from turtleact.goals.observers import Observers
from turtleact.goals.remote_goals import RemoteGoals
from turtleact.goals.state import Goal
from turtleact.goals.wire import GoalMetadata
from turtleact.interfaces import implied
from turtleact.tasks import current_tasks
from turtleact.transports.base import Reply

from ..lab import Count, goal, result, settle

IMPLIED = implied(Count)
ACCEPTED = Reply(IMPLIED.send_goal.Response(accepted=True), "{}")
SUCCEEDED = Reply(
    IMPLIED.get_result.Response(status=int(GoalStatus.SUCCEEDED), result=result(7)), "{}"
)
REJECTED = Reply(IMPLIED.send_goal.Response(accepted=False), GoalMetadata("no").write())
UNKNOWN = Reply(IMPLIED.get_result.Response(status=int(GoalStatus.UNKNOWN)), "{}")
FOREIGN = Reply(SUCCEEDED.message)
NO_ANSWER = ServerUnavailable("/count", "no answer")
GONE = ServerUnavailable("/count", "the server went away")
UNCLEAR = ServerUnavailable("/count", "the server went away", otherwise="dropped it")


class Early:
    """A request that was sent early."""

    came: Reply | Exception

    def __init__(self) -> None:
        self.is_dropped = False
        self._is_over = anyio.Event()

    def come(self, what: Reply | Exception) -> None:
        """Be over."""
        self.came = what
        self._is_over.set()

    async def reply(self) -> Reply:
        try:
            await self._is_over.wait()
        finally:
            self.is_dropped = not self._is_over.is_set()
        if isinstance(self.came, Exception):
            raise self.came
        return self.came

    def drop(self) -> None:
        self.is_dropped = True


class Service:
    """One of the server's services."""

    def __init__(self, server: Server, name: str) -> None:
        self.server = server
        self.name = name

    @property
    def is_served(self) -> bool:
        return self.server.is_back

    def ask(self, _request: object, note: str = "") -> Early | None:
        if not self.server.early:
            return None
        self.server.story.append(f"{self.name} early")
        return self.server.early.pop(0)

    async def call(self, _request: object, note: str = "") -> Reply:
        self.server.story.append(self.name)
        answer = self.server.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


class Server:
    """Stands for the endpoints of a client whose server takes both requests at once.

    Attributes:
        sent: The request that sends the goal, if that goes out early.
        asked: The request for its result, likewise.
        answers: To what is asked later, in that order; without one, the server is away.
        story: What was asked.
    """

    name = "/count"
    implied = IMPLIED
    is_open = True
    is_ours = takes_both = True

    def __init__(self, *answers: Reply | Exception, is_prompt: bool = True) -> None:
        self.sent, self.asked = Early(), Early()
        self.early = [self.sent, self.asked] if is_prompt else []
        self.answers = list(answers)
        self.story: list[str] = []
        self.send_goal, self.get_result = Service(self, "send"), Service(self, "result")
        self.ask_for_goal = self.send_goal.call

    @property
    def is_back(self) -> bool:
        return bool(self.answers)

    def knows_ours(self) -> bool:
        return self.is_ours

    def learn(self, reply: Reply) -> None:
        self.is_ours = bool(reply.note)

    async def wait_until_served(self) -> None:
        if not self.answers:
            await anyio.sleep_forever()


class GappyServer(Server):
    """A server some of whose feedback does not arrive."""

    is_open = False
    lost = 0

    def open(self, goals: Any, take_feedback: Any, on_gap: Any) -> None:
        self.on_gap = on_gap

    def report_lost(self, count: int) -> None:
        self.lost += count


def new_goal() -> Goal:
    return Goal(bytes(16), goal(), current_tasks().signal())


def follow(server: Any) -> tuple[RemoteGoals, Goal]:
    goals = RemoteGoals(server, current_tasks(), lambda: 1, Observers("/count"))
    return goals, goals.send(new_goal()).goal


async def test_a_goal_ends_with_the_reply_to_the_second_request():
    server = Server()
    goals, sent = follow(server)
    server.sent.come(ACCEPTED)
    await settle()
    assert not sent.ended
    server.asked.come(SUCCEEDED)
    await settle()
    assert (sent.status, sent.result) == (GoalStatus.SUCCEEDED, result(7))
    assert goals.by_id == {}


async def test_a_result_that_comes_first_waits_for_the_acceptance():
    server = Server()
    _, sent = follow(server)
    server.asked.come(SUCCEEDED)
    await settle()
    assert not sent.ended
    server.sent.come(ACCEPTED)
    await settle()
    assert sent.status is GoalStatus.SUCCEEDED


async def test_a_result_waits_for_the_feedback_before_it():
    server = Server()
    goals, sent = follow(server)
    server.sent.come(ACCEPTED)
    server.asked.come(Reply(SUCCEEDED.message, GoalMetadata(feedback=1).write()))
    await settle()
    assert not sent.ended
    goals.by_id[bytes(16)].received = 1
    sent.changed.fire()
    await settle()
    assert sent.status is GoalStatus.SUCCEEDED


@pytest.mark.parametrize("is_ours", [False, True])
async def test_gaps_in_the_feedback_of_a_server_of_ros_are_told_once_a_goal(caplog, is_ours):
    server = GappyServer(ACCEPTED, SUCCEEDED if is_ours else FOREIGN, is_prompt=False)
    _, sent = follow(server)
    server.on_gap(2)
    server.on_gap(3)
    await settle()
    assert sent.status is GoalStatus.SUCCEEDED
    told = f"5 feedback messages of /count were lost while goal {sent.hex} was active"
    assert (told in caplog.text, server.lost) == (not is_ours, 0 if is_ours else 5)


async def test_why_a_request_has_failed_is_asked_once_all_is_known_that_came_with_it(monkeypatch):
    monkeypatch.setattr("turtleact.goals.remote_goals.BACK_WITHIN", 0.0)
    server = Server()
    _, sent = follow(server)
    server.sent.come(ACCEPTED)
    server.asked.come(NO_ANSWER)
    server.asked.came = GONE
    await settle()
    assert isinstance(sent.error, ServerUnavailable)
    assert sent.error.problem == GONE.problem


@pytest.mark.parametrize(
    ("error", "problem"),
    [
        (ServerUnavailable("/count", "the server fell", when="before it replied"), "fell"),
        (ServerUnavailable("/count"), "went away"),
    ],
)
async def test_the_error_of_an_accepted_goal_says_that_it_has_not_ended(
    monkeypatch, error, problem
):
    monkeypatch.setattr("turtleact.goals.remote_goals.BACK_WITHIN", 0.0)
    server = Server()
    _, sent = follow(server)
    server.sent.come(ACCEPTED)
    server.asked.come(error)
    await settle()
    assert str(sent.error) == f"action '/count': the server {problem} before the goal ended"


@pytest.mark.parametrize("is_accepted", [True, False])
async def test_only_a_goal_not_accepted_yet_may_have_been_dropped(is_accepted, monkeypatch):
    monkeypatch.setattr("turtleact.goals.remote_goals.BACK_WITHIN", 0.0)
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
    goals, sent = follow(server)
    if is_accepted:
        server.sent.come(ACCEPTED)
        await settle()
    await goals.aclose()
    assert sent.ended
    assert server.asked.is_dropped
    assert server.sent.is_dropped is not is_accepted


ONE_BY_ONE = ["send", "result"]
TOGETHER = ["send early", "result early"]


async def test_one_that_does_not_know_the_goal_yet_is_asked_again_and_never_early_any_more():
    server = Server(SUCCEEDED, ACCEPTED, SUCCEEDED)
    goals, sent = follow(server)
    server.sent.come(ACCEPTED)
    server.asked.come(UNKNOWN)
    await settle()
    assert sent.status is GoalStatus.SUCCEEDED
    server.early = [Early(), Early()]
    again = goals.send(new_goal())
    await settle()
    assert again.goal.status is GoalStatus.SUCCEEDED
    assert server.story == [*TOGETHER, "result", *ONE_BY_ONE]


async def test_one_without_a_note_is_asked_one_by_one_from_then_on():
    server = Server(ACCEPTED, FOREIGN)
    goals, _ = follow(server)
    server.sent.come(Reply(ACCEPTED.message))
    server.asked.come(FOREIGN)
    await settle()
    server.early = [Early(), Early()]
    goals.send(new_goal())
    await settle()
    assert server.story == [*TOGETHER, *ONE_BY_ONE]


async def test_the_request_for_the_result_of_a_rejected_goal_is_dropped():
    server = Server()
    _, sent = follow(server)
    server.sent.come(REJECTED)
    await settle()
    assert isinstance(sent.error, GoalRejected)
    assert sent.error.reason == "no"
    assert server.asked.is_dropped


async def test_if_only_the_second_request_takes_waiting_the_goal_is_sent_once():
    server = Server(SUCCEEDED)
    server.early.pop()
    server.sent.come(ACCEPTED)
    _, sent = follow(server)
    await settle()
    assert sent.status is GoalStatus.SUCCEEDED
    assert server.story == ["send early", "result"]


@pytest.mark.parametrize(
    ("answers", "error", "said"),
    [
        ([ACCEPTED, UNKNOWN], UnknownGoal, "'/count' holds no goal"),
        (
            [ACCEPTED, GONE, UNKNOWN],
            UnknownGoal,
            "and the new server of '/count' does not have it",
        ),
        ([ACCEPTED, GONE, GONE, GONE, SUCCEEDED], ServerUnavailable, "the server went away"),
        ([ACCEPTED, ServiceTimeout("/count", 600), SUCCEEDED], None, ""),
        ([ACCEPTED, GONE, GONE, SUCCEEDED], None, ""),
    ],
    ids=[
        "unknown",
        "unknown to the next server",
        "lost three times",
        "longer than a call",
        "lost twice",
    ],
)
async def test_a_result_is_asked_for_until_it_is_there_or_lost(answers, error, said):
    _, sent = follow(Server(*answers, is_prompt=False))
    await settle()
    if error is None:
        assert sent.status is GoalStatus.SUCCEEDED
    else:
        assert isinstance(sent.error, error)
        assert said in str(sent.error)
