"""Action clients.

The server's answers, feedback and goal states wait in one queue in the order of their arrival. An
executor handles the queued messages in the client's callback group. No message is dropped. If
feedback arrives before the answer to its goal request, the feedback waits for that answer.

Source: rcl_action ``action_client.c``; rclpy ``action/client.py`` for names and texts.
"""

from __future__ import annotations

import threading
import uuid
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, TypeAlias
from weakref import WeakValueDictionary

from turtleact.errors import InvalidMessage, TurtleactError
from turtleact.goals.wire import read_states
from turtleact.interfaces import GOAL_ID
from turtleact.rclpy.action.endpoints import FEEDBACK_QOS, STATUS, ActionKind, goal_key
from turtleact.rclpy.impl.entity import (
    QueueEntity,
    Waitable,
    await_or_execute,
    wait_for_answer,
    wait_until,
)
from turtleact.rclpy.impl.typing import Anything, Subscriptable
from turtleact.rclpy.messages import decode, encode, interface_class
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

__all__ = ["ActionClient", "ClientGoalHandle"]

Event: TypeAlias = "tuple[Callable[..., Anything], tuple[Anything, ...]]"
"""A queued message: the function that handles the message, and the function's arguments."""


class ClientGoalHandle(Subscriptable):
    """A client's handle of a goal that it has sent.

    Args:
        action_client: The client.
        goal_id: The goal's id.
        goal_response: The server's answer to the goal request.
    """

    def __init__(
        self, action_client: ActionClient, goal_id: Anything, goal_response: Anything
    ) -> None:
        self._action_client = action_client
        self._goal_id = goal_id
        self._goal_response = goal_response
        self._status = 0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ClientGoalHandle) and self._goal_id == other._goal_id

    def __hash__(self) -> int:
        return hash(goal_key(self._goal_id))

    def __repr__(self) -> str:
        return (
            f"ClientGoalHandle <id={goal_key(self._goal_id).hex()}, accepted={self.accepted}, "
            f"status={self._status}>"
        )

    @property
    def goal_id(self) -> Anything:
        """The goal's id, a ``unique_identifier_msgs.msg.UUID``."""
        return self._goal_id

    @property
    def stamp(self) -> Anything:
        """The time when the goal was accepted, a ``builtin_interfaces.msg.Time``."""
        return self._goal_response.stamp

    @property
    def accepted(self) -> bool:
        """Whether the goal was accepted."""
        accepted: bool = self._goal_response.accepted
        return accepted

    @property
    def status(self) -> int:
        """The last known state of the goal: a number of ``action_msgs.msg.GoalStatus``."""
        return self._status

    def update_status(self, status: int) -> None:
        """Remember the goal's state. After the goal's end, ignore states of a running goal."""
        if self._status < 4 or status >= 4:
            self._status = status

    def cancel_goal(self) -> Anything:
        """Ask the server to cancel the goal, and wait for the answer.

        While this method waits, another thread must spin the node.
        """
        return self._action_client.wait_for_future(self.cancel_goal_async(), "cancel_goal()")

    def cancel_goal_async(self) -> Future:
        """Ask the server to cancel the goal, and return the future of the answer."""
        return self._action_client.cancel_goal_async(self)

    def get_result(self) -> Anything:
        """Wait for the result, while another thread spins the node."""
        return self._action_client.wait_for_future(self.get_result_async(), "get_result()")

    def get_result_async(self) -> Future:
        """Return the future of the result, a message with ``status`` and ``result``."""
        return self._action_client.get_result_async(self)


class ActionClient(Introspected, Waitable, QueueEntity):
    """Sends goals to an action.

    Args:
        node: The node.
        action_type: The class of the action.
        action_name: The name of the action.
        callback_group: Decides when answers may be handled. None means the node's default group.
        goal_service_qos_profile: Ignored.
        result_service_qos_profile: Ignored.
        cancel_service_qos_profile: Ignored.
        feedback_sub_qos_profile: The quality of service of the feedback topic.
        status_sub_qos_profile: The quality of service of the status topic.
    """

    def __init__(
        self,
        node: Node,
        action_type: Anything,
        action_name: str,
        *,
        callback_group: CallbackGroup | None = None,
        goal_service_qos_profile: QoSProfile = qos_profile_services_default,  # noqa: ARG002
        result_service_qos_profile: QoSProfile = qos_profile_services_default,  # noqa: ARG002
        cancel_service_qos_profile: QoSProfile = qos_profile_services_default,  # noqa: ARG002
        feedback_sub_qos_profile: QoSProfile = FEEDBACK_QOS,
        status_sub_qos_profile: QoSProfile = qos_profile_action_status_default,
    ) -> None:
        group = callback_group or node.default_callback_group
        super().__init__(group, wake=node.wake_executor)
        self._node = node
        self._action_type = action_type
        self._action_name = action_name
        self._kind = ActionKind(node, action_type, action_name)
        self._goal_handles: WeakValueDictionary[bytes, ClientGoalHandle] = WeakValueDictionary()
        self._feedback_callbacks: dict[bytes, Callable[[Anything], object]] = {}
        self._early: dict[bytes, list[bytes]] = {}  # feedback of goals without an answer yet
        self._lock = threading.Lock()
        self._ends = {
            name: self._kind.join(name) for name in ("send_goal", "cancel_goal", "get_result")
        }
        self.ends = tuple(self._ends.values())
        names, kind = self._kind.names, self._kind
        self._closing = [
            kind.subscribe(
                names.feedback, kind.feedback_type, feedback_sub_qos_profile, self._take_feedback
            ),
            kind.subscribe(names.status, STATUS, status_sub_qos_profile, self._take_status),
        ]
        node.add_waitable(self)

    # sending

    def send_goal(
        self, goal: Anything, feedback_callback: Anything = None, goal_uuid: Anything = None
    ) -> Anything:
        """Send a goal and wait for its result, a message with ``status`` and ``result``.

        While this method waits, another thread must spin the node. Returns None if the goal is
        rejected.

        Raises:
            TypeError: if the goal is not of the action's class, or a value does not fit its type.
        """
        sent = self.send_goal_async(goal, feedback_callback, goal_uuid)
        handle = self.wait_for_future(sent, "send_goal()")
        return handle.get_result() if handle.accepted else None

    def send_goal_async(
        self, goal: Anything, feedback_callback: Anything = None, goal_uuid: Anything = None
    ) -> Future:
        """Send a goal, and return the future of its `ClientGoalHandle`.

        Args:
            goal: The goal message.
            feedback_callback: Called with each feedback message of the goal.
            goal_uuid: The goal's id. None means a random id.

        Raises:
            TypeError: if the goal is not of the action's class, or a value does not fit its type.
        """
        if not isinstance(goal, self._action_type.Goal):
            raise TypeError(f"expected a goal of the action, not {type(goal)}")
        if goal_uuid is None:
            made = interface_class("unique_identifier_msgs/msg/UUID")
            goal_uuid = made(uuid=list(uuid.uuid4().bytes))
        request = self._kind.service("send_goal").Request(goal_id=goal_uuid, goal=goal)
        data = encode(request, type(request))
        self.handle.check()
        key = goal_key(goal_uuid)
        if feedback_callback is not None:
            self._early[key] = []  # first, because feedback may come as soon as there is a callback
            self._feedback_callbacks[key] = feedback_callback
        return self._call("send_goal", data, partial(self._goal_answered, goal_uuid))

    def cancel_goal_async(self, goal_handle: ClientGoalHandle) -> Future:
        """Ask the server to cancel a goal, and return the future of the answer.

        Raises:
            TypeError: if ``goal_handle`` is not a `ClientGoalHandle`.
        """
        _check_handle(goal_handle)
        info = self._kind.goal_info(goal_handle.goal_id)
        request = self._kind.service("cancel_goal").Request(goal_info=info)
        return self._call("cancel_goal", encode(request, type(request)), lambda answer: answer)

    def get_result_async(self, goal_handle: ClientGoalHandle) -> Future:
        """Return the future of a goal's result, a message with ``status`` and ``result``.

        Raises:
            TypeError: if ``goal_handle`` is not a `ClientGoalHandle`.
        """
        _check_handle(goal_handle)
        request = self._kind.service("get_result").Request(goal_id=goal_handle.goal_id)
        ended = partial(self._goal_ended, goal_handle)
        return self._call("get_result", encode(request, type(request)), ended)

    def wait_for_future(self, future: Future, what: str) -> Anything:
        """Block until a future is done, and return its result."""
        where = f"{what} of {self._kind.names.name}"
        wait_for_answer(self, where, future, self._node.context.ok)
        return future.result()

    def server_is_ready(self) -> bool:
        """Whether the action has a server that can receive a goal now."""
        with self.handle:
            return all(end.is_served for end in self._ends.values())

    def wait_for_server(self, timeout_sec: float | None = None) -> bool:
        """Wait until the action has a server, without spinning. Return whether it has a server."""
        return wait_until(self.server_is_ready, timeout_sec, self._node.context.ok)

    # what comes; any thread

    def _call(
        self,
        service: str,
        data: bytes,
        handle: Callable[[Anything], Anything],
    ) -> Future:
        """Send a request. The returned future gets the return value of ``handle(response)``.

        If there is no response, the future never gets a result.
        """
        future = Future()
        response_class = self._kind.service(service).Response

        def answered(reply: Reply | TurtleactError) -> None:
            if isinstance(reply, Reply):
                arguments = future, response_class, reply.message, handle
                self.put((self._answered, arguments))
            else:
                # As in ROS 2, a request that nobody answers is lost: its future is never done.
                self._node.get_logger().debug(f"a request was lost: {reply}")

        self._ends[service].send(data, answered)
        return future

    def _take_feedback(self, data: bytes) -> None:
        key = data[GOAL_ID]
        if key not in self._feedback_callbacks:
            return
        with self._lock:
            early = self._early.get(key)
            if early is not None:
                early.append(data)
                return
        self.put((self._feedback, (data,)))

    def _take_status(self, data: bytes) -> None:
        if self._goal_handles:
            self.put((self._update_states, (data,)))

    # as a waitable

    def take(self) -> Anything:
        """Remove the oldest item from the queue and return it."""
        with self._lock:  # see `_goal_answered`
            return super().take()

    async def run(self, taken: Event) -> None:
        """Handle an item that `take` has returned."""
        handle, arguments = taken
        await await_or_execute(handle, *arguments)

    def describe(self) -> str:
        """Return a description of this client for a diagnostic message."""
        return f"the action client of {self._kind.names.name}"

    def destroy(self) -> None:
        """Destroy the client. A second call does nothing."""
        if self.handle.is_destroyed:
            return
        super().destroy()
        for end in self._ends.values():
            end.close()
        for close in self._closing:
            close()
        self._node.remove_waitable(self)

    def _answered(
        self,
        future: Future,
        response_class: Anything,
        data: bytes,
        handle: Callable[[Anything], Anything],
    ) -> None:
        try:
            response = decode(data, response_class)
        except InvalidMessage as error:
            self._node.get_logger().error(f"a response cannot be read: {error}")
            return
        result = handle(response)
        if not future.cancelled():
            # From now on the executor runs the done callbacks.
            future.set_executor(self._node.executor)
            future.set_result(result)

    def _goal_answered(self, goal_id: Anything, response: Anything) -> ClientGoalHandle:
        handle = ClientGoalHandle(self, goal_id, response)
        key = goal_key(goal_id)
        if handle.accepted:
            self._goal_handles[key] = handle
        else:
            self._feedback_callbacks.pop(key, None)
        with self._lock:
            # One step for `_take_feedback`, which from now on adds to the end of the queue: the
            # early feedback stays ahead of it.
            early = self._early.pop(key, ())
            if handle.accepted:
                self._waiting.extendleft((self._feedback, (data,)) for data in reversed(early))
        self.wake()
        return handle

    def _goal_ended(self, goal_handle: ClientGoalHandle, response: Anything) -> Anything:
        goal_handle.update_status(response.status)
        # Feedback that was published before the result has come before it.
        self._feedback_callbacks.pop(goal_key(goal_handle.goal_id), None)
        return response

    async def _feedback(self, data: bytes) -> None:
        callback = self._feedback_callbacks.get(data[GOAL_ID])
        if callback is not None:
            await await_or_execute(callback, decode(data, self._action_type.Impl.FeedbackMessage))

    def _update_states(self, data: bytes) -> None:
        states = read_states(data) or {}
        for key, handle in list(self._goal_handles.items()):
            if key in states:
                handle.update_status(states[key][2])


def _check_handle(goal_handle: object) -> None:
    if not isinstance(goal_handle, ClientGoalHandle):
        raise TypeError(f"Expected type ClientGoalHandle but received {type(goal_handle)}")
