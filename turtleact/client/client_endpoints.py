"""The endpoints of an action's client: three services that it calls, two topics that it reads.

Knows which kind of server is at the other end, as far as that decides how requests are sent. A
service of ROS 2 keeps ten requests that its node has not taken yet, and drops the oldest of more
without telling anybody. So a client sends only a few at a time. Servers of turtleact drop none, and
say that they are such by a note beside each answer.

Source: rcl_action ``action_client.c``; rmw_zenoh_cpp ``rmw_service_data.cpp``, ``add_new_query``;
rmw ``qos_profiles.h``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, Final, Generic, TypeVar, cast

import anyio

from turtleact.body import ActionType
from turtleact.goal import CancelCode, GoalStatus
from turtleact.goal_wire import State, read_states
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
    EVERY_SERVER,
    STATUS_QOS,
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

__all__ = ["ClientEndpoints", "RequestLimiter"]

T = TypeVar("T")

AT_ONCE: Final = 8
"""How many requests are sent before the first is answered; two more are left to other clients."""

# Both responses begin with a number, in the byte behind the header of CDR.
_UNKNOWN: Final = bytes([GoalStatus.UNKNOWN])
_UNKNOWN_GOAL_ID: Final = bytes([CancelCode.UNKNOWN_GOAL_ID])


class RequestLimiter:
    """Sends requests to one service in their order, at most `AT_ONCE` before one is answered."""

    def __init__(self) -> None:
        self._unanswered = 0
        self._waiting: deque[anyio.Event] = deque()

    async def call(self, caller: Caller, request: object) -> Reply:
        """Send a request in its turn, and wait for the reply; raises as the caller does.

        Cancelling: safe; a request that waits for its turn is not sent.
        """
        await self._wait_for_turn()
        try:
            return await caller.call(request)
        finally:
            self._unanswered -= 1
            if self._unanswered < AT_ONCE:
                self._admit_next()

    def admit_all(self) -> None:
        """Send all requests that wait now: the server drops none."""
        while self._waiting:
            self._admit_next()

    async def _wait_for_turn(self) -> None:
        if self._unanswered < AT_ONCE and not self._waiting:
            self._unanswered += 1
            return
        turn = anyio.Event()
        self._waiting.append(turn)
        try:
            await turn.wait()
        except BaseException:
            if turn.is_set():  # the turn and the cancellation came together: pass the turn on
                self._unanswered -= 1
                self._admit_next()
            else:
                self._waiting.remove(turn)
            raise

    def _admit_next(self) -> None:
        if self._waiting:
            self._unanswered += 1
            self._waiting.popleft().set()


class ClientEndpoints:
    """The endpoints of one client.

    At first there is only the client of ``send_goal``, by which the graph sees the action's client.
    The others cost something, and a server in the same process needs none of them: see `open`.

    Args:
        transport: Where they are opened.
        endpoint: Describes them.
        names: Their names.
        action_type: The action.

    Attributes:
        transport: The same.
        name: The fully qualified name of the action.
        action_type: The action.
        is_open: Whether the other endpoints are open.
        send_goal: Sends goals, each to one server.
        get_result: Asks for results; there once `open` was called.
        is_ours: Whether the server was one of turtleact's when it answered last; see `knows_ours`.
        takes_both: Whether that server may get both requests of a goal at once. Set to False if it
            did not know a goal yet when it was asked for its result.
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
        self.transport = transport
        self.name = names.name
        self.action_type = action_type
        self.is_open = False
        self.is_ours = False
        self.takes_both = True
        self._endpoint = endpoint
        self._names = names
        self._opened: list[Closeable] = []
        self._watches_status = False
        self._goals, self._cancels = RequestLimiter(), RequestLimiter()
        self._servers: list[Endpoint] = []  # those that were there when `is_ours` was learned
        self._seen = 0  # the count of the graph's changes at which they were compared last
        self.send_goal = self._join(names.send_goal, "SendGoal", Target("one"))

    @cached_property
    def implied(self) -> Implied:
        """The services and the message that the action is sent in."""
        return implied(cast("type[Action]", self.action_type))

    def find_local(self) -> object | None:
        """What serves the action in this very process."""
        return self.transport.local(self._names.send_goal, f"{self.action_type.type_name}_SendGoal")

    async def wait_until_served(self) -> None:
        """Wait for a server. Cancelling: safe."""
        await wait_until_served(self.transport, lambda: self.send_goal.is_served or None, None)

    # which kind of server

    def knows_ours(self) -> bool:
        """Whether the server is one of turtleact's: its note said so, and no server has come since.

        Then requests need not wait for one another.
        """
        if self.is_ours and self._seen != self.transport.changes:
            self._seen = self.transport.changes
            self.is_ours = self._servers == self._find_servers()
        return self.is_ours

    def learn(self, reply: Reply) -> None:
        """Note by its reply of what kind the server is: ours put a note beside what they say."""
        if not reply.note:
            self.is_ours = False
        elif not self.is_ours:
            self.is_ours = self.takes_both = True
            self._servers, self._seen = self._find_servers(), self.transport.changes
            self._goals.admit_all()
            self._cancels.admit_all()

    async def ask_for_goal(self, request: object) -> Reply:
        """Send a goal and wait for the answer; in its turn, unless the server `knows_ours`."""
        if self.knows_ours():
            return await self.send_goal.call(request)
        return await self._goals.call(self.send_goal, request)

    async def ask_to_cancel(self, request: object) -> Reply:
        """Send a cancel request and wait for the answer, likewise; once `open` was called."""
        if self.knows_ours():
            return await self._cancel_goal.call(request)
        return await self._cancels.call(self._cancel_goal, request)

    # opening and closing

    def open(self, goals: Mapping[bytes, T], take_feedback: Callable[[T, Any], None]) -> None:
        """Open the other services and the feedback topic; a second time does nothing.

        Args:
            goals: What is known of the goals whose feedback is wanted, by their ids.
            take_feedback: Gets each feedback message of one of them, with what is known of it.
        """
        if self.is_open:
            return
        self.is_open = True
        names, action = self._names, self.action_type.type_name

        def deliver(message: Any) -> None:  # noqa: ANN401  # see `_FeedbackOfGoals.decode`
            if type(message) is tuple:
                take_feedback(*message)
            elif message is not None:  # it came as an object
                known = goals.get(bytes(message.goal_id.uuid))
                if known is not None:
                    take_feedback(known, message.feedback)

        format = _FeedbackOfGoals(cast("type[Action]", self.action_type), goals)
        self._subscribe(names.feedback, f"{action}_FeedbackMessage", format, deliver)
        # All servers are asked for a result, and to cancel: one that does not know the goal says
        # so, and may say it sooner than the one that does.
        self.get_result = self._join(
            names.get_result, "GetResult", Target(counts=lambda reply: reply[4:5] != _UNKNOWN)
        )
        self._cancel_goal = self.transport.join(
            self._endpoint("client", names.cancel_goal, CancelGoal.type_name),
            WireFormat(CancelGoal, asks=True),
            Target(counts=lambda reply: reply[4:5] != _UNKNOWN_GOAL_ID),
        )
        self._opened.append(self._cancel_goal)

    def watch_status(self, take_states: Callable[[dict[bytes, State]], None]) -> None:
        """Open the status topic; a second time does nothing."""
        if self._watches_status:
            return
        self._watches_status = True

        def deliver(told: Any) -> None:  # noqa: ANN401  # see `_States.decode`
            take_states(_states(told) if isinstance(told, GoalStatusArray) else told)

        name, type_name = self._names.status, GoalStatusArray.type_name
        self._subscribe(name, type_name, _States(), deliver, STATUS_QOS)

    def close(self) -> None:
        """Leave the graph."""
        for opened in reversed(self._opened):
            opened.close()
        self._opened.clear()

    def _find_servers(self) -> list[Endpoint]:
        """All servers of the name; one that is opened again is another."""
        endpoints = self.transport.endpoints(self._names.send_goal)
        return [each for each in endpoints if each.kind == "service"]

    def _join(self, name: str, kind: str, target: Target = EVERY_SERVER) -> Caller:
        service = {"SendGoal": "send_goal", "GetResult": "get_result"}[kind]
        format = WireFormat(lambda: getattr(self.implied, service), asks=True)
        endpoint = self._endpoint("client", name, f"{self.action_type.type_name}_{kind}")
        caller = self.transport.join(endpoint, format, target)
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
        self._opened.append(self.transport.subscribe(endpoint, format, deliver))


class _FeedbackOfGoals(FeedbackFormat, Generic[T]):
    """Reads the feedback of some goals only: in ROS 2 everybody gets the feedback of all.

    Args:
        action: The action.
        goals: What is known of these goals, by their ids.
    """

    def __init__(self, action: type[Action], goals: Mapping[bytes, T]) -> None:
        super().__init__(action)
        self._goals = goals

    def decode(self, data: bytes) -> Any:  # noqa: ANN401  # not the message of the topic
        """What is known of the goal, and its feedback; None if it is another goal."""
        known = self._goals.get(data[GOAL_ID])
        return None if known is None else (known, self.read(data))


class _States(WireFormat):
    """Reads the status of all goals as what is needed of it."""

    def __init__(self) -> None:
        super().__init__(GoalStatusArray)

    def decode(self, data: bytes) -> Any:  # noqa: ANN401  # not the message of the topic
        """The states; the message if they are written in an uncommon way."""
        states = read_states(data)
        return super().decode(data) if states is None else states


def _states(array: GoalStatusArray) -> dict[bytes, State]:
    return {
        bytes(each.goal_info.goal_id.uuid): (
            each.goal_info.stamp.sec,
            each.goal_info.stamp.nanosec,
            each.status,
        )
        for each in array.status_list
    }
