"""The transport to other processes: the common suite over two sessions, and what is its own."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any, NamedTuple, cast

import anyio
import anyio.to_thread
import msgspec
import pytest
import zenoh

import turtleact
from turtleact.errors import (
    InvalidMessage,
    InvalidOption,
    ServerUnavailable,
    ServiceError,
    ServiceTimeout,
    TurtleactError,
    UnknownGoal,
)
from turtleact.interfaces import (
    Action,
    Message,
    WireFormat,
    implied,
    int32,
    type_hash,
)
from turtleact.interfaces.standard import Fibonacci
from turtleact.interfaces.standard.rcl_interfaces.srv import ListParameters
from turtleact.names import PARAMETER_SERVICES
from turtleact.transports import QoS, ZenohTransport, open_zenoh
from turtleact.transports.base import REQUEST_NOTE, Endpoint, Reply, ServiceHandler, Target
from turtleact.transports.rmw_zenoh import services
from turtleact.transports.rmw_zenoh.config import session_config
from turtleact.transports.rmw_zenoh.services import WireCaller
from turtleact.transports.rmw_zenoh.session import Declared, Publisher, Query, Session
from turtleact.transports.rmw_zenoh.topics import WirePublication
from turtleact.transports.rmw_zenoh.wire import (
    data_key,
    endpoint_token,
    gid_of,
    read_attachment,
    write_attachment,
)

from .. import warm
from ..lab import Count, Gate, count, feedback, goal, result, running, settle
from ..registry import isolated_registry
from ..robots import Robot, write_package
from .conformance import (
    ASKING,
    LATCHED,
    SERVING,
    SPEECH,
    Adder,
    Inbox,
    Numbers,
    Peers,
    Sum,
    TransportConformance,
    client,
    connected,
    listen,
    numbers,
    publisher,
    say,
    served,
    service,
    subscription,
)

DOMAIN = int(os.environ["ROS_DOMAIN_ID"])

ROUNDS = 3
"""How often two sessions greet each other: what one learns may be answered by the other."""


@asynccontextmanager
async def acquainted(here: ZenohTransport, there: ZenohTransport):
    """What waits until each of two transports knows what the other has done."""
    ways = [Greeting(here, there), Greeting(there, here)]
    for greet in ways:
        await greet.open()

    async def meet() -> None:
        for _ in range(ROUNDS):
            await settle()
            while any(map(has_news, (here, there))):
                await anyio.sleep(0)
            for greet in ways:
                await greet()
        while not all(is_up_to_date(each) for each in (here, there)):
            await anyio.sleep(0)
        await settle()

    yield meet
    for greet in ways:
        greet.close()


class Greeting:
    """Something sent behind all that was sent before, and waited for.

    Args:
        sender: Who sends it.
        receiver: Who gets it.
    """

    publisher: Publisher

    def __init__(self, sender: ZenohTransport, receiver: ZenohTransport) -> None:
        self._sender = sender.context
        self._receiver = receiver.context
        self._ready = anyio.Event()
        self._arrived = anyio.Event()

    async def open(self) -> None:
        key = f"greetings/{self._sender.session.zid}"
        self._receiver.send_queue.post(
            lambda: self._receiver.session.declare_subscriber(key, self._take)
        )
        self._sender.send_queue.post(lambda: self._declare(key))
        await self._ready.wait()

    async def __call__(self) -> None:
        self._arrived = anyio.Event()
        self._sender.send_queue.post(lambda: self.publisher.put(b"", b""))
        await self._arrived.wait()

    def close(self) -> None:
        self._sender.send_queue.post(lambda: self.publisher.undeclare())

    def _declare(self, key: str) -> None:
        self.publisher = self._sender.session.declare_publisher(
            key, is_reliable=True, matching=self._match
        )

    def _match(self, is_matching: bool) -> None:
        self._sender.receive_queue.push(self._ready.set)

    def _take(self, payload: bytes, _attachment: bytes) -> None:
        self._receiver.receive_queue.push(lambda: self._arrived.set())


def has_news(transport: ZenohTransport) -> bool:
    """Whether a state of it is yet to be sent."""
    publications = [each for each in transport.context.opened if isinstance(each, WirePublication)]
    return any(each.is_stale for each in publications)


def is_up_to_date(transport: ZenohTransport) -> bool:
    """Whether its endpoints have heard what Zenoh knows of their peers."""
    for each in transport.context.opened:
        endpoint: Any = each
        if endpoint.declaration.is_pending:
            continue
        if isinstance(each, WirePublication) and not each.is_latched:
            zenohs, ours = endpoint.publisher, each.is_read
        elif isinstance(each, WireCaller):
            zenohs, ours = endpoint.querier, each.is_matching
        else:
            continue
        if zenohs.declared.matching_status.matching != ours:
            return False
    return True


class TestOneZenohTransport(TransportConformance):
    """Both ends on one transport: nothing goes over the wire."""

    @pytest.fixture
    def transport(self):
        @asynccontextmanager
        async def open_peers():
            async with open_zenoh([], listen=[]) as transport:
                yield Peers(transport, transport, settle)

        return open_peers


class TestTwoZenohTransports(TransportConformance):
    """Each end on a transport of its own, as in two processes."""

    @pytest.fixture
    def transport(self, address):
        @asynccontextmanager
        async def open_peers():
            async with (
                open_zenoh([], listen=[address]) as here,
                open_zenoh([address], listen=[]) as there,
                acquainted(here, there) as meet,
            ):
                yield Peers(here, there, meet)

        return open_peers


# --- two transports, and a bare session that does what ROS 2 does -----------------------------


class Pair(NamedTuple):
    """`Peers` that are known to be these."""

    here: ZenohTransport
    there: ZenohTransport
    settle: Callable[[], Awaitable[None]]


@asynccontextmanager
async def two(address: str) -> AsyncIterator[Pair]:
    async with (
        open_zenoh([], listen=[address]) as here,
        open_zenoh([address], listen=[]) as there,
        acquainted(here, there) as meet,
    ):
        yield Pair(here, there, meet)


@asynccontextmanager
async def two_nodes(address: str) -> AsyncIterator[tuple[Pair, turtleact.Node, turtleact.Node]]:
    """Two transports, a node ``lab`` there and a node ``user`` here."""
    async with (
        two(address) as peers,
        turtleact.open_node("lab", transport=peers.there) as lab,
        turtleact.open_node("user", transport=peers.here) as user,
    ):
        yield peers, lab, user


@pytest.fixture
async def peers(address: str, anyio_backend: object) -> AsyncIterator[Pair]:
    async with two(address) as pair:
        yield pair


class Bare:
    """A session that speaks in keys and bytes; what comes is kept."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.samples: list[tuple[bytes, bytes]] = []
        self.replies: list[tuple[bytes, bytes]] = []
        self.errors: list[tuple[str, str]] = []
        self.queries: list[Query] = []
        self.tokens: list[str] = []
        self.came = threading.Event()
        self._readers: list[Declared] = []

    def read(self, key: str) -> None:
        self._readers.append(self.session.declare_latched_subscriber(key, self._take, depth=1))

    def publisher(self, key: str) -> Publisher:
        """A publisher that has found its reader."""
        found = threading.Event()
        made = self.session.declare_publisher(
            key, is_reliable=True, matching=lambda is_matching: found.set()
        )
        assert found.wait(10)
        return made

    def serve(self, key: str) -> None:
        self.session.declare_queryable(key, self._asked)

    def ask(self, key: str, payload: bytes, attachment: bytes) -> None:
        """Send a request, and wait for its end."""
        matching, ended = threading.Event(), threading.Event()
        querier = self.session.declare_querier(key, lambda is_matching: matching.set())
        assert matching.wait(10)
        querier.get(
            payload,
            attachment,
            replied=lambda *reply: self.replies.append(reply),
            failed=lambda *error: self.errors.append(error),
            ended=ended.set,
        )
        assert ended.wait(10)

    def close(self) -> None:
        for reader in self._readers:
            reader.undeclare()
        self.session.close()

    def _take(self, payload: bytes, attachment: bytes) -> None:
        self.samples.append((payload, attachment))
        self.came.set()

    def _asked(self, query: Query) -> None:
        self.queries.append(query)
        self.came.set()


@asynccontextmanager
async def bare(address: str) -> AsyncIterator[Bare]:
    settings = session_config([address], [], "peer", DOMAIN, "")
    opened = Bare(await anyio.to_thread.run_sync(Session.open, settings))
    try:
        yield opened
    finally:
        await anyio.to_thread.run_sync(opened.close)


@asynccontextmanager
async def beside(address: str) -> AsyncIterator[tuple[ZenohTransport, Bare]]:
    """A transport, and a bare session that reaches it."""
    async with open_zenoh([], listen=[address]) as transport, bare(address) as other:
        yield transport, other


async def until(transport: ZenohTransport, is_so: Any) -> None:
    """Wait for changes of the graph until something is so."""
    while not is_so():
        await transport.wait_for_change()


async def served_by(other: Bare, transport: ZenohTransport) -> Any:
    """A client of a service of a bare session."""
    caller = transport.join(client(), ASKING)
    await anyio.to_thread.run_sync(other.serve, ADD_KEY)
    await until(transport, lambda: caller.is_served)
    return caller


async def until_read(publication: Any) -> None:
    while not publication.is_read:
        await anyio.sleep(0)


CLOSED = "the Zenoh transport is closed: open another"
GID = bytes(range(16))
ADD_KEY = data_key(DOMAIN, msgspec.structs.replace(service(), type_hash=SERVING.type_hash))
CHATTER_KEY = data_key(DOMAIN, msgspec.structs.replace(publisher(), type_hash=SPEECH.type_hash))
REQUEST = ASKING.encode(numbers(2, 3))


# --- what is on the wire ----------------------------------------------------------------------


async def test_a_message_goes_as_cdr_with_its_number_and_gid(address):
    async with beside(address) as (transport, other):
        await anyio.to_thread.run_sync(other.read, CHATTER_KEY)
        publication = transport.advertise(publisher(), SPEECH)
        await until_read(publication)
        publication.publish(feedback(7))
        publication.publish(feedback(8))
        await transport.flush()
        while len(other.samples) < 2:
            await anyio.to_thread.run_sync(other.came.wait, 10)
        (first, beside_it), (second, _) = other.samples
        assert first.hex(" ", 4) == "00010000 01000000 07000000"
        assert SPEECH.decode(second) == feedback(8)
        read = read_attachment(beside_it)
        assert (len(beside_it), read.sequence) == (33, 1)
        (endpoint,) = transport.endpoints()
        assert read.gid == endpoint.gid


async def test_messages_that_a_publisher_counted_and_that_did_not_arrive_are_told(address):
    async with beside(address) as (transport, other):
        inbox, gaps = Inbox(), list[int]()
        transport.subscribe(subscription(), SPEECH, inbox.deliver, on_gap=gaps.append)
        sender = await anyio.to_thread.run_sync(other.publisher, CHATTER_KEY)
        for number in (3, 4, 7, 8, 10):
            message = SPEECH.encode(feedback(number)) + b"garbage"
            sender.put(message, write_attachment(number, 0, GID))
        sender.put(SPEECH.encode(feedback(0)), write_attachment(1, 0, GID[::-1]))
        while len(inbox.numbers) < 6:
            await anyio.sleep(0)
        assert gaps == [2, 1]


async def test_a_message_that_cannot_be_read_is_logged_and_the_next_is_read(address, caplog):
    async with beside(address) as (transport, other):
        inbox = listen(transport)
        sender = await anyio.to_thread.run_sync(other.publisher, CHATTER_KEY)
        sender.put(b"no message", b"")
        sender.put(SPEECH.encode(feedback(7)), b"")
        while not inbox.numbers:
            await anyio.sleep(0)
    (logged,) = caplog.messages
    assert logged.startswith("topic /chatter: a message cannot be read: message: not plain CDR")


async def test_a_request_of_ros_is_answered_with_its_own_number_and_gid(address):
    async with beside(address) as (transport, other):
        transport.serve(service(), SERVING, adder := Adder())
        beside_it = write_attachment(7, 5, GID)
        await anyio.to_thread.run_sync(other.ask, ADD_KEY, REQUEST, beside_it)
        ((payload, attachment),) = other.replies
        read = read_attachment(attachment)
        assert ASKING.decode(payload) == Sum.Response(total=5)
        assert (read.sequence, read.gid, read.note) == (7, GID, "added up")
        assert read.stamp > 10**18
        assert adder.callers == [GID]


@pytest.mark.parametrize(
    ("payload", "attachment", "said"),
    [
        (REQUEST, b"", "attachment: expected 33 bytes, got 0"),
        (b"", write_attachment(1, 0, GID), "message: not plain CDR"),
        (REQUEST[:6], write_attachment(1, 0, GID), "these 6 bytes are not of type"),
    ],
    ids=["attachment", "nothing", "cut"],
)
async def test_a_request_that_cannot_be_read_is_answered_so(
    address, payload, attachment, said, caplog
):
    async with beside(address) as (transport, other):
        transport.serve(service(), SERVING, adder := Adder())
        await anyio.to_thread.run_sync(other.ask, ADD_KEY, payload, attachment)
        ((text, kind),) = other.errors
        assert (said in text, kind, adder.callers) == (True, "InvalidMessage", [])
    assert "service /add: a request cannot be read" in caplog.text


async def test_a_thread_that_brings_messages_stays_with_python(address):
    """A state made anew for each call would hold nothing of the one before."""
    fresh, state, last = [], threading.local(), threading.Event()

    def take(payload, _attachment):
        if not hasattr(state, "is_known"):
            state.is_known = True
            fresh.append(threading.get_ident())
        if SPEECH.decode(payload) == feedback(9):
            last.set()

    async with beside(address) as (transport, other):
        await anyio.to_thread.run_sync(other.session.declare_subscriber, CHATTER_KEY, take)
        publication = transport.advertise(publisher(), SPEECH)
        await until_read(publication)
        for number in range(10):
            publication.publish(feedback(number))
        assert await anyio.to_thread.run_sync(last.wait, 10)
    assert len(fresh) == len(set(fresh))


async def test_a_note_follows_the_attachment_of_a_request(address):
    heard: list[str] = []

    class Handler(ServiceHandler):
        async def reply(self, request: object, caller: bytes) -> Reply:
            heard.append(REQUEST_NOTE.get())
            return Reply(Sum.Response(total=5))

    async with two(address) as (here, there, _):
        there.serve(service(), SERVING, Handler())
        caller = here.join(client(), ASKING)
        await until(here, lambda: caller.is_served)
        await caller.call(numbers(2, 3), "a note")
        await caller.call(numbers(2, 3))
    assert heard == ["a note", ""]
    async with beside(address) as (transport, other):
        caller = await served_by(other, transport)
        async with running(lambda: caller.call(numbers(2, 3), "a note")):
            await anyio.to_thread.run_sync(other.came.wait, 10)
            (query,) = other.queries
            assert (query.payload, query.attachment[33:]) == (REQUEST, b"a note")
            assert len(query.attachment) == 39
            query.reply(SERVING.encode(Sum.Response(total=5)), query.attachment)


async def test_a_server_of_ros_is_called(address):
    async with beside(address) as (transport, other):
        caller = await served_by(other, transport)
        async with running(lambda: caller.call(numbers(2, 3))) as called:
            await anyio.to_thread.run_sync(other.came.wait, 10)
            (query,) = other.queries
            read = read_attachment(query.attachment)
            assert (query.payload, len(query.attachment)) == (REQUEST, 33)
            assert (read.sequence, read.gid) == (1, transport.endpoints()[0].gid)
            query.reply(SERVING.encode(Sum.Response(total=5)), query.attachment)
        told = called.value
        assert (told.message, told.note) == (Sum.Response(total=5), "")
        assert told.stamp == read.stamp


@pytest.mark.parametrize(
    ("answer", "error", "said"),
    [
        (lambda query: query.reply(b"?", b""), ServiceError, "its response cannot be read"),
        (lambda query: query.fail("no room", ""), ServiceError, "service '/add': no room"),
        (lambda query: query.drop(), ServerUnavailable, "the server went away before"),
    ],
    ids=["bytes", "error", "nothing"],
)
async def test_a_server_of_ros_that_answers_badly(address, answer, error, said):
    async with beside(address) as (transport, other):
        caller = await served_by(other, transport)
        async with running(lambda: caller.call(numbers())) as called:
            await anyio.to_thread.run_sync(other.came.wait, 10)
            answer(other.queries[0])
        assert isinstance(called.error, error)
        assert said in str(called.error)


async def test_a_server_of_ros_that_is_there_and_answers_nothing_may_have_dropped_it(address):
    async with beside(address) as (transport, other):
        caller = transport.join(client(), ASKING)
        announced = msgspec.structs.replace(service(), type_hash=SERVING.type_hash)
        token = endpoint_token(DOMAIN, other.session.zid, 0, 1, announced)
        declared = await anyio.to_thread.run_sync(other.session.declare_token, token)
        await anyio.to_thread.run_sync(other.serve, ADD_KEY)
        await until(transport, lambda: caller.is_served and len(transport.endpoints()) == 2)
        async with running(lambda: caller.call(numbers())) as called:
            await anyio.to_thread.run_sync(other.came.wait, 10)
            other.queries[0].drop()
        assert isinstance(called.error, ServerUnavailable)
        assert called.error.problem == "the server went away before there was an answer"
        assert called.error.otherwise == "dropped the request: ROS 2 keeps 10 that wait"
        declared.undeclare()


async def test_the_same_names_and_gids_are_seen_on_both_sides(peers):
    peers.here.enter("/sim/lab")
    peers.here.advertise(publisher(), SPEECH)
    peers.here.serve(service(), SERVING, Adder())
    await peers.settle()
    assert peers.there.endpoints() == peers.here.endpoints()
    assert peers.there.nodes() == peers.here.nodes() == ("/sim/lab",)
    hashes = [endpoint.type_hash for endpoint in peers.there.endpoints()]
    assert hashes == [SPEECH.type_hash, SERVING.type_hash]
    assert all(len(endpoint.gid) == 16 for endpoint in peers.there.endpoints())


async def test_a_server_that_is_announced_and_cannot_be_reached_is_given_up(address, monkeypatch):
    monkeypatch.setattr(services, "GRACE", 0.05)
    async with beside(address) as (transport, other):
        caller = transport.join(client(), ASKING)
        announced = msgspec.structs.replace(service(), type_hash=SERVING.type_hash)
        token = endpoint_token(DOMAIN, other.session.zid, 0, 1, announced)
        declared = await anyio.to_thread.run_sync(other.session.declare_token, token)
        await until(transport, lambda: len(transport.endpoints()) == 2)
        said = "service '/add': node /adder serves it, but cannot be reached"
        with pytest.raises(ServerUnavailable, match=said):
            await caller.call(numbers())
        assert transport.endpoints()[1].gid == gid_of(token)
        declared.undeclare()


async def test_a_client_that_sees_no_actions_asks_for_the_router(address):
    async with (
        open_zenoh([], listen=[address]) as alone,
        turtleact.open_node("robot", transport=alone) as node,
    ):
        alone.discovery_ends = 0.0  # do not wait for servers
        with pytest.raises(ServerUnavailable, match=r"are the server and the router running\?$"):
            await node.action_client(Fibonacci, "fibonacci").send_goal(Fibonacci.Goal())


RECORDED = """
@ros2_lv/0/ZID/0/N/NN/%/%sim%a/turtle_node
@ros2_lv/0/ZID/0/N/SS/%/%sim%a/turtle_node/%sim%a%turtle1%rotate_absolute%_action%send_goal/\
turtlesim::action::dds_::RotateAbsolute_SendGoal_/\
RIHS01_0b9b876a15971456fbad2c7f0665c9879a41bb3fcba31a9015180a830f0ca84f/::,10:,:,:,,
@ros2_lv/0/ZID/0/N/MP/%/%sim%a/turtle_node/%sim%a%turtle1%rotate_absolute%_action%status/\
action_msgs::msg::dds_::GoalStatusArray_/\
RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e/:1:,1:,:,:,,
"""
"""What rclpy 9.1 on rmw_zenoh_cpp 0.6.7 declares for such a node, without its ids."""


async def test_an_action_server_is_in_the_graph_as_one_of_ros_is(address):
    seen: set[str] = set()

    def note(key: str) -> None:
        chunks = key.split("/")
        chunks[1], chunks[2], chunks[4] = "0", "ZID", "N"
        seen.add("/".join(chunks))

    async with (
        beside(address) as (transport, other),
        turtleact.open_node("turtle_node", namespace="/sim/a", transport=transport) as node,
    ):
        rotate_absolute: Any = turtleact.interfaces.get_interface("turtlesim/action/RotateAbsolute")
        node.action_server(rotate_absolute, "turtle1/rotate_absolute", count)
        await transport.flush()
        other.session.watch_tokens(f"@ros2_lv/{DOMAIN}/**", note, note)
        while len(seen) < 6:
            await anyio.sleep(0)
        assert set(RECORDED.split()) <= seen


async def test_of_several_servers_the_quickest_is_heard(address):
    gate = anyio.Event()
    async with (
        two(address) as peers,
        open_zenoh([address], listen=[]) as third,
    ):
        peers.there.serve(service(), SERVING, slow := Adder(gate=gate))
        third.serve(service(), SERVING, Adder())
        caller = peers.here.join(client(), ASKING)
        await until(peers.here, lambda: len(peers.here.endpoints()) == 3 and caller.is_served)
        await peers.settle()
        assert (await caller.call(numbers(2, 3))).message == Sum.Response(total=5)
        gate.set()
        await peers.settle()
        assert len(slow.callers) == 1


async def test_of_several_servers_one_is_asked_if_the_client_says_so(address):
    async with two(address) as peers, open_zenoh([address], listen=[]) as third:
        servers = [Adder(), Adder()]
        peers.there.serve(service(), SERVING, servers[0])
        third.serve(service(), SERVING, servers[1])
        caller = peers.here.join(client(), ASKING, Target("one"))
        await until(peers.here, lambda: len(peers.here.endpoints()) == 3 and caller.is_served)
        await peers.settle()
        for _ in range(5):
            assert (await caller.call(numbers(2, 3))).message == Sum.Response(total=5)
        assert sorted(len(each.callers) for each in servers) == [0, 5]


@pytest.mark.parametrize("best", [7, 5], ids=["one that counts", "none that counts"])
async def test_a_reply_that_does_not_count_is_used_only_if_no_other_comes(address, best):
    gate = anyio.Event()
    counts = SERVING.encode(Sum.Response(total=7)).__eq__
    async with two(address) as peers, open_zenoh([address], listen=[]) as third:
        peers.there.serve(service(), SERVING, Adder(gate=gate, extra=best - 5))
        third.serve(service(), SERVING, Adder())
        caller = peers.here.join(client(), ASKING, Target(counts=counts))
        await until(peers.here, lambda: len(peers.here.endpoints()) == 3 and caller.is_served)
        await peers.settle()
        async with running(lambda: caller.call(numbers(2, 3))) as called:
            await peers.settle()
            assert not called.done.is_set()
            gate.set()
        assert called.value.message == Sum.Response(total=best)


# --- what costs nothing -----------------------------------------------------------------------


class Counting(WireFormat):
    """Counts what it encodes."""

    encoded = 0

    def encode(self, message: object) -> bytes:
        self.encoded += 1
        return super().encode(message)


async def test_nothing_is_encoded_while_nobody_elsewhere_reads(peers):
    format = Counting(Count.Feedback)
    publication = peers.here.advertise(publisher(), format)
    peers.here.subscribe(subscription(), SPEECH, (inbox := Inbox()).deliver)
    await peers.settle()
    publication.publish(feedback(1))
    assert (inbox.numbers, format.encoded) == ([1], 0)
    peers.there.subscribe(subscription(), SPEECH, inbox.deliver)
    await peers.settle()
    publication.publish(feedback(2))
    assert format.encoded == 1


async def test_many_changes_of_a_state_are_sent_once(peers):
    format, source = Counting(Count.Feedback), Numbers()
    publication = peers.here.advertise(publisher(qos=LATCHED), format, source)
    await peers.settle()
    before = format.encoded
    for source.number in range(100):
        publication.refresh()
    assert format.encoded == before
    await peers.settle()
    assert format.encoded - before < 5
    peers.there.subscribe(subscription(qos=LATCHED), SPEECH, (inbox := Inbox()).deliver)
    await peers.settle()
    assert inbox.numbers[-1] == 99


async def test_the_last_state_is_sent_when_its_publisher_closes(peers):
    source, inbox = Numbers(), Inbox()
    publication = peers.here.advertise(publisher(qos=LATCHED), SPEECH, source)
    peers.there.subscribe(subscription(qos=LATCHED), SPEECH, inbox.deliver)
    await peers.settle()
    source.number = 5
    publication.refresh()
    publication.close()
    await peers.settle()
    assert inbox.numbers[-1] == 5


async def test_a_source_of_a_volatile_topic_is_asked_while_somebody_elsewhere_reads(peers):
    source, inbox = Numbers(), Inbox()
    publication = peers.here.advertise(publisher(), SPEECH, source)
    publication.refresh()
    peers.there.subscribe(subscription(), SPEECH, inbox.deliver)
    await peers.settle()
    source.number = 5
    publication.refresh()
    await peers.settle()
    assert inbox.numbers == [5]


async def test_what_a_latched_source_publishes_itself_is_its_state_elsewhere(peers):
    source, near, far = Numbers(), Inbox(), Inbox()
    publication = peers.here.advertise(publisher(qos=LATCHED), SPEECH, source)
    peers.here.subscribe(subscription(), SPEECH, near.deliver)
    peers.there.subscribe(subscription(), SPEECH, far.deliver)
    await peers.settle()
    source.number = 5
    await say(peers, publication, 4)
    assert (near.numbers[-1], far.numbers[-1]) == (4, 5)


# --- on demand --------------------------------------------------------------------------------


def shy(endpoint):
    return msgspec.structs.replace(endpoint, on_demand=True)


@pytest.mark.parametrize("is_first", [False, True])
async def test_a_topic_on_demand_is_there_for_those_who_read_it(peers, is_first):
    inbox = Inbox()
    if is_first:
        peers.there.subscribe(subscription(), SPEECH, inbox.deliver)
        await peers.settle()
    publication = peers.here.advertise(shy(publisher()), SPEECH)
    if not is_first:
        peers.there.subscribe(subscription(), SPEECH, inbox.deliver)
    await until_read(publication)
    await say(peers, publication, 3)
    assert inbox.numbers == [3]
    assert "/chatter" in {each.name for each in peers.there.endpoints()}


async def test_a_topic_on_demand_is_there_for_those_who_write_it(peers):
    inbox = Inbox()
    peers.here.subscribe(shy(subscription()), SPEECH, inbox.deliver)
    publication = peers.there.advertise(publisher(), SPEECH)
    await until_read(publication)
    await say(peers, publication, 3)
    assert inbox.numbers == [3]


async def test_a_service_on_demand_is_there_for_those_who_ask(peers):
    peers.here.serve(shy(service()), SERVING, Adder())
    caller = peers.there.join(client(), ASKING)
    await until(peers.there, lambda: caller.is_served)
    response: Any = (await caller.call(numbers(2, 3))).message
    assert response.total == 5


async def test_a_latched_source_on_demand_tells_its_state_once_it_is_asked_for(peers):
    source, far = Numbers(), Inbox()
    source.number = 4
    publication = peers.here.advertise(shy(publisher(qos=LATCHED)), SPEECH, source)
    source.number = 5
    publication.refresh()
    await peers.settle()
    peers.there.subscribe(subscription(qos=LATCHED), SPEECH, far.deliver)
    await peers.settle()
    await peers.settle()
    assert far.numbers[-1] == 5


async def test_what_is_on_demand_and_closed_leaves_nothing_behind(peers):
    opened = [
        peers.here.advertise(shy(publisher()), SPEECH),
        peers.here.subscribe(shy(subscription()), SPEECH, Inbox().deliver),
    ]
    for each in opened:
        each.close()
    peers.there.subscribe(subscription(), SPEECH, Inbox().deliver).close()
    await peers.settle()
    assert peers.there.endpoints() == ()


async def test_a_node_without_parameters_answers_those_who_ask_for_them(address):
    async with (
        two(address) as peers,
        turtleact.open_node("lab", transport=peers.here) as lab,
        turtleact.open_node("asker", transport=peers.there) as asker,
    ):
        name = "/lab/list_parameters"
        assert not lab.transport.endpoints(name)
        caller = asker.service_client(ListParameters, name)
        assert await caller.wait_for_service()
        response = await caller.call(ListParameters.Request())
        assert response.result.names == []
        assert {each.name for each in lab.transport.endpoints() if each.kind == "service"} == {
            f"/lab/{service}" for service in PARAMETER_SERVICES
        }


# --- many, and slow ones ----------------------------------------------------------------------


async def test_a_flood_arrives_whole_and_in_order(peers):
    publication, inbox = await connected(peers)
    for number in range(5_000):
        publication.publish(feedback(number))
        if publication.is_congested:
            await publication.drained()
    await peers.settle()
    while len(inbox.numbers) < 5_000:
        await anyio.sleep(0)
    assert inbox.numbers == list(range(5_000))


@pytest.mark.parametrize("closes", [False, True])
async def test_who_publishes_more_than_goes_out_can_wait_until_it_is_out_or_closed(peers, closes):
    gate = threading.Event()
    publication, _ = await connected(peers)
    peers.here.context.send_queue.post(gate.wait)  # as a reader that takes nothing does
    while not publication.is_congested:
        publication.publish(feedback(*range(1000)))
    async with running(publication.drained) as waiting:
        assert not waiting.done.is_set()
        if closes:
            publication.close()
        else:
            gate.set()
        await waiting.done.wait()
    assert closes or not publication.is_congested
    gate.set()


async def test_what_is_written_already_is_sent_to_other_processes_alone(peers):
    near, far = Inbox(), Inbox()
    publication = peers.here.advertise(publisher(), SPEECH)
    peers.there.subscribe(subscription(), SPEECH, far.deliver)
    await peers.settle()
    peers.here.subscribe(subscription(), SPEECH, near.deliver)
    publication.send(SPEECH.encode(feedback(1)))
    await say(peers, publication, 2)
    assert (near.numbers, far.numbers) == ([2], [1, 2])


async def test_what_is_sent_between_two_messages_keeps_its_place(peers, monkeypatch):
    """Else an acceptance would come behind the feedback of a body that never waits."""
    gate = threading.Event()
    seen: list[object] = []

    def note(self, payload, attachment):
        seen.append(SPEECH.decode(payload))

    publication, _ = await connected(peers)
    monkeypatch.setattr(Publisher, "put", note)
    outbox = peers.here.context.send_queue
    outbox.post(gate.wait)
    publication.publish(feedback(1))
    outbox.post(lambda: seen.append("a reply"))
    publication.publish(feedback(2))
    gate.set()
    await peers.here.flush()
    monkeypatch.undo()
    assert seen == [feedback(1), "a reply", feedback(2)]


async def test_a_call_of_a_closed_client_ends_when_its_server_has_gone(peers, monkeypatch):
    monkeypatch.setattr(services, "LOST", 0.0)
    caller = await served(peers, Adder(gate=anyio.Event()), peers.here, by=peers.there)
    async with running(lambda: caller.call(numbers(1))) as called:
        await peers.settle()
        caller.close()
        (token,) = peers.there.graph.tokens
        peers.there.token_gone(token)  # and Zenoh says nothing of the call
        await called.done.wait()
    assert isinstance(called.error, ServerUnavailable)


async def leave_the_graph(user: turtleact.Node, called: Any, settle: Any) -> None:
    """Give the call up, which nobody is told of, and close the node of its client."""
    called.scope.cancel()
    await called.done.wait()
    await settle()
    await user.aclose()


async def end_the_session(user: turtleact.Node, called: Any, settle: Any) -> None:
    """End the session with all that is on it, as the end of a process does."""
    transport: Any = user.transport
    await transport.aclose()


@pytest.mark.parametrize("leave", [leave_the_graph, end_the_session])
async def test_a_handler_is_canceled_once_the_client_of_its_caller_has_gone(address, leave):
    canceled = anyio.Event()

    async def handler(request: Sum.Request) -> Sum.Response:
        try:
            await anyio.sleep_forever()
        finally:
            canceled.set()
        return Sum.Response()  # pragma: no cover  # it is never woken

    async with (
        two(address) as peers,
        turtleact.open_node("lab", transport=peers.here) as lab,
    ):
        lab.service(Sum, "add", handler)
        user = turtleact.Node("user", "/", peers.there)
        asking = user.service_client(Sum, "/add")
        await asking.wait_for_service()
        async with running(lambda: asking.call(numbers())) as called:
            await peers.settle()
            assert not canceled.is_set()
            await leave(user, called, peers.settle)
            await canceled.wait()


@pytest.mark.parametrize("reliability", ["reliable", "best_effort"])
async def test_who_publishes_without_end_loses_the_oldest(
    address, reliability, caplog, monkeypatch
):
    monkeypatch.setattr("turtleact.transports.rmw_zenoh.topics.CAPACITY", 100_000)
    gate, qos = threading.Event(), QoS(depth=3, reliability=reliability)
    async with two(address) as peers:
        inbox = listen(peers.there, subscription(qos=qos))
        publication = peers.here.advertise(publisher(qos=qos), SPEECH)
        await peers.settle()
        peers.here.context.send_queue.post(gate.wait)
        for number in range(1_000):
            publication.publish(feedback(number))
        gate.set()
        await peers.settle()
        while not inbox.numbers or inbox.numbers[-1] != 999:
            await anyio.sleep(0)
    warned = "topic /chatter: more is published than can be sent; the oldest messages are dropped"
    assert caplog.messages.count(warned) == (reliability == "reliable")
    assert len(inbox.numbers) < 1_000


# --- ends -------------------------------------------------------------------------------------


async def test_a_server_that_closes_its_transport_answers_first(address):
    gate = anyio.Event()
    async with open_zenoh([], listen=[address]) as here:
        caller = here.join(client(), ASKING)
        async with open_zenoh([address], listen=[]) as there:
            there.serve(service(), SERVING, adder := Adder(gate=gate))
            await until(here, lambda: caller.is_served)
            async with running(lambda: caller.call(numbers())) as called:
                while not adder.callers:
                    await anyio.sleep(0)
                await there.aclose()
        assert isinstance(called.error, ServerUnavailable)
        assert str(called.error) == "service '/add': the server was closed"
        await until(here, lambda: not caller.is_served and len(here.endpoints()) == 1)


async def test_a_transport_that_closes_ends_its_own_calls(peers):
    gate = anyio.Event()
    caller = await served(peers, Adder(gate=gate))
    async with running(lambda: caller.call(numbers())) as called:
        await peers.here.aclose()
        await called.done.wait()
    said = "the Zenoh transport was closed before there was an answer"
    assert said in str(called.error)
    gate.set()


async def test_a_closed_transport_takes_nothing_more(address):
    async with open_zenoh([], listen=[address]) as transport:
        publication = transport.advertise(publisher(qos=LATCHED), SPEECH)
        caller = transport.join(client(), ASKING)
        await transport.aclose()
        await transport.aclose()
        publication.publish(feedback(1))
        publication.refresh()
        with pytest.raises(TurtleactError):
            await caller.call(numbers())
        for open_it in (
            lambda: transport.advertise(publisher(), SPEECH),
            lambda: transport.subscribe(subscription(), SPEECH, Inbox().deliver),
            lambda: transport.serve(service(), SERVING, Adder()),
            lambda: transport.join(client(), ASKING),
            lambda: transport.enter("/lab"),
        ):
            with pytest.raises(TurtleactError, match=CLOSED):
                open_it()
        for wait in (transport.flush, transport.explore):
            with pytest.raises(TurtleactError, match=CLOSED):
                await wait()
        assert transport.endpoints() == ()


async def test_waiting_for_a_graph_ends_when_its_transport_is_closed(address, monkeypatch):
    monkeypatch.setattr("turtleact.transports.rmw_zenoh.context.GRACE", 0.05)
    gate = threading.Event()
    async with open_zenoh([], listen=[address]) as transport:
        transport.context.send_queue.post(lambda: gate.wait())  # as a peer does that takes nothing
        async with running(transport.flush) as flushing, running(transport.explore) as exploring:
            await settle()
            await transport.aclose()
            for each in (flushing, exploring):
                await each.done.wait()
                assert str(each.error) == CLOSED
        gate.set()


async def test_the_domain_is_that_of_the_environment_unless_one_is_given(address, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    async with (
        open_zenoh([], listen=[address]) as here,
        open_zenoh([address], listen=[], domain=7) as there,
    ):
        here.enter("/lab")
        await until(there, lambda: there.nodes() == ("/lab",))


async def test_a_domain_of_the_environment_that_is_none_is_said(address, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "many")
    with pytest.raises(InvalidOption, match="ROS_DOMAIN_ID': expected 0 to 232, not 'many'"):
        await open_zenoh([], listen=[address]).__aenter__()


async def test_a_handler_that_never_ends_does_not_keep_a_transport_open(address, monkeypatch):
    monkeypatch.setattr("turtleact.transports.rmw_zenoh.context.GRACE", 0.01)

    class Stubborn(Adder):
        async def reply(self, request: Any, caller: bytes) -> Any:
            self.callers.append(caller)
            with anyio.CancelScope(shield=True):
                await gate.wait()

    gate = anyio.Event()
    async with open_zenoh([], listen=[address]) as here:
        caller = here.join(client(), ASKING)
        async with open_zenoh([address], listen=[]) as there:
            there.serve(service(), SERVING, stubborn := Stubborn())
            await until(here, lambda: caller.is_served)
            async with running(lambda: caller.call(numbers())) as called:
                while not stubborn.callers:
                    await anyio.sleep(0)
                await there.aclose()
                await called.done.wait()
        assert isinstance(called.error, ServerUnavailable)
        gate.set()
        await settle()


SERVER = """
import sys, anyio
from turtleact.interfaces import WireFormat
from turtleact.transports import open_zenoh
from turtleact.transports.base import Endpoint, Reply, ServiceHandler, Target
from turtleact.interfaces.standard import CancelGoal

class Silent(ServiceHandler):
    async def reply(self, request, caller):
        print("asked", flush=True)
        await anyio.sleep_forever()

async def main():
    async with open_zenoh([sys.argv[1]], listen=[]) as transport:
        transport.serve(
            Endpoint("service", "/cancel", CancelGoal.type_name, "/far"),
            WireFormat(CancelGoal),
            Silent(),
        )
        await anyio.sleep_forever()

anyio.run(main)
"""


@asynccontextmanager
async def far_server(address: str) -> AsyncIterator[subprocess.Popen[str]]:
    """A process with a server that never answers."""
    command = [sys.executable, "-W", "error", "-c", SERVER, address]
    with warm.start(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


CANCEL = WireFormat(turtleact.interfaces.standard.CancelGoal, asks=True)
CANCELER = Endpoint("client", "/cancel", "action_msgs/srv/CancelGoal", "/near")


async def test_a_server_that_is_killed_ends_the_calls_to_it(address):
    async with open_zenoh([], listen=[address]) as transport, far_server(address) as process:
        caller = transport.join(CANCELER, CANCEL)
        await until(transport, lambda: caller.is_served)
        request = turtleact.interfaces.standard.CancelGoal.Request()
        async with running(lambda: caller.call(request)) as called:
            said: Any = process.stdout
            await anyio.to_thread.run_sync(said.readline)
            process.send_signal(signal.SIGKILL)
            await called.done.wait()
        assert isinstance(called.error, ServerUnavailable)
        assert "the server went away" in str(called.error)
        await until(transport, lambda: len(transport.endpoints()) == 1)


# --- opening ----------------------------------------------------------------------------------


async def test_a_graph_out_of_reach_is_said_at_once(address):
    with pytest.raises(TurtleactError, match="reach: no router answers at unixsock") as said:
        await open_zenoh([address], listen=[]).__aenter__()
    assert str(said.value).endswith("; 'turtleact serve' starts one")


@pytest.mark.parametrize("mode", ["peer", "client"])
async def test_who_listens_and_says_nothing_is_given_up(mode):
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        at = f"tcp/127.0.0.1:{silent.getsockname()[1]}"
        hurry = {"transport/unicast/open_timeout": 50}
        with pytest.raises(TurtleactError, match=f"no router (answers )?at {at}"):
            await open_zenoh([at], listen=[], mode=mode, config=hurry).__aenter__()


async def test_a_port_that_is_taken_is_said():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        at = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        said = (
            rf"^cannot listen at {at}: Address already in use [^\[\]]*; if a router listens there"
        )
        with pytest.raises(TurtleactError, match=said):
            await open_zenoh(mode="router", listen=[at]).__aenter__()


@pytest.mark.parametrize(
    ("config", "said"),
    [({"no/such": 1}, "unknown key"), ("{mode: 'boat'}", "unknown variant"), ("{", "Zenoh says")],
)
async def test_a_configuration_that_zenoh_does_not_take_is_refused(config, said):
    with pytest.raises(InvalidOption, match=said):
        await open_zenoh([], listen=[], config=config).__aenter__()


async def test_a_whole_file_configures_a_session(address):
    text = f"{{mode: 'peer', listen: {{endpoints: ['{address}']}}, connect: {{endpoints: []}}}}"
    async with (
        open_zenoh(config=text) as here,
        open_zenoh([address], listen=[]) as there,
        acquainted(here, there) as meet,
    ):
        here.enter("/lab")
        await meet()
        assert there.nodes() == ("/lab",)


def test_turtleact_is_imported_without_zenoh():
    code = "import sys, turtleact.transports; print('zenoh' in sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout == "False\n"


# --- nodes ------------------------------------------------------------------------------------


@asynccontextmanager
async def counted(address: str, body: Any):
    """A node that serves a body, and the handle of a goal that another process has sent to it."""
    async with two_nodes(address) as (_, lab, user):
        lab.action_server(Count, "count", body)
        client = user.action_client(Count, "count")
        assert await client.wait_for_server()
        async with client.send_goal(goal(1)) as handle:
            yield lab, handle


async def test_a_service_error_that_utf_8_cannot_encode_is_escaped(peers):
    caller = await served(peers, Adder(ServiceError("/add", "caf\udce9")))
    with pytest.raises(ServiceError, match=re.escape(r"caf\udce9")):
        await caller.call(numbers())


async def test_who_attaches_itself_later_sees_the_last_feedback_sent_to_another_process(address):
    gate = anyio.Event()

    async def body(_):
        yield feedback(1)
        yield feedback(2)
        await gate.wait()
        yield feedback(3)
        yield result(4)

    async with counted(address, body) as (lab, handle):
        assert [await anext(handle) for _ in range(2)] == [feedback(1), feedback(2)]
        beside = await lab.action_client(Count, "count").attach(handle.goal_id)
        assert beside.last_feedback == feedback(2)
        gate.set()
        assert await handle.result() == result(4)
        assert beside.last_feedback == feedback(3)


@asynccontextmanager
async def newcomer(address: str, **options: Any) -> AsyncIterator[turtleact.Node]:
    """A node whose session has just been opened, while another has been serving for a while."""
    async with (
        open_zenoh([], listen=[address]) as there,
        turtleact.open_node("lab", transport=there) as lab,
    ):
        lab.action_server(Count, "count", count)
        lab.service(Sum, "add", lambda request: Sum.Response(total=sum(request.numbers)))
        await there.flush()
        async with (
            open_zenoh([address], listen=[], **options) as here,
            turtleact.open_node("user", transport=here) as user,
        ):
            yield user


async def send(user: turtleact.Node) -> Any:
    return await user.action_client(Count, "count").send_goal(goal())


async def attach(user: turtleact.Node) -> Any:
    try:
        return await user.action_client(Count, "count").attach(bytes(range(16)))
    except UnknownGoal:
        return "unknown"


async def cancel(user: turtleact.Node) -> Any:
    return (await user.action_client(Count, "count").cancel_all()).return_code


async def call(user: turtleact.Node) -> Any:
    return (await user.service_client(Sum, "add").call(numbers(2, 3))).total


@pytest.mark.parametrize(
    ("ask", "answer"), [(send, result(0, 1, 2)), (attach, "unknown"), (cancel, 0), (call, 5)]
)
async def test_who_has_just_come_need_not_wait_for_a_server(address, ask, answer):
    async with newcomer(address) as user:
        assert await ask(user) == answer


@pytest.mark.parametrize("ask", [send, attach, cancel, call])
async def test_a_server_is_not_waited_for_once_the_discovery_is_over(address, ask):
    async with (
        open_zenoh([], listen=[address], discovery=0.01) as transport,
        turtleact.open_node("user", transport=transport) as user,
    ):
        with pytest.raises(ServerUnavailable, match="no server answers"):
            await ask(user)
        assert transport.discovery_ends <= anyio.current_time()


@pytest.mark.parametrize("discovery", ["long", None, True, float("nan")])
async def test_a_discovery_without_a_length_is_refused(discovery):
    problem = f"option 'discovery': expected a number of seconds, not {discovery!r}$"
    with pytest.raises(InvalidOption, match=problem):
        async with open_zenoh(discovery=discovery):
            pass


async def test_actions_whose_definitions_differ_are_named_before_the_discovery_ends(address):
    with isolated_registry():

        class Longer(Action, type_name=Count.type_name):
            class Goal(Message):
                upto: int32 = 0
                step: int32 = 1

            Result, Feedback = Count.Result, Count.Feedback

    async with (
        open_zenoh([], listen=[address]) as there,
        turtleact.open_node("lab", transport=there) as lab,
        open_zenoh([address], listen=[], discovery=600.0) as here,
        turtleact.open_node("user", transport=here) as user,
    ):
        lab.action_server(Count, "count", count)
        with pytest.raises(ServerUnavailable) as caught:
            await user.action_client(Longer, "count").send_goal(Longer.Goal())
        theirs, ours = (implied(each).send_goal for each in (Count, Longer))
        assert str(caught.value) == (
            f"action '/count': the definitions of {Count.type_name} differ: its type hash is "
            f"{type_hash(theirs)} at the server, {type_hash(ours)} here; both sides need the same "
            f"one; {Count.type_name}_Goal has 'int32 step' here, no further field there"
        )
        assert anyio.current_time() < here.discovery_ends


async def test_a_description_of_more_than_4_mb_is_refused_before_it_is_decoded(address, tmp_path):
    async with two_nodes(address) as (peers, _, user):
        robot = Robot(cast("Any", peers.there), write_package(tmp_path))
        robot.answer = lambda _, truth: type(truth)(failure_reason="x" * 4_000_000)
        robot.open("publisher", "/battery", "robot_msgs/msg/Battery")
        told = r"node /robot: .*the answer has 4,000,\d+ bytes, over 4,000,000"
        with pytest.raises(turtleact.NotLearned, match=told):
            await turtleact.learn_interface(user, "/battery", timeout=5)


async def test_a_goal_may_take_longer_than_zenoh_waits(address, monkeypatch):
    monkeypatch.setattr("turtleact.transports.rmw_zenoh.session.PATIENCE", 0.1)
    gate, asked = Gate(), list[bytes]()

    class Counting(ServiceHandler):
        """Counts the requests for results; the third one opens the gate."""

        def __init__(self, handler: Any) -> None:
            self._handler = handler

        async def reply(self, request: object, caller: bytes) -> Any:
            asked.append(caller)
            if len(asked) == 3:
                gate.opened.set()
            return await self._handler.reply(request, caller)

    def serve(endpoint: Endpoint, format: Any, handler: ServiceHandler) -> Any:
        is_counted = endpoint.name.endswith("get_result")
        return offer(endpoint, format, Counting(handler) if is_counted else handler)

    async with two(address) as (here, there, _):
        offer = here.serve
        monkeypatch.setattr(here, "serve", serve)
        async with (
            turtleact.open_node("robot", transport=here) as robot,
            turtleact.open_node("guest", transport=there) as guest,
        ):
            robot.action_server(Count, "count", gate.wait)
            action_client = guest.action_client(Count, "count")
            assert await action_client.wait_for_server(5)
            assert await action_client.send_goal(goal(7)) == result(7)
            assert len(asked) >= 3


async def test_a_call_that_takes_longer_is_told(address, monkeypatch):
    monkeypatch.setattr("turtleact.transports.rmw_zenoh.session.PATIENCE", 0.1)
    async with two(address) as (here, there, _):
        opened = anyio.Event()

        class Slow(ServiceHandler):
            async def reply(self, request: object, caller: bytes) -> Any:
                await opened.wait()

        here.serve(service(), SERVING, Slow())
        caller = there.join(client(), ASKING)
        await until(there, lambda: caller.is_served)
        with pytest.raises(ServiceTimeout):
            await caller.call(Sum.Request())
        opened.set()


async def test_a_change_of_the_graph_is_told_once_a_reader_is_reached(address):
    async with two(address) as (here, there, _):
        publication = here.advertise(publisher(), SPEECH)
        there.subscribe(subscription(), SPEECH, print)
        while not publication.has_readers:
            await here.wait_for_change()


class Unending:
    """A session of Zenoh that cannot be closed."""

    def zid(self) -> str:
        return "ab"

    def close(self) -> None:
        raise zenoh.ZError("close operation timed out! at /zenoh/close.rs:135.")


def test_a_session_that_zenoh_cannot_close_is_left_behind_with_a_word(caplog):
    Session(cast("zenoh.Session", Unending())).close()
    said = "Zenoh cannot close its session: close operation timed out; it is left open"
    assert caplog.messages == [said]


def test_a_latched_publisher_is_closed_though_zenoh_waits_to_call_python(address):
    session = Session.open(session_config([], [address], "peer", 0, ""))
    other = Session.open(session_config([address], [], "peer", 0, ""))
    called, goes_on = threading.Event(), threading.Event()

    def keep_busy(is_matching: bool) -> None:
        called.set()
        goes_on.wait(10)

    latched = session.declare_latched_publisher("latched", is_reliable=True, depth=1)
    watched = session.declare_publisher("watched", is_reliable=True, matching=keep_busy)
    reader = other.declare_subscriber("watched", print)
    assert called.wait(10)
    began = time.perf_counter()
    goes_on.set()  # it goes on once it gets the GIL, and its thread ends the task of the publisher
    latched.undeclare()
    assert time.perf_counter() - began < 5
    reader.undeclare()
    watched.undeclare()
    other.close()
    session.close()


async def test_nothing_stays_of_a_latched_subscription_that_is_closed(address):
    async with two(address) as (here, there, settle):

        async def parts() -> list[str]:
            await settle()
            return await anyio.to_thread.run_sync(here.context.session.tokens, "**/@adv/**")

        reader = there.subscribe(subscription(qos=LATCHED), SPEECH, Inbox().deliver)
        assert len(await parts()) == 1
        reader.close()
        assert await parts() == []


async def test_what_waits_behind_a_message_that_cannot_be_sent_is_sent(
    address, monkeypatch, caplog
):
    gate, put = threading.Event(), Publisher.put

    def fail_once(self, payload, attachment):
        if SPEECH.decode(payload) == feedback(1):
            raise TurtleactError("Zenoh cannot publish: as a test wants it")
        put(self, payload, attachment)

    async with two(address) as peers:
        publication, inbox = await connected(peers)
        monkeypatch.setattr(Publisher, "put", fail_once)
        peers.here.context.send_queue.post(gate.wait)
        for number in range(4):
            publication.publish(feedback(number))
        gate.set()
        await peers.here.flush()
        monkeypatch.undo()
        await peers.settle()
    assert inbox.numbers == [0, 2, 3]
    assert "as a test wants it" in caplog.text


async def test_odd_feedback_is_converted_or_refused_for_another_process_too(address):
    odd: Any = (1, 2)
    told: list[str] = []

    async def body(_):
        yield Count.Feedback(so_far=odd)
        try:
            yield Count.Feedback(so_far=[3, True])
        except InvalidMessage as error:
            told.append(str(error))
        yield result(4)

    async with counted(address, body) as (_, handle):
        assert [each async for each in handle] == [feedback(1, 2)]
        assert await handle.result() == result(4)
    assert told == ["feedback.so_far[1]: expected a whole number (int32), got True"]
