"""Holds what all clients of a bridge share: the node, topics, goals and services.

- All clients that read a topic share one subscription, and each frame is made once (`TopicHub`). A
  latched topic gets a new subscription for each client, because only a new subscription gets the
  messages that the publishers keep.
- The node's service clients and action clients stay open, so that the next web client can use them.
- `Goals` follows each goal until the goal ends. A goal continues when its web client disconnects,
  unless ``cancel_on_disconnect`` is set.
- A web client may cancel a goal that another web client has sent. Web clients choose the ids of
  their goals themselves, so several of them may choose the same id. A request to cancel a goal
  applies to the client's own goal with the given id. If the client has no goal with that id, the
  request applies to another client's goal with that id, provided that only one such goal exists. If
  the action server has not accepted the goal yet, the goal is canceled once it is accepted.

Source: rosbridge_library ``capabilities/action_*.py``; its issues 1003, 1013, 1139 and 1152.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol, TypeAlias, TypeVar, cast

import msgspec

from turtleact.errors import GoalRejected, ServerUnavailable, TurtleactError
from turtleact.goals.body import ActionType
from turtleact.goals.client import ActionClient, ClientGoalHandle
from turtleact.goals.server import new_goal_id
from turtleact.goals.wire import GoalMetadata
from turtleact.interfaces import Message
from turtleact.names import resolve_name
from turtleact.node import Node
from turtleact.node.services import ServiceClient, ServiceType
from turtleact.node.topics import Subscription
from turtleact.tasks import Background, current_tasks
from turtleact.transports import QoS
from turtleact.transports.base import REQUEST_NOTE
from turtleact.web.message_conversion import Rendering, json_values, read_message, reply
from turtleact.web.name_lookup import Directory, class_of_action
from turtleact.web.operations import CallService, CancelActionGoal, Id, SendActionGoal
from turtleact.web.rosapi import Parameters, Rosapi
from turtleact.web.watching import Watch

__all__ = [
    "BridgeState",
    "Deliver",
    "Feed",
    "GoalClient",
    "Goals",
    "Limits",
    "TopicHub",
]

Req = TypeVar("Req", bound=Message)
Res = TypeVar("Res", bound=Message)

ANSWER: Final = 5.0
"""How long to wait for a node's answer about its parameters (s)."""

Deliver: TypeAlias = Callable[[Rendering], None]

DEPTH = 32
"""How many messages may wait for the task that hands them to all clients."""

NO_SERVER: Final = "No action server available"
CLOSING: Final = "The server is closing: you will not hear of this goal any more"
REJECTED: Final = "Action goal was rejected"


class Limits(msgspec.Struct, frozen=True):
    """Limits on what clients may use.

    Attributes:
        connections: How many clients may be connected.
        opened: How many subscriptions, advertisements, services and actions one client may have
            open.
        calls: How many service calls of one client may be under way.
        message_size: The maximum size of a message that a client sends (bytes).
        memory: How much may wait to be sent to one client (bytes). If the limit is exceeded, the
            client loses its oldest topic messages and feedback. If other messages exceed the limit,
            the client is disconnected.
    """

    connections: int = 100
    opened: int = 256
    calls: int = 256
    message_size: int = 10_000_000
    memory: int = 16_000_000


class BridgeState:
    """The objects that all connections of a bridge share.

    Args:
        node: The node through which the clients use the graph.
        limits: The limits on what clients may use.
        cancel_on_disconnect: Whether a client's goals are canceled when it disconnects.
    """

    def __init__(self, node: Node, limits: Limits, *, cancel_on_disconnect: bool) -> None:
        self.node = node
        self.limits = limits
        self.tasks = current_tasks()
        self.directory = Directory(node.transport)
        self.feeds = TopicHub(node, self.directory)
        self.goals = Goals(node, cancel_on_disconnect=cancel_on_disconnect)
        self.watch = self.goals.watch
        self.rosapi = Rosapi(node, self.directory, Parameters(node, self._ask))
        self._clients: dict[tuple[str, object], ServiceClient[Message, Message]] = {}

    async def call(self, said: CallService) -> object:
        """Call a service, and return the values of the response.

        The service may belong to rosapi, to the bridge's web page, or to a node on the graph.

        Raises:
            TurtleactError: if the call fails.
        """
        values = await self.rosapi.call(said.service, said.args)
        if values is None:
            values = await self.watch.call(said.service, said.args)
        if values is not None:
            return values
        name = resolve_name(said.service)
        service_type = self.directory.service_class(name, said.type or "")
        request = await read_message(service_type.Request, said.args, root="args")
        timeout = said.timeout if said.timeout is not None and said.timeout > 0 else None
        response = await self._ask(
            name, cast("ServiceType[Message, Message]", service_type), request, timeout
        )
        self.watch.note_call(name, request)
        return json_values(response)

    async def _ask(
        self,
        name: str,
        service_type: ServiceType[Req, Res],
        request: Req,
        timeout: float | None = ANSWER,
    ) -> Res:
        key = (name, service_type)
        client = self._clients.get(key)
        if client is None:
            client = self.node.service_client(service_type, name)
            self._clients[key] = client
        return cast("Res", await client.call(request, timeout))

    async def aclose(self) -> None:
        """Close everything that the connections share."""
        await self.watch.aclose()
        await self.goals.aclose()
        for client in self._clients.values():
            await client.aclose()


class Feed:
    """Delivers the messages of a topic to its readers.

    Args:
        subscription: A new subscription to the topic.
        reader: The first reader. It gets all messages of the subscription, including those that
            have already arrived.
        now: Returns the time (ns since the epoch).

    Attributes:
        readers: The functions to which each message is delivered.
    """

    def __init__(
        self, subscription: Subscription[Message], reader: Deliver, now: Callable[[], int]
    ) -> None:
        self.readers: list[Deliver] = [reader]
        self._subscription = subscription
        self._now = now
        self._reading = Background(self._read(), f"a reader of {subscription.topic}")

    async def aclose(self) -> None:
        """Close the subscription."""
        await self._subscription.aclose()
        await self._reading.aclose()

    async def _read(self) -> None:
        async for message in self._subscription:
            rendering = Rendering(message, self._now())
            # A copy, because a reader may leave while it is delivered to. The rendering is shared:
            # the message becomes JSON once, however many clients read the topic.
            for deliver in tuple(self.readers):
                deliver(rendering)


class TopicHub:
    """The subscriptions to the topics that clients read.

    Args:
        node: The node that subscribes to the topics.
        directory: Tells which topics are latched.
    """

    def __init__(self, node: Node, directory: Directory) -> None:
        self._node = node
        self._directory = directory
        self._shared: dict[tuple[str, type[Message]], Feed] = {}

    def join(self, topic: str, message_type: type[Message], deliver: Deliver) -> Feed:
        """Start to deliver a topic's messages to a reader.

        On a latched topic, the reader also gets the messages that the publishers have kept. Pass
        the returned feed to `leave`.

        Raises:
            TurtleactError: if the node is closed.
        """
        key = (topic, message_type)
        # A latched topic is not shared. Only a new subscription gets the kept messages, so each
        # client needs its own.
        is_latched = self._directory.is_latched(topic)
        feed = None if is_latched else self._shared.get(key)
        if feed is not None:
            feed.readers.append(deliver)
            return feed
        qos = QoS(depth=DEPTH, durability="transient_local" if is_latched else "volatile")
        subscription = self._node.subscription(message_type, topic, qos)
        feed = Feed(subscription, deliver, self._node.clock.now)
        if not is_latched:
            self._shared[key] = feed
        return feed

    async def leave(self, feed: Feed, deliver: Deliver) -> None:
        """Stop delivering messages to a reader. Close the feed if it has no other reader."""
        feed.readers.remove(deliver)
        if not feed.readers:
            # Before the await: a client that joins while this feed closes must open a new one.
            self._shared = {key: each for key, each in self._shared.items() if each is not feed}
            await feed.aclose()


class GoalClient(Protocol):
    """The part of a `Connection` that sends the frames about a goal to the client."""

    def keep(self, frame: str) -> None:
        """Queue a frame that must not be dropped."""

    def put(self, source: str, frame: str) -> None:
        """Queue a frame that may be dropped if the client reads too slowly."""


Client = ActionClient[Message, Message, Message]


class Goals:
    """Sends the goals of all clients of a bridge, and follows them.

    Args:
        node: The node that sends the goals.
        cancel_on_disconnect: Whether a client's goals are canceled when it disconnects.

    Attributes:
        watch: Records the goals that are sent or rejected, for the page.
    """

    def __init__(self, node: Node, *, cancel_on_disconnect: bool = False) -> None:
        self.watch = Watch(node, self.client)
        self._cancel_on_disconnect = cancel_on_disconnect
        self._node = node
        self._clients: dict[tuple[str, object], Client] = {}
        self._sent: dict[int, _Sent] = {}
        self._followed = current_tasks().signal()
        self._count = 0

    def __len__(self) -> int:
        return len(self._sent)

    def client(self, name: str, action_type: ActionType[Message, Message, Message]) -> Client:
        """Return a client of an action. It stays open until this object is closed."""
        key = (name, action_type)
        client = self._clients.get(key)
        if client is None:
            client = self._clients[key] = self._node.action_client(action_type, name)
        return client

    def send(self, said: SendActionGoal, teller: GoalClient) -> None:
        """Send a goal, and tell the web client the goal's feedback and result.

        If there is no result, the web client is told why.
        """
        if said.id is not None and self._own(said.id, teller) is not None:
            _tell_failure(
                said, teller, f"a goal of the id '{said.id}' is under way: use another id"
            )
        else:
            # Numbered by us: two clients may use one id, and one client an id again.
            self._count += 1
            sent = self._sent[self._count] = _Sent(self._count, said, teller)
            sent.following = Background(self._follow(sent), f"goal {said.id} of a web client")

    def cancel(self, said: CancelActionGoal, teller: GoalClient) -> str:
        """Cancel a goal. Return an empty string, or the reason why the goal cannot be canceled."""
        sent = self._own(said.id, teller)
        if sent is None:
            found = [each for each in self._sent.values() if each.said.id == said.id]
            if len(found) != 1:
                many = f"{len(found)} clients have sent" if found else "nobody has sent"
                return f"{many} a goal of the id '{said.id}' that is under way"
            sent = found[0]
        sent.cancel()
        return ""

    def lose(self, teller: GoalClient) -> None:
        """Stop telling a client about its goals, because the client has gone.

        If ``cancel_on_disconnect`` is set, also cancel the goals that the client has sent.
        """
        for sent in self._sent.values():
            if sent.teller is teller:
                sent.teller = None
                if self._cancel_on_disconnect:
                    sent.cancel()

    async def wait_until_told(self) -> None:
        """Wait until clients have the results of all goals that have ended. Cancelling: safe."""
        while any(sent.has_ended for sent in self._sent.values()):
            await self._followed.wait()

    def leave(self) -> None:
        """Tell all clients with goals under way that the results of these goals will not come."""
        # `is_over` keeps the end of the goal, should it still come, from being told after this.
        for sent in self._sent.values():
            sent.fail(CLOSING)
            sent.is_over = True

    async def aclose(self) -> None:
        """Stop following the goals. The goals themselves continue."""
        # A copy, because each task removes its goal from the dict when it ends. Goals that were
        # accepted go on, because they are detached.
        for sent in list(self._sent.values()):
            await sent.following.aclose()
        for client in self._clients.values():
            await client.aclose()

    def _own(self, id: Id, teller: GoalClient) -> _Sent | None:
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
        finally:
            del self._sent[sent.number]
            self._followed.fire()

    async def _run(self, sent: _Sent) -> None:
        said = sent.said
        if said.traceparent is not None:  # only in the context of this task
            note = GoalMetadata(traceparent=said.traceparent, tracestate=said.tracestate or "")
            REQUEST_NOTE.set(note.write())
        name = resolve_name(said.action)
        action_type = class_of_action(self._node, name, said.action_type)
        goal = await read_message(action_type.Goal, said.args, root="goal")
        client = self.client(name, cast("ActionType[Message, Message, Message]", action_type))
        on_feedback = sent.tell_feedback if said.feedback else None
        sending = client.send_goal(goal, goal_id=sent.goal_id, feedback_callback=on_feedback)
        try:
            async with sending as handle:
                self.watch.note_request(sent.goal_id, goal)
                # Detached: leaving this block, when the bridge closes, must not cancel the goal.
                handle.detach()
                sent.accept(handle)
                outcome = await handle.outcome()
                sent.tell("action_result", outcome.result, status=int(outcome.status), result=True)
        except GoalRejected as rejected:
            self.watch.note_rejection((name, action_type.type_name), goal, rejected.reason)
            raise


class _Sent:
    """A goal that a web client has sent.

    Attributes:
        number: A number that no other goal of the bridge has.
        said: The ``send_action_goal`` operation with which the client sent the goal.
        teller: Sends frames to the client; None after the client has gone.
        goal_id: The id of the goal on the graph (16 bytes).
        following: The task that follows the goal.
        is_over: Whether the client was told that no more frames about the goal will come.
    """

    following: Background

    def __init__(self, number: int, said: SendActionGoal, teller: GoalClient) -> None:
        self.number = number
        self.said = said
        self.teller: GoalClient | None = teller
        self.goal_id = new_goal_id()
        self.is_over = False
        self._handle: ClientGoalHandle[Message, Message] | None = None
        self._is_canceled = False

    @property
    def has_ended(self) -> bool:
        """Whether the goal's handle has received a final status."""
        return self._handle is not None and self._handle.status.is_terminal

    def accept(self, handle: ClientGoalHandle[Message, Message]) -> None:
        """Record that the server has accepted the goal.

        If the client has already asked to cancel the goal, cancel the goal now.
        """
        self._handle = handle
        if self._is_canceled:
            handle.cancel_nowait()

    def cancel(self) -> None:
        """Cancel the goal now or, if the server has not accepted it yet, once it is accepted."""
        # Without a handle the server has not answered yet: `accept` cancels it then.
        self._is_canceled = True
        if self._handle is not None:
            self._handle.cancel_nowait()

    def tell_feedback(self, feedback: Message) -> None:
        """Send a feedback message to the client that sent the goal."""
        self.tell("action_feedback", feedback)

    def tell(self, op: str, message: Message, **members: object) -> None:
        """Send a frame to the goal's client, unless the client has gone or `is_over` is true."""
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
        """Tell the goal's client why the goal has no result."""
        if self.teller is not None and not self.is_over:
            _tell_failure(self.said, self.teller, problem)


def _tell_failure(said: SendActionGoal, teller: GoalClient, problem: str) -> None:
    members = {"action": said.action, "values": problem, "status": 0, "result": False}
    teller.keep(reply("action_result", said.id, **members))
