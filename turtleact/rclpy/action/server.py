"""Action servers.

Requests wait in one queue. An executor answers them in the callback group of the server. An execute
callback runs as a task of the executor, outside every callback group. So with a
`MultiThreadedExecutor`, the callback may block, for example in ``time.sleep``.
`turtleact.goals.state` defines the states of a goal and how they change.

Source: rcl_action ``action_server.c``; the ROS 2 design article "Actions"; rclpy
``action/server.py`` for names and texts.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

from turtleact.errors import InvalidMessage, InvalidTransition
from turtleact.goals.state import (
    CancelResponse,
    Goal,
    GoalEvent,
    GoalResponse,
    GoalStatus,
    cancel_code,
    select,
)
from turtleact.goals.wire import GoalMetadata
from turtleact.rclpy.action.endpoints import FEEDBACK_QOS, ActionKind, StatusTopic, goal_key
from turtleact.rclpy.exceptions import InvalidHandle, RCLError
from turtleact.rclpy.impl.connection import Respond
from turtleact.rclpy.impl.entity import QueueEntity, Waitable, await_or_execute
from turtleact.rclpy.impl.typing import Anything, Subscriptable
from turtleact.rclpy.messages import decode, encode
from turtleact.rclpy.qos import (
    QoSProfile,
    qos_profile_action_status_default,
    qos_profile_services_default,
)
from turtleact.rclpy.services import Introspected
from turtleact.rclpy.task import Future
from turtleact.transports.base import Reply

if TYPE_CHECKING:
    from turtleact.rclpy.impl.entity import CallbackGroup
    from turtleact.rclpy.node import Node

__all__ = [
    "ActionServer",
    "CancelResponse",
    "GoalResponse",
    "ServerGoalHandle",
    "default_cancel_callback",
    "default_goal_callback",
    "default_handle_accepted_callback",
]

Request: TypeAlias = "tuple[str, Anything, Respond]"
"""A request that waits: its service, its message, and the function that answers it."""


def default_handle_accepted_callback(goal_handle: ServerGoalHandle) -> None:
    """Execute an accepted goal at once."""
    goal_handle.execute()


def default_goal_callback(goal_request: Anything) -> GoalResponse:  # noqa: ARG001  # any goal
    """Accept every goal."""
    return GoalResponse.ACCEPT


def default_cancel_callback(cancel_request: Anything) -> CancelResponse:  # noqa: ARG001  # any
    """Reject every cancel request."""
    return CancelResponse.REJECT


class _Unheard:
    """The signal of a goal whose changes no task waits for."""

    def fire(self) -> None:
        """Do nothing."""

    async def wait(self) -> None:
        """Never called, because executors do not wait for goals."""


class ServerGoalHandle(Subscriptable):
    """A server's handle of a goal. Any thread may use it.

    Args:
        action_server: The server.
        goal_info: An ``action_msgs.msg.GoalInfo``: the goal's id, and the time of its acceptance.
        goal_request: The goal message.
    """

    def __init__(
        self, action_server: ActionServer, goal_info: Anything, goal_request: Anything
    ) -> None:
        stamp = goal_info.stamp
        accepted = stamp.sec * 1_000_000_000 + stamp.nanosec
        self.goal = Goal(goal_key(goal_info.goal_id), goal_request, _Unheard(), accepted)
        self._action_server = action_server
        self._goal_info = goal_info
        self._lock = threading.Lock()
        self._is_destroyed = False
        self.response: Anything = None
        self.ended = Future()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ServerGoalHandle) and self.goal.id == other.goal.id

    def __hash__(self) -> int:
        return hash(self.goal.id)

    @property
    def request(self) -> Anything:
        """The goal message."""
        return self.goal.request

    @property
    def goal_id(self) -> Anything:
        """The goal's id, a ``unique_identifier_msgs.msg.UUID``."""
        return self._goal_info.goal_id

    @property
    def goal_info(self) -> Anything:
        """An ``action_msgs.msg.GoalInfo``: the goal's id, and the time of its acceptance."""
        return self._goal_info

    @property
    def is_active(self) -> bool:
        """Whether the goal has not ended yet."""
        return not self._is_destroyed and self.goal.status.is_active

    @property
    def is_cancel_requested(self) -> bool:
        """Whether the goal is being canceled."""
        return self.status == GoalStatus.CANCELING

    @property
    def status(self) -> int:
        """The goal's state, a number of ``action_msgs.msg.GoalStatus``."""
        return int(GoalStatus.UNKNOWN if self._is_destroyed else self.goal.status)

    def update(self, event: GoalEvent) -> None:
        """Apply an event to the goal's state.

        Raises:
            RCLError: if the goal's present state does not allow the event.
        """
        with self._lock:
            if self._is_destroyed:
                return
            before = self.goal.status
            try:
                self.goal.apply(event)
            except InvalidTransition as error:
                raise RCLError(
                    "Failed to update goal state: goal_handle attempted invalid transition "
                    f"from state {before.name} with event {event.name}"
                ) from error
        self._action_server.goal_changed(self)

    def execute(self, execute_callback: Anything = None) -> None:
        """Let the executor run ``execute_callback``; None means the server's callback.

        The goal becomes EXECUTING, unless it is already CANCELING.
        """
        if not self.is_cancel_requested:
            self.update(GoalEvent.EXECUTE)
        self._action_server.notify_execute(self, execute_callback)

    def publish_feedback(self, feedback: Anything) -> None:
        """Publish feedback of the goal.

        Raises:
            TypeError: if the feedback is not of the action's class, or a value does not fit its
                type.
        """
        if not isinstance(feedback, self._action_server.action_type.Feedback):
            raise TypeError(f"expected feedback of the action, not {type(feedback)}")
        if not self._is_destroyed:
            with self._lock:  # clients wait for as many messages as are counted here
                self.goal.log.count += 1
            self._action_server.publish_feedback(self.goal.id, feedback)

    def succeed(self, response: Anything = None) -> None:
        """End the goal as SUCCEEDED.

        ``response`` is the result, unless the execute callback returns one.
        """
        self._end(GoalEvent.SUCCEED, response)

    def abort(self, response: Anything = None) -> None:
        """End the goal as ABORTED.

        ``response`` is the result, unless the execute callback returns one.
        """
        self._end(GoalEvent.ABORT, response)

    def canceled(self, response: Anything = None) -> None:
        """End the goal as CANCELED.

        ``response`` is the result, unless the execute callback returns one.
        """
        self._end(GoalEvent.CANCELED, response)

    def destroy(self) -> None:
        """Forget the goal. From now on, its state is UNKNOWN."""
        self._is_destroyed = True

    def _end(self, event: GoalEvent, response: Anything) -> None:
        if response is not None:
            self.response = response
        self.update(event)


class ActionServer(Introspected, Waitable, QueueEntity):
    """Serves an action.

    Args:
        node: The node.
        action_type: The class of the action.
        action_name: The name of the action.
        execute_callback: Takes a `ServerGoalHandle` and returns the result. It may be a coroutine
            function.
        callback_group: Decides when requests may be answered. None means the node's default group.
        goal_callback: Takes a goal message and returns a `GoalResponse`. By default, every goal is
            accepted.
        handle_accepted_callback: Takes the `ServerGoalHandle` of an accepted goal. By default, the
            goal is executed at once.
        cancel_callback: Takes a `ServerGoalHandle` and returns a `CancelResponse`. By default,
            every request is rejected.
        goal_service_qos_profile: Ignored.
        result_service_qos_profile: Ignored.
        cancel_service_qos_profile: Ignored.
        feedback_pub_qos_profile: The quality of service of the feedback topic.
        status_pub_qos_profile: The quality of service of the status topic.
        result_timeout: How long a result is kept after the goal's end (s). With a negative number,
            results are kept for ever.
    """

    def __init__(
        self,
        node: Node,
        action_type: Anything,
        action_name: str,
        execute_callback: Anything,
        *,
        callback_group: CallbackGroup | None = None,
        goal_callback: Anything = default_goal_callback,
        handle_accepted_callback: Anything = default_handle_accepted_callback,
        cancel_callback: Anything = default_cancel_callback,
        goal_service_qos_profile: QoSProfile = qos_profile_services_default,  # noqa: ARG002
        result_service_qos_profile: QoSProfile = qos_profile_services_default,  # noqa: ARG002
        cancel_service_qos_profile: QoSProfile = qos_profile_services_default,  # noqa: ARG002
        feedback_pub_qos_profile: QoSProfile = FEEDBACK_QOS,
        status_pub_qos_profile: QoSProfile = qos_profile_action_status_default,
        result_timeout: float = 10,
    ) -> None:
        group = callback_group or node.default_callback_group
        super().__init__(group, wake=node.wake_executor)
        self._node = node
        self._action_type = action_type
        self._name = action_name
        self._kind = ActionKind(node, action_type, action_name)
        self._timeout_ns = round(result_timeout * 1e9)
        self._goal_handles: dict[bytes, ServerGoalHandle] = {}
        self._expiries: deque[tuple[int, ServerGoalHandle]] = deque()
        self._lock = threading.Lock()
        self._logger = node.get_logger().get_child("action_server")
        self.register_goal_callback(goal_callback)
        self.register_handle_accepted_callback(handle_accepted_callback)
        self.register_cancel_callback(cancel_callback)
        self.register_execute_callback(execute_callback)
        kind = self._kind
        feedback = kind.names.feedback
        self._feedback = node.advertise(feedback, kind.feedback_type, feedback_pub_qos_profile)
        # Who sends a goal reads feedback, but may not be discovered as a reader before that.
        self._feedback.expect_readers()
        self._status = StatusTopic(node, self._kind, status_pub_qos_profile, self._held)
        # The last is send_goal: clients that see it expect the others.
        self.ends = tuple(
            kind.serve(service, partial(self._receive, service))
            for service in ("cancel_goal", "get_result", "send_goal")
        )
        node.add_waitable(self)

    @property
    def action_type(self) -> Anything:
        """The class of the action."""
        return self._action_type

    # callbacks

    def register_handle_accepted_callback(self, handle_accepted_callback: Anything) -> None:
        """Replace the callback for accepted goals. None means the default callback."""
        self._handle_accepted_callback = (
            handle_accepted_callback or default_handle_accepted_callback
        )

    def register_goal_callback(self, goal_callback: Anything) -> None:
        """Replace the callback for goal requests. None means the default callback."""
        self._goal_callback = goal_callback or default_goal_callback

    def register_cancel_callback(self, cancel_callback: Anything) -> None:
        """Replace the callback for cancel requests. None means the default callback."""
        self._cancel_callback = cancel_callback or default_cancel_callback

    def register_execute_callback(self, execute_callback: Anything) -> None:
        """Replace the execute callback.

        Raises:
            TypeError: if the callback is not callable.
        """
        if not callable(execute_callback):
            raise TypeError("Failed to register goal execution callback: not callable")
        self._execute_callback = execute_callback

    # as a waitable

    def _receive(self, service: str, request: bytes, respond: Respond) -> None:
        """Put a request into the queue. The transport may call this in any thread."""
        try:
            message = decode(request, self._kind.service(service).Request)
        except InvalidMessage as error:
            self._logger.error(f"a request cannot be read: {error}")
            respond(error)  # the transport counts the request as under way until its answer
            return
        self.put((service, message, respond))

    def is_ready_now(self) -> bool:
        """Whether a request is unanswered, or a goal's ``result_timeout`` has passed."""
        is_due = self._first_expiry() <= time.monotonic_ns() and not self.handle.is_destroyed
        return is_due or super().is_ready_now()

    def due_in(self) -> float | None:
        """The time until the next goal is forgotten (s); None if no goal will be forgotten."""
        if not self._expiries or self.handle.is_destroyed:
            return None
        return max(0.0, (self._first_expiry() - time.monotonic_ns()) / 1e9)

    def take(self) -> Anything:
        """Remove the oldest request from the queue and return it.

        This also forgets goals whose ``result_timeout`` has passed.
        """
        self._expire()
        return super().take()

    async def run(self, taken: Request) -> None:
        """Answer a request that `take` has returned."""
        service, message, respond = taken
        if service == "send_goal":
            await self._execute_goal_request(message, respond)
        elif service == "cancel_goal":
            await self._execute_cancel_request(message, respond)
        else:
            self._execute_get_result_request(message, respond)

    def describe(self) -> str:
        """Return a description of this server for a diagnostic message."""
        return f"the action server of {self._kind.names.name}"

    def destroy(self) -> None:
        """Destroy the server and its goal handles. A second call does nothing."""
        if self.handle.is_destroyed:
            return
        super().destroy()
        for goal_handle in list(self._goal_handles.values()):
            goal_handle.destroy()
        for each in (*self.ends, self._feedback, self._status):
            each.close()
        self._node.remove_waitable(self)

    # goals

    async def _execute_goal_request(self, request: Anything, respond: Respond) -> None:
        goal_id = goal_key(request.goal_id)
        info = self._kind.goal_info(request.goal_id, self._node.get_clock())
        accepted = goal_id not in self._goal_handles and await self._is_wanted(request.goal)
        handle = None
        if accepted:
            handle = self._goal_handles[goal_id] = ServerGoalHandle(self, info, request.goal)
        self._respond(respond, "send_goal", accepted=accepted, stamp=info.stamp)
        if handle is None:
            self._logger.debug(f"New goal rejected: {goal_id.hex()}")
            return
        self._logger.debug(f"New goal accepted: {goal_id.hex()}")
        self._status.publish()
        await await_or_execute(self._handle_accepted_callback, handle)

    async def _is_wanted(self, goal: Anything) -> bool:
        response = await await_or_execute(self._goal_callback, goal)
        if not isinstance(response, GoalResponse):
            self._logger.warning(
                "Goal request callback did not return a GoalResponse type. Rejecting goal."
            )
            return False
        return response is GoalResponse.ACCEPT

    def notify_execute(self, goal_handle: ServerGoalHandle, execute_callback: Anything) -> None:
        """Let the executor run ``execute_callback``; None means the server's callback.

        Raises:
            TypeError: if the callback is not callable.
        """
        if execute_callback is None:
            execute_callback = self._execute_callback
        elif not callable(execute_callback):
            raise TypeError("Failed to register goal execution callback: not callable")
        executor = self._node.executor
        if executor is not None:
            executor.create_task(self._execute_goal, execute_callback, goal_handle)

    async def _execute_goal(
        self, execute_callback: Anything, goal_handle: ServerGoalHandle
    ) -> None:
        """Run an execute callback to its end, and answer the clients that wait for the result."""
        try:
            result = await await_or_execute(execute_callback, goal_handle)
        except Exception as error:
            if isinstance(error, InvalidHandle) and not self._node.context.ok():
                return  # the context was shut down while the callback ran
            self._logger.error(f"Error raised in execute callback: {error}")
            traceback.print_exc()
            result = self._action_type.Result()
        else:
            result = self._checked_result(result, goal_handle)
        if goal_handle.is_active:
            uuid = goal_handle.goal_id.uuid
            self._logger.warning(f"Goal state not set, assuming aborted. Goal ID: {uuid}")
            goal_handle.abort()
        self._logger.debug(f"Goal with ID {goal_handle.goal.hex} finished")
        self._end_goal(goal_handle, result)

    def _checked_result(self, result: Anything, goal_handle: ServerGoalHandle) -> Anything:
        """Return the goal's result. If it is not of the action's class, return an empty result.

        With a result of another class, rclpy's server would crash.
        """
        if result is None:
            result = goal_handle.response
        if isinstance(result, self._action_type.Result):
            return result
        said = "nothing" if result is None else repr(result)
        self._logger.warning(
            f"The execute callback returned {said}, not a Result: an empty one is sent"
        )
        return self._action_type.Result()

    def _end_goal(self, goal_handle: ServerGoalHandle, result: Anything) -> None:
        made = self._kind.service("get_result").Response
        response = made(status=goal_handle.status, result=result)
        try:
            data = encode(response, made)
        except TypeError as error:
            self._logger.error(f"The result cannot be sent, so an empty one is sent: {error}")
            response.result = self._action_type.Result()
            data = encode(response, made)
        note = GoalMetadata(feedback=goal_handle.goal.log.count).write()
        goal_handle.ended.set_result(Reply(data, note))

    def goal_changed(self, goal_handle: ServerGoalHandle) -> None:
        """Publish a goal's new state. The goal's handle calls this after each change."""
        if not goal_handle.is_active and self._timeout_ns >= 0:
            due = time.monotonic_ns() + self._timeout_ns
            self._expiries.append((due, goal_handle))
            self.wake()
        self._status.publish()

    def publish_feedback(self, goal_id: bytes, feedback: Anything) -> None:
        """Publish feedback of a goal. The goal's handle calls this."""
        message = self._action_type.Impl.FeedbackMessage(feedback=feedback)
        message.goal_id.uuid = list(goal_id)
        self._feedback.publish(encode(message, type(message)))

    # canceling

    async def _execute_cancel_request(self, request: Anything, respond: Respond) -> None:
        info = request.goal_info
        key = goal_key(info.goal_id)
        goal_id = key if any(key) else None
        stamp = info.stamp.sec * 1_000_000_000 + info.stamp.nanosec
        chosen = select(self._held(), goal_id, stamp)
        canceling: list[Anything] = []
        for goal in chosen:
            handle = self._goal_handles.get(goal.id or b"")
            if handle is not None and await self._may_cancel(handle):
                canceling.append(handle.goal_info)
        named = None if goal_id is None else self._goal_handles.get(goal_id)
        code = cancel_code(
            None if named is None else named.goal,
            by_id=goal_id is not None and not stamp,
            asked=len(chosen),
            let_go=len(canceling),
        )
        self._respond(respond, "cancel_goal", return_code=int(code), goals_canceling=canceling)

    async def _may_cancel(self, goal_handle: ServerGoalHandle) -> bool:
        """Ask the cancel callback. If it accepts and the goal has not ended, cancel the goal.

        Return whether the goal is being canceled.
        """
        answer = await await_or_execute(self._cancel_callback, goal_handle)
        if answer is not CancelResponse.ACCEPT:
            return False
        if goal_handle.is_cancel_requested:
            return True
        try:
            goal_handle.update(GoalEvent.CANCEL_GOAL)
        except RCLError as error:
            self._logger.debug(f"Failed to cancel goal: {error}")
            return False
        return True

    # results

    def _execute_get_result_request(self, request: Anything, respond: Respond) -> None:
        handle = self._goal_handles.get(goal_key(request.goal_id))
        if handle is None:
            self._logger.warning(
                f"Sending result response for unknown goal ID: {request.goal_id.uuid}"
            )
            self._respond(respond, "get_result")
        else:
            handle.ended.add_done_callback(lambda ended: respond(ended.result()))

    def _respond(self, respond: Respond, service: str, **fields: Anything) -> None:
        response = self._kind.service(service).Response(**fields)
        respond(Reply(encode(response, type(response)), NOTE))

    def _first_expiry(self) -> int:
        """Return when the next goal is forgotten (ns, monotonic clock); `NEVER` if none will be."""
        return self._expiries[0][0] if self._expiries else NEVER

    def _expire(self) -> None:
        """Forget the goals whose ``result_timeout`` has passed."""
        if self._first_expiry() > time.monotonic_ns():
            return
        with self._lock:
            while self._first_expiry() <= time.monotonic_ns():
                _, handle = self._expiries.popleft()
                self._goal_handles.pop(handle.goal.id, None)
                handle.destroy()
        self._status.publish()

    def _held(self) -> list[Goal]:
        """Return all goals that the server has not forgotten."""
        return [each.goal for each in list(self._goal_handles.values())]


NOTE = GoalMetadata().write()
"""The note that tells clients of turtleact that this server drops no requests."""

NEVER = 2**63
