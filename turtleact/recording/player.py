"""Plays a bag: publishes its messages again, and sends its goals again.

Messages are published at the intervals at which they were recorded, measured by the graph's clock.
Over a network, the bytes in the bag are sent without decoding them. Instead of publishing the
topics of an action, the player can send the action's goals again. These goals get new ids, because
a server may still hold the recorded goals and would then reject their ids.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Awaitable, Callable, Collection, Mapping
from contextlib import aclosing
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias, TypedDict, Unpack

import anyio
import anyio.to_thread
import msgspec

from turtleact.errors import InvalidInterface, InvalidOption, TurtleactError, UnknownInterface
from turtleact.goals.client import ActionClient, ClientGoalHandle
from turtleact.goals.state import GoalStatus
from turtleact.interfaces import WireFormat, get_action, stamp_of, type_hash
from turtleact.interfaces.standard.rosgraph_msgs.msg import Clock
from turtleact.names import resolve_name
from turtleact.node import Node, check_open
from turtleact.recording.bag import Bag, Recorded, messages_in, reader_of
from turtleact.recording.metadata import Offer
from turtleact.recording.recorded_goals import RecordedGoal, goals_in
from turtleact.recording.schemas import class_of
from turtleact.recording.selection import EVERYTHING, Selection, owner_of, part_of
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


WaitUntil: TypeAlias = Callable[[int], Awaitable[None]]
"""Waits until a stamp of the bag (ns since 1970) is due."""


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
    with thread_work().counted():
        bag = await anyio.to_thread.run_sync(Bag, path)
    player = _Player(node, bag, options, times)
    failure: TurtleactError | None = None
    try:
        async with anyio.create_task_group() as goals:
            try:
                await player.prepare()
                await player.wait_for_readers()
                while True:
                    await player.run(None if rate == "max" else float(rate), goals)
                    if not options.get("loop") or player.is_idle:
                        break
            except TurtleactError as error:  # the task group would wrap it
                failure = error
                goals.cancel_scope.cancel()
    finally:
        with anyio.CancelScope(shield=True):
            await player.aclose()
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
        self._resent: list[RecordedGoal] = []
        self._frequency = options.get("clock", 0.0)
        self._qos = options.get("qos", {})
        self._clock: Publication | None = None

    async def prepare(self) -> None:
        """Open the publishers and clients that the bag needs, and look for its goals."""
        if self._sends_goals:
            self._goals = _GoalSender(self._node, self._remap, self.played)
            found = await goals_in(self._bag, self._selection)
            self._resent = [each for each in found if self._is_resent(each)]
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
        """Whether there are no topics to publish and no goals to send."""
        return not (self._outlets or any(each.goal is not None for each in self._resent))

    async def run(self, rate: float | None, tasks: anyio.abc.TaskGroup) -> None:
        """Play the bag once, and send its goals in a task group.

        If ``rate`` is None, play without pauses.
        """
        clock = self._node.clock
        begun = clock.time()
        self._reached = self._start

        async def wait_until(stamp: int) -> None:
            if rate is not None:
                due = begun + (stamp - self._start) / 1e9 / rate
                if due > clock.time():
                    await clock.sleep_until(due)

        ticking: Background | None = None
        if self._clock is not None:
            ticking = Background(self._tick(begun, rate), f"the clock of {self._bag.path}")
        try:
            if self._goals is not None:
                for goal in self._resent:
                    tasks.start_soon(self._goals.send, goal, wait_until)
            await self._play_all(wait_until)
            for goal in self._resent:
                await wait_until(max(goal.requested, goal.canceled))
        finally:
            if ticking is not None:
                await ticking.aclose()

    async def _play_all(self, wait_until: WaitUntil) -> None:
        count = 0
        wanted = Range(self._start, self._end, self._outlets.__contains__)
        async with aclosing(messages_in(self._bag, wanted, is_decoded=False)) as messages:
            async for message in messages:
                count += 1
                self._reached = message.stamp
                await wait_until(message.stamp)
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

    def _is_resent(self, goal: RecordedGoal) -> bool:
        """Whether to send a goal again, or to count that the bag does not have it."""
        if goal.is_begun_before or (goal.goal is None and not goal.states):
            return False
        stamp = goal.requested or goal.stamp
        return self._start <= stamp and (self._end is None or stamp <= self._end)

    async def _play(self, message: Recorded) -> None:
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


class _GoalSender:
    """Sends the goals of a bag again, and cancels those that were canceled.

    Args:
        node: A node on the graph.
        remap: New names of actions, by their recorded names.
        played: The outcome of `play`. The sender updates its counts when a goal ends.
    """

    def __init__(self, node: Node, remap: Mapping[str, str], played: Played) -> None:
        self._node = node
        self._remap = remap
        self._played = played
        self._clients: dict[str, ActionClient[Any, Any, Any]] = {}  # by recorded names

    def expect(self, channel: Channel) -> None:
        """Open the client of an action that has goals in the bag."""
        action = part_of(channel.topic).name
        try:
            action_type = get_action(owner_of(channel.topic, channel.schema.name))
        except (UnknownInterface, InvalidInterface) as error:
            self._played.skipped[action] = str(error)
        else:
            name = self._remap.get(action, action)
            self._clients[action] = self._node.action_client(action_type, name)

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

    async def send(self, recorded: RecordedGoal, wait_until: WaitUntil) -> None:
        """Send a goal when it was sent, cancel it when it was canceled, and count its end.

        Args:
            recorded: The goal in the bag.
            wait_until: Waits until a stamp of the bag is due.
        """
        action = self._remap.get(recorded.action, recorded.action)
        if recorded.action in self._played.skipped:
            self._played.failed += 1
            return
        if recorded.goal is None:
            self._fail(action, UNSENT)
            return
        client = self._clients[recorded.action]
        try:
            goal = client.action_type.Goal(**msgspec.structs.asdict(recorded.goal))
        except TypeError:
            self._fail(action, "the recorded goal has other fields")
            return
        await wait_until(recorded.requested)
        try:
            async with client.send_goal(goal) as handle, anyio.create_task_group() as beside:
                if recorded.canceled:
                    beside.start_soon(_cancel, handle, recorded.canceled, wait_until)
                status: GoalStatus = (await handle.outcome()).status
                beside.cancel_scope.cancel()
        except TurtleactError as error:
            self._fail(action, str(error))
            return
        self._played.goals[action, status.name] += 1

    def _fail(self, action: str, reason: str) -> None:
        self._played.goals[action, reason] += 1
        self._played.failed += 1


async def _cancel(handle: ClientGoalHandle[Any, Any], stamp: int, wait_until: WaitUntil) -> None:
    await wait_until(stamp)
    handle.cancel_nowait()


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
