"""Watches the graph for the page: the goals of all actions, and the trails of turtles.

The server keeps all of this, so that it survives a reload and is the same in every browser.
Watching begins when the first page asks, and continues until the bridge is closed. For programs
that only use rosbridge, it costs nothing.

A page asks by calling services that only web clients can call, like those of rosapi:

- ``/turtleact/web/watch`` answers with the news after a revision, and waits if there is none. A
  slow page therefore asks less often, and nothing piles up for it.
- ``/turtleact/web/form`` describes an action's type.
- ``/turtleact/web/clear_trails`` erases the trails.
- ``/turtleact/web/set_paused`` pauses or resumes a goal.

Each goal is followed as any other client would follow it: this module attaches to the goal when it
appears on its action's status topic.
"""

from __future__ import annotations

import math
import secrets
import time
from collections.abc import Awaitable, Callable
from contextlib import AbstractAsyncContextManager
from typing import Any, Final, Protocol, TypeAlias

import anyio

from turtleact.client import (
    ActionClient,
    ClientGoalHandle,
    Event,
    FeedbackReceived,
    ResultReceived,
    StatusChanged,
)
from turtleact.errors import InvalidMessage, TurtleactError, UnknownGoal, UnknownInterface
from turtleact.goal import GoalStatus, status_of
from turtleact.goal_id import new_goal_id
from turtleact.goal_wire import PausedGoals, paused_topic
from turtleact.interfaces import Message, nanoseconds
from turtleact.interfaces.standard import GoalStatusArray
from turtleact.node import Node
from turtleact.tasks import Background, current_tasks
from turtleact.topics import Subscription
from turtleact.transports import QoS
from turtleact.transports.base import STATUS_QOS
from turtleact.web.goal_history import REJECTED, GoalHistory, GoalRecord
from turtleact.web.name_lookup import action_class, message_class
from turtleact.web.page_values import Plain, excerpt, form
from turtleact.web.pen_trails import Pen, PenTrails

__all__ = [
    "MOST_ACTIONS",
    "MOST_FOLLOWED",
    "MOST_TURTLES",
    "PACE",
    "PATIENCE",
    "OpenClient",
    "Watch",
]

PACE: Final = 0.1
"""A page gets news at most once per this time (s)."""

PATIENCE: Final = 1.0
"""A page gets an answer at least once per this time (s), so that it knows the time."""

REACHED_WITHIN: Final = 5.0
"""How long to try to reach the server of a goal (s, by the graph's clock)."""

MOST_ACTIONS: Final = 200
"""At most this many actions are watched."""

MOST_FOLLOWED: Final = 256
"""At most this many goals are followed at a time. Of all other goals, only the status is known."""

MOST_TURTLES: Final = 64
"""The trails of at most this many turtles are kept."""

MOST_REQUESTS: Final = 64
"""The maximum number of goals that were sent but have no status yet."""

FORGOTTEN: Final = "its server has forgotten it"

SERVICES: Final = "/turtleact/web/"
POSE: Final = "/pose"
POSE_TYPES: Final = frozenset({"turtlesim/msg/Pose", "turtlesim_msgs/msg/Pose"})

Values: TypeAlias = dict[str, Any]
Client: TypeAlias = ActionClient[Message, Message, Message]
AnyEvent: TypeAlias = Event[Message, Message]


class OpenClient(Protocol):
    """A function that opens a client of an action, or shares an open one."""

    def __call__(self, name: str, action_type: Any) -> AbstractAsyncContextManager[Client]:  # noqa: ANN401  # any action
        """Give a block the client of the action with a name and type."""


class Watch:
    """Watches a graph for the pages of a bridge.

    Args:
        node: A node of the graph.
        open_client: Opens the clients that follow goals.

    Attributes:
        history: The goals.
        trails: The trails.
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
        self._following: dict[str, Background] = {}
        self._handles: dict[str, ClientGoalHandle[Message, Message]] = {}
        self._requests: dict[str, Plain] = {}
        self._services: dict[str, Callable[[Values], Awaitable[Values]]] = {
            "watch": self._watch,
            "form": _form,
            "clear_trails": self._clear_trails,
            "set_paused": self._set_paused,
        }

    @property
    def is_watching(self) -> bool:
        """Whether a page has asked for news, so that watching has begun."""
        return self._looked_at > -math.inf

    async def call(self, service: str, args: object) -> Values | None:
        """Return the values of a response; None if the service is not for pages.

        Raises:
            InvalidMessage: if an argument does not fit.
            TurtleactError: if a type is not known.
        """
        name = f"/{service.removeprefix('/')}"
        answer = self._services.get(name.removeprefix(SERVICES)) if SERVICES in name else None
        if answer is None:
            return None
        if args is not None and not isinstance(args, dict):
            raise InvalidMessage("args", "expected an object")
        return await answer(args or {})

    # called by other parts of the bridge

    def note_request(self, goal_id: bytes, request: Message) -> None:
        """Record the message of a web client's goal, because a remote server does not send it."""
        if not self.is_watching:
            return
        record = self.history.find(goal_id.hex())
        if record is not None:
            record.request = excerpt(request)
            self.history.change(record)
            return
        self._requests[goal_id.hex()] = excerpt(request)
        if len(self._requests) > MOST_REQUESTS:
            del self._requests[next(iter(self._requests))]

    def note_rejection(self, action: tuple[str, str], request: Message, reason: str) -> None:
        """Record that a goal of a web client was rejected.

        Args:
            action: The name and the type of the action.
            request: The goal.
            reason: Why the goal was rejected.
        """
        if self.is_watching:
            record = GoalRecord(new_goal_id().hex(), *action, accepted=self._now(), at=time.time())
            record.request, record.reason = excerpt(request), reason
            self.history.end(record, REJECTED)

    def note_call(self, service: str, request: Any) -> None:  # noqa: ANN401  # any request
        """Note that a web client has called a service, because some services change the drawing."""
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
        # A copy, because each task removes itself from the dict when it ends.
        for following in list(self._following.values()):
            await following.aclose()
        for action in self._actions.values():
            await action.aclose()
        for subscription in self._poses.values():
            subscription.close()

    # the services

    async def _watch(self, args: Values) -> Values:
        """Return the news after a revision.

        If the revision is 0 or from another session, return everything.
        """
        since = args.get("since", 0)
        if not isinstance(since, int):
            raise InvalidMessage("args.since", "expected a whole number")
        self._look()
        if since == 0 or args.get("session") != self._session:
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
        news = {
            "session": self._session,
            "revision": self._revision,
            "is_whole": since == 0,
            "now": self._now(),
            "goals": [record.told() for record in changes.goals],
            "dropped": changes.dropped,
            "trails": self.trails.since(since),
        }
        return news if self._graph_revision <= since else {**news, "graph": self._graph}

    async def _clear_trails(self, _args: Values) -> Values:
        self.trails.clear()
        return {}

    async def _set_paused(self, args: Values) -> Values:
        """Pause or resume the goal with the id ``id``, as ``is_paused`` says."""
        handle = self._handles.get(str(args.get("id")))
        if handle is None:
            raise TurtleactError("nobody follows such a goal")
        await (handle.pause() if args.get("is_paused", True) else handle.resume())
        return {}

    # looking around

    def _look(self) -> None:
        """Follow new actions and turtles on the graph, unless the last look was a moment ago."""
        now = anyio.current_time()
        if now - self._looked_at < PATIENCE:
            return
        self._looked_at = now
        graph = self._node.graph()
        seen: Values = {
            "nodes": list(graph.nodes),
            "topics": {name: types[0] for name, types in graph.topics.items()},
            "services": {name: types[0] for name, types in graph.services.items()},
            "actions": {name: types[0] for name, types in graph.actions.items()},
            "poses": self._published_poses(),
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
            if key not in self._actions and len(self._actions) < MOST_ACTIONS:
                self._actions[key] = _Action(
                    self._node, key, self._take_statuses, self._take_paused
                )

    def _published_poses(self) -> dict[str, str]:
        """The topics on which turtles publish their poses, with their types."""
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
            self.trails.lift(_turtle(topic))
        for topic, type in found.items():
            if topic not in self._poses and len(self._poses) < MOST_TURTLES:
                self._follow_turtle(topic, message_class(type))

    def _follow_turtle(self, topic: str, pose_type: type[Message]) -> None:
        name, follow = _turtle(topic), self.trails.follow

        def take(pose: Any) -> bool:  # noqa: ANN401  # of either package
            follow(name, pose.x, pose.y)
            return True

        subscription: Subscription[Any] = self._node.subscription(pose_type, topic, QoS(depth=1))
        subscription.taker = take
        self._poses[topic] = subscription

    # goals

    def _take_statuses(
        self, action: tuple[str, str], message: GoalStatusArray, known: set[str]
    ) -> set[str]:
        """Take a status message of an action's goals, and return the goals' ids.

        Args:
            action: The name and the type of the action.
            message: The status message.
            known: The ids in the message before. Goals that the history has dropped are not taken
                up again.
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
        """Record which of the known goals of an action are paused."""
        for id in known | paused:
            record = self.history.find(id)
            if record is not None and not record.has_ended and record.is_paused != (id in paused):
                record.is_paused = id in paused
                self.history.change(record)

    def _lose(self, ids: set[str], reason: str) -> None:
        """End these goals as UNKNOWN, except those that are followed or have ended."""
        for id in ids - self._following.keys():
            record = self.history.find(id)
            if record is not None and not record.has_ended:
                record.reason = reason
                self.history.end(record, GoalStatus.UNKNOWN.name, self._now())

    def _new_record(
        self, id: str, action: tuple[str, str], stamp: float, status: GoalStatus
    ) -> GoalRecord:
        age = max(0.0, self._now() - stamp)
        record = GoalRecord(id, *action, accepted=stamp, at=time.time() - age)
        record.request = self._requests.pop(id, None)
        record.status = status.name
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
        """Follow a goal to its end."""
        try:
            await self._read(record, is_late=record.has_ended)
        except UnknownInterface:
            pass  # only its status can be known
        except UnknownGoal:
            if not record.has_ended:
                record.reason = FORGOTTEN
                self.history.end(record, GoalStatus.UNKNOWN.name, self._now())
        except TurtleactError as error:
            record.reason = str(error)
            self.history.end(record, GoalStatus.UNKNOWN.name, self._now())
        finally:
            del self._following[record.id]

    async def _read(self, record: GoalRecord, *, is_late: bool) -> None:
        async with self._open_client(record.action, action_class(record.type)) as client:
            # A client that was opened just now may need a moment until it can reach a server in
            # another process.
            await client.wait_for_server(REACHED_WITHIN)
            handle = await client.attach(bytes.fromhex(record.id))
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

    def _revise(self) -> int:
        self._revision += 1
        self._changed.fire()
        return self._revision

    def _now(self) -> float:
        return self._node.clock.now() / 1e9


class _Action:
    """An action with goals that are watched.

    Args:
        node: The node that subscribes to its status.
        key: Its name and type.
        take: Called with each status message and the ids in the message before. Returns the new
            ids.
        take_paused: Called with the known ids and the ids of the paused goals.

    Attributes:
        known: The ids in the last status message.
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
        self._statuses = node.subscription(GoalStatusArray, topic, STATUS_QOS)
        self._reading = Background(self._read(), f"the watch of {key[0]}")

    def leave(self) -> None:
        """Stop watching soon."""
        self._statuses.close()
        self._paused.close()

    async def aclose(self) -> None:
        """Stop watching."""
        self.leave()
        await self._reading.aclose()

    def _hear_paused(self, message: PausedGoals) -> bool:
        self._told_paused = frozenset(bytes(each.uuid).hex() for each in message.goal_ids)
        self._take_paused(self.known, self._told_paused)
        return True

    async def _read(self) -> None:
        # Only the newest message is kept, as each has all goals: under load, some are skipped.
        async for message in self._statuses:
            self.known = self._take(self._key, message, self.known)
            self._take_paused(self.known, self._told_paused)


async def _form(args: Values) -> Values:
    wanted = args.get("type")
    if not isinstance(wanted, str):
        raise InvalidMessage("args.type", "expected text")
    return form(action_class(wanted))


def _turtle(topic: str) -> str:
    """The name of the turtle that publishes to a topic."""
    return topic.removesuffix(POSE).removeprefix("/")
