"""Opens the endpoints of an action client: three service clients and two subscriptions.

A ROS 2 service queues at most ten requests that its node has not taken yet. If more arrive, the
service silently drops the oldest. The client therefore sends only a few requests at a time, until
an answer shows that the server runs turtleact.

Source: rcl_action ``action_client.c``; rmw_zenoh_cpp ``rmw_service_data.cpp``, ``add_new_query``;
rmw ``qos_profiles.h``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar, cast

import anyio

from turtleact.errors import PauseRefused, ServerUnavailable
from turtleact.goals.body import ActionType
from turtleact.goals.service_server import Introspection, service_events
from turtleact.goals.state import CancelCode, Goal, GoalStatus
from turtleact.goals.wire import (
    PausedGoals,
    SetPaused,
    State,
    paused_topic,
    read_states,
    set_paused_service,
)
from turtleact.interfaces import (
    GOAL_ID,
    Action,
    FeedbackFormat,
    Implied,
    WireFormat,
    implied,
)
from turtleact.interfaces.standard import UUID, CancelGoal, GoalStatusArray
from turtleact.names import ActionNames
from turtleact.transports.base import (
    STATUS_QOS,
    Caller,
    Closeable,
    Format,
    MakeEndpoint,
    QoS,
    Reply,
    Target,
    Transport,
    find_server,
    wait_until_served,
)

if TYPE_CHECKING:
    from turtleact.goals.fault_reports import LostFeedback
    from turtleact.goals.server import GoalServer
    from turtleact.interfaces import Service

__all__ = ["TARGETS", "ClientEndpoints"]

T = TypeVar("T")

OFFERED_WITHIN: Final = 2.0
"""How long to wait for a server to declare its service for pausing (s, by the graph's clock)."""

AT_ONCE: Final = 8
"""The most unanswered requests that a client sends to a service.

A ROS 2 service keeps at most ten waiting requests by default, so there is room for two requests of
other clients.
"""

# Both responses begin with a number, in the byte after the CDR header.
_UNKNOWN: Final = bytes([GoalStatus.UNKNOWN])
_UNKNOWN_GOAL_ID: Final = bytes([CancelCode.UNKNOWN_GOAL_ID])


# Results and cancels are requested from every server of the name. A server that does not know the
# goal says so, perhaps before the right server answers; that reply does not count.
TARGETS: Final = {
    "send_goal": Target("one"),
    "cancel_goal": Target(counts=lambda reply: reply[4:5] != _UNKNOWN_GOAL_ID),
    "get_result": Target(counts=lambda reply: reply[4:5] != _UNKNOWN),
}
"""Which servers of an action's name get the requests of each service."""


class ClientEndpoints:
    """The endpoints of one action client.

    At first, the only endpoint is the service client for ``send_goal``, which makes the action
    client visible on the graph. `open` adds the other endpoints later, because opening endpoints
    takes time. A client of a server in the same process does not need the other endpoints.

    Args:
        transport: The transport on which the endpoints are opened.
        endpoint: A function that makes the description of an endpoint.
        names: The names of the action's services and topics.
        action_type: The type of the action.
        introspection: The service events that the client publishes: "off" for none, "metadata" for
            events without messages, or "contents" for events with messages.

    Attributes:
        transport: The transport on which the endpoints are opened.
        name: The fully qualified name of the action.
        action_type: The type of the action.
        is_open: Whether `open` was called.
        send_goal: The service client that sends goals. If the action has several servers, each goal
            goes to only one server.
        get_result: The service client that asks for results. It exists only after `open`.
        is_ours: Whether the last answer to a goal request came from a turtleact server, because
            only such a server attaches a note.
    """

    get_result: Caller
    _cancel_goal: Caller

    def __init__(
        self,
        transport: Transport,
        endpoint: MakeEndpoint,
        names: ActionNames,
        action_type: ActionType[Any, Any, Any],
        introspection: Introspection = "off",
    ) -> None:
        self.transport = transport
        self.name = names.name
        self.action_type = action_type
        self.is_open = False
        self.is_ours = False
        self._endpoint = endpoint
        self._names = names
        self._introspection = introspection
        self._opened: list[Closeable] = []
        self._read: set[str] = set()  # the topics that are subscribed to
        self._goals = anyio.Semaphore(AT_ONCE, fast_acquire=True)
        self._cancels = anyio.Semaphore(AT_ONCE, fast_acquire=True)
        self._lost: LostFeedback | None = None
        self.send_goal = self._join(
            names.send_goal,
            f"{action_type.type_name}_SendGoal",
            lambda: self.implied.send_goal,
            TARGETS["send_goal"],
        )
        self._set_paused: Caller | None = None

    @cached_property
    def implied(self) -> Implied:
        """The types of the action's services and of its feedback message."""
        return implied(cast("type[Action]", self.action_type))

    def find_local(self) -> GoalServer | None:
        """Return the server of the action in this process, or None.

        With introspection, the result is None, because a direct call publishes no events.
        """
        if self._introspection != "off":  # the requests are published, so they must be sent
            return None
        type_name = f"{self.action_type.type_name}_SendGoal"
        handlers = self.transport.local(self._names.send_goal, type_name)
        return cast("GoalServer | None", handlers[0].direct) if handlers else None

    async def wait_until_served(self) -> None:
        """Wait until the action has a server on the graph. Cancelling: safe."""
        await wait_until_served(self.transport, lambda: self.send_goal.is_served or None, None)

    # requests

    async def ask_for_goal(self, request: object, note: str) -> Reply:
        """Send a goal when its turn comes, and return the server's answer. Cancelling: safe."""
        async with nullcontext() if self.is_ours else self._goals:
            reply = await self.send_goal.call(request, note)
        self.is_ours = bool(reply.note)
        return reply

    async def ask_to_cancel(self, request: object) -> Reply:
        """Send a cancel request when its turn comes, and return the server's answer.

        Call `open` first.
        """
        # A client that has just come may know a server's other services before this one.
        await find_server(self.transport, lambda: self._cancel_goal.is_served or None)
        async with nullcontext() if self.is_ours else self._cancels:
            return await self._cancel_goal.call(request)

    async def set_paused(self, goal: Goal, *, is_paused: bool, timeout: float = 0.0) -> None:
        """Pause or resume a goal. Only turtleact servers offer a service for pausing.

        Args:
            goal: The goal.
            is_paused: True to pause the goal, False to resume the goal.
            timeout: How long the goal's body may take to pause (s).

        Raises:
            PauseRefused: if the server refuses, or does not offer the service for pausing.
            ServerUnavailable: if the server goes away.
        """
        if self._set_paused is None:
            name = set_paused_service(self.name)
            self._set_paused = self.transport.join(
                self._endpoint("client", name, SetPaused.type_name),
                WireFormat(SetPaused, asks=True),
                Target("one"),
            )
            self._opened.append(self._set_paused)
        caller = self._set_paused
        await wait_until_served(self.transport, lambda: caller.is_served or None, OFFERED_WITHIN)
        if not (caller.is_served or self.send_goal.is_served):
            problem = "the server is gone, so its goals cannot be paused or resumed"
            raise ServerUnavailable(self.name, problem)
        if not caller.is_served:
            raise PauseRefused("its server does not offer that; is it a server of turtleact?")
        request = SetPaused.Request(UUID(goal.id), is_paused, timeout)
        response: Any = (await caller.call(request)).message
        if not response.success:
            raise PauseRefused(response.message)

    # opening and closing

    def open(
        self,
        goals: Mapping[bytes, T],
        take_feedback: Callable[[T, Any], None],
        on_gap: Callable[[int], None],
    ) -> None:
        """Open the clients for ``cancel_goal`` and ``get_result``, and subscribe to feedback.

        A second call does nothing.

        Args:
            goals: Maps goal ids to objects of any kind. The feedback of other goals is ignored.
            take_feedback: Called with the goal's object from ``goals``, and the feedback message.
            on_gap: Called with the number of feedback messages, of any goal, that did not arrive.
        """
        if self.is_open:
            return
        self.is_open = True
        names, action = self._names, self.action_type.type_name

        def deliver(message: Any) -> None:  # noqa: ANN401  # see `_FeedbackOfGoals.decode`
            if type(message) is tuple:
                take_feedback(*message)
            elif message is not None:  # the publisher is in this process, so it was not encoded
                known = goals.get(bytes(message.goal_id.uuid))
                if known is not None:
                    take_feedback(known, message.feedback)

        format = _FeedbackOfGoals(cast("type[Action]", self.action_type), goals)
        type_name = f"{action}_FeedbackMessage"
        self._subscribe(names.feedback, type_name, format, deliver, on_gap=on_gap)
        self.get_result = self._join(
            names.get_result,
            f"{action}_GetResult",
            lambda: self.implied.get_result,
            TARGETS["get_result"],
        )
        self._cancel_goal = self._join(
            names.cancel_goal,
            CancelGoal.type_name,
            lambda: CancelGoal,
            TARGETS["cancel_goal"],
        )

    def watch_status(self, take_states: Callable[[dict[bytes, State]], None]) -> None:
        """Subscribe to the status topic. A second call does nothing."""

        def deliver(told: Any) -> None:  # noqa: ANN401  # see `_States.decode`
            take_states(_states(told) if isinstance(told, GoalStatusArray) else told)

        name, type_name = self._names.status, GoalStatusArray.type_name
        self._subscribe(name, type_name, _States(), deliver, STATUS_QOS)

    def watch_paused(self, take_paused: Callable[[frozenset[bytes]], None]) -> None:
        """Subscribe to the topic that lists the paused goals. A second call does nothing.

        Args:
            take_paused: Called with the ids of all goals that are paused.
        """

        def deliver(message: PausedGoals) -> None:
            take_paused(frozenset(bytes(each.uuid) for each in message.goal_ids))

        name, type_name = paused_topic(self.name), PausedGoals.type_name
        self._subscribe(name, type_name, WireFormat(PausedGoals), deliver, STATUS_QOS)

    def report_lost(self, count: int) -> None:
        """Report ``count`` more lost feedback messages, so that ``turtleact doctor`` shows them."""
        if self._lost is None:
            from turtleact.goals.fault_reports import LostFeedback  # few programs need it

            how, advice = "did not reach", "publish feedback less often, or mend the network"
            self._lost = LostFeedback(self.transport, self._node, self.name, how, advice)
            self._opened.append(self._lost)
        self._lost.add(count)

    def close(self) -> None:
        """Close the endpoints."""
        for opened in reversed(self._opened):
            opened.close()
        self._opened.clear()

    def _join(
        self, name: str, type_name: str, find_type: Callable[[], type[Service]], target: Target
    ) -> Caller:
        endpoint = self._endpoint("client", name, type_name)
        self._node = endpoint.node
        mode, maker = self._introspection, self._endpoint
        events = service_events(self.transport, maker, endpoint, find_type, mode)
        if events is not None:
            self._opened.append(events)
        caller = self.transport.join(endpoint, WireFormat(find_type, asks=True), target)
        caller.observer = events
        self._opened.append(caller)
        return caller

    def _subscribe(
        self,
        name: str,
        type_name: str,
        format: Format,
        deliver: Callable[[Any], None],
        qos: QoS | None = None,
        on_gap: Callable[[int], None] | None = None,
    ) -> None:
        if name not in self._read:
            self._read.add(name)
            endpoint = self._endpoint("subscription", name, type_name, qos)
            self._opened.append(self.transport.subscribe(endpoint, format, deliver, on_gap=on_gap))


class _FeedbackOfGoals(FeedbackFormat, Generic[T]):
    """Decodes only the feedback of known goals.

    In ROS 2, every client gets the feedback of all goals.

    Args:
        action: The type of the action.
        goals: Maps the id of each known goal to an object of any kind.
    """

    def __init__(self, action: type[Action], goals: Mapping[bytes, T]) -> None:
        super().__init__(action)
        self._goals = goals

    def decode(self, data: bytes) -> Any:  # noqa: ANN401  # not the message of the topic
        """Return a pair: the object of a goal in ``goals``, and the feedback message.

        For an unknown goal, return None.
        """
        known = self._goals.get(data[GOAL_ID])
        return None if known is None else (known, self.read(data))


class _States(WireFormat):
    """Decodes a status message into a dict from goal ids to states."""

    def __init__(self) -> None:
        super().__init__(GoalStatusArray)

    def decode(self, data: bytes) -> Any:  # noqa: ANN401  # not the message of the topic
        """Return the states, or the whole message if it has an unusual encoding."""
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
