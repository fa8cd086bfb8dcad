"""A Zenoh session whose methods take bytes and callbacks. Only this module calls Zenoh.

Every method may block, so call it in a `SendQueue` or another thread, never in the event loop.
Zenoh runs callbacks in its own threads. Undeclare every declared object explicitly. Otherwise, the
garbage collector would undeclare it in an arbitrary thread. Objects that one session declares
exchange no data with each other, because messages inside a process travel as Python objects and not
through Zenoh. Only this module turns Zenoh's exceptions into `TurtleactError`.

Source: rmw_zenoh_cpp ``rmw_publisher_data.cpp``, ``rmw_subscription_data.cpp``,
``rmw_service_data.cpp`` and ``rmw_client_data.cpp``; eclipse-zenoh 1.10.
"""

from __future__ import annotations

import ctypes
import logging
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence, Sized
from contextlib import contextmanager
from time import monotonic, sleep
from typing import Any, Protocol, TypeAlias

import zenoh
from zenoh import ext
from zenoh.handlers import Callback

from turtleact.errors import InvalidOption, TurtleactError, encodable
from turtleact.transports.rmw_zenoh.config import (
    PATIENCE,
    Mode,
    SessionConfig,
    session_config,
    why_not_open,
    words,
)
from turtleact.transports.rmw_zenoh.wire import Graph, all_tokens

__all__ = ["Declared", "Publisher", "Querier", "Query", "Session", "census", "stay_attached"]

logger = logging.getLogger("turtleact.transport")

Take: TypeAlias = Callable[[bytes, bytes], object]

#: The kind of error that ends a query without an answer.
TIMEOUT = "Timeout"

#: How long others have to answer which tokens they know (s).
ANSWER = 2.0

#: How long routers have to tell about themselves (s).
ADMIN = 1.0

#: How soon after the last message its number is repeated for readers that missed it (s).
HEARTBEAT = 0.5

#: How long closing a session may take (s).
CLOSING = 1.0

#: How long a new peer may take to connect to other peers (s).
MEETING = 2.0

#: A new peer is connected if no connection was added for this time (s), and for a multiple of the
#: time that the router took to greet or to answer. Greeting a peer takes a few round trips too.
SHORTEST_QUIET = 0.04
QUIET_PER_TRIP = 3.0

#: How often to count the connections meanwhile (s).
LOOK = 0.005

REMOTE = zenoh.Locality.REMOTE


class Declared(Protocol):
    """An object of Zenoh that is declared on a session."""

    def undeclare(self) -> object:
        """Undeclare the object."""


class Session:
    """A Zenoh session. `Session.open` opens one, and `close` closes it.

    Attributes:
        zid: The session's id, as it appears in tokens.
    """

    def __init__(
        self, session: zenoh.Session, *, is_peer: bool = False, opening: float = 0.0
    ) -> None:
        self._session = session
        self._is_peer = is_peer
        self._opening = opening  # how long opening took (s)
        self._opened_at = monotonic()
        self.zid = str(session.zid())

    @classmethod
    def open(cls, config: SessionConfig) -> Session:
        """Open a session. This blocks for a few seconds at most.

        Raises:
            InvalidOption: if the configuration is not valid.
            TurtleactError: if the session cannot connect to an endpoint or cannot listen at one.
        """
        try:
            settings = zenoh.Config.from_json5(config.text) if config.text else zenoh.Config()
            for path, value in config.settings.items():
                settings.insert_json5(path, value)
            for path, value in config.defaults.items():
                if settings.get_json(path) == "null":
                    settings.insert_json5(path, value)
        except zenoh.ZError as error:
            raise InvalidOption("config", f"Zenoh says: {words(str(error))}") from error
        began = monotonic()
        try:
            session = zenoh.open(settings)
        except zenoh.ZError as error:
            raise TurtleactError(why_not_open(config, words(str(error)))) from error
        is_peer = settings.get_json("mode") == '"peer"'
        return cls(session, is_peer=is_peer, opening=monotonic() - began)

    def close(self) -> None:
        """Close the session. Before you call this, undeclare everything that is declared on it.

        This blocks for `CLOSING` seconds at most. Zenoh itself may need up to ten seconds if it is
        still connecting to a peer that is suspended (by SIGSTOP or a debugger). In that case, this
        method returns, and the thread that closes the session is left running. This daemon thread
        does not prevent the process from ending. Before this method returns, Zenoh has told the
        other processes that the session closes.
        """
        session = self._session
        # The closing thread drops the session, where that may block. Without this line the garbage
        # collector might do it in any thread.
        del self._session
        closing = threading.Thread(target=_close, args=[session], name="closing", daemon=True)
        del session
        closing.start()
        closing.join(CLOSING)

    def declare_token(self, key: str) -> Declared:
        """Declare a liveliness token."""
        with _mapped(f"declare {key}"):
            return self._session.liveliness().declare_token(key)

    def watch_tokens(
        self, key: str, appeared: Callable[[str], object], gone: Callable[[str], object]
    ) -> Declared:
        """Call ``appeared`` with each token that appears, and ``gone`` with each that disappears.

        Only tokens that match ``key`` count. ``appeared`` is also called with each token that
        exists already.
        """

        def take(sample: zenoh.Sample) -> None:
            is_put = sample.kind == zenoh.SampleKind.PUT
            (appeared if is_put else gone)(str(sample.key_expr))

        with _mapped(f"watch {key}"):
            watched: Declared = self._session.liveliness().declare_subscriber(
                key, _direct(take), history=True
            )
            return watched

    def tokens(self, key: str) -> list[str]:
        """Return all existing tokens that match ``key``.

        This blocks until every process that knows such tokens has answered, or `ANSWER` seconds
        have passed. If this session is a peer that was opened a moment ago, this method first waits
        until the session is connected to the other peers.
        """
        if not self._is_peer or monotonic() > self._opened_at + MEETING:
            return self._ask(key)
        # Also watch, because a peer just met sometimes answers a question without its own tokens.
        found: dict[str, None] = {}
        watched = self.watch_tokens(key, found.setdefault, lambda gone: found.pop(gone, None))
        began = monotonic()
        self._ask(key)  # the router announces the other peers before it answers this
        self._meet_peers(max(self._opening, monotonic() - began), found)
        asked = self._ask(key)
        watched.undeclare()
        return list(dict.fromkeys([*asked, *tuple(found)]))

    def routers(self) -> dict[str, str]:
        """Return the ids of the connected routers, each with the router's own description as JSON.

        The description is empty if the router's admin space is off. This blocks for `ADMIN` seconds
        at most.
        """
        found = {str(zid): "" for zid in self._session.info.routers_zid()}
        for key, said in self._answers(self._session.get, "@/*/router", ADMIN):
            zid = key.split("/")[1]
            if zid in found:
                found[zid] = said.decode(errors="replace")
        return found

    def _ask(self, key: str) -> list[str]:
        return [token for token, _ in self._answers(self._session.liveliness().get, key, ANSWER)]

    def _answers(
        self, get: Callable[..., object], key: str, timeout: float
    ) -> list[tuple[str, bytes]]:
        """Return the key and the payload of each answer to a question."""
        # Zenoh delivers tokens that it knows inside `get`. Its own channel holds 256 and then waits
        # for a reader, which would be this thread: so collect them in a callback.
        found: list[tuple[str, bytes]] = []
        ended = threading.Event()

        def take(reply: zenoh.Reply) -> None:
            sample = reply.ok
            if sample is not None:
                found.append((str(sample.key_expr), sample.payload.to_bytes()))

        with _mapped(f"ask for {key}"):
            get(key, Callback(take, ended.set, indirect=False), timeout=timeout)
        ended.wait()
        return found

    def _meet_peers(self, round_trip: float, found: Sized) -> None:
        """Wait until this new peer has connected to the peers that its router announced.

        A router tells a peer where other peers are, but does not forward their tokens. The peer
        connects to each of them in the background, and Zenoh does not report when it has connected
        to all. Therefore, this method waits until no connection and no token has been added for a
        certain period. The longer the router took to greet or to answer, the longer the period,
        because a busy machine or a slow network needs more time.
        """
        quiet = SHORTEST_QUIET + QUIET_PER_TRIP * round_trip
        known, since = -1, monotonic()
        while (now := monotonic()) < self._opened_at + MEETING:
            count = len(self._session.info.peers_zid()) + len(found)
            if count != known:
                known, since = count, now
            elif now - since >= quiet:
                return
            sleep(LOOK)

    def declare_publisher(
        self, key: str, *, is_reliable: bool, matching: Callable[[bool], object]
    ) -> Publisher:
        """Declare a publisher.

        ``matching`` is called with True when other processes start to read the topic, and with
        False when they have all stopped.
        """
        with _mapped(f"declare {key}"):
            publisher = self._session.declare_publisher(
                key, congestion_control=_congestion(is_reliable), allowed_destination=REMOTE
            )
            publisher.declare_matching_listener(_direct(lambda status: matching(status.matching)))
            return Publisher(publisher)

    def declare_latched_publisher(self, key: str, *, is_reliable: bool, depth: int) -> Publisher:
        """Declare a publisher that keeps its last messages for later readers."""
        with _mapped(f"declare {key}"):
            return Publisher(
                ext.declare_advanced_publisher(
                    self._session,
                    key,
                    congestion_control=_congestion(is_reliable),
                    allowed_destination=REMOTE,
                    publisher_detection=True,
                    cache=ext.CacheConfig(depth),
                    sample_miss_detection=ext.MissDetectionConfig(
                        heartbeat=None, sporadic_heartbeat=HEARTBEAT
                    ),
                )
            )

    def declare_subscriber(self, key: str, take: Take) -> Declared:
        """Subscribe to a topic. ``take`` is called with each message's payload and attachment."""
        receive = _direct(lambda sample: take(*_parts(sample)))
        with _mapped(f"declare {key}"):
            subscriber: Declared = self._session.declare_subscriber(
                key, receive, allowed_origin=REMOTE
            )
            return subscriber

    def declare_latched_subscriber(self, key: str, take: Take, *, depth: int) -> Declared:
        """Subscribe to a latched topic.

        ``take`` is called with the payload and attachment of each message, oldest first.
        """
        with _mapped(f"declare {key}"):
            return _LatchedSubscriber(
                ext.declare_advanced_subscriber(
                    self._session,
                    key,
                    # Without the None, parts of it would live as long as the session.
                    (_direct(lambda sample: take(*_parts(sample))), None),
                    allowed_origin=REMOTE,
                    subscriber_detection=True,
                    history=ext.HistoryConfig(detect_late_publishers=True, max_samples=depth),
                    recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
                )
            )

    def declare_queryable(self, key: str, take: Callable[[Query], object]) -> Declared:
        """Declare the server of a service. ``take`` is called with each request."""
        with _mapped(f"declare {key}"):
            checked = zenoh.KeyExpr(key)  # checked once, not for each reply
            receive = _direct(lambda query: take(Query(query, checked)))
            queryable: Declared = self._session.declare_queryable(
                checked, receive, complete=True, allowed_origin=REMOTE
            )
            return queryable

    def declare_querier(
        self, key: str, matching: Callable[[bool], object], *, is_for_all: bool = True
    ) -> Querier:
        """Declare a client.

        ``matching`` is called with True when other processes start to serve the service, and with
        False when they have all stopped. With ``is_for_all``, each request goes to all servers, as
        in rmw_zenoh. Otherwise, it goes only to the nearest server.
        """
        target = zenoh.QueryTarget.ALL_COMPLETE if is_for_all else zenoh.QueryTarget.BEST_MATCHING
        with _mapped(f"declare {key}"):
            querier = self._session.declare_querier(
                key,
                target=target,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=PATIENCE,
                allowed_destination=REMOTE,
            )
            querier.declare_matching_listener(_direct(lambda status: matching(status.matching)))
            return Querier(querier)


class Publisher:
    """The sending end of a topic.

    Attributes:
        declared: Zenoh's object.
    """

    def __init__(self, publisher: zenoh.Publisher | ext.AdvancedPublisher) -> None:
        self.declared = publisher

    def put(self, payload: bytes, attachment: bytes) -> None:
        """Send a message.

        On a reliable topic, this method blocks while a subscriber does not keep up.
        """
        try:
            self.declared.put(payload, attachment=attachment)
        except zenoh.ZError as error:
            raise _error("publish", error) from error

    def undeclare(self) -> None:
        """Undeclare the publisher, and drop the messages that it keeps. Call this once.

        This method deletes Zenoh's publisher instead of calling Zenoh's ``undeclare``. Deleting the
        publisher releases the GIL. The method ``undeclare`` of an advanced publisher would hold the
        GIL while ``undeclare`` waits for one of Zenoh's threads. If this thread of Zenoh is waiting
        for the GIL, no Python code runs for ten seconds (eclipse-zenoh 1.10).
        """
        del self.declared


class _LatchedSubscriber:
    """The receiving end of a latched topic."""

    def __init__(self, subscriber: ext.AdvancedSubscriber[None]) -> None:
        self._subscriber = subscriber

    def undeclare(self) -> None:
        """Undeclare by dropping Zenoh's object, as in `Publisher.undeclare`. Call this once."""
        del self._subscriber


class Querier:
    """The client end of a service.

    Attributes:
        declared: Zenoh's object.
    """

    def __init__(self, querier: zenoh.Querier) -> None:
        self.declared = querier

    def get(
        self,
        payload: bytes,
        attachment: bytes,
        *,
        replied: Take,
        failed: Callable[[str, str], object],
        ended: Callable[[], object],
    ) -> None:
        """Send a request. Only undeclaring the querier cancels it.

        Args:
            payload: The encoded request.
            attachment: The request's attachment.
            replied: Called with the payload and attachment of each reply.
            failed: Called with the text and kind of each error.
            ended: Called once, after all replies and errors.
        """

        def take(reply: zenoh.Reply) -> None:
            sample = reply.ok  # each access creates a new object
            if sample is not None:
                replied(*_parts(sample))
            elif (error := reply.err) is not None:
                kind = str(error.encoding).partition(";")[2]
                text = error.payload.to_bytes().decode(errors="replace")
                failed(text, kind or (TIMEOUT if text == TIMEOUT else ""))

        try:
            self.declared.get(_direct(take, ended), payload=payload, attachment=attachment)
        except zenoh.ZError as error:
            raise _error("send a request", error) from error

    def undeclare(self) -> None:
        """Undeclare the client."""
        with _mapped("close a client"):
            self.declared.undeclare()  # type: ignore[no-untyped-call]  # zenoh has no type here


class Query:
    """A request that has arrived. Call `reply`, `fail` or `drop` once.

    Attributes:
        payload: The encoded request.
        attachment: The request's attachment.
    """

    def __init__(self, query: zenoh.Query, key: zenoh.KeyExpr) -> None:
        payload, attachment = query.payload, query.attachment  # each access creates new objects
        self.payload = b"" if payload is None else payload.to_bytes()
        self.attachment = b"" if attachment is None else attachment.to_bytes()
        self._query = query
        self._key = key

    def reply(self, payload: bytes, attachment: bytes) -> None:
        """Answer the request."""
        try:
            with self._query:
                self._query.reply(self._key, payload, attachment=attachment)
        except zenoh.ZError as error:
            raise _error("reply", error) from error

    def fail(self, text: str, kind: str) -> None:
        """Answer the request with an error: a text for people, and a kind that turtleact reads."""
        with _mapped("reply"), self._query:
            self._query.reply_err(encodable(text).encode(), encoding=f"text/plain;{kind}")

    def drop(self) -> None:
        """End the request without an answer."""
        self._query.drop()  # type: ignore[no-untyped-call]  # zenoh has no type here


def stay_attached() -> None:
    """Keep the Python thread state of the calling thread from now on.

    When one of Zenoh's threads calls Python, the thread gets a Python thread state and releases it
    after the call. Creating a thread state for each message costs 9 us or more. Without this
    function, a client needs 28 us to receive a feedback message. With this function, it needs 9 us
    (CPython 3.11, two cores).

    The interpreter counts how often a thread state was requested. This function requests the state
    once and never releases this request, so the state lives until the thread or Python ends. Use
    this function only in threads that live long.

    Source: CPython ``Doc/c-api/init.rst``, "Non-Python created threads".
    """
    if not hasattr(ATTACHED, "is_so"):
        ATTACHED.is_so = True
        if ENSURE_STATE is not None:
            ENSURE_STATE()


#: Per-thread data of Zenoh's threads.
ATTACHED = threading.local()

#: A function of the public C API; None on Pythons without it.
ENSURE_STATE = getattr(ctypes.pythonapi, "PyGILState_Ensure", None)


def _close(session: zenoh.Session) -> None:
    try:
        session.close()  # type: ignore[no-untyped-call]  # zenoh has no type here
    except zenoh.ZError as error:
        logger.error("%s; it is left open", _error("close its session", error))


def _parts(sample: zenoh.Sample) -> tuple[bytes, bytes]:
    """Copy the payload and attachment of a sample.

    If the sample itself were kept, the whole batch of messages that it came in would stay in
    memory.
    """
    attachment = sample.attachment
    return sample.payload.to_bytes(), b"" if attachment is None else attachment.to_bytes()


def _direct(callback: Callable[[Any], object], ended: Callable[[], object] | None = None) -> Any:  # noqa: ANN401  # of whatever is declared
    """Make a handler for Zenoh that runs ``callback`` in the thread that receives the data.

    The thread keeps its Python thread state; see `stay_attached`. ``ended`` is called after all
    data.
    """

    def take(value: object) -> None:
        stay_attached()
        callback(value)

    return Callback(take, ended, indirect=False)


def _congestion(is_reliable: bool) -> zenoh.CongestionControl:
    control = zenoh.CongestionControl
    return control.BLOCK if is_reliable else control.DROP


@contextmanager
def _mapped(what: str) -> Iterator[None]:
    """Turn Zenoh's errors in the ``with`` block into `TurtleactError`.

    This takes 1 to 4 us, so code that runs for each message does not use it.
    """
    try:
        yield
    except zenoh.ZError as error:
        raise _error(what, error) from error


def _error(what: str, error: zenoh.ZError) -> TurtleactError:
    return TurtleactError(f"Zenoh cannot {what}: {words(str(error))}")


def census(
    connect: Sequence[str] | None,
    domain: int,
    config: Mapping[str, object] | None = None,
    mode: Mode = "peer",
) -> Graph:
    """Ask once which nodes and endpoints are on a graph, without joining the graph.

    This blocks, usually for some hundredths of a second.

    Args:
        connect: The Zenoh endpoints to connect to; None for the router of this machine.
        domain: The ROS domain.
        config: More of Zenoh's configuration: a mapping from paths to values, as for `open_zenoh`.
        mode: See `open_zenoh`.

    Raises:
        InvalidOption: if the value of an option is not allowed.
        TurtleactError: if no graph can be reached.
    """
    session = Session.open(session_config(connect, None, mode, domain, config or {}))
    try:
        graph = Graph(session.zid)
        for key in session.tokens(all_tokens(domain)):
            graph.add(key)
        return graph
    finally:
        session.close()
