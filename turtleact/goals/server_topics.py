"""The topics of an action server: feedback, the status of its goals, and why goals failed.

The messages of a topic are created and sent only while the topic has readers.

Source: rcl_action ``rcl_action_get_goal_status_array``; the ROS 2 design article "Actions".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, cast

from turtleact.goals.observers import FeedbackLost, GoalObserver
from turtleact.goals.server import LocalActionServer
from turtleact.goals.state import Goal, GoalStatus
from turtleact.goals.wire import GoalReason, pack_state, reason_topic, write_states
from turtleact.interfaces import (
    SECOND,
    Action,
    FeedbackFormat,
    Message,
    WireFormat,
    implied,
    stamp_of,
)
from turtleact.interfaces.standard import UUID, GoalInfo, GoalStatusArray, GoalStatusMessage
from turtleact.tasks import Background
from turtleact.transports.base import Endpoint, MakeEndpoint, Publication, QoS, Source, Transport

if TYPE_CHECKING:
    from turtleact.goals.fault_reports import LostFeedback

__all__ = ["FeedbackTopic", "ReasonTopic", "StatusTopic"]

EXPIRED_TOGETHER: Final = 1.0
"""The shortest time between two status messages that report only expired goals (s)."""


class FeedbackTopic(Source):
    """Publishes the feedback of a server's goals.

    Args:
        server: The server.
        transport: The transport to open the topic on.
        endpoint: The description of the topic's endpoint.
    """

    def __init__(self, server: LocalActionServer, transport: Transport, endpoint: Endpoint) -> None:
        self._server = server
        self._action = cast("type[Action]", server.spec.action_type)
        self._format = FeedbackFormat(self._action)
        self._transport, self._endpoint = transport, endpoint
        self._lost: LostFeedback | None = None
        self._publication = transport.advertise(endpoint, self._format, self)
        self._dropped = 0

    def readers_changed(self, *, has_readers: bool) -> None:
        """Start to publish feedback if the topic has readers; otherwise stop."""
        self._server.publisher = self if has_readers else None

    def message_lost(self) -> None:
        """Report to ``turtleact doctor`` that feedback was dropped."""
        if self._lost is None:
            from turtleact.goals.fault_reports import LostFeedback  # few programs need it

            how, advice = "were dropped by", "publish feedback less often, or read it faster"
            place = self._transport, self._endpoint.node
            self._lost = LostFeedback(*place, self._server.name, how, advice)
        self._lost.add(1)

    def expect_readers(self) -> None:
        """Publish from now on, even if no reader is known yet.

        Called when a client in another process sends a goal, because that client reads feedback.
        """
        self._publication.expect_readers()

    def close(self) -> None:
        """Close the topic."""
        self._publication.close()
        if self._lost is not None:
            self._lost.close()

    @property
    def is_congested(self) -> bool:
        """Whether bodies should wait before they publish more feedback."""
        return self._publication.is_congested

    async def drained(self) -> None:
        """Wait until the topic is not congested. Cancelling: safe."""
        await self._publication.drained()

    def send(self, goal: Goal, message: Message) -> None:
        """Publish feedback that has been checked and copied."""
        publication = self._publication
        if publication.has_object_readers:
            publication.publish(self._message_type(UUID(goal.id), message))
        else:
            publication.send(self._format.write(goal.id, message))
            if publication.dropped != self._dropped:
                self._tell_of_loss(goal)

    def _tell_of_loss(self, goal: Goal) -> None:
        """Tell the observers that feedback was dropped.

        The report names ``goal``, but the dropped feedback may belong to another goal.
        """
        lost, self._dropped = self._publication.dropped - self._dropped, self._publication.dropped
        self._server.observers.noted(goal, FeedbackLost(lost))

    @cached_property
    def _message_type(self) -> type[Any]:
        return implied(self._action).feedback_message


class StatusTopic(Source, GoalObserver):
    """Publishes the status of all goals that a server holds.

    When a goal changes, the topic only marks the goal as changed. A message lists all goals, and a
    server may hold thousands. The topic therefore builds a message only when it sends the message,
    and one message may report several changes.

    Args:
        server: The server.
        transport: The transport to open the topic on.
        endpoint: The description of the topic's endpoint.
    """

    def __init__(self, server: LocalActionServer, transport: Transport, endpoint: Endpoint) -> None:
        self._server = server
        self._changed: dict[Goal, None] | None = None  # in order; None if all goals must be written
        self._entries: dict[bytes, bytes] = {}  # in the order of the goals' acceptance
        self._is_stale = False  # whether anything has changed since the last write
        self._clock = transport.clock
        self._expiring: Background | None = None
        self._publication: Publication | None = None  # `readers_changed` may be called in here:
        self._publication = transport.advertise(endpoint, WireFormat(GoalStatusArray), self)

    def current(self) -> Sequence[object]:
        """Build the message with all goals that the server holds."""
        statuses = [
            GoalStatusMessage(GoalInfo(UUID(goal.id), stamp_of(goal.stamp)), int(goal.status))
            for goal in self._server.held().values()
        ]
        return (GoalStatusArray(statuses),)

    def written(self, encode: Callable[[object], bytes]) -> Sequence[bytes]:  # noqa: ARG002
        """Build the status message as bytes. Only goals that have changed are encoded again."""
        changed, entries = self._changed, self._entries
        held = self._server.held()
        for goal in held.values() if changed is None else changed:
            entries[goal.id] = pack_state(goal.id, (*divmod(goal.stamp, SECOND), goal.status))
        self._changed, self._is_stale = {}, False
        if len(entries) > len(held):  # every goal held has an entry
            entries = self._entries = {key: each for key, each in entries.items() if key in held}
        return (write_states(entries.values()),)

    def readers_changed(self, *, has_readers: bool) -> None:
        """Start to observe goals if the topic has readers; otherwise stop observing."""
        self._changed, self._entries, self._is_stale = None, {}, False
        self._stop_observing()
        if has_readers:
            self._server.observers.add(self)
            name, tasks = f"the status of {self._server.name}", self._server.tasks
            self._expiring = Background(self._refresh_at_expiries(), name, tasks)

    def _stop_observing(self) -> None:
        self._server.observers.remove(self)
        if self._expiring is not None:
            self._expiring.cancel()

    async def _refresh_at_expiries(self) -> None:
        """Publish the status again when goals have expired, so that no reader asks for them."""
        while True:
            due = self._server.table.next_expiry()
            if due is None:
                await self._server.idle.wait()
            else:
                left = (due - self._server.now()) / SECOND
                await self._clock.sleep(max(left, EXPIRED_TOGETHER))
                self._refresh()

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:  # noqa: ARG002
        """Publish the status of all goals again.

        Readers in this process get a message at each change. Readers in other processes get one
        message for several changes in quick succession.
        """
        if self._changed is not None:
            self._changed[goal] = None
        self._refresh()

    def _refresh(self) -> None:
        publication = self._publication
        if publication is not None and (not self._is_stale or publication.has_local_readers):
            self._is_stale = True
            publication.refresh()

    def close(self) -> None:
        """Close the topic."""
        self._stop_observing()
        if self._publication is not None:
            self._publication.close()


class ReasonTopic(Source, GoalObserver):
    """Publishes, for recorders, why goals were rejected or ended without success.

    ROS 2 has no topic for reasons, and its messages have no field for a reason. Clients get the
    reason as an attachment of a response, but recorders cannot record attachments.

    Args:
        server: The server.
        transport: The transport to open the topic on.
        endpoint: A function that describes the endpoint.
    """

    def __init__(
        self, server: LocalActionServer, transport: Transport, endpoint: MakeEndpoint
    ) -> None:
        self._server = server
        name, type_name = reason_topic(server.name), GoalReason.type_name
        described = endpoint("publisher", name, type_name, QoS(depth=100))
        self._publication = transport.advertise(described, WireFormat(GoalReason), self)

    def readers_changed(self, *, has_readers: bool) -> None:
        """Start to observe goals if the topic has readers; otherwise stop observing.

        Observing costs time for each goal.
        """
        self._server.observers.remove(self)
        if has_readers:
            self._server.observers.add(self)

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:  # noqa: ARG002
        """If a goal has ended and has a reason, publish the reason."""
        if after.is_terminal and goal.reason:
            self._publish(goal.id, after, goal.reason)

    def rejected(self, goal_id: bytes, reason: str) -> None:
        """Publish why a goal was rejected."""
        if self._publication.has_readers:
            self._publish(goal_id, GoalStatus.UNKNOWN, reason)

    def close(self) -> None:
        """Close the topic."""
        self._server.observers.remove(self)
        self._publication.close()

    def _publish(self, goal_id: bytes, status: GoalStatus, reason: str) -> None:
        self._publication.publish(GoalReason(UUID(goal_id), int(status), reason))
