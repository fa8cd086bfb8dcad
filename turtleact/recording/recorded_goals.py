"""Reads the goals in a bag: puts them together from the messages on their actions' topics.

Requests and responses come from the service events of the server, of the client, or of both. A
response does not contain the goal id, so its request is found by the client's gid and the sequence
number. If the bag has no service events, the goal messages and the results are unknown.
"""

from __future__ import annotations

from collections.abc import Collection
from contextlib import aclosing
from pathlib import Path
from typing import Any

import anyio.to_thread
import msgspec

from turtleact.goals.state import GoalStatus
from turtleact.interfaces import nanoseconds
from turtleact.recording.bag import Bag, Recorded, messages_in
from turtleact.recording.selection import REQUESTS, Selection, owner_of, part_of
from turtleact.recording.storage import Range

__all__ = ["RecordedGoal", "goals", "goals_in"]


class RecordedGoal(msgspec.Struct, kw_only=True):
    """A goal in a bag.

    Attributes:
        action: The name of the action.
        type_name: The type of the action; empty if the bag does not have it.
        id: The id of the goal (16 bytes).
        goal: The goal message; None if the bag does not have it.
        accepted: Whether the server accepted the goal; None if the bag does not show that.
        stamp: When the goal was accepted or, if the bag does not show that, when the goal's first
            message was recorded (ns since 1970).
        states: The goal's states in order, each as a pair of the time at which it was recorded (ns
            since 1970) and the state.
        feedback_count: How many feedback messages were recorded.
        result: The result; None if it was not recorded.
        is_begun_before: Whether the goal was accepted before the recording began.
        requested: When the request for the goal was recorded (ns since 1970); 0 if it was not.
        told: The reason that the server published for rejecting the goal, or for ending the goal
            without success; empty if the bag has no reason.
    """

    action: str
    id: bytes
    stamp: int
    type_name: str = ""
    goal: Any = None
    accepted: bool | None = None
    states: list[tuple[int, GoalStatus]] = []
    feedback_count: int = 0
    result: Any = None
    is_begun_before: bool = False
    requested: int = 0
    told: str = ""

    @property
    def status(self) -> GoalStatus:
        """The last state that was recorded; UNKNOWN if there is none."""
        return self.states[-1][1] if self.states else GoalStatus.UNKNOWN

    @property
    def canceled(self) -> int:
        """When the server was seen to cancel the goal (ns since 1970); 0 if it did not."""
        ways = (GoalStatus.CANCELING, GoalStatus.CANCELED)
        return next((stamp for stamp, status in self.states if status in ways), 0)

    @property
    def ended(self) -> int:
        """When the goal's end was recorded (ns since 1970); 0 if the end is not in the bag."""
        return self.states[-1][0] if self.status.is_terminal else 0

    @property
    def duration(self) -> float | None:
        """The time from ``stamp`` to the goal's end (s).

        None if the end is not in the bag, or if the goal had ended before the recording began.
        """
        had_ended = self.is_begun_before and len(self.states) == 1
        if had_ended or not self.ended:
            return None
        return (self.ended - self.stamp) / 1e9

    @property
    def reason(self) -> str:
        """Why the goal did not succeed; empty if it succeeded, or if the bag does not show why.

        Only servers of turtleact publish reasons, because the messages of ROS 2 have no field for
        them.
        """
        if self.told:
            return self.told
        if self.accepted is False:
            return "rejected"
        return "" if self.status.is_terminal else "its end was not recorded"


async def goals(path: str | Path, *, actions: Collection[str] | None = None) -> list[RecordedGoal]:
    """Return the goals in a bag, in the order of their first messages.

    Args:
        path: The folder of the bag, or a single file.
        actions: The names of the actions. If left out, the goals of all actions are returned.

    Raises:
        BagError: if there is no bag at ``path``, or if the bag is damaged.
    """
    wanted = Selection(actions=frozenset(actions or ()), all_actions=actions is None)
    return await goals_in(await anyio.to_thread.run_sync(Bag, path), wanted)


async def goals_in(bag: Bag, wanted: Selection) -> list[RecordedGoal]:
    """Return the goals of the wanted actions in an open bag; see `goals`."""
    found = Gathering(bag.info.start)
    messages = messages_in(bag, Range(wants=lambda topic: wanted.wants(topic, "")))
    async with aclosing(messages):
        async for message in messages:
            found.take(message)
    return found.goals


class Gathering:
    """Builds goals from recorded messages.

    Args:
        start: When the recording began (ns since 1970).
    """

    def __init__(self, start: int) -> None:
        self._start = start
        self._goals: dict[tuple[str, bytes], RecordedGoal] = {}
        self._asked: dict[tuple[str, bytes, int], RecordedGoal] = {}

    @property
    def goals(self) -> list[RecordedGoal]:
        """The goals found so far."""
        return list(self._goals.values())

    def take(self, message: Recorded) -> None:
        """Update the goals with the information in a message.

        A message has an effect only if it is on a topic of an action.
        """
        owner, action, part = part_of(message.topic)
        if owner != "action" or message.value is None:
            return
        if part == "feedback":
            goal = self._goal(action, message.value.goal_id.uuid, message)
            goal.feedback_count += 1
        elif part == "reason":
            goal = self._goal(action, message.value.goal_id.uuid, message)
            goal.told = message.value.reason
            if message.value.status == GoalStatus.UNKNOWN:
                goal.accepted = False
        elif part == "status":
            for each in message.value.status_list:
                self._note_status(action, each, message)
        elif part in ("send_goal", "get_result"):
            self._note_event(action, part, message)

    def _goal(self, action: str, goal_id: bytes, message: Recorded) -> RecordedGoal:
        key = action, bytes(goal_id)
        if key not in self._goals:
            self._goals[key] = RecordedGoal(action=action, id=key[1], stamp=message.stamp)
        goal = self._goals[key]
        goal.type_name = goal.type_name or owner_of(message.topic, message.type_name)
        return goal

    def _note_status(self, action: str, entry: Any, message: Recorded) -> None:  # noqa: ANN401  # a message
        goal = self._goal(action, entry.goal_info.goal_id.uuid, message)
        if not goal.states:
            accepted = nanoseconds(entry.goal_info.stamp)
            goal.is_begun_before = 0 < accepted < self._start
            goal.stamp = accepted or goal.stamp
            goal.accepted = True
        _add_state(goal, message.stamp, entry.status)

    def _note_event(self, action: str, part: str, message: Recorded) -> None:
        event = message.value
        call = part, bytes(event.info.client_gid), event.info.sequence_number
        if event.info.event_type in REQUESTS:
            for request in event.request:
                goal = self._asked[call] = self._goal(action, request.goal_id.uuid, message)
                if part == "send_goal":
                    goal.goal = request.goal
                    goal.requested = goal.requested or message.stamp
            return
        asked = self._asked.get(call)
        if asked is None:  # the recording began in between
            return
        for response in event.response:
            if part == "get_result":
                asked.result = response.result
                _add_state(asked, message.stamp, response.status)
                continue
            asked.accepted = response.accepted
            if response.accepted:
                asked.stamp = nanoseconds(response.stamp) or asked.stamp


def _add_state(goal: RecordedGoal, stamp: int, number: int) -> None:
    """Add a state, unless it equals the goal's last state or the goal has ended already."""
    try:
        status = GoalStatus(number)
    except ValueError:
        return
    if status not in (goal.status, GoalStatus.UNKNOWN) and not goal.status.is_terminal:
        goal.states.append((stamp, status))
