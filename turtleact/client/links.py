"""The endpoints of an action's client: three services that it calls, two topics that it reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, cast

from turtleact.body import ActionType
from turtleact.client.followed import Followed
from turtleact.client.pace import Pace
from turtleact.goal import CancelCode, GoalStatus
from turtleact.goal_states import read_states
from turtleact.interfaces import (
    GOAL_ID,
    Action,
    FeedbackFormat,
    Implied,
    WireFormat,
    implied,
)
from turtleact.interfaces.standard import CancelGoal, GoalStatusArray
from turtleact.names import ActionNames
from turtleact.transports.base import (
    STATUS_QOS,
    Asked,
    Caller,
    Closeable,
    Endpoint,
    Format,
    MakeEndpoint,
    QoS,
    Reply,
    Target,
    Transport,
    wait_until_served,
)

__all__ = ["Links"]

# Both responses begin with a number, in the byte behind the header of CDR.
_UNKNOWN = bytes([GoalStatus.UNKNOWN])
_UNKNOWN_GOAL_ID = bytes([CancelCode.UNKNOWN_GOAL_ID])


class Links:
    """The endpoints of one client.

    At first it only shows itself, as a client of ``send_goal``: the others cost something, and a
    server in the same process needs none of them.

    Args:
        transport: Where they are opened.
        endpoint: Describes them.
        names: Their names.
        action_type: The action.

    Attributes:
        name: The fully qualified name of the action.
        get_result: Asks for results; there once `open` was called.
    """

    get_result: Caller
    _cancel_goal: Caller

    def __init__(
        self,
        transport: Transport,
        endpoint: MakeEndpoint,
        names: ActionNames,
        action_type: ActionType[Any, Any, Any],
    ) -> None:
        self.name = names.name
        self._transport = transport
        self._endpoint = endpoint
        self._names = names
        self._action_type = action_type
        self._opened: list[Closeable] = []
        self._is_open = False
        self._watches_status = False
        self._sends, self._cancels = Pace(), Pace()
        self._ours: list[Endpoint] | None = None  # the servers, as they were known to be ours
        self._seen = 0  # the changes of the graph by which they are still these
        self._send_goal = self._join(
            names.send_goal,
            "SendGoal",
            WireFormat(lambda: self.implied.send_goal, asks=True),
            Target("one"),
        )

    @cached_property
    def implied(self) -> Implied:
        """The services and the message that the action is sent in."""
        return implied(cast("type[Action]", self._action_type))

    @property
    def is_served(self) -> bool:
        """Whether there is a server to call."""
        return self._send_goal.is_served

    def why_not_served(self) -> str:
        """Why there is none."""
        return self._send_goal.why_not_served("_SendGoal")

    @property
    def is_of_our_kind(self) -> bool:
        """Whether the server has shown to be one of turtleact's, and none has come or gone since.

        If so, requests are not held back, and may be sent before the one before is answered.
        """
        if self._ours is None:
            return False
        if self._seen != self._transport.changes:
            if self._ours != self._servers():
                return False
            self._seen = self._transport.changes
        return True

    def learn(self, reply: Reply) -> None:
        """Note of what kind the server is: ours have a note beside what they say of a goal."""
        if not reply.note:
            self._ours = None
        elif not self.is_of_our_kind:
            self._ours, self._seen = self._servers(), self._transport.changes
            self._sends.send_all()
            self._cancels.send_all()

    async def wait_until_served(self) -> None:
        """Wait for a server. Cancelling: safe."""
        await wait_until_served(self._transport, lambda: self.is_served or None, None)

    async def send(self, request: object) -> Reply:
        """Ask for a goal to be taken; in its turn, unless the server `is_of_our_kind`."""
        return await self._call(self._sends, self._send_goal, request)

    async def cancel(self, request: object) -> Reply:
        """Ask for goals to be canceled, likewise; once `open` was called."""
        return await self._call(self._cancels, self._cancel_goal, request)

    def ask(self, request: object) -> Asked | None:
        """Send what `send` does, now, to a server of our kind; None if that takes waiting."""
        return self._send_goal.ask(request)

    def open(self, on_feedback: Callable[[Any], None], followed: Mapping[bytes, Followed]) -> None:
        """Open the other services and the feedback topic; a second time does nothing.

        Args:
            on_feedback: Gets each message of the topic; for one that comes as bytes, what is
                ``followed`` and the feedback, or None if it is of another goal.
            followed: The goals whose feedback is wanted, by their ids.
        """
        if self._is_open:
            return
        self._is_open = True
        names, action = self._names, self._action_type.type_name
        self._subscribe(
            names.feedback,
            f"{action}_FeedbackMessage",
            _FollowedFormat(cast("type[Action]", self._action_type), followed),
            on_feedback,
        )
        self.get_result = self._join(
            names.get_result,
            "GetResult",
            WireFormat(lambda: self.implied.get_result, asks=True),
            Target(counts=lambda reply: reply[4:5] != _UNKNOWN),
        )
        self._cancel_goal = self._transport.join(
            self._endpoint("client", names.cancel_goal, CancelGoal.type_name),
            WireFormat(CancelGoal, asks=True),
            Target(counts=lambda reply: reply[4:5] != _UNKNOWN_GOAL_ID),
        )
        self._opened.append(self._cancel_goal)

    def watch_status(self, on_status: Callable[[Any], None]) -> None:
        """Open the status topic; a second time does nothing.

        Args:
            on_status: Gets each message of the topic: a ``GoalStatusArray``, or what `read_states`
                makes of one that comes as bytes.
        """
        if not self._watches_status:
            self._watches_status = True
            self._subscribe(
                self._names.status,
                GoalStatusArray.type_name,
                _StatusFormat(),
                on_status,
                STATUS_QOS,
            )

    def close(self) -> None:
        """Leave the graph."""
        for opened in reversed(self._opened):
            opened.close()
        self._opened.clear()

    def _servers(self) -> list[Endpoint]:
        """All servers of the name; one that is opened again is another."""
        endpoints = self._transport.endpoints(self._names.send_goal)
        return [each for each in endpoints if each.kind == "service"]

    async def _call(self, pace: Pace, caller: Caller, request: object) -> Reply:
        if self.is_of_our_kind:
            return await caller.call(request)
        return await pace.call(caller, request)

    def _join(self, name: str, kind: str, format: WireFormat, target: Target) -> Caller:
        type_name = f"{self._action_type.type_name}_{kind}"
        caller = self._transport.join(self._endpoint("client", name, type_name), format, target)
        self._opened.append(caller)
        return caller

    def _subscribe(
        self,
        name: str,
        type_name: str,
        format: Format,
        deliver: Callable[[Any], None],
        qos: QoS | None = None,
    ) -> None:
        endpoint = self._endpoint("subscription", name, type_name, qos)
        self._opened.append(self._transport.subscribe(endpoint, format, deliver))


class _FollowedFormat(FeedbackFormat):
    """Reads the feedback of some goals alone: everybody gets that of all, in ROS 2.

    Args:
        action: The action.
        followed: The goals by their ids.
    """

    def __init__(self, action: type[Action], followed: Mapping[bytes, Followed]) -> None:
        super().__init__(action)
        self._followed = followed

    def decode(self, data: bytes) -> Any:  # noqa: ANN401  # see `Links.open`
        """What is known of a goal, and its feedback; None if it is another goal."""
        followed = self._followed.get(data[GOAL_ID])
        return None if followed is None else (followed, self.read(data))


class _StatusFormat(WireFormat):
    """Reads the status of all goals as what is needed of it."""

    def __init__(self) -> None:
        super().__init__(GoalStatusArray)

    def decode(self, data: bytes) -> Any:  # noqa: ANN401  # see `Links.watch_status`
        """The states; the message if they are written in an uncommon way."""
        states = read_states(data)
        return super().decode(data) if states is None else states
