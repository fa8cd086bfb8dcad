"""What every transport must do: one suite, put to each of them.

A transport's test module subclasses `TransportConformance` and gives it the fixture ``transport``:
a function that opens two peers of one graph. Nothing here knows how they talk; what takes its time
on its way is waited for by `Peers.settle`.
"""

from __future__ import annotations

import functools
import logging
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AbstractAsyncContextManager
from typing import Any, NamedTuple, TypeAlias

import anyio
import msgspec
import pytest

from turtleact.errors import (
    InvalidMessage,
    ServerUnavailable,
    ServiceError,
    TurtleactError,
)
from turtleact.interfaces import Message, Service, WireFormat, int32
from turtleact.transports import QoS, Transport
from turtleact.transports.base import (
    Endpoint,
    EndpointKind,
    Publication,
    RawFormat,
    Reply,
    ServiceHandler,
    Source,
)

from ..lab import Count, feedback, running, take_turns


class Peers(NamedTuple):
    """Two participants of one graph; they may be the same object.

    Attributes:
        here: The one.
        there: The other.
        settle: Waits until each knows what the other has done, and what was sent has arrived.
    """

    here: Transport
    there: Transport
    settle: Callable[[], Awaitable[None]]


OpenPeers: TypeAlias = Callable[[], AbstractAsyncContextManager[Peers]]


class Sum(Service, type_name="lab_interfaces/srv/Sum"):
    """What the services of this suite are of."""

    class Request(Message):
        numbers: list[int32] = []

    class Response(Message):
        total: int32 = 0


TYPE = Count.Feedback.type_name
SPEECH = WireFormat(Count.Feedback)
SERVING = WireFormat(Sum)
ASKING = WireFormat(Sum, asks=True)
LATCHED = QoS(depth=2, durability="transient_local")
KINDS: tuple[EndpointKind, ...] = ("publisher", "subscription", "service", "client")

EACH_KIND = pytest.mark.parametrize("kind", KINDS)


class Handler(ServiceHandler):
    """What serves a service, and is never asked."""


class Adder(ServiceHandler):
    """A server that adds up; notes its callers, and waits or fails as told."""

    def __init__(
        self, fail: Exception | None = None, gate: anyio.Event | None = None, extra: int = 0
    ) -> None:
        self.callers: list[bytes] = []
        self.lost: list[bytes] = []
        self._fail = fail
        self._gate = gate
        self._extra = extra

    async def reply(self, request: Any, caller: bytes) -> Reply:
        self.callers.append(caller)
        if self._gate is not None:
            await self._gate.wait()
        if self._fail is not None:
            raise self._fail
        return Reply(Sum.Response(total=sum(request.numbers) + self._extra), "added up")

    def caller_lost(self, caller: bytes) -> None:
        self.lost.append(caller)


class Inbox:
    """A subscriber that keeps what it is given."""

    def __init__(self) -> None:
        self.numbers: list[int] = []
        self.threads: set[int] = set()

    def deliver(self, message: Any) -> None:
        self.numbers += message.so_far
        self.threads.add(threading.get_ident())


class Numbers(Source):
    """A source that shows a number."""

    def __init__(self) -> None:
        self.number = 0
        self.told: list[bool] = []

    def current(self) -> list[object]:
        return [feedback(self.number)]

    def written(self, encode: Callable[[object], bytes]) -> list[bytes]:
        return [encode(message) for message in self.current()]

    def readers_changed(self, *, has_readers: bool) -> None:
        self.told.append(has_readers)


def publisher(name: str = "/chatter", qos: QoS | None = None, type_name: str = TYPE) -> Endpoint:
    return Endpoint("publisher", name, type_name, "/talker", qos or QoS())


def subscription(name: str = "/chatter", qos: QoS | None = None, type_name: str = TYPE) -> Endpoint:
    return Endpoint("subscription", name, type_name, "/listener", qos or QoS())


def service(name: str = "/add", type_name: str = Sum.type_name) -> Endpoint:
    return Endpoint("service", name, type_name, "/adder")


def client(name: str = "/add", type_name: str = Sum.type_name) -> Endpoint:
    return Endpoint("client", name, type_name, "/asker")


def numbers(*values: int) -> Sum.Request:
    return Sum.Request(numbers=list(values))


def listen(at: Transport, endpoint: Endpoint | None = None) -> Inbox:
    """What a new subscription gets."""
    inbox = Inbox()
    at.subscribe(endpoint or subscription(), SPEECH, inbox.deliver)
    return inbox


async def connected(peers: Any) -> tuple[Publication, Inbox]:
    """A publisher here, and what a subscription there gets, once they know each other."""
    inbox = listen(peers.there)
    publication = peers.here.advertise(publisher(), SPEECH)
    await peers.settle()
    return publication, inbox


async def say(peers: Any, publication: Publication, *numbers: int) -> None:
    """Publish numbers, and wait until they have arrived."""
    for number in numbers:
        publication.publish(feedback(number))
    await peers.settle()


async def served(
    peers: Any, handler: ServiceHandler, at: Transport | None = None, *, by: Transport | None = None
) -> Any:
    """A client by one of two peers, once it knows the handler at the other end."""
    (at or peers.there).serve(service(), SERVING, handler)
    caller = (by or peers.here).join(client(), ASKING)
    await peers.settle()
    return caller


def of_kind(kind: EndpointKind, name: str = "/it") -> Endpoint:
    return Endpoint(kind, name, TYPE, "/lab")


def open_it(transport: Transport, endpoint: Endpoint) -> Any:
    """Open an endpoint by the method for its kind."""
    if endpoint.kind == "publisher":
        return transport.advertise(endpoint, SPEECH)
    if endpoint.kind == "subscription":
        return transport.subscribe(endpoint, SPEECH, Inbox().deliver)
    if endpoint.kind == "service":
        return transport.serve(endpoint, SERVING, Handler())
    return transport.join(endpoint, ASKING)


def seen(transport: Transport) -> list[Endpoint]:
    """The endpoints of a graph, without what only a wire knows of them."""
    return [
        msgspec.structs.replace(endpoint, type_hash="", gid=b"")
        for endpoint in transport.endpoints()
    ]


class TransportConformance:
    """The suite; a subclass gives the fixture ``transport``."""

    @pytest.fixture
    def transport(self) -> OpenPeers:
        raise NotImplementedError("a subclass says how its peers are opened")

    @pytest.fixture
    async def peers(self, transport: OpenPeers, anyio_backend: object) -> AsyncIterator[Peers]:
        async with transport() as peers:
            yield peers

    @pytest.fixture(params=["here", "there"])
    def at(self, request: pytest.FixtureRequest, peers: Peers) -> Transport:
        """The other end: on the same transport, or on that of the other peer."""
        found: Transport = getattr(peers, request.param)
        return found

    # topics

    async def test_a_raw_subscription_gets_the_bytes_that_are_sent(self, peers, at):
        seen: list[object] = []
        raw = RawFormat(SPEECH.type_hash, SPEECH.encode)
        at.subscribe(subscription(), raw, seen.append)
        publication = peers.here.advertise(publisher(), SPEECH)
        await peers.settle()
        assert publication.has_readers
        assert not publication.has_object_readers
        publication.send(SPEECH.encode(feedback(7)))
        await peers.settle()
        assert seen == [SPEECH.encode(feedback(7))]

    async def test_a_message_reaches_raw_subscriptions_once_beside_others(self, peers):
        inbox, raw, seen = Inbox(), RawFormat(SPEECH.type_hash, SPEECH.encode), list[object]()
        peers.here.subscribe(subscription(), raw, seen.append)
        peers.here.subscribe(subscription(), SPEECH, inbox.deliver)
        publication = peers.here.advertise(publisher(), SPEECH)
        await peers.settle()
        assert publication.has_object_readers
        await say(peers, publication, 7)
        assert inbox.numbers == [7]
        assert [raw.encode(each) for each in seen] == [SPEECH.encode(feedback(7))]

    @pytest.mark.parametrize("in_any_thread", [False, True])
    async def test_messages_arrive_in_the_order_of_their_publishing(self, peers, at, in_any_thread):
        inbox, wanted = Inbox(), subscription(qos=QoS(depth=200))
        at.subscribe(wanted, SPEECH, inbox.deliver, in_any_thread=in_any_thread)
        publication = peers.here.advertise(publisher(qos=QoS(depth=200)), SPEECH)
        await peers.settle()
        for number in range(200):
            publication.publish(feedback(number))
        await peers.settle()
        assert inbox.numbers == list(range(200))

    async def test_a_message_reaches_every_subscription(self, peers):
        inboxes = [Inbox(), Inbox(), Inbox()]
        for peer, inbox in zip((peers.here, peers.here, peers.there), inboxes, strict=True):
            peer.subscribe(subscription(), SPEECH, inbox.deliver)
        publication = peers.here.advertise(publisher(), SPEECH)
        await peers.settle()
        await say(peers, publication, 7)
        assert [inbox.numbers for inbox in inboxes] == [[7], [7], [7]]

    async def test_a_subscription_hears_every_publisher(self, peers):
        inbox = listen(peers.here)
        one = peers.here.advertise(publisher(), SPEECH)
        other = peers.there.advertise(publisher(), SPEECH)
        await peers.settle()
        one.publish(feedback(1))
        await peers.settle()
        other.publish(feedback(2))
        await peers.settle()
        assert inbox.numbers == [1, 2]

    @pytest.mark.parametrize(
        "wanted",
        [subscription("/chatter2"), subscription(type_name=Count.Goal.type_name)],
        ids=["name", "type"],
    )
    async def test_a_subscription_of_something_else_hears_nothing(self, peers, wanted):
        inbox = Inbox()
        peers.there.subscribe(wanted, SPEECH, inbox.deliver)
        publication = peers.here.advertise(publisher(), SPEECH)
        await peers.settle()
        await say(peers, publication, 7)
        assert inbox.numbers == []

    async def test_a_message_is_delivered_where_the_event_loop_runs(self, peers):
        publication, inbox = await connected(peers)
        await say(peers, publication, 7)
        assert inbox.threads == {threading.get_ident()}

    # a subscriber that fails

    async def test_a_failure_of_a_subscriber_is_logged_and_harms_nobody(self, peers, caplog):
        def fail(message: object) -> None:
            failing.deliver(message)
            raise ValueError("no room")

        failing, other = Inbox(), Inbox()
        peers.there.subscribe(subscription(), SPEECH, fail)
        peers.there.subscribe(subscription(), SPEECH, other.deliver)
        publication = peers.here.advertise(publisher(), SPEECH)
        await peers.settle()
        await say(peers, publication, 1, 2)
        assert (failing.numbers, other.numbers) == ([1, 2], [1, 2])
        record, _ = caplog.records
        assert (record.name, record.levelno) == ("turtleact.transport", logging.ERROR)
        assert record.getMessage() == "a subscription of topic /chatter failed to handle a message"
        assert "no room" in str(record.exc_info)

    async def test_a_subscriber_that_fails_on_a_latched_message_stays(self, peers):
        inbox = Inbox()

        def fail_once(message: object) -> None:
            inbox.deliver(message)
            if inbox.numbers == [1]:
                raise ValueError("no room")

        publication = peers.here.advertise(publisher(qos=LATCHED), SPEECH)
        await say(peers, publication, 1)
        peers.there.subscribe(subscription(qos=LATCHED), SPEECH, fail_once)
        await peers.settle()
        await say(peers, publication, 2)
        assert inbox.numbers == [1, 2]

    # latched messages

    async def test_a_late_subscription_gets_the_last_latched_messages_first(self, peers, at):
        publication = peers.here.advertise(publisher(qos=LATCHED), SPEECH)
        for number in (1, 2, 3):
            publication.publish(feedback(number))
        await peers.settle()
        inbox = listen(at, subscription(qos=LATCHED))
        await peers.settle()
        await say(peers, publication, 4)
        assert inbox.numbers == [2, 3, 4]

    async def test_latched_messages_of_several_publishers_all_come(self, peers):
        for number in (1, 2):
            latched = peers.here.advertise(publisher(qos=LATCHED), SPEECH)
            latched.publish(feedback(number))
        await peers.settle()
        inbox = listen(peers.there, subscription(qos=LATCHED))
        await peers.settle()
        assert sorted(inbox.numbers) == [1, 2]

    async def test_a_latched_message_does_not_come_twice(self, peers):
        inbox = listen(peers.there, subscription(qos=LATCHED))
        publication = peers.here.advertise(publisher(qos=LATCHED), SPEECH)
        await peers.settle()
        await say(peers, publication, 1)
        peers.there.subscribe(subscription(qos=LATCHED), SPEECH, Inbox().deliver)
        await peers.settle()
        assert inbox.numbers == [1]

    @pytest.mark.parametrize(
        ("sent", "wanted"),
        [(LATCHED, QoS()), (QoS(), LATCHED), (QoS(), QoS())],
        ids=["reader-volatile", "publisher-volatile", "both-volatile"],
    )
    async def test_old_messages_come_only_if_both_sides_want_them(self, peers, sent, wanted):
        publication = peers.here.advertise(publisher(qos=sent), SPEECH)
        await say(peers, publication, 1)
        inbox = listen(peers.there, subscription(qos=wanted))
        await peers.settle()
        await say(peers, publication, 2)
        assert inbox.numbers == [2]

    async def test_latched_messages_go_with_their_publisher(self, peers):
        publication = peers.here.advertise(publisher(qos=LATCHED), SPEECH)
        await say(peers, publication, 1)
        publication.close()
        await peers.settle()
        inbox = listen(peers.there, subscription(qos=LATCHED))
        await peers.settle()
        assert inbox.numbers == []

    # who reads

    async def test_a_publisher_has_readers_as_long_as_a_subscription_is_open(self, peers, at):
        publication = peers.here.advertise(publisher(), SPEECH)
        peers.there.subscribe(subscription("/chatter2"), SPEECH, Inbox().deliver)
        await peers.settle()
        assert not publication.has_readers
        subscribed = at.subscribe(subscription(), SPEECH, Inbox().deliver)
        await peers.settle()
        assert publication.has_readers
        subscribed.close()
        await peers.settle()
        assert not publication.has_readers

    async def test_a_publisher_that_latches_may_have_readers_later(self, peers):
        assert peers.here.advertise(publisher(qos=LATCHED), SPEECH).has_readers

    @pytest.mark.parametrize("qos", [QoS(), LATCHED], ids=["volatile", "latched"])
    async def test_a_closed_publisher_has_no_readers(self, peers, qos):
        publication = peers.here.advertise(publisher(qos=qos), SPEECH)
        peers.there.subscribe(subscription(), SPEECH, Inbox().deliver)
        await peers.settle()
        publication.close()
        assert not publication.has_readers

    # closing

    async def test_a_closed_subscription_gets_nothing_more(self, peers, at):
        inbox, other = Inbox(), Inbox()
        subscribed = at.subscribe(subscription(), SPEECH, inbox.deliver)
        at.subscribe(subscription(), SPEECH, other.deliver)
        publication = peers.here.advertise(publisher(), SPEECH)
        await peers.settle()
        await say(peers, publication, 1)
        subscribed.close()
        await say(peers, publication, 2)
        assert (inbox.numbers, other.numbers) == ([1], [1, 2])

    async def test_a_subscription_closed_by_another_one_gets_nothing_more(self, peers):
        inboxes = [Inbox(), Inbox()]
        subscribed: list[Any] = []

        def take_and_close(mine: int, message: object) -> None:
            inboxes[mine].deliver(message)
            subscribed[1 - mine].close()

        for mine in range(2):
            take = functools.partial(take_and_close, mine)
            subscribed.append(peers.there.subscribe(subscription(), SPEECH, take))
        publication = peers.here.advertise(publisher(), SPEECH)
        await peers.settle()
        await say(peers, publication, 1)
        assert sorted(inbox.numbers for inbox in inboxes) == [[], [1]]

    async def test_a_subscriber_that_closes_itself_takes_nothing_from_others(self, peers):
        inbox, other = Inbox(), Inbox()

        def take_one(message: object) -> None:
            inbox.deliver(message)
            subscribed.close()

        subscribed = peers.there.subscribe(subscription(), SPEECH, take_one)
        peers.there.subscribe(subscription(), SPEECH, other.deliver)
        publication = peers.here.advertise(publisher(), SPEECH)
        await peers.settle()
        await say(peers, publication, 1, 2)
        assert (inbox.numbers, other.numbers) == ([1], [1, 2])

    async def test_a_closed_publisher_gives_nothing_more(self, peers):
        publication, inbox = await connected(peers)
        await say(peers, publication, 1)
        publication.close()
        await say(peers, publication, 2)
        assert inbox.numbers == [1]

    async def test_a_publisher_outlives_the_last_subscription(self, peers):
        publication = peers.here.advertise(publisher(), SPEECH)
        peers.there.subscribe(subscription(), SPEECH, Inbox().deliver).close()
        await peers.settle()
        inbox = listen(peers.there)
        await peers.settle()
        await say(peers, publication, 1)
        assert inbox.numbers == [1]

    async def test_a_subscription_outlives_the_last_publisher(self, peers):
        inbox = listen(peers.there)
        peers.here.advertise(publisher(), SPEECH).close()
        await peers.settle()
        publication = peers.here.advertise(publisher(), SPEECH)
        await peers.settle()
        await say(peers, publication, 1)
        assert inbox.numbers == [1]

    @EACH_KIND
    async def test_closing_twice_is_closing_once(self, peers, kind):
        first, _ = open_it(peers.here, of_kind(kind)), open_it(peers.here, of_kind(kind))
        first.close()
        first.close()
        await peers.settle()
        assert seen(peers.here) == [of_kind(kind)]

    # the graph

    @EACH_KIND
    async def test_an_endpoint_is_in_the_graph_while_it_is_open(self, peers, kind, at):
        opened = open_it(peers.here, of_kind(kind))
        await peers.settle()
        assert seen(at) == [of_kind(kind)]
        opened.close()
        await peers.settle()
        assert seen(at) == []

    async def test_endpoints_are_in_the_order_of_their_opening(self, peers):
        wanted = [of_kind(kind, f"/{name}") for name in "ba" for kind in reversed(KINDS)]
        for endpoint in wanted:
            open_it(peers.here, endpoint)
        assert seen(peers.here) == wanted

    async def test_an_endpoint_shows_its_quality_of_service(self, peers):
        qos = QoS(depth=3, durability="transient_local", reliability="best_effort")
        peers.here.advertise(publisher(qos=qos), SPEECH)
        await peers.settle()
        assert [endpoint.qos for endpoint in peers.there.endpoints()] == [qos]

    async def test_a_node_is_in_the_graph_from_entering_to_closing(self, peers, at):
        entered = peers.here.enter("/sim/lab")
        await peers.settle()
        assert at.nodes() == ("/sim/lab",)
        entered.close()
        await peers.settle()
        assert at.nodes() == ()

    async def test_of_two_nodes_of_one_name_each_is_in_the_graph(self, peers):
        first, _ = peers.here.enter("/lab"), peers.there.enter("/lab")
        await peers.settle()
        assert peers.here.nodes() == ("/lab", "/lab")
        first.close()
        first.close()
        await peers.settle()
        assert peers.here.nodes() == ("/lab",)

    @EACH_KIND
    async def test_opening_and_closing_an_endpoint_is_a_change(self, peers, kind, at):
        graph = at
        counts = [graph.changes]
        async with running(graph.wait_for_change) as waiting:
            assert not waiting.done.is_set()
            opened = open_it(peers.here, of_kind(kind))
            await waiting.done.wait()
        await peers.settle()
        counts.append(graph.changes)
        async with running(graph.wait_for_change) as waiting:
            assert not waiting.done.is_set()
            opened.close()
            await waiting.done.wait()
        assert counts[0] < counts[1] < graph.changes

    async def test_as_long_as_nothing_changes_no_change_is_counted(self, peers):
        caller = await served(peers, Adder(), peers.here, by=peers.there)
        before = peers.here.changes, peers.there.changes
        await caller.call(numbers(1))
        await peers.settle()
        assert (peers.here.changes, peers.there.changes) == before

    async def test_a_node_that_comes_or_goes_is_a_change(self, peers, at):
        async with running(at.wait_for_change) as waiting:
            entered = peers.here.enter("/lab")
            await waiting.done.wait()
        await peers.settle()
        async with running(at.wait_for_change) as waiting:
            assert not waiting.done.is_set()
            entered.close()
            await waiting.done.wait()

    async def test_closing_again_is_no_change(self, peers):
        opened = open_it(peers.here, of_kind("client"))
        opened.close()
        await peers.settle()
        async with running(peers.here.wait_for_change) as waiting:
            opened.close()
            await peers.settle()
            await take_turns()
            assert not waiting.done.is_set()
            waiting.scope.cancel()

    async def test_a_canceled_wait_for_a_change_leaves_others_waiting(self, peers):
        wait = peers.here.wait_for_change
        async with running(wait) as first, running(wait) as second:
            first.scope.cancel()
            await first.done.wait()
            assert not second.done.is_set()
            peers.here.enter("/lab")
            await second.done.wait()

    # services of the same process

    @pytest.mark.parametrize(
        "other", [service("/add2"), service(type_name="lab_interfaces/srv/Other")]
    )
    async def test_a_service_of_another_name_or_type_is_not_found(self, peers, other):
        peers.here.serve(other, SERVING, Handler())
        assert peers.here.local("/add", Sum.type_name) == ()

    async def test_of_several_handlers_the_first_is_found_then_the_next(self, peers):
        handlers = [Handler(), Handler()]
        found = []
        for opened in [peers.here.serve(service(), SERVING, handler) for handler in handlers]:
            found.append(peers.here.local("/add", Sum.type_name)[0])
            opened.close()
            opened.close()
        assert found == handlers
        assert peers.here.local("/add", Sum.type_name) == ()

    async def test_handlers_of_one_node_are_one_service_until_the_last_is_closed(self, peers):
        opened = [peers.here.serve(service(), SERVING, Adder()) for _ in range(2)]
        await peers.settle()
        (seen,) = peers.there.endpoints()
        assert peers.here.endpoints() == (seen,)
        opened[0].close()
        await peers.settle()
        assert peers.there.endpoints() == (seen,)
        for each in (*opened, *opened):
            each.close()
        await peers.settle()
        assert peers.there.endpoints() == peers.here.endpoints() == ()

    async def test_of_the_handlers_of_one_node_the_first_answers_then_the_next(self, peers):
        adders = [Adder(), Adder()]
        opened = [peers.here.serve(service(), SERVING, each) for each in adders]
        caller = peers.there.join(client(), ASKING)
        await peers.settle()
        await caller.call(numbers())
        opened[0].close()
        await caller.call(numbers())
        assert [len(each.callers) for each in adders] == [1, 1]

    async def test_the_same_service_of_two_nodes_is_two(self, peers):
        for node in ("/one", "/two"):
            served = msgspec.structs.replace(service(), node=node)
            peers.here.serve(served, SERVING, Adder())
        await peers.settle()
        assert [each.node for each in peers.there.endpoints()] == ["/one", "/two"]

    async def test_local_endpoints_are_those_of_this_process(self, peers):
        peers.here.serve(service(), SERVING, Adder())
        await peers.settle()
        assert len(peers.here.local_endpoints("/add")) == 1
        assert peers.here.local_endpoints("/other") == ()
        others = () if peers.here is not peers.there else peers.here.local_endpoints()
        assert peers.there.local_endpoints() == others

    # calls

    async def test_a_call_gets_the_servers_reply(self, peers, at):
        caller = await served(peers, Adder(), at)
        reply = await caller.call(numbers(2, 3))
        assert (reply.message, reply.note) == (Sum.Response(total=5), "added up")

    async def test_a_caller_is_served_while_a_server_is_open(self, peers, at):
        caller = peers.here.join(client(), ASKING)
        seen = [caller.is_served]
        offered = at.serve(service(), SERVING, Adder())
        await peers.settle()
        seen.append(caller.is_served)
        offered.close()
        await peers.settle()
        assert [*seen, caller.is_served] == [False, True, False]

    async def test_who_waits_to_be_served_is_woken(self, peers):
        caller = peers.here.join(client(), ASKING)

        async def wait() -> None:
            while not caller.is_served:
                await peers.here.wait_for_change()

        async with running(wait) as waiting:
            peers.there.serve(service(), SERVING, Adder())
            await waiting.done.wait()
        assert (await caller.call(numbers(1))).message == Sum.Response(total=1)

    async def test_several_calls_are_under_way_at_once(self, peers, at):
        gate = anyio.Event()
        adder = Adder(gate=gate)
        caller = await served(peers, adder, at)
        async with (
            running(lambda: caller.call(numbers(1))) as one,
            running(lambda: caller.call(numbers(2))) as other,
        ):
            await peers.settle()
            assert len(adder.callers) == 2
            gate.set()
        assert (one.value.message.total, other.value.message.total) == (1, 2)

    async def test_a_server_knows_its_callers_apart(self, peers, at):
        at.serve(service(), SERVING, adder := Adder())
        one, other = (peers.here.join(client(), ASKING) for _ in range(2))
        await peers.settle()
        for caller in (one, other, one):
            await caller.call(numbers())
        first, second, third = adder.callers
        assert (len(first), first == third, first == second) == (16, True, False)

    async def test_a_server_is_told_of_a_caller_that_leaves(self, peers, at):
        at.serve(service(), SERVING, adder := Adder())
        caller, _ = (peers.here.join(client(), ASKING) for _ in range(2))
        await peers.settle()
        await caller.call(numbers())
        assert adder.lost == []
        caller.close()
        caller.close()
        await peers.settle()
        assert adder.lost == adder.callers

    async def test_a_caller_that_is_closed_leaves_when_its_calls_are_over(self, peers, at):
        gate = anyio.Event()
        adder = Adder(gate=gate)
        caller = await served(peers, adder, at)
        async with running(lambda: caller.call(numbers(4))) as called:
            await peers.settle()
            caller.close()
            await peers.settle()
            assert adder.lost == []
            gate.set()
        await peers.settle()
        assert called.value.message == Sum.Response(total=4)
        assert adder.lost == adder.callers

    async def test_a_call_that_nobody_serves_ends_at_once(self, peers):
        caller = peers.here.join(client(), ASKING)
        with pytest.raises(ServerUnavailable, match="service '/add': no server answers"):
            await caller.call(numbers())

    async def test_a_service_of_another_type_is_named(self, peers, at):
        other = service(type_name="lab_interfaces/srv/Other")
        at.serve(other, SERVING, Adder())
        caller = peers.here.join(client(), ASKING)
        await peers.settle()
        said = r"served as lab_interfaces/srv/Other, not as lab_interfaces/srv/Sum"
        with pytest.raises(ServerUnavailable, match=said):
            await caller.call(numbers())

    async def test_a_handler_that_fails_says_why(self, peers, at):
        caller = await served(peers, Adder(fail=ValueError("no room")), at)
        said = "service '/add': the handler failed: ValueError: no room"
        with pytest.raises(ServiceError, match=said):
            await caller.call(numbers())

    @pytest.mark.parametrize(
        "error",
        [
            ServiceError("/add", "too many: at most 3"),
            ServerUnavailable("/add", "the server was closed", kind="service"),
            InvalidMessage("request.numbers[1]", "expected a number: not 'two'"),
        ],
        ids=lambda error: type(error).__name__,
    )
    async def test_what_a_handler_raises_on_purpose_comes_as_it_is(self, peers, at, error):
        caller = await served(peers, Adder(fail=error), at)
        with pytest.raises(TurtleactError) as caught:
            await caller.call(numbers())
        assert (type(caught.value), caught.value.args) == (type(error), error.args)

    async def test_a_service_that_closes_still_answers_what_is_under_way(self, peers, at):
        gate = anyio.Event()
        offered = at.serve(service(), SERVING, Adder(gate=gate))
        caller = peers.here.join(client(), ASKING)
        await peers.settle()
        async with running(lambda: caller.call(numbers(4))) as called:
            await peers.settle()
            offered.close()
            await peers.settle()
            gate.set()
        assert called.value.message == Sum.Response(total=4)

    async def test_a_call_that_is_canceled_harms_no_other(self, peers, at):
        gate = anyio.Event()
        caller = await served(peers, Adder(gate=gate), at)
        async with (
            running(lambda: caller.call(numbers(1))) as one,
            running(lambda: caller.call(numbers(2))) as other,
        ):
            await peers.settle()
            one.scope.cancel()
            await one.done.wait()
            gate.set()
        assert (one.value, other.value.message.total) == (None, 2)

    async def test_a_closed_caller_calls_no_more(self, peers):
        caller = await served(peers, Adder())
        caller.close()
        with pytest.raises(TurtleactError, match="the client of service '/add' is closed"):
            await caller.call(numbers())

    # waiting for readers

    async def test_a_publisher_that_sends_little_is_not_congested(self, peers):
        publication, _ = await connected(peers)
        publication.publish(feedback(1))
        await publication.drained()
        assert not publication.is_congested

    async def test_a_source_is_told_of_its_first_and_last_reader(self, peers, at):
        source = Numbers()
        peers.here.advertise(publisher(), SPEECH, source)
        for _ in range(2):
            opened = [at.subscribe(subscription(), SPEECH, Inbox().deliver) for _ in range(2)]
            await peers.settle()
            for each in opened:
                each.close()
            await peers.settle()
        assert source.told == [True, False, True, False]

    async def test_a_late_reader_gets_what_a_source_makes(self, peers, at):
        source = Numbers()
        publication = peers.here.advertise(publisher(qos=LATCHED), SPEECH, source)
        source.number = 5
        publication.refresh()
        await peers.settle()
        at.subscribe(subscription(qos=LATCHED), SPEECH, (inbox := Inbox()).deliver)
        await peers.settle()
        assert inbox.numbers[-1:] == [5]

    async def test_a_reader_is_sent_what_a_source_has_changed(self, peers, at):
        source, inbox = Numbers(), Inbox()
        publication = peers.here.advertise(publisher(qos=LATCHED), SPEECH, source)
        at.subscribe(subscription(qos=LATCHED), SPEECH, inbox.deliver)
        await peers.settle()
        source.number = 5
        publication.refresh()
        await peers.settle()
        assert inbox.numbers[-1:] == [5]

    async def test_refreshing_without_a_source_publishes_nothing(self, peers):
        inbox = Inbox()
        publication = peers.here.advertise(publisher(), SPEECH)
        peers.here.subscribe(subscription(), SPEECH, inbox.deliver)
        publication.refresh()
        await peers.settle()
        assert inbox.numbers == []
