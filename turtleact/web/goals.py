"""The goals that clients of a bridge have sent, each followed to its end.

- A goal goes on when its client disconnects, unless the bridge is told otherwise: clients come and
  go in the middle of a goal, and cancel it from another connection.
- Goals are named by their clients, which count for themselves: a cancel means the client's own goal
  of that id, else the only one of that id that anybody has sent.
- A cancel that comes before the server has accepted the goal is remembered.

Source: rosbridge_library ``capabilities/action_*.py``; its issues 1003, 1013, 1139 and 1152.
"""

from __future__ import annotations

import logging
from typing import Any, Final, Protocol, cast

from turtleact.body import ActionType
from turtleact.client import ActionClient, ClientGoalHandle
from turtleact.errors import GoalRejected, ServerUnavailable, TurtleactError
from turtleact.goal_id import new_goal_id
from turtleact.interfaces import Message
from turtleact.node import Node
from turtleact.summaries import summary
from turtleact.tasks import Background
from turtleact.web.frames import reply
from turtleact.web.operations import CancelActionGoal, Id, SendActionGoal
from turtleact.web.pool import Pool
from turtleact.web.reading import read_message
from turtleact.web.spelling import absolute, action_class
from turtleact.web.values import json_values

__all__ = ["Goals", "Teller"]

logger = logging.getLogger("turtleact.web")

MOST: Final = 1024
"""So many goals are followed at once, those of disconnected clients among them."""

NO_SERVER: Final = "No action server available"
CLOSING: Final = "The server is closing: there will be no word of this goal"
REJECTED: Final = "Action goal was rejected"


class Teller(Protocol):
    """Whom the frames of a goal go to."""

    def keep(self, frame: str) -> None:
        """Send what must arrive."""

    def put(self, source: str, frame: str) -> None:
        """Send what newer frames of its source may push out."""


Client = ActionClient[Message, Message, Message]


class Goals:
    """All goals of a bridge.

    Args:
        node: Sends them.
        cancel_on_disconnect: Whether a client that goes takes its goals along.
    """

    def __init__(self, node: Node, *, cancel_on_disconnect: bool = False) -> None:
        self._cancel_on_disconnect = cancel_on_disconnect
        self._clients: Pool[tuple[str, Any], Client] = Pool(
            lambda key: node.action_client(key[1], key[0])
        )
        self._sent: dict[int, _Sent] = {}
        self._count = 0

    def __len__(self) -> int:
        return len(self._sent)

    def send(self, said: SendActionGoal, teller: Teller) -> None:
        """Send a goal and tell of it, its end in any case."""
        if said.id is not None and self._own(said.id, teller) is not None:
            _tell_failure(said, teller, f"a goal of the id '{said.id}' is under way: say another")
        elif len(self._sent) >= MOST:
            _tell_failure(said, teller, f"{len(self._sent)} goals are under way: wait for some")
        else:
            self._count += 1
            sent = self._sent[self._count] = _Sent(self._count, said, teller)
            sent.following = Background(self._follow(sent), f"goal {said.id} of a web client")

    def cancel(self, said: CancelActionGoal, teller: Teller) -> str:
        """Cancel a goal; what is wrong, if something is."""
        sent = self._own(said.id, teller)
        if sent is None:
            found = [each for each in self._sent.values() if each.said.id == said.id]
            if len(found) != 1:
                many = f"{len(found)} clients have sent" if found else "nobody has sent"
                return f"{many} a goal of the id '{said.id}' that is under way"
            sent = found[0]
        sent.cancel()
        return ""

    def lose(self, teller: Teller) -> None:
        """Tell somebody no more, who has gone."""
        for sent in self._sent.values():
            if sent.teller is teller:
                sent.teller = None
                if self._cancel_on_disconnect:
                    sent.cancel()

    def leave(self) -> None:
        """Tell all who wait for a goal that they will not hear of its end."""
        for sent in self._sent.values():
            sent.fail(CLOSING)
            sent.is_over = True

    async def aclose(self) -> None:
        """Follow no goal any more; they go on."""
        for sent in list(self._sent.values()):
            await sent.following.aclose()
        await self._clients.aclose()

    def _own(self, id: Id, teller: Teller) -> _Sent | None:
        for sent in self._sent.values():
            if sent.said.id == id and sent.teller is teller:
                return sent
        return None

    async def _follow(self, sent: _Sent) -> None:
        try:
            await self._run(sent)
        except GoalRejected as rejected:
            sent.fail(f"{REJECTED}: {rejected.reason}" if rejected.reason else REJECTED)
        except ServerUnavailable as error:
            is_usual = error.problem == "no server answers"
            sent.fail(NO_SERVER if is_usual else f"{NO_SERVER}: {error.problem}")
        except TurtleactError as error:
            sent.fail(str(error))
        except Exception as error:
            logger.exception("goal %s of a web client cannot be followed", sent.said.id)
            sent.fail(f"the goal cannot be followed: {summary(error)}")
        finally:
            del self._sent[sent.number]

    async def _run(self, sent: _Sent) -> None:
        said = sent.said
        name, action_type = absolute(said.action), action_class(said.action_type)
        goal = await read_message(action_type.Goal, said.args, root="goal")
        key = (name, cast("ActionType[Message, Message, Message]", action_type))
        on_feedback = sent.tell_feedback if said.feedback else None
        async with (
            self._clients.use(key) as client,
            client.send_goal(goal, goal_id=sent.goal_id, feedback_callback=on_feedback) as handle,
        ):
            handle.detach()
            sent.accept(handle)
            outcome = await handle.outcome()
            sent.tell("action_result", outcome.result, status=int(outcome.status), result=True)


class _Sent:
    """One goal.

    Attributes:
        number: Tells it from all others of the bridge.
        said: What its client has said.
        teller: Its client; None once that has gone.
        goal_id: Its 16 bytes.
        following: The task that follows it.
        is_over: Whether its client was told that there is nothing more to tell.
    """

    following: Background

    def __init__(self, number: int, said: SendActionGoal, teller: Teller) -> None:
        self.number = number
        self.said = said
        self.teller: Teller | None = teller
        self.goal_id = new_goal_id()
        self.is_over = False
        self._handle: ClientGoalHandle[Message, Message] | None = None
        self._is_canceled = False

    def accept(self, handle: ClientGoalHandle[Message, Message]) -> None:
        """Note that the server has taken it; it may be unwanted by now."""
        self._handle = handle
        if self._is_canceled:
            handle.cancel_nowait()

    def cancel(self) -> None:
        """Cancel it as soon as it is accepted."""
        self._is_canceled = True
        if self._handle is not None:
            self._handle.cancel_nowait()

    def tell_feedback(self, feedback: Message) -> None:
        """Tell its client of feedback."""
        self.tell("action_feedback", feedback)

    def tell(self, op: str, message: Message, **members: object) -> None:
        """Tell its client something, if that is still there."""
        if self.teller is None or self.is_over:
            return
        frame = reply(
            op,
            self.said.id,
            action=self.said.action,
            values=json_values(message),
            **members,
            goal_id=self.goal_id.hex(),
        )
        if op == "action_feedback":
            self.teller.put(f"goal {self.number}", frame)
        else:
            self.teller.keep(frame)

    def fail(self, problem: str) -> None:
        """Tell its client that there is no result."""
        if self.teller is not None and not self.is_over:
            _tell_failure(self.said, self.teller, problem)


def _tell_failure(said: SendActionGoal, teller: Teller, problem: str) -> None:
    members = {"action": said.action, "values": problem, "status": 0, "result": False}
    teller.keep(reply("action_result", said.id, **members))
