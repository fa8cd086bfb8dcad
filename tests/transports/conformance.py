"""What every transport must do: one suite, put to each of them.

A transport's test module subclasses `TransportConformance` and gives it the fixture ``transport``:
a function that opens two peers of one graph. Nothing here knows how they talk; what takes its time
on its way is waited for by `Peers.settle`.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Awaitable, Callable
from contextlib import AbstractAsyncContextManager
from typing import Any, NamedTuple, TypeAlias

import pytest

from turtleact.transports import QoS, Transport
from turtleact.transports.base import Endpoint, EndpointKind

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

TYPE = Count.Feedback.type_name
LATCHED = QoS(depth=2, durability="transient_local")
KINDS: tuple[EndpointKind, ...] = ("publisher", "subscription", "service", "client")

BOTH_WAYS = pytest.mark.parametrize("end", ["here", "there"])
EACH_KIND = pytest.mark.parametrize("kind", KINDS)


class Handler:
    """What serves a service; a transport does not look into it."""


class Inbox:
    """A subscriber that keeps what it is given."""

    def __init__(self) -> None:
        self.numbers: list[int] = []
        self.threads: set[int] = set()

    def deliver(self, message: Any) -> None:
        self.numbers += message.so_far
        self.threads.add(threading.get_ident())


def publisher(name: str = "/chatter", qos: QoS | None = None, type_name: str = TYPE) -> Endpoint:
    return Endpoint("publisher", name, type_name, "/talker", qos or QoS())


def subscription(name: str = "/chatter", qos: QoS | None = None, type_name: str = TYPE) -> Endpoint:
    return Endpoint("subscription", name, type_name, "/listener", qos or QoS())


def service(name: str = "/add", type_name: str = "lab_interfaces/srv/Add") -> Endpoint:
    return Endpoint("service", name, type_name, "/adder")


def of_kind(kind: EndpointKind, name: str = "/it") -> Endpoint:
    return Endpoint(kind, name, TYPE, "/lab")


def open_it(transport: Transport, endpoint: Endpoint) -> Any:
    """Open an endpoint by the method for its kind."""
    if endpoint.kind == "publisher":
        return transport.advertise(endpoint)
    if endpoint.kind == "subscription":
        return transport.subscribe(endpoint, Inbox().deliver)
    if endpoint.kind == "service":
        return transport.serve(endpoint, Handler())
    return transport.join(endpoint)


class TransportConformance:
    """The suite; a subclass gives the fixture ``transport``."""

    @pytest.fixture
    def transport(self) -> OpenPeers:
        raise NotImplementedError("a subclass says how its peers are opened")

    # topics

    @BOTH_WAYS
    async def test_a_message_reaches_a_subscription(self, transport, end):
        async with transport() as peers:
            inbox = Inbox()
            getattr(peers, end).subscribe(subscription(), inbox.deliver)
            publication = peers.here.advertise(publisher())
            await peers.settle()
            publication.publish(feedback(7))
            await peers.settle()
            assert inbox.numbers == [7]

    @BOTH_WAYS
    async def test_messages_arrive_in_the_order_of_their_publishing(self, transport, end):
        async with transport() as peers:
            inbox = Inbox()
            getattr(peers, end).subscribe(subscription(qos=QoS(depth=200)), inbox.deliver)
            publication = peers.here.advertise(publisher(qos=QoS(depth=200)))
            await peers.settle()
            for number in range(200):
                publication.publish(feedback(number))
            await peers.settle()
            assert inbox.numbers == list(range(200))

    async def test_a_message_reaches_every_subscription(self, transport):
        async with transport() as peers:
            inboxes = [Inbox(), Inbox(), Inbox()]
            for peer, inbox in zip((peers.here, peers.here, peers.there), inboxes, strict=True):
                peer.subscribe(subscription(), inbox.deliver)
            publication = peers.here.advertise(publisher())
            await peers.settle()
            publication.publish(feedback(7))
            await peers.settle()
            assert [inbox.numbers for inbox in inboxes] == [[7], [7], [7]]

    async def test_two_subscriptions_may_share_what_takes_their_messages(self, transport):
        async with transport() as peers:
            inbox = Inbox()
            first = peers.here.subscribe(subscription(), inbox.deliver)
            peers.here.subscribe(subscription(), inbox.deliver)
            publication = peers.here.advertise(publisher())
            await peers.settle()
            publication.publish(feedback(7))
            first.close()
            await peers.settle()
            publication.publish(feedback(8))
            await peers.settle()
            assert inbox.numbers.count(8) == 1

    async def test_a_subscription_hears_every_publisher(self, transport):
        async with transport() as peers:
            inbox = Inbox()
            peers.here.subscribe(subscription(), inbox.deliver)
            one, other = peers.here.advertise(publisher()), peers.there.advertise(publisher())
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
    async def test_a_subscription_of_something_else_hears_nothing(self, transport, wanted):
        async with transport() as peers:
            inbox = Inbox()
            peers.there.subscribe(wanted, inbox.deliver)
            publication = peers.here.advertise(publisher())
            await peers.settle()
            publication.publish(feedback(7))
            await peers.settle()
            assert inbox.numbers == []

    async def test_a_message_is_delivered_where_the_event_loop_runs(self, transport):
        async with transport() as peers:
            inbox = Inbox()
            peers.there.subscribe(subscription(), inbox.deliver)
            publication = peers.here.advertise(publisher())
            await peers.settle()
            publication.publish(feedback(7))
            await peers.settle()
            assert inbox.threads == {threading.get_ident()}

    async def test_a_message_can_be_published_where_nobody_reads(self, transport):
        async with transport() as peers:
            publication = peers.here.advertise(publisher())
            publication.publish(feedback(7))
            inbox = Inbox()
            await peers.settle()
            peers.there.subscribe(subscription(), inbox.deliver)
            await peers.settle()
            assert inbox.numbers == []

    # a subscriber that fails

    async def test_a_subscriber_that_fails_harms_neither_publisher_nor_others(self, transport):
        def fail(message: object) -> None:
            raise ValueError("no room")

        async with transport() as peers:
            inbox = Inbox()
            peers.there.subscribe(subscription(), fail)
            peers.there.subscribe(subscription(), inbox.deliver)
            publication = peers.here.advertise(publisher())
            await peers.settle()
            publication.publish(feedback(7))
            await peers.settle()
            assert inbox.numbers == [7]

    async def test_what_a_subscriber_raises_is_logged(self, transport, caplog):
        def fail(message: object) -> None:
            raise ValueError("no room")

        async with transport() as peers:
            peers.there.subscribe(subscription(), fail)
            publication = peers.here.advertise(publisher())
            await peers.settle()
            publication.publish(feedback(7))
            await peers.settle()
        (record,) = caplog.records
        assert (record.name, record.levelno) == ("turtleact.transport", logging.ERROR)
        assert record.getMessage() == "a subscription of topic /chatter failed on a message"
        assert "no room" in str(record.exc_info)

    async def test_a_subscriber_that_has_failed_gets_the_next_message(self, transport):
        async with transport() as peers:
            inbox = Inbox()

            def fail_once(message: object) -> None:
                inbox.deliver(message)
                if inbox.numbers == [1]:
                    raise ValueError("no room")

            peers.there.subscribe(subscription(), fail_once)
            publication = peers.here.advertise(publisher())
            await peers.settle()
            publication.publish(feedback(1))
            publication.publish(feedback(2))
            await peers.settle()
            assert inbox.numbers == [1, 2]

    async def test_a_subscriber_that_fails_on_a_latched_message_stays(self, transport):
        async with transport() as peers:
            inbox = Inbox()

            def fail_once(message: object) -> None:
                inbox.deliver(message)
                if inbox.numbers == [1]:
                    raise ValueError("no room")

            publication = peers.here.advertise(publisher(qos=LATCHED))
            publication.publish(feedback(1))
            await peers.settle()
            peers.there.subscribe(subscription(qos=LATCHED), fail_once)
            await peers.settle()
            publication.publish(feedback(2))
            await peers.settle()
            assert inbox.numbers == [1, 2]

    # latched messages

    @BOTH_WAYS
    async def test_a_late_subscription_gets_the_last_latched_messages_first(self, transport, end):
        async with transport() as peers:
            publication = peers.here.advertise(publisher(qos=LATCHED))
            for number in (1, 2, 3):
                publication.publish(feedback(number))
            await peers.settle()
            inbox = Inbox()
            getattr(peers, end).subscribe(subscription(qos=LATCHED), inbox.deliver)
            await peers.settle()
            publication.publish(feedback(4))
            await peers.settle()
            assert inbox.numbers == [2, 3, 4]

    async def test_latched_messages_of_several_publishers_all_come(self, transport):
        async with transport() as peers:
            for number in (1, 2):
                peers.here.advertise(publisher(qos=LATCHED)).publish(feedback(number))
            await peers.settle()
            inbox = Inbox()
            peers.there.subscribe(subscription(qos=LATCHED), inbox.deliver)
            await peers.settle()
            assert sorted(inbox.numbers) == [1, 2]

    async def test_a_latched_message_does_not_come_twice(self, transport):
        async with transport() as peers:
            inbox = Inbox()
            peers.there.subscribe(subscription(qos=LATCHED), inbox.deliver)
            publication = peers.here.advertise(publisher(qos=LATCHED))
            await peers.settle()
            publication.publish(feedback(1))
            await peers.settle()
            peers.there.subscribe(subscription(qos=LATCHED), Inbox().deliver)
            await peers.settle()
            assert inbox.numbers == [1]

    @pytest.mark.parametrize(
        ("sent", "wanted"),
        [(LATCHED, QoS()), (QoS(), LATCHED), (QoS(), QoS())],
        ids=["reader-volatile", "publisher-volatile", "both-volatile"],
    )
    async def test_old_messages_come_only_if_both_sides_want_them(self, transport, sent, wanted):
        async with transport() as peers:
            publication = peers.here.advertise(publisher(qos=sent))
            publication.publish(feedback(1))
            await peers.settle()
            inbox = Inbox()
            peers.there.subscribe(subscription(qos=wanted), inbox.deliver)
            await peers.settle()
            publication.publish(feedback(2))
            await peers.settle()
            assert inbox.numbers == [2]

    async def test_latched_messages_go_with_their_publisher(self, transport):
        async with transport() as peers:
            publication = peers.here.advertise(publisher(qos=LATCHED))
            publication.publish(feedback(1))
            await peers.settle()
            publication.close()
            await peers.settle()
            inbox = Inbox()
            peers.there.subscribe(subscription(qos=LATCHED), inbox.deliver)
            await peers.settle()
            assert inbox.numbers == []

    # who reads

    async def test_a_publisher_without_subscriptions_has_no_readers(self, transport):
        async with transport() as peers:
            publication = peers.here.advertise(publisher())
            peers.there.subscribe(subscription("/chatter2"), Inbox().deliver)
            await peers.settle()
            assert not publication.has_readers

    @BOTH_WAYS
    async def test_a_publisher_has_readers_as_long_as_a_subscription_is_open(self, transport, end):
        async with transport() as peers:
            publication = peers.here.advertise(publisher())
            subscribed = getattr(peers, end).subscribe(subscription(), Inbox().deliver)
            await peers.settle()
            assert publication.has_readers
            subscribed.close()
            await peers.settle()
            assert not publication.has_readers

    async def test_a_publisher_that_latches_may_have_readers_later(self, transport):
        async with transport() as peers:
            assert peers.here.advertise(publisher(qos=LATCHED)).has_readers

    @pytest.mark.parametrize("qos", [QoS(), LATCHED], ids=["volatile", "latched"])
    async def test_a_closed_publisher_has_no_readers(self, transport, qos):
        async with transport() as peers:
            publication = peers.here.advertise(publisher(qos=qos))
            peers.there.subscribe(subscription(), Inbox().deliver)
            await peers.settle()
            publication.close()
            assert not publication.has_readers

    # closing

    @BOTH_WAYS
    async def test_a_closed_subscription_gets_nothing_more(self, transport, end):
        async with transport() as peers:
            inbox, other = Inbox(), Inbox()
            subscribed = getattr(peers, end).subscribe(subscription(), inbox.deliver)
            getattr(peers, end).subscribe(subscription(), other.deliver)
            publication = peers.here.advertise(publisher())
            await peers.settle()
            publication.publish(feedback(1))
            await peers.settle()
            subscribed.close()
            publication.publish(feedback(2))
            await peers.settle()
            assert (inbox.numbers, other.numbers) == ([1], [1, 2])

    async def test_a_subscription_closed_by_another_one_gets_nothing_more(self, transport):
        async with transport() as peers:
            inboxes = [Inbox(), Inbox()]
            subscribed: list[Any] = []

            def take_and_close(mine: int, message: object) -> None:
                inboxes[mine].deliver(message)
                subscribed[1 - mine].close()

            for mine in range(2):
                subscribed.append(
                    peers.there.subscribe(
                        subscription(), lambda message, mine=mine: take_and_close(mine, message)
                    )
                )
            publication = peers.here.advertise(publisher())
            await peers.settle()
            publication.publish(feedback(1))
            await peers.settle()
            assert sorted(inbox.numbers for inbox in inboxes) == [[], [1]]

    async def test_a_subscriber_may_close_itself(self, transport):
        async with transport() as peers:
            inbox = Inbox()

            def take_one(message: object) -> None:
                inbox.deliver(message)
                subscribed.close()

            subscribed = peers.there.subscribe(subscription(), take_one)
            publication = peers.here.advertise(publisher())
            await peers.settle()
            publication.publish(feedback(1))
            publication.publish(feedback(2))
            await peers.settle()
            assert inbox.numbers == [1]

    async def test_a_subscriber_that_closes_itself_takes_nothing_from_others(self, transport):
        async with transport() as peers:
            other = Inbox()

            def leave(message: object) -> None:
                subscribed.close()

            subscribed = peers.there.subscribe(subscription(), leave)
            peers.there.subscribe(subscription(), other.deliver)
            publication = peers.here.advertise(publisher())
            await peers.settle()
            publication.publish(feedback(1))
            await peers.settle()
            assert other.numbers == [1]

    async def test_a_closed_publisher_gives_nothing_more(self, transport):
        async with transport() as peers:
            inbox = Inbox()
            peers.there.subscribe(subscription(), inbox.deliver)
            publication = peers.here.advertise(publisher())
            await peers.settle()
            publication.publish(feedback(1))
            await peers.settle()
            publication.close()
            publication.publish(feedback(2))
            await peers.settle()
            assert inbox.numbers == [1]

    async def test_a_topic_deserted_by_all_can_be_opened_again(self, transport):
        async with transport() as peers:
            peers.here.advertise(publisher()).close()
            peers.there.subscribe(subscription(), Inbox().deliver).close()
            await peers.settle()
            inbox = Inbox()
            publication = peers.here.advertise(publisher())
            peers.there.subscribe(subscription(), inbox.deliver)
            await peers.settle()
            publication.publish(feedback(1))
            await peers.settle()
            assert inbox.numbers == [1]

    async def test_a_publisher_outlives_the_last_subscription(self, transport):
        async with transport() as peers:
            publication = peers.here.advertise(publisher())
            peers.there.subscribe(subscription(), Inbox().deliver).close()
            await peers.settle()
            inbox = Inbox()
            peers.there.subscribe(subscription(), inbox.deliver)
            await peers.settle()
            publication.publish(feedback(1))
            await peers.settle()
            assert inbox.numbers == [1]

    async def test_a_subscription_outlives_the_last_publisher(self, transport):
        async with transport() as peers:
            inbox = Inbox()
            peers.there.subscribe(subscription(), inbox.deliver)
            peers.here.advertise(publisher()).close()
            await peers.settle()
            publication = peers.here.advertise(publisher())
            await peers.settle()
            publication.publish(feedback(1))
            await peers.settle()
            assert inbox.numbers == [1]

    @EACH_KIND
    async def test_closing_twice_is_closing_once(self, transport, kind):
        async with transport() as peers:
            first, _ = open_it(peers.here, of_kind(kind)), open_it(peers.here, of_kind(kind))
            first.close()
            first.close()
            await peers.settle()
            assert peers.here.endpoints() == (of_kind(kind),)

    # the graph

    @BOTH_WAYS
    @EACH_KIND
    async def test_an_endpoint_is_in_the_graph_while_it_is_open(self, transport, kind, end):
        async with transport() as peers:
            opened = open_it(peers.here, of_kind(kind))
            await peers.settle()
            assert getattr(peers, end).endpoints() == (of_kind(kind),)
            opened.close()
            await peers.settle()
            assert getattr(peers, end).endpoints() == ()

    async def test_endpoints_are_in_the_order_of_their_opening(self, transport):
        wanted = [of_kind(kind, f"/{name}") for name in "ba" for kind in reversed(KINDS)]
        async with transport() as peers:
            for endpoint in wanted:
                open_it(peers.here, endpoint)
            assert list(peers.here.endpoints()) == wanted

    async def test_an_endpoint_shows_its_quality_of_service(self, transport):
        qos = QoS(depth=3, durability="transient_local", reliability="best_effort")
        async with transport() as peers:
            peers.here.advertise(publisher(qos=qos))
            await peers.settle()
            assert [endpoint.qos for endpoint in peers.there.endpoints()] == [qos]

    @BOTH_WAYS
    async def test_a_node_is_in_the_graph_from_entering_to_closing(self, transport, end):
        async with transport() as peers:
            entered = peers.here.enter("/sim/lab")
            await peers.settle()
            assert getattr(peers, end).nodes() == ("/sim/lab",)
            entered.close()
            await peers.settle()
            assert getattr(peers, end).nodes() == ()

    async def test_of_two_nodes_of_one_name_each_is_in_the_graph(self, transport):
        async with transport() as peers:
            first, _ = peers.here.enter("/lab"), peers.there.enter("/lab")
            await peers.settle()
            assert peers.here.nodes() == ("/lab", "/lab")
            first.close()
            first.close()
            await peers.settle()
            assert peers.here.nodes() == ("/lab",)

    @BOTH_WAYS
    @EACH_KIND
    async def test_opening_and_closing_an_endpoint_is_a_change(self, transport, kind, end):
        async with transport() as peers:
            async with running(getattr(peers, end).wait_for_change) as waiting:
                assert not waiting.done.is_set()
                opened = open_it(peers.here, of_kind(kind))
                await waiting.done.wait()
            await peers.settle()
            async with running(getattr(peers, end).wait_for_change) as waiting:
                assert not waiting.done.is_set()
                opened.close()
                await waiting.done.wait()

    @BOTH_WAYS
    async def test_a_node_that_comes_or_goes_is_a_change(self, transport, end):
        async with transport() as peers:
            async with running(getattr(peers, end).wait_for_change) as waiting:
                entered = peers.here.enter("/lab")
                await waiting.done.wait()
            await peers.settle()
            async with running(getattr(peers, end).wait_for_change) as waiting:
                assert not waiting.done.is_set()
                entered.close()
                await waiting.done.wait()

    async def test_a_change_wakes_all_who_wait_for_one(self, transport):
        async with transport() as peers:
            wait = peers.here.wait_for_change
            async with running(wait) as first, running(wait) as second:
                peers.there.enter("/lab")
                await first.done.wait()
                await second.done.wait()

    async def test_closing_again_is_no_change(self, transport):
        async with transport() as peers:
            opened = open_it(peers.here, of_kind("client"))
            opened.close()
            await peers.settle()
            async with running(peers.here.wait_for_change) as waiting:
                opened.close()
                await peers.settle()
                await take_turns()
                assert not waiting.done.is_set()
                waiting.scope.cancel()

    async def test_a_canceled_wait_for_a_change_leaves_others_waiting(self, transport):
        async with transport() as peers:
            wait = peers.here.wait_for_change
            async with running(wait) as first, running(wait) as second:
                first.scope.cancel()
                await first.done.wait()
                assert not second.done.is_set()
                peers.here.enter("/lab")
                await second.done.wait()

    # services of the same process

    async def test_what_nobody_serves_is_not_found(self, transport):
        async with transport() as peers:
            peers.here.join(Endpoint("client", "/add", "lab_interfaces/srv/Add", "/lab"))
            assert peers.here.local("/add", "lab_interfaces/srv/Add") is None

    async def test_the_very_handler_is_found(self, transport):
        async with transport() as peers:
            handler = Handler()
            peers.here.serve(service(), handler)
            assert peers.here.local("/add", "lab_interfaces/srv/Add") is handler

    @pytest.mark.parametrize(
        "other", [service("/add2"), service(type_name="lab_interfaces/srv/Sum")]
    )
    async def test_a_service_of_another_name_or_type_is_not_found(self, transport, other):
        async with transport() as peers:
            peers.here.serve(other, Handler())
            assert peers.here.local("/add", "lab_interfaces/srv/Add") is None

    async def test_of_several_handlers_the_first_is_found_then_the_next(self, transport):
        async with transport() as peers:
            handlers = [Handler(), Handler()]
            found = []
            for opened in [peers.here.serve(service(), handler) for handler in handlers]:
                found.append(peers.here.local("/add", "lab_interfaces/srv/Add"))
                opened.close()
                opened.close()
            assert found == handlers
            assert peers.here.local("/add", "lab_interfaces/srv/Add") is None
