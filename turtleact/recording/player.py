"""Plays a bag: publishes its messages again, and sends its goals again.

Messages are published at the intervals at which they were recorded, measured by the graph's clock.
Over a network, the bytes in the bag are sent without decoding them. Instead of publishing the
topics of an action, the player can send the action's goals again. These goals get new ids, because
a server may still hold the recorded goals and would then reject their ids.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Collection, Mapping
from contextlib import aclosing
from pathlib import Path
from typing import Any, Final, Literal, TypedDict, Unpack

import anyio
import anyio.to_thread
import msgspec

from turtleact.errors import InvalidInterface, InvalidOption, TurtleactError, UnknownInterface
from turtleact.goals.client import ActionClient, ClientGoalHandle
from turtleact.goals.state import GoalStatus
from turtleact.interfaces import Message, WireFormat, get_action, nanoseconds, stamp_of, type_hash
from turtleact.interfaces.standard.rosgraph_msgs.msg import Clock
from turtleact.names import resolve_name
from turtleact.node import Node, check_open
from turtleact.recording.bag import Bag, Reading, Recorded, reader_of
from turtleact.recording.metadata import Offer
from turtleact.recording.schemas import class_of
from turtleact.recording.selection import EVERYTHING, REQUESTS, Selection, owner_of, part_of
from turtleact.recording.storage import Channel, Range, in_nanoseconds
from turtleact.tasks import Background, current_tasks, thread_work
from turtleact.transports.base import Endpoint, Publication, QoS, RawFormat
from turtleact.transports.graph import SEND_GOAL

__all__ = ["PlayOptions", "Played", "play"]

PATIENCE: Final = 2.0
"""How long to wait until known readers can be reached (s)."""

TURN: Final = 32
"""After this many messages without a pause, other tasks get a turn."""

UNSENT: Final = (
    "not sent, because the recording does not have the goal itself; to record goals, serve the "
    "action with introspection 'contents'"
)
"""The reason why a goal is not sent if the recording has only the goal's acceptance."""

CLOCK: Final = "/clock"
"""The topic with the time, for nodes with ``use_sim_time``."""

Sender = Literal["service", "client"]


class PlayOptions(TypedDict, total=False):
    """The options of `play`."""

    rate: float | Literal["max"]
    loop: bool
    start_offset: float
    duration: float | None
    topics: Collection[str]
    selection: Selection
    remap: Mapping[str, str]
    send_goals: bool
    clock: float
    qos: Mapping[str, QoS]


class Played(msgspec.Struct):
    """The outcome of playing a bag.

    Attributes:
        messages: How many messages were published.
        goals: How many goals ended in each way. A key is a pair: the name of the action, and the
            goal's last state. For a goal that counts as failed, the second item is the
            reason.
        skipped: Why messages or goals could not be played, by the name of their topic or action.
        failed: How many goals could not be sent, were rejected, or have no known end. A failed
            goal is also counted in ``goals``, unless the goal's action is in ``skipped``.
    """

    messages: int = 0
    goals: Counter[tuple[str, str]] = msgspec.field(default_factory=Counter)
    skipped: dict[str, str] = {}
    failed: int = 0


async def play(node: Node, path: str | Path, **options: Unpack[PlayOptions]) -> Played:
    """Play a bag on a graph, until the bag ends.

    Cancelling: safe. `play` then cancels the goals that it has sent.

    Args:
        node: A node on the graph.
        path: The folder of the bag, or a single file.
        **options: ``rate`` is the speed relative to the recording. With "max", messages are
            published without pauses, even if the clock stands still. With ``loop``, playing starts
            over whenever the bag ends. Playing starts ``start_offset`` seconds after the bag's
            beginning and covers ``duration`` seconds. ``topics`` are the names of the topics to
            play; if left out, all topics are played. ``selection``, a `Selection`, replaces
            ``topics``. ``remap`` maps recorded names of topics and actions to new names. With
            ``send_goals``, the recorded goals and cancel requests are sent again, and `play` waits
            until the goals end; the topics of actions are then not published. ``clock`` is how
            often per second the time in the bag is published on ``/clock``; 0 for never. ``qos``
            maps recorded topic names to the quality of service to offer; other topics get their
            recorded quality of service.

    Raises:
        BagError: if there is no bag at ``path``, or if the bag is damaged.
        InvalidOption: if ``rate`` is neither a number above zero nor "max", or if ``start_offset``
            or ``duration`` is negative or above 1,000,000,000.
        TurtleactError: if the node is closed, or the caller runs in another event loop than the
            node.
        TypeError: if an option does not exist.
    """
    for unknown in options.keys() - PlayOptions.__annotations__.keys():
        raise TypeError(f"play has no option '{unknown}'")
    rate = options.get("rate", 1.0)
    if rate != "max" and not (isinstance(rate, int | float) and rate > 0):
        raise InvalidOption("rate", f"expected a number above zero or 'max', not {rate!r}")
    check_open(node)
    times = _times(options)
    bag = Bag(path)
    player = _Player(node, bag, options, times)
    failure: TurtleactError | None = None
    try:
        async with anyio.create_task_group() as goals:
            try:
                player.prepare(goals)
                await player.wait_for_readers()
                while True:
                    await player.run(None if rate == "max" else float(rate))
                    if not options.get("loop") or player.is_idle:
                        break
            except TurtleactError as error:  # the task group would wrap it
                failure = error
                goals.cancel_scope.cancel()
    finally:
        with anyio.CancelScope(shield=True):
            await player.aclose()
        bag.close()
    if failure is not None:
        raise failure
    return player.played


class _Player:
    """Plays one bag.

    Args:
        node: A node on the graph.
        bag: The bag.
        options: The options of `play`.
        times: The options ``start_offset`` and ``duration`` in nanoseconds. Without a duration, the
            bag is played to its end.
    """

    def __init__(
        self, node: Node, bag: Bag, options: PlayOptions, times: tuple[int, int | None]
    ) -> None:
        self.played = Played()
        self._node = node
        self._bag = bag
        self._remap = options.get("remap", {})
        self._selection = _selection(node, options)
        self._sends_goals = options.get("send_goals", False)
        offset, duration = times
        self._start = bag.info.start + offset
        self._end = None if duration is None else self._start + duration
        self._outlets: dict[str, Callable[[bytes], None]] = {}
        self._publications: dict[str, Publication] = {}
        self._goals: _GoalSender | None = None
        self._frequency = options.get("clock", 0.0)
        self._qos = options.get("qos", {})
        self._clock: Publication | None = None

    def prepare(self, tasks: anyio.abc.TaskGroup) -> None:
        """Open the publishers and clients that the bag needs."""
        if self._sends_goals:
            self._goals = _GoalSender(self._node, tasks, self._remap, self.played, self._start)
        if self._frequency:
            endpoint = self._endpoint(
                CLOCK, Clock.type_name, QoS(depth=1, reliability="best_effort")
            )
            self._clock = self._node.transport.advertise(endpoint, WireFormat(Clock))
        for channel in self._bag.channels():
            if self._clock is not None and self._name(channel.topic) == CLOCK:
                continue
            if self._selection.wants(channel.topic, channel.schema.name):
                if self._goals is None or part_of(channel.topic).owner != "action":
                    self._open(channel)
                elif part_of(channel.topic).part == "send_goal":
                    self._goals.expect(channel)

    async def aclose(self) -> None:
        """Close all publishers and clients."""
        if self._clock is not None:
            self._clock.close()
        for each in self._publications.values():
            each.close()
        if self._goals is not None:
            await self._goals.aclose()

    async def wait_for_readers(self) -> None:
        """Wait until subscriptions and servers can be reached, at most `PATIENCE` seconds."""
        transport = self._node.transport
        endpoints = transport.endpoints()
        read = {each.name for each in endpoints if each.kind == "subscription"}
        served = {each.name for each in endpoints if each.kind == "service"}
        waiting = [each for topic, each in self._publications.items() if self._name(topic) in read]
        with anyio.move_on_after(PATIENCE):
            while not all(each.has_readers for each in waiting):
                await transport.wait_for_change()
            if self._goals is not None:
                await self._goals.wait_for_servers(served)

    @property
    def is_idle(self) -> bool:
        """Whether the last `run` had no topics to publish and no goals to send."""
        return not (self._outlets or (self._goals is not None and self._goals.has_sent))

    async def run(self, rate: float | None) -> None:
        """Play the bag once. If ``rate`` is None, play without pauses."""
        if self._goals is not None:
            self._goals.start_over()
        begun = self._node.clock.time()
        self._reached = self._start
        ticking: Background | None = None
        if self._clock is not None:
            ticking = Background(self._tick(begun, rate), f"the clock of {self._bag.path}")
        try:
            await self._play_all(begun, rate)
            if self._goals is not None:
                self._goals.note_unsent()
        finally:
            if ticking is not None:
                await ticking.aclose()

    async def _play_all(self, begun: float, rate: float | None) -> None:
        clock, count = self._node.clock, 0
        reading = Reading(
            self._bag, Range(self._start, self._end, self._is_wanted), is_decoded=False
        )
        async with aclosing(reading.batches()) as read, aclosing(_still(read)) as batches:
            async for message in batches:
                count += 1
                self._reached = message.stamp
                if rate is not None:
                    due = begun + (message.stamp - self._start) / 1e9 / rate
                    if due > clock.time():
                        await clock.sleep_until(due)
                if not count % TURN:
                    await current_tasks().checkpoint()
                await self._play(message)

    async def _tick(self, begun: float, rate: float | None) -> None:
        """Publish the time in the bag on ``/clock``, until cancelled.

        If ``rate`` is None, this time is the stamp of the message that was played last.
        """
        clock = self._node.clock
        while self._clock is not None:
            stamp = self._reached
            if rate is not None:
                stamp = self._start + round((clock.time() - begun) * rate * 1e9)
            self._clock.publish(Clock(stamp_of(stamp)))
            await clock.sleep(1 / self._frequency)

    def _is_wanted(self, topic: str) -> bool:
        return topic in self._outlets or (
            self._goals is not None
            and part_of(topic).owner == "action"
            and self._selection.wants(topic, "")
        )

    async def _play(self, message: Recorded) -> None:
        if message.topic not in self._outlets:
            if self._goals is not None:
                await self._goals.take(message)
            return
        self._outlets[message.topic](message.data)
        self.played.messages += 1
        publication = self._publications[message.topic]
        if publication.is_congested:
            await publication.drained()

    def _open(self, channel: Channel) -> None:
        """Open the publisher of a topic, unless the topic's type is unknown."""
        cls = class_of(channel.schema, channel.type_hash)
        hash_of = channel.type_hash or ("" if cls is None else type_hash(cls))
        if channel.format != "cdr" or not hash_of:
            self.played.skipped[channel.topic] = f"its type {channel.schema.name} is not known"
            return
        qos = self._qos.get(channel.topic) or _offered(channel.offers)
        endpoint = self._endpoint(self._name(channel.topic), channel.schema.name, qos)
        encode = None if cls is None else WireFormat(cls).encode
        publication = self._node.transport.advertise(endpoint, RawFormat(hash_of, encode))
        self._publications[channel.topic] = publication
        read = reader_of(channel)

        def publish(data: bytes) -> None:
            message = read(data) if publication.has_object_readers else None
            if message is None:
                publication.send(data)
            else:
                publication.publish(message)

        self._outlets[channel.topic] = publish

    def _endpoint(self, topic: str, type_name: str, qos: QoS) -> Endpoint:
        return Endpoint("publisher", topic, type_name, self._node.fully_qualified_name, qos)

    def _name(self, topic: str) -> str:
        return self._remap.get(topic, topic)


class _Resent(msgspec.Struct):
    """A recorded goal that is sent again.

    Attributes:
        stamp: When the goal was requested during the recording (ns since 1970).
        handle: The handle of the new goal; None until the server has accepted it.
        is_canceled: Whether to cancel the goal as soon as it is accepted.
    """

    stamp: int
    handle: ClientGoalHandle[Any, Any] | None = None
    is_canceled: bool = False

    def cancel(self) -> None:
        """Cancel the goal now, or when it is accepted."""
        self.is_canceled = True
        if self.handle is not None:
            self.handle.cancel_nowait()


class _GoalSender:
    """Sends the goals of a bag again, and repeats the recorded cancel requests.

    Args:
        node: A node on the graph.
        tasks: The task group in which the goals are awaited.
        remap: New names of actions, by their recorded names.
        played: The outcome of `play`. The sender updates its counts when a goal ends.
        start: The time in the bag at which playing begins (ns since 1970).

    Attributes:
        has_sent: Whether a goal was sent since the last call of `start_over`.
    """

    def __init__(
        self,
        node: Node,
        tasks: anyio.abc.TaskGroup,
        remap: Mapping[str, str],
        played: Played,
        start: int,
    ) -> None:
        self.has_sent = False
        self._start = start
        self._accepted: dict[bytes, str] = {}  # the actions of the goals in status messages
        self._node = node
        self._tasks = tasks
        self._remap = remap
        self._played = played
        self._clients: dict[str, ActionClient[Any, Any, Any]] = {}
        self._goals: dict[bytes, _Resent] = {}  # by their recorded ids
        self._canceled: set[tuple[bytes, int]] = set()
        self._readers: dict[str, Callable[[bytes], Message | None]] = {}

    def expect(self, channel: Channel) -> None:
        """Open the client of an action that has goals in the bag."""
        action = part_of(channel.topic).name
        try:
            self._client(action, owner_of(channel.topic, channel.schema.name))
        except (UnknownInterface, InvalidInterface) as error:
            self._played.skipped[action] = str(error)

    async def wait_for_servers(self, served: Collection[str]) -> None:
        """Wait until the action servers can be reached.

        An action is left out if ``served`` does not contain the name of its ``send_goal`` service.

        Cancelling: safe.
        """
        for client in self._clients.values():
            if f"{client.name}{SEND_GOAL}" in served:
                await client.wait_for_server()

    async def aclose(self) -> None:
        """Close the clients."""
        for client in self._clients.values():
            await client.aclose()

    def start_over(self) -> None:
        """Forget the goals sent so far, so that all goals in the bag can be sent again."""
        self.has_sent = False
        self._goals.clear()
        self._canceled.clear()
        self._accepted.clear()

    def note_unsent(self) -> None:
        """Count an accepted goal as failed if its request is not in the bag."""
        for goal_id, action in self._accepted.items():
            if goal_id in self._goals:
                continue
            if action in self._played.skipped:
                self._played.failed += 1
            else:
                self._fail(self._remap.get(action, action), UNSENT)

    async def take(self, message: Recorded) -> None:
        """Handle a message of an action's topics.

        If the message is a goal request or a cancel request, send the request again. If it is a
        status message, note its goals as accepted. Ignore all other messages.
        """
        _, action, part = part_of(message.topic)
        if part not in ("send_goal", "cancel_goal", "status"):
            return
        event = self._decoded(message)
        if event is not None and part == "status":
            self._note_accepted(action, event)
            return
        if event is None or event.info.event_type not in REQUESTS:
            return
        for request in event.request:
            if part == "send_goal":
                self._send(action, request, nanoseconds(event.info.stamp))
            else:
                self._cancel(event.info, request)

    def _note_accepted(self, action: str, states: Any) -> None:  # noqa: ANN401  # a message
        for each in states.status_list:
            # A server also lists goals that it accepted before the recording began.
            if nanoseconds(each.goal_info.stamp) >= self._start:
                self._accepted[bytes(each.goal_info.goal_id.uuid)] = action

    def _fail(self, action: str, reason: str) -> None:
        self._played.goals[action, reason] += 1
        self._played.failed += 1

    def _decoded(self, message: Recorded) -> Any:  # noqa: ANN401  # an event of any service
        read = self._readers.get(message.topic)
        if read is None:
            channel = Channel(topic=message.topic, schema=message.schema)
            read = self._readers[message.topic] = reader_of(channel)
        return read(message.data)

    def _send(self, action: str, request: Any, stamp: int) -> None:  # noqa: ANN401  # a message
        old = bytes(request.goal_id.uuid)
        if old in self._goals:  # the client's event and the server's are of one request
            return
        resent = self._goals[old] = _Resent(stamp)
        client = self._clients.get(self._remap.get(action, action))
        if client is None:  # its type is not known here
            self._played.failed += 1
            return
        try:
            goal = client.action_type.Goal(**msgspec.structs.asdict(request.goal))
        except TypeError:
            self._fail(client.name, "the recorded goal has other fields")
            return
        self.has_sent = True
        self._tasks.start_soon(self._follow, client, goal, resent)

    async def _follow(
        self, client: ActionClient[Any, Any, Any], goal: Message, resent: _Resent
    ) -> None:
        try:
            async with client.send_goal(goal) as handle:
                resent.handle = handle
                if resent.is_canceled:
                    handle.cancel_nowait()
                status: GoalStatus = (await handle.outcome()).status
        except TurtleactError as error:
            self._fail(client.name, str(error))
            return
        self._played.goals[client.name, status.name] += 1

    def _cancel(self, info: Any, request: Any) -> None:  # noqa: ANN401  # messages
        call = bytes(info.client_gid), info.sequence_number
        if call in self._canceled:
            return
        self._canceled.add(call)
        old = bytes(request.goal_info.goal_id.uuid)
        stamp = nanoseconds(request.goal_info.stamp)
        everything = not any(old) and not stamp
        for each, goal in self._goals.items():
            if everything or each == old or (stamp and goal.stamp <= stamp):
                goal.cancel()

    def _client(self, action: str, type_name: str) -> ActionClient[Any, Any, Any]:
        name = self._remap.get(action, action)
        if name not in self._clients:
            self._clients[name] = self._node.action_client(get_action(type_name), name)
        return self._clients[name]


async def _still(batches: AsyncIterator[list[Recorded]]) -> AsyncGenerator[Recorded]:
    """Yield the messages, and stop virtual time while a thread reads the next batch."""
    while True:
        with thread_work().counted():
            batch = await anext(batches, None)
        if batch is None:
            return
        for message in batch:
            yield message


def _times(options: PlayOptions) -> tuple[int, int | None]:
    """Return the options ``start_offset`` and ``duration`` in nanoseconds."""
    offset = in_nanoseconds("start_offset", options.get("start_offset", 0.0))
    duration = options.get("duration")
    return offset, None if duration is None else in_nanoseconds("duration", duration)


def _selection(node: Node, options: PlayOptions) -> Selection:
    if "selection" in options:
        return options["selection"]
    if "topics" not in options:
        return msgspec.structs.replace(EVERYTHING, hidden=True)
    names = (resolve_name(each, node.namespace, node.name) for each in options["topics"])
    return Selection(topics=frozenset(names))


def _offered(offers: tuple[Offer, ...]) -> QoS:
    """Return the QoS if all publishers offered the same one; otherwise return the default QoS."""
    found = {each.qos for each in offers}
    return found.pop() if len(found) == 1 else QoS()
