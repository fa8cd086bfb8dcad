"""Watches the graph for the page: the goals of all actions, and the trails of turtles.

The server keeps the goals and trails, so that they survive a reload of the page and are the same in
every browser. Watching begins when the first page asks for the goals and trails, and continues
until the bridge is closed. Until a page asks, watching costs nothing.

A page calls the services below. Like the services of rosapi, they exist only for web clients:

- ``/turtleact/web/watch`` returns the changes after a revision. If nothing has changed, the service
  waits for up to `PATIENCE` seconds. The page calls the service again after each answer. A slow
  page therefore calls less often, and no changes pile up for that page.
- ``/turtleact/web/form`` describes the fields of an action's type.
- ``/turtleact/web/clear_trails`` erases the trails.
- ``/turtleact/web/set_paused`` pauses or resumes a goal.

This module follows goals as any other client would: it attaches to a goal when the goal appears on
its action's status topic.
"""

from __future__ import annotations

import math
import secrets
import time
from collections.abc import Awaitable, Callable
from typing import Any, Final, TypeAlias

import anyio

from turtleact.errors import TurtleactError, UnknownGoal, UnknownInterface
from turtleact.goals.client import (
    ActionClient,
    ClientGoalHandle,
    Event,
    FeedbackReceived,
    ResultReceived,
    StatusChanged,
)
from turtleact.goals.server import new_goal_id
from turtleact.goals.state import GoalStatus, status_of
from turtleact.goals.wire import PausedGoals, paused_topic
from turtleact.interfaces import Message, nanoseconds
from turtleact.interfaces.standard import GoalStatusArray
from turtleact.names import resolve_name
from turtleact.node import Node
from turtleact.node.topics import Subscription
from turtleact.sim.world_services import Poses
from turtleact.tasks import Background, current_tasks
from turtleact.transports import QoS
from turtleact.transports.base import STATUS_QOS
from turtleact.web.name_lookup import class_of_action, message_class
from turtleact.web.page_history import REJECTED, GoalHistory, GoalRecord, Pen, PenTrails
from turtleact.web.page_values import Plain, excerpt, form, hues

__all__ = [
    "MOST_FOLLOWED",
    "MOST_TURTLES",
    "PACE",
    "PATIENCE",
    "OpenClient",
    "Watch",
]

PACE: Final = 0.1
"""The shortest time between two answers with changes to a page (s)."""

PATIENCE: Final = 1.0
"""The longest time until a page gets an answer (s). Each answer tells the page the graph's time."""

REACHED_WITHIN: Final = 5.0
"""How long to try to reach the server of a goal (s, by the graph's clock)."""

MOST_FOLLOWED: Final = 256
"""The maximum number of goals that are followed at a time.

For goals beyond this number, only the status is known."""

MOST_TURTLES: Final = 64
"""The maximum number of turtles whose poses are followed."""

STATUSES_QOS: Final = QoS(depth=8, durability="transient_local")
"""The QoS of subscriptions to status topics.

The depth is above 1, because an action such as ``/fibonacci`` has several types, and the server of
each type publishes its own statuses on the same topic."""

FORGOTTEN: Final = "its server has forgotten it"

WATCH: Final = "/turtleact/web/watch"
POSE: Final = "/pose"
POSE_TYPES: Final = frozenset({"turtlesim/msg/Pose", "turtlesim_msgs/msg/Pose"})

Values: TypeAlias = dict[str, Any]
Client: TypeAlias = ActionClient[Message, Message, Message]
Handle: TypeAlias = ClientGoalHandle[Message, Message]
AnyEvent: TypeAlias = Event[Message, Message]


OpenClient: TypeAlias = Callable[[str, Any], Client]
"""A function that opens a client of an action, or returns the open one, for a name and a type."""


class Watch:
    """Watches a graph for the pages of a bridge.

    Args:
        node: A node on the graph.
        open_client: Opens the action clients that follow goals.

    Attributes:
        history: The goals of all watched actions.
        trails: The trails of all watched turtles.
    """

    def __init__(self, node: Node, open_client: OpenClient) -> None:
        self._node = node
        self._open_client = open_client
        self._tasks = current_tasks()
        self._changed = self._tasks.signal()
        self._revision = 0
        self._session = secrets.token_hex(4)
        self.history = GoalHistory(self._revise)
        self.trails = PenTrails(self._revise)
        self._looked_at = -math.inf
        self._graph: Values = {}
        self._graph_revision = 0
        self._actions: dict[tuple[str, str], _Action] = {}
        self._poses: dict[str, Subscription[Any]] = {}
        self._places: dict[str, tuple[float, float, float]] = {}
        self._locating: Background | None = None
        self._following: dict[str, Background] = {}
        self._handles: dict[str, Handle] = {}
        self._requests: dict[str, Plain] = {}
        self._services: dict[str, Callable[[Values], Awaitable[Values]]] = {
            WATCH: self._watch,
            "/turtleact/web/form": self._form,
            "/turtleact/web/clear_trails": self._clear_trails,
            "/turtleact/web/set_paused": self._set_paused,
        }

    @property
    def is_watching(self) -> bool:
        """Whether watching has begun, because a page has asked for changes."""
        return self._looked_at > -math.inf

    async def call(self, service: str, args: Any) -> Values | None:  # noqa: ANN401  # of the page
        """Return the response of a service under ``/turtleact/web/``; None for any other service.

        Raises:
            TurtleactError: if a type is not known, or if a goal to pause or to resume is not
                followed.
        """
        answer = self._services.get(service)
        return None if answer is None else await answer(args or {})

    # called by other parts of the bridge

    async def wait_until_told(self) -> None:
        """If followed goals have ended, wait until the history has recorded their ends.

        Cancelling: safe.
        """
        while any(map(self._is_late, self._handles)):
            await self._changed.wait()

    def last_news(self, service: str, args: Any) -> Values | None:  # noqa: ANN401  # of the page
        """Return the changes for a waiting call of ``watch`` that must be answered now.

        Return None if the call is of another service.
        """
        return self._news(self._since(args or {})) if service == WATCH else None

    def _since(self, args: Values) -> int:
        """Return the revision that a page knows; 0 if that is from another session."""
        return int(args.get("since", 0)) if args.get("session") == self._session else 0

    def note_request(self, goal_id: bytes, request: Message) -> None:
        """Record a web client's goal message, because remote servers do not publish it."""
        if not self.is_watching:
            return
        record = self.history.find(goal_id.hex())
        if record is not None:
            record.request = excerpt(request)
            self.history.change(record)
            return
        self._requests[goal_id.hex()] = excerpt(request)

    def note_rejection(self, action: tuple[str, str], request: Message, reason: str) -> None:
        """Record that a goal of a web client was rejected.

        Args:
            action: The name and the type of the action.
            request: The goal message.
            reason: Why the goal was rejected.
        """
        if self.is_watching:
            record = GoalRecord(new_goal_id().hex(), *action, self._now(), time.time())
            record.request, record.reason = excerpt(request), reason
            self.history.end(record, REJECTED)

    def note_call(self, service: str, request: Any) -> None:  # noqa: ANN401  # any request
        """Update the trails if a web client has called a service that changes the drawing."""
        if service == "/reset":
            self.trails.reset()
        elif service == "/clear":
            self.trails.clear()
        elif service.endswith("/set_pen") and hasattr(request, "width"):
            colour = f"#{request.r:02x}{request.g:02x}{request.b:02x}"
            pen = Pen(colour, request.width, is_off=bool(request.off))
            self.trails.set_pen(service.removesuffix("/set_pen").removeprefix("/"), pen)

    async def aclose(self) -> None:
        """Stop watching."""
        if self._locating is not None:
            await self._locating.aclose()
        # A copy, because each task removes itself from the dict when it ends.
        for following in list(self._following.values()):
            await following.aclose()
        for action in self._actions.values():
            await action.aclose()
        for subscription in self._poses.values():
            subscription.close()

    # the services

    async def _watch(self, args: Values) -> Values:
        """Return the changes after the revision ``since``.

        If nothing has changed, wait for up to `PATIENCE` seconds. If the revision is 0 or comes
        from another session, return everything without waiting.
        """
        since = self._since(args)
        self._look()
        if since == 0:
            return self._news(0)
        # Having waited for a change, this waits `PACE` more, so that changes that come together are
        # told together. If nothing changes, the page gets empty news and asks again, which also
        # makes the bridge look at the graph.
        with anyio.move_on_after(PATIENCE):
            while self._revision <= since:
                await self._changed.wait()
            await anyio.sleep(PACE)
        return self._news(since)

    def _news(self, since: int) -> Values:
        changes = self.history.since(since)
        if since and not changes.is_complete:
            return self._news(0)
        trails = self.trails.since(since)
        news = {
            "session": self._session,
            "revision": self._revision,
            "is_whole": since == 0,
            "now": self._now(),
            "goals": [record.told() for record in changes.goals],
            "dropped": changes.dropped,
            "trails": trails,
            # In a paused world, a page hears no pose from the topics.
            "poses": {name: self._places[name] for name in trails if name in self._places},
        }
        return news if self._graph_revision <= since else {**news, "graph": self._graph}

    async def _form(self, args: Values) -> Values:
        return form(class_of_action(self._node, resolve_name(args["action"]), args["type"]))

    async def _clear_trails(self, _args: Values) -> Values:
        self.trails.clear()
        return {}

    async def _set_paused(self, args: Values) -> Values:
        """Pause the goal with the id ``id`` if ``is_paused`` is true; resume it otherwise."""
        handle = self._handles.get(str(args.get("id")))
        if handle is None:
            raise TurtleactError("nobody follows such a goal")
        await (handle.pause() if args.get("is_paused", True) else handle.resume())
        return {}

    # looking around

    def _look(self) -> None:
        """Update the watched actions and turtles from the graph.

        Do nothing if the last update was less than `PATIENCE` seconds ago.
        """
        now = anyio.current_time()
        if now - self._looked_at < PATIENCE:
            return
        self._looked_at = now
        graph, poses = self._node.graph(), self._published_poses()
        seen: Values = {
            "nodes": list(graph.nodes),
            "topics": {name: types[0] for name, types in graph.topics.items()},
            "services": {name: types[0] for name, types in graph.services.items()},
            "actions": {name: types[0] for name, types in graph.actions.items()},
            "poses": poses,
            "hues": hues(poses),
        }
        if seen != self._graph:
            self._graph, self._graph_revision = seen, self._revise()
        self._look_for_actions(seen["actions"])
        self._look_for_turtles(seen["poses"])

    def _look_for_actions(self, served: dict[str, str]) -> None:
        for key in self._actions.keys() - served.items():
            action = self._actions.pop(key)
            action.leave()
            self._lose(action.known, "its server has gone")
        for key in served.items():
            if key not in self._actions:
                self._actions[key] = _Action(
                    self._node, key, self._take_statuses, self._take_paused
                )

    def _published_poses(self) -> dict[str, str]:
        """Return the topics on which turtles publish their poses, and the types of these topics."""
        # Topics of turtles that are gone are left out: they stay on the graph as long as somebody
        # reads them, and the bridge does.
        return {
            each.name: each.type_name
            for each in self._node.transport.endpoints()
            if each.kind == "publisher"
            and each.type_name in POSE_TYPES
            and each.name.endswith(POSE)
        }

    def _look_for_turtles(self, found: dict[str, str]) -> None:
        for topic in self._poses.keys() - found.keys():
            self._poses.pop(topic).close()
            self._places.pop(_turtle(topic), None)
            self.trails.lift(_turtle(topic))
        for topic, type in found.items():
            if topic not in self._poses and len(self._poses) < MOST_TURTLES:
                self._follow_turtle(topic, message_class(type))
        is_idle = self._locating is None or self._locating.has_ended
        if is_idle and not self._places.keys() >= {_turtle(topic) for topic in self._poses}:
            self._locating = Background(self._locate(), "looking for turtles")

    async def _locate(self) -> None:
        """Learn where the turtles of a world are. While it is paused, they publish no poses."""
        for topic, type in self._graph["topics"].items():
            if type == Poses.type_name:
                subscription = self._node.subscription(Poses, topic, QoS(depth=1))
                try:
                    poses = await anext(subscription)
                finally:
                    subscription.close()
                for name, *place in zip(poses.names, poses.x, poses.y, poses.theta, strict=True):
                    if f"/{name}{POSE}" in self._poses:
                        self._move(name, *place)

    def _move(self, name: str, x: float, y: float, theta: float) -> None:
        self._places[name] = x, y, theta
        self.trails.follow(name, x, y)

    def _follow_turtle(self, topic: str, pose_type: type[Message]) -> None:
        name = _turtle(topic)

        def take(pose: Any) -> bool:  # noqa: ANN401  # of either package
            self._move(name, pose.x, pose.y, pose.theta)
            return True

        subscription: Subscription[Any] = self._node.subscription(pose_type, topic, QoS(depth=1))
        subscription.taker = take
        self._poses[topic] = subscription

    # goals

    def _take_statuses(
        self, action: tuple[str, str], message: GoalStatusArray, known: set[str]
    ) -> set[str]:
        """Record the statuses in a status message of an action, and return the ids of its goals.

        Args:
            action: The name and the type of the action.
            message: The status message.
            known: The goal ids in the previous status message. If the history has dropped one of
                these goals, the goal is not recorded again.
        """
        told: set[str] = set()
        for each in message.status_list:
            id = bytes(each.goal_info.goal_id.uuid).hex()
            told.add(id)
            record, status = self.history.find(id), status_of(each.status)
            # The history is bounded. A goal that it has dropped is still in the server's messages,
            # and would come back as new with each of them.
            if record is None and id in known:
                continue
            if record is None:
                stamp = nanoseconds(each.goal_info.stamp) / 1e9
                record = self._new_record(id, action, stamp, status)
            elif record.status == GoalStatus.UNKNOWN.name and status.is_active:
                record.has_ended, record.reason = False, ""  # its server is back
                self._set_status(record, status)
            elif record.has_ended or id in self._following:
                continue
            elif record.status != status.name:
                self._set_status(record, status)
            else:
                continue
            self._follow_goal(record)
        self._lose(known - told, FORGOTTEN)
        return told

    def _take_paused(self, known: set[str], paused: frozenset[str]) -> None:
        """Record which goals of an action are paused."""
        for id in known | paused:
            record = self.history.find(id)
            if record is not None and not record.has_ended and record.is_paused != (id in paused):
                record.is_paused = id in paused
                self.history.change(record)

    def _lose(self, ids: set[str], reason: str) -> None:
        """Record these goals as ended with the status UNKNOWN.

        Skip goals that are followed or have already ended.
        """
        for id in ids - self._following.keys():
            record = self.history.find(id)
            if record is not None:
                self._lose_one(record, reason)

    def _lose_one(self, record: GoalRecord, reason: str) -> None:
        if not record.has_ended:
            record.reason = reason
            self.history.end(record, GoalStatus.UNKNOWN.name, self._now())

    def _new_record(
        self, id: str, action: tuple[str, str], stamp: float, status: GoalStatus
    ) -> GoalRecord:
        # The server's clock may be ahead, for example if the world here was paused.
        now = self._now()
        accepted = min(stamp, now)
        record = GoalRecord(id, *action, accepted, time.time() - (now - accepted), status.name)
        record.request = self._requests.pop(id, None)
        record.has_ended = status.is_terminal
        self.history.change(record)
        return record

    def _set_status(self, record: GoalRecord, status: GoalStatus) -> None:
        if status.is_terminal:
            self.history.end(record, status.name, self._now())
        else:
            record.status = status.name
            self.history.change(record)

    def _follow_goal(self, record: GoalRecord) -> None:
        # Too many goals are not followed: their states come with the status topic, but no feedback.
        if record.id not in self._following and len(self._following) < MOST_FOLLOWED:
            self._following[record.id] = Background(
                self._follow(record), f"the watch of goal {record.id}"
            )

    async def _follow(self, record: GoalRecord) -> None:
        """Follow a goal to its end, with the first type of its action whose server knows it."""
        errors: list[TurtleactError] = []
        try:
            for type in self._node.graph().actions.get(record.action, (record.type,)):
                try:
                    await self._follow_as(record, type)
                except TurtleactError as error:
                    errors.append(error)
                else:
                    return
            if not any(isinstance(each, UnknownInterface) for each in errors):
                reasons = [str(each) for each in errors if not isinstance(each, UnknownGoal)]
                self._lose_one(record, reasons[0] if reasons else FORGOTTEN)
        finally:
            del self._following[record.id]

    async def _follow_as(self, record: GoalRecord, type: str) -> None:
        action_type = class_of_action(self._node, record.action, type)
        client = self._open_client(record.action, action_type)
        # A client that was opened just now may need a moment until it can reach a server in another
        # process.
        await client.wait_for_server(REACHED_WITHIN)
        handle = await client.attach(bytes.fromhex(record.id))
        record.type = type
        await self._read(record, handle, is_late=record.has_ended)

    async def _read(self, record: GoalRecord, handle: Handle, *, is_late: bool) -> None:
        if record.request is None and handle.request is not None:
            record.request = excerpt(handle.request)
        record.is_resumed = handle.is_resumed
        self.history.change(record)
        self._handles[record.id] = handle
        try:
            async for event in handle.events():
                self._take_event(record, event, is_late=is_late)
        finally:
            del self._handles[record.id]

    def _take_event(self, record: GoalRecord, event: AnyEvent, *, is_late: bool) -> None:
        match event:
            case FeedbackReceived(feedback=feedback):
                record.take(feedback, self._now())
                self.history.change(record)
            case StatusChanged(status=status) if not status.is_terminal:
                record.status = status.name
                self.history.change(record)
            case ResultReceived(outcome=outcome):
                record.result, record.reason = excerpt(outcome.result), outcome.reason
                now = None if is_late else self._now()
                self.history.end(record, outcome.status.name, now)

    def _is_late(self, id: str) -> bool:
        """Whether a followed goal has ended, but the history has not recorded its end yet."""
        record = self.history.find(id)
        has_ended = record is None or record.has_ended
        return not has_ended and self._handles[id].status.is_terminal

    def _revise(self) -> int:
        self._revision += 1
        self._changed.fire()
        return self._revision

    def _now(self) -> float:
        return self._node.clock.now() / 1e9


class _Action:
    """Subscribes to the status of an action's goals.

    Args:
        node: The node that subscribes.
        key: The action's name and type.
        take: Called with ``key``, each status message, and the goal ids in the previous message.
            Returns the goal ids in the new message.
        take_paused: Called with `known` and the ids of the paused goals.

    Attributes:
        known: The goal ids in the last status message.
    """

    def __init__(
        self,
        node: Node,
        key: tuple[str, str],
        take: Callable[[tuple[str, str], GoalStatusArray, set[str]], set[str]],
        take_paused: Callable[[set[str], frozenset[str]], None],
    ) -> None:
        self.known: set[str] = set()
        self._key = key
        self._take = take
        self._take_paused = take_paused
        self._told_paused: frozenset[str] = frozenset()
        self._paused = node.subscription(PausedGoals, paused_topic(key[0]), STATUS_QOS)
        self._paused.taker = self._hear_paused
        topic = f"{key[0]}/_action/status"
        self._statuses = node.subscription(GoalStatusArray, topic, STATUSES_QOS)
        self._reading = Background(self._read(), f"the watch of {key[0]}")

    def leave(self) -> None:
        """Close the subscriptions, but do not wait for the end of the task that reads them."""
        self._statuses.close()
        self._paused.close()

    async def aclose(self) -> None:
        """Close the subscriptions, and wait for the end of the task that reads them."""
        self.leave()
        await self._reading.aclose()

    def _hear_paused(self, message: PausedGoals) -> bool:
        self._told_paused = frozenset(bytes(each.uuid).hex() for each in message.goal_ids)
        self._take_paused(self.known, self._told_paused)
        return True

    async def _read(self) -> None:
        # Each message has all goals of one server. Only the newest messages are kept, so under load
        # some are skipped.
        async for message in self._statuses:
            self.known = self._take(self._key, message, self.known)
            self._take_paused(self.known, self._told_paused)


def _turtle(topic: str) -> str:
    """Return the name of the turtle that publishes its pose to a topic."""
    return topic.removesuffix(POSE).removeprefix("/")
