"""How goals elsewhere are followed: what the replies to their requests do."""

from __future__ import annotations

from typing import Any

import anyio
import anyio.lowlevel
import pytest

from turtleact import GoalStatus
from turtleact.errors import ServerUnavailable, ServiceTimeout, UnknownGoal
from turtleact.goals.observers import Observers
from turtleact.goals.remote import RemoteActionServer
from turtleact.goals.state import Goal, GoalRequest
from turtleact.goals.wire import GoalMetadata
from turtleact.interfaces import implied
from turtleact.tasks import current_tasks
from turtleact.transports import MemoryTransport
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
GONE = ServerUnavailable("/count", "the server went away")
UNCLEAR = ServerUnavailable("/count", "the server went away", otherwise="dropped it")


class Service:
    """One of the server's services."""

    def __init__(self, server: Server) -> None:
        self.server = server

    @property
    def is_served(self) -> bool:
        return bool(self.server.answers)

    async def call(self, _request: object, note: str = "") -> Reply:
        await anyio.lowlevel.checkpoint()
        answer = self.server.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


class Server:
    """Stands for the endpoints of a client.

    Attributes:
        answers: To the requests in that order; without one, the server is away.
        lost: How much lost feedback was reported.
    """

    name = "/count"
    implied = IMPLIED
    action_type = Count
    is_ours = False

    def __init__(self, *answers: Reply | Exception) -> None:
        self.transport = MemoryTransport()
        self.answers = list(answers)
        self.send_goal = self.get_result = Service(self)
        self.ask_for_goal = self.send_goal.call
        self.lost = 0

    async def wait_until_served(self) -> None:
        if not self.answers:
            await anyio.sleep_forever()

    def open(self, goals: Any, take_feedback: Any, on_gap: Any) -> None:
        self.take_feedback, self.on_gap = take_feedback, on_gap

    def report_lost(self, count: int) -> None:
        self.lost += count

    def close(self) -> None:
        self.answers.clear()


async def follow(server: Any) -> tuple[RemoteActionServer, Goal]:
    remote = RemoteActionServer(server, current_tasks(), Observers("/count"))
    return remote, await remote.send(GoalRequest(goal(), None))


@pytest.mark.parametrize("is_ours", [False, True])
async def test_gaps_in_the_feedback_of_a_server_of_ros_are_told_once_a_goal(caplog, is_ours):
    server = Server(ACCEPTED, SUCCEEDED if is_ours else FOREIGN)
    _, sent = await follow(server)
    server.on_gap(2)
    server.on_gap(3)
    await settle()
    assert sent.status is GoalStatus.SUCCEEDED
    told = f"5 feedback messages of /count were lost while goal {sent.hex} was active"
    assert (told in caplog.text, server.lost) == (not is_ours, 0 if is_ours else 5)


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
    monkeypatch.setattr("turtleact.goals.remote.BACK_WITHIN", 0.0)
    _, sent = await follow(Server(ACCEPTED, error))
    await settle()
    assert str(sent.error) == f"action '/count': the server {problem} before the goal ended"


@pytest.mark.parametrize("is_accepted", [True, False])
async def test_only_a_goal_not_accepted_yet_may_have_been_dropped(is_accepted, monkeypatch):
    monkeypatch.setattr("turtleact.goals.remote.BACK_WITHIN", 0.0)
    _, sent = await follow(Server(*[ACCEPTED] * is_accepted, UNCLEAR))
    await settle()
    assert isinstance(sent.error, ServerUnavailable)
    assert sent.error.problem == UNCLEAR.problem
    assert sent.error.otherwise == ("" if is_accepted else "dropped it")


@pytest.mark.parametrize(
    ("answers", "error", "said"),
    [
        ([ACCEPTED, UNKNOWN], UnknownGoal, "'/count' holds no goal"),
        (
            [ACCEPTED, GONE, UNKNOWN],
            UnknownGoal,
            "and the new server of '/count' does not have it",
        ),
        ([ACCEPTED, GONE, GONE, GONE], ServerUnavailable, "the server went away"),
        ([ACCEPTED, ServiceTimeout("/count", 600), SUCCEEDED], None, ""),
        ([ACCEPTED, GONE, GONE, SUCCEEDED], None, ""),
    ],
    ids=[
        "unknown",
        "unknown to the next server",
        "lost for good",
        "longer than a call",
        "lost twice",
    ],
)
async def test_a_result_is_asked_for_until_it_is_there_or_lost(answers, error, said, monkeypatch):
    monkeypatch.setattr("turtleact.goals.remote.PAUSE", 0.0)
    _, sent = await follow(Server(*answers))
    with anyio.fail_after(5):
        await sent.wait_for_end()
    if error is None:
        assert sent.status is GoalStatus.SUCCEEDED
    else:
        assert isinstance(sent.error, error)
        assert said in str(sent.error)
