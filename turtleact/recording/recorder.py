"""Records the topics of a graph: subscribes to them, and passes their messages to a `WriterThread`.

Messages from a network are recorded as the bytes that arrive, without decoding them. An action is
recorded through its topics and the events of its services. Servers and clients publish these events
only if their introspection is on. Without the events, the recording lacks goal messages and
results, and `turtleact bag info` says so.
"""

from __future__ import annotations

import logging
from collections.abc import AsyncIterator, Collection, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple, TypedDict, Unpack

import anyio
import anyio.to_thread

from turtleact.errors import TurtleactError
from turtleact.goals.fault_reports import watching_disk
from turtleact.goals.wire import GoalReason, reason_topic
from turtleact.interfaces import Message, WireFormat, type_hash
from turtleact.interfaces.loading import known_classes
from turtleact.names import EVENT_SUFFIX, event_topic, resolve_name
from turtleact.node import Node, check_open
from turtleact.recording.bag_writer import BagWriter, Compression, Split
from turtleact.recording.metadata import BagError, Offer
from turtleact.recording.schemas import Schema, schema_of
from turtleact.recording.selection import EVERYTHING, Selection
from turtleact.recording.storage import Channel, in_nanoseconds
from turtleact.recording.writer_thread import CAPACITY, WriterThread
from turtleact.tasks import Background, current_tasks, opening, thread_work
from turtleact.tasks.clock import WallClock
from turtleact.transports.base import Closeable, Endpoint, QoS, RawFormat
from turtleact.transports.graph import SEND_GOAL, Kind

logger = logging.getLogger("turtleact.recording")

__all__ = ["RecordOptions", "Recording", "record"]

IN_FLIGHT = 0.04
"""How long to wait at the end for service events from other processes (s, event loop time)."""


class RecordOptions(TypedDict, total=False):
    """The options of `record`."""

    topics: Collection[str]
    actions: Collection[str]
    services: Collection[str]
    selection: Selection
    max_size: int
    max_duration: float
    compression: Compression
    capacity: int
    qos: Mapping[str, QoS]


class _Key(NamedTuple):
    """A topic, and one of the types that its publishers use.

    Publishers of the same topic may use different types, or different definitions of a type.
    """

    topic: str
    type_name: str
    type_hash: str


class Recording:
    """A recording in progress, which `record` starts.

    Attributes:
        path: The folder or file of the bag.
        topics: The names of the topics recorded so far.
        unrecorded: The names of the topics that cannot be recorded, each with the reason.
    """

    def __init__(
        self,
        node: Node,
        path: Path,
        selection: Selection,
        thread: WriterThread,
        qos: Mapping[str, QoS],
    ) -> None:
        self.path = path
        self.topics: list[str] = []
        self.unrecorded: dict[str, str] = {}
        self._node = node
        self._selection = selection
        self._thread = thread
        self._qos = qos
        self._subscriptions: dict[_Key, Closeable] = {}
        self._numbers: dict[_Key, int] = {}
        self._failed: set[_Key] = set()
        self._changed = current_tasks().signal()
        self._is_over = False

    @property
    def count(self) -> int:
        """How many messages are in the bag or wait to be written."""
        return self._thread.count

    @property
    def lost(self) -> int:
        """How many messages were dropped because the disk was too slow."""
        return sum(self.lost_by_topic.values())

    @property
    def lost_by_topic(self) -> dict[str, int]:
        """How many messages of each topic were dropped. Topics without a loss are left out."""
        return self._thread.lost

    @property
    def waiting(self) -> int:
        """How many messages are not on disk yet."""
        return self._thread.waiting

    @property
    def error(self) -> BagError | None:
        """Why the recording has ended early; None if it has not."""
        problem = self._thread.error
        if problem is None:
            return None
        if isinstance(problem, BagError):
            return problem
        reason = getattr(problem, "strerror", None) or problem
        what = f"it cannot be written any more: {reason}"
        return BagError(self.path, f"{what}; what was recorded until then can be read")

    async def wait_ended(self) -> None:
        """Wait until the recording ends early, for example because the disk is full.

        Cancelling: safe.
        """
        while not self._is_over:
            await self._changed.wait()

    async def wait_changed(self) -> None:
        """Wait until another topic is recorded, or the recording ends early. Cancelling: safe."""
        await self._changed.wait()

    @property
    def is_over(self) -> bool:
        """Whether the recording has ended early."""
        return self._is_over

    def _end(self) -> None:
        """Mark the recording as ended, and wake the tasks that wait for a change."""
        self._is_over = True
        self._changed.fire()

    async def _look(self) -> None:
        """Subscribe to the selected topics on the graph that are not recorded yet.

        Other tasks get a turn after each topic, because making hundreds of schemas takes a while.
        """
        endpoints = self._node.transport.endpoints()
        offered = dict[_Key, list[Endpoint]]()
        for each in endpoints:
            if each.kind == "publisher" and self._selection.wants(each.name, each.type_name):
                key = _Key(each.name, each.type_name, each.type_hash)
                offered.setdefault(key, []).append(each)
        listed = {each[:2] for each in offered}
        for key in self._unlisted(endpoints):
            if key[:2] not in listed:
                offered[key] = []
        checkpoint = current_tasks().checkpoint
        unknown = [key for key in offered if _message_class(key) is None]
        for key in sorted(offered, key=unknown.__contains__):
            publishers = offered[key]
            if key in unknown[:1]:  # what is known is recorded already
                await self._node.learner.learn_all(self._wants)
            if key not in self._failed and self._try_to_record(key, publishers):
                await checkpoint()

    def _wants(self, kind: Kind, name: str) -> bool:
        if kind != "topic":
            return self._selection.wants_owner(kind, name)
        ends = self._node.transport.endpoints(name)
        return any(self._selection.wants(name, each.type_name) for each in ends)

    def _try_to_record(self, key: _Key, publishers: list[Endpoint]) -> bool:
        try:
            return self._record(key, publishers)
        except TurtleactError as error:  # the other topics matter, too
            logger.error("topic %s cannot be recorded: %s", key.topic, error)
            self._failed.add(key)
            self.unrecorded[key.topic] = str(error)
            return False

    async def _watch(self) -> None:
        """Subscribe to selected topics as they appear on the graph, until cancelled."""
        transport = self._node.transport
        seen = -1
        while True:
            if transport.changes == seen:
                await transport.wait_for_change()
            seen = transport.changes
            await self._look()

    async def _wait_for_events(self) -> None:
        """Wait for service events from other processes that are still on their way."""
        if self._is_over:
            return
        transport = self._node.transport
        topics = [each.topic for each in self._subscriptions if each.topic.endswith(EVENT_SUFFIX)]
        for topic in topics:
            here = transport.local_endpoints(topic)
            if any(each.kind == "publisher" for each in set(transport.endpoints(topic)) - {*here}):
                await anyio.sleep(IN_FLIGHT)
                return

    def _close(self) -> None:
        """Close all subscriptions."""
        for each in self._subscriptions.values():
            each.close()

    def _unlisted(self, endpoints: Iterable[Endpoint]) -> Iterable[_Key]:
        """Yield the topics to subscribe to even if the graph shows no publisher of them.

        These are the topics asked for by name, so that the first message of a publisher that comes
        later is recorded; and the event topics of selected services and actions and the actions'
        reason topics, because their publishers may wait for a subscription.
        """
        for each in endpoints:
            if each.kind == "subscription" and self._is_asked_for(each):
                yield _Key(each.name, each.type_name, each.type_hash)
            if each.kind != "service":
                continue
            if each.name.endswith(SEND_GOAL):
                name = each.name.removesuffix(SEND_GOAL)
                if self._selection.wants_owner("action", name):
                    owner = each.type_name.removesuffix("_SendGoal")
                    for part, type_name in (
                        ("send_goal", f"{owner}_SendGoal_Event"),
                        ("cancel_goal", "action_msgs/srv/CancelGoal_Event"),
                        ("get_result", f"{owner}_GetResult_Event"),
                    ):
                        yield _Key(event_topic(f"{name}/_action/{part}"), type_name, "")
                    yield _Key(reason_topic(name), GoalReason.type_name, "")
            elif "/_" not in each.name and self._selection.wants_owner("service", each.name):
                yield _Key(event_topic(each.name), f"{each.type_name}_Event", "")

    def _is_asked_for(self, endpoint: Endpoint) -> bool:
        is_named = endpoint.name in self._selection.topics
        return is_named and self._selection.wants(endpoint.name, endpoint.type_name)

    def _record(self, key: _Key, publishers: list[Endpoint]) -> bool:
        """Subscribe to a topic, unless it is recorded already.

        Return whether this call has subscribed.
        """
        cls = _message_class(key)
        own_hash = "" if cls is None else type_hash(cls)
        key = key._replace(type_hash=key.type_hash or own_hash)
        is_shown = key.topic in self.topics  # a topic may have several types
        if not key.type_hash or (key in self._subscriptions and (is_shown or not publishers)):
            return False
        is_known = cls is not None and own_hash == key.type_hash
        channel = Channel(
            topic=key.topic,
            schema=schema_of(cls) if cls is not None and is_known else Schema(key.type_name),
            offers=tuple(dict.fromkeys(Offer(each.qos, each.times) for each in publishers)),
            type_hash=key.type_hash,
        )
        if key in self._subscriptions:
            self._thread.list_topic(self._numbers[key], channel)
        else:
            encode = WireFormat(cls).encode if cls is not None else None
            number = self._thread.add(channel, encode, is_there=bool(publishers))
            self._numbers[key] = number
            self._subscriptions[key] = self._subscribe(key, publishers, number)
        if publishers and not is_shown:
            self.topics.append(key.topic)
            self._changed.fire()
        return True

    def _subscribe(self, key: _Key, publishers: list[Endpoint], number: int) -> Closeable:
        put, now = self._thread.put, self._node.clock.now

        def deliver(message: object) -> None:
            put(number, now(), message)

        qos = self._qos.get(key.topic) or _request(publishers)
        endpoint = Endpoint(
            "subscription", key.topic, key.type_name, self._node.fully_qualified_name, qos
        )
        # Wall time can be read in any thread, and then messages need no detour through the loop.
        is_anywhere = isinstance(self._node.clock, WallClock)
        return self._node.transport.subscribe(
            endpoint, RawFormat(key.type_hash), deliver, in_any_thread=is_anywhere
        )


@opening
async def record(
    node: Node, path: str | Path, **options: Unpack[RecordOptions]
) -> AsyncIterator[Recording]:
    """Record topics, services and actions while the block runs.

    Topics, services and actions that appear on the graph during the block are recorded too. A
    thread writes the messages. If the thread cannot keep up, messages are dropped and counted; see
    `Recording.lost`. At the end of the block, `record` waits until all remaining messages are
    written, however long that takes.

    Args:
        node: A node on the graph.
        path: The folder to create. A path that ends in ``.mcap`` names a single file instead.
        **options: ``topics``, ``actions`` and ``services`` are the names to record. If all three
            are left out, everything that is not hidden is recorded. ``selection``, a `Selection`,
            replaces ``topics``, ``actions`` and ``services``. When a file has reached ``max_size``
            (bytes) or ``max_duration`` (s), recording continues in another file. ``compression`` is
            "none", "zstd_fast" or "zstd_small". ``capacity`` is how many bytes may wait to be
            written. ``qos`` maps topics to the quality of service to request; for other topics, the
            recorder requests one that suits all publishers.

    Raises:
        BagError: if the folder or file exists already, or cannot be created. If the disk was full
            or the files were deleted, the error is raised at the end of the block, unless the block
            raises another error. Messages written before the error can be read, unless their files
            were deleted.
        InvalidName: if a name breaks ROS 2's rules.
        InvalidOption: if ``max_duration`` is negative or above 1,000,000,000.
        TurtleactError: if the node is closed, or belongs to another event loop.
        TypeError: if an option does not exist.
    """
    for unknown in options.keys() - RecordOptions.__annotations__.keys():
        raise TypeError(f"record has no option '{unknown}'")
    check_open(node)
    split = Split(
        max_size=options.get("max_size", 0),
        max_duration=in_nanoseconds("max_duration", options.get("max_duration", 0.0)),
        compression=options.get("compression", "none"),
    )
    selection = _selection(node, options)
    tasks = current_tasks()
    # Not in a thread: virtual time would go on meanwhile.
    writer = BagWriter(Path(path), split)
    thread = WriterThread(
        writer,
        capacity=options.get("capacity", CAPACITY),
        is_patient=not isinstance(node.clock, WallClock),
    )
    recording = Recording(node, Path(path), selection, thread, options.get("qos", {}))
    thread.start(lambda: tasks.from_anywhere(recording._end))
    try:
        await recording._look()
        watch = Background(recording._watch(), f"recording {path}")
        own, folder = node.fully_qualified_name, Path(path)
        try:
            async with watching_disk(node.transport, own, folder, "recording"):
                yield recording
        finally:
            with anyio.CancelScope(shield=True):  # bounded
                await recording._wait_for_events()
            await watch.aclose()
    finally:
        recording._close()
        with anyio.CancelScope(shield=True), thread_work().counted():
            await anyio.to_thread.run_sync(thread.close)
    if recording.error is not None:
        raise recording.error


def _selection(node: Node, options: RecordOptions) -> Selection:
    if "selection" in options:
        return options["selection"]
    topics, services, actions = (
        frozenset(resolve_name(each, node.namespace, node.name) for each in names)
        for names in (
            options.get("topics", ()),
            options.get("services", ()),
            options.get("actions", ()),
        )
    )
    if not (topics or services or actions):
        return EVERYTHING
    return Selection(topics=topics, services=services, actions=actions)


def _message_class(key: _Key) -> type[Message] | None:
    """Return the class of a topic, if possible the one with the hash of the topic."""
    found = [each for each in known_classes(key.type_name) if issubclass(each, Message)]
    same = (each for each in found if type_hash(each) == key.type_hash)
    return next(same, found[0] if found else None)


def _request(publishers: list[Endpoint]) -> QoS:
    """Return the quality of service for a subscription that receives from all these publishers.

    If a publisher keeps messages for late subscriptions, the recorder also requests the kept
    messages.
    """
    is_latched = any(each.qos.durability == "transient_local" for each in publishers)
    is_lossy = any(each.qos.reliability == "best_effort" for each in publishers)
    return QoS(
        depth=max([10, *(each.qos.depth for each in publishers)]),
        durability="transient_local" if is_latched else "volatile",
        reliability="best_effort" if is_lossy else "reliable",
    )
