"""The door to Zenoh: a session, with plain bytes and callbacks in and out.

Every method may block, so an `Outbox` calls them. Zenoh calls back in its own threads. Whatever is
declared must be undeclared by hand, since the garbage collector would do so in any thread. Nothing
that is declared here talks with its own session: within a process messages are objects. Exceptions
of Zenoh become `TurtleactError` here and nowhere else.

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

from turtleact.errors import InvalidOption, TurtleactError
from turtleact.summaries import encodable
from turtleact.transports.rmw_zenoh.config import (
    PATIENCE,
    Mode,
    SessionConfig,
    session_config,
    why_not_open,
    words,
)
from turtleact.transports.rmw_zenoh.keys import Graph, all_tokens

__all__ = ["Declared", "Publisher", "Querier", "Query", "Session", "census", "stay_attached"]

logger = logging.getLogger("turtleact.transport")

Take: TypeAlias = Callable[[bytes, bytes], object]

#: The kind of the error by which a query is over that nobody has answered.
TIMEOUT = "Timeout"

#: So long others have to say which tokens they know (s).
ANSWER = 2.0

#: How soon after the last message its number is told, for who has missed it (s).
HEARTBEAT = 0.5

#: How long closing a session may take (s).
CLOSING = 1.0

#: How long a new peer may take to connect to the other peers (s).
MEETING = 2.0

#: It is done if no connection has been added for this time (s), and so many times what the router
#: took to greet or to answer: greeting a peer takes a few round trips as well.
SHORTEST_QUIET = 0.04
QUIET_PER_TRIP = 3.0

#: How often the connections are counted meanwhile (s).
LOOK = 0.005

REMOTE = zenoh.Locality.REMOTE


class Declared(Protocol):
    """Something declared on a session."""

    def undeclare(self) -> object:
        """Take it back."""


class Session:
    """A session; opened by `Session.open`, closed by `close`.

    Attributes:
        zid: Its id, as tokens say it.
    """

    def __init__(
        self, session: zenoh.Session, *, is_peer: bool = False, opening: float = 0.0
    ) -> None:
        self._session = session
        self._is_peer = is_peer
        self._opening = opening  # how long that took (s)
        self._opened_at = monotonic()
        self.zid = str(session.zid())

    @classmethod
    def open(cls, config: SessionConfig) -> Session:
        """Open a session; blocks, a few seconds at most.

        Raises:
            InvalidOption: if the configuration is none.
            TurtleactError: if an endpoint cannot be reached, or not be listened at.
        """
        try:
            settings = zenoh.Config.from_json5(config.text) if config.text else zenoh.Config()
            for path, value in config.settings.items():
                settings.insert_json5(path, value)
            for path, value in config.defaults.items():
                if settings.get_json(path) in ("null", _UNTOUCHED.get(path)):
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
        """End it; what was declared on it must have been taken back.

        Blocks for `CLOSING` seconds at most. Zenoh waits longer, up to ten seconds, if it is still
        greeting a peer that has stopped (SIGSTOP, a debugger). The thread that closes is left
        behind then; others have been told by that time, and the process can end.
        """
        session = self._session
        # Given up in that thread, where it may block: the garbage collector would do it in any.
        del self._session
        closing = threading.Thread(target=_close, args=[session], name="closing", daemon=True)
        del session
        closing.start()
        closing.join(CLOSING)

    def declare_token(self, key: str) -> Declared:
        """Be in the graph."""
        with _mapped(f"declare {key}"):
            return self._session.liveliness().declare_token(key)

    def watch_tokens(
        self, key: str, appeared: Callable[[str], object], gone: Callable[[str], object]
    ) -> Declared:
        """Be told of all tokens, those that there are already too."""

        def take(sample: zenoh.Sample) -> None:
            is_put = sample.kind == zenoh.SampleKind.PUT
            (appeared if is_put else gone)(str(sample.key_expr))

        with _mapped(f"watch {key}"):
            watched: Declared = self._session.liveliness().declare_subscriber(
                key, _direct(take), history=True
            )
            return watched

    def tokens(self, key: str) -> list[str]:
        """All tokens that there are; blocks until those who know of some have answered.

        A peer that has just been opened waits until it is connected with the other peers.
        """
        if not self._is_peer or monotonic() > self._opened_at + MEETING:
            return self._ask(key)
        # Watched meanwhile: a question to a peer just met is sometimes answered without its tokens.
        found: dict[str, None] = {}
        watched = self.watch_tokens(key, found.setdefault, lambda gone: found.pop(gone, None))
        began = monotonic()
        self._ask(key)  # the router tells of the other peers before it answers this
        self._meet_peers(max(self._opening, monotonic() - began), found)
        asked = self._ask(key)
        watched.undeclare()
        return list(dict.fromkeys([*asked, *tuple(found)]))

    def _ask(self, key: str) -> list[str]:
        with _mapped(f"ask for {key}"):
            replies = self._session.liveliness().get(key, timeout=ANSWER)
            return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]

    def _meet_peers(self, round_trip: float, found: Sized) -> None:
        """Wait until a new peer has connected to the peers that its router has told it of.

        A router tells a peer where the others are, but passes on none of their tokens. The peer
        connects to each of them in the background, and Zenoh does not say when it is done. So this
        waits until no connection and no token has been added for some time. That time is a multiple
        of how long the router took to greet or to answer, so that it fits a busy machine and a slow
        network.
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
        """Publish a topic; ``matching`` is told whether anybody elsewhere reads it."""
        with _mapped(f"declare {key}"):
            publisher = self._session.declare_publisher(
                key, congestion_control=_congestion(is_reliable), allowed_destination=REMOTE
            )
            publisher.declare_matching_listener(_direct(lambda status: matching(status.matching)))
            return Publisher(publisher)

    def declare_latched_publisher(self, key: str, *, is_reliable: bool, depth: int) -> Publisher:
        """Publish a topic whose last messages are kept for who comes later."""
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

    def declare_subscriber(self, key: str, take: Callable[[bytes], object]) -> Declared:
        """Read a topic: the payload of each message."""

        def receive(sample: zenoh.Sample) -> None:  # as `_direct` does, without calls between
            stay_attached()
            take(sample.payload.to_bytes())

        with _mapped(f"declare {key}"):
            subscriber: Declared = self._session.declare_subscriber(
                key, Callback(receive, indirect=False), allowed_origin=REMOTE
            )
            return subscriber

    def declare_latched_subscriber(self, key: str, take: Take, *, depth: int) -> Declared:
        """Read a topic, the last messages of its publishers first: payload and attachment."""
        with _mapped(f"declare {key}"):
            return _LatchedSubscriber(
                ext.declare_advanced_subscriber(
                    self._session,
                    key,
                    # With None beside it, or parts of it would stay for as long as the session.
                    (_direct(lambda sample: take(*_parts(sample))), None),
                    allowed_origin=REMOTE,
                    subscriber_detection=True,
                    history=ext.HistoryConfig(detect_late_publishers=True, max_samples=depth),
                    recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
                )
            )

    def declare_queryable(self, key: str, take: Callable[[Query], object]) -> Declared:
        """Serve a service."""
        with _mapped(f"declare {key}"):
            checked = zenoh.KeyExpr(key)  # once, not at each reply

            def receive(query: zenoh.Query) -> None:  # as `_direct` does, without calls between
                stay_attached()
                take(Query(query, checked))

            queryable: Declared = self._session.declare_queryable(
                checked,
                Callback(receive, indirect=False),
                complete=True,
                allowed_origin=REMOTE,
            )
            return queryable

    def declare_querier(
        self, key: str, matching: Callable[[bool], object], *, is_for_all: bool = True
    ) -> Querier:
        """Call a service; ``matching`` is told whether anybody elsewhere serves it.

        If several do, all get each request, as in rmw_zenoh, or only the nearest.
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
    """The sending end of a topic."""

    def __init__(self, publisher: zenoh.Publisher | ext.AdvancedPublisher) -> None:
        self._publisher = publisher

    def put(self, payload: bytes, attachment: bytes) -> None:
        """Send a message; blocks while a reader takes nothing, if it is reliable."""
        try:
            self._publisher.put(payload, attachment=attachment)
        except zenoh.ZError as error:
            raise _error("publish", error) from error

    @property
    def is_matching(self) -> bool:
        """Whether Zenoh knows of a reader elsewhere; a latched one does not say."""
        publisher = self._publisher
        return isinstance(publisher, zenoh.Publisher) and _is_matching(publisher)

    def undeclare(self) -> None:
        """Take it back, and what it has kept; to be called once.

        It is dropped, which leaves the GIL to others. ``undeclare`` of an advanced one holds it and
        waits for a task in a thread of Zenoh, which may be waiting for the GIL: for ten seconds
        nothing of Python runs (eclipse-zenoh 1.10).
        """
        del self._publisher


class _LatchedSubscriber:
    """The receiving end of a latched topic."""

    def __init__(self, subscriber: ext.AdvancedSubscriber[None]) -> None:
        self._subscriber = subscriber

    def undeclare(self) -> None:
        """Take it back, once; it is dropped, as `Publisher` is, and for the same reason."""
        del self._subscriber


class Querier:
    """The asking end of a service."""

    def __init__(self, querier: zenoh.Querier) -> None:
        self._querier = querier

    def get(
        self,
        payload: bytes,
        attachment: bytes,
        *,
        replied: Take,
        failed: Callable[[str, str], object],
        ended: Callable[[], object],
        is_cancelable: bool,
    ) -> Callable[[], None] | None:
        """Send a request; this costs a fifth less if it need not be cancelable.

        Args:
            payload: The request.
            attachment: What goes beside it.
            replied: Gets payload and attachment of each reply.
            failed: Gets the text of each error, and its kind.
            ended: Called when there is no more to come, whatever came before.
            is_cancelable: Whether it can be given up before this is taken back.

        Returns:
            What gives the request up, if it is cancelable.
        """

        def take(reply: zenoh.Reply) -> None:  # as `_direct` does, without a call between
            stay_attached()
            sample = reply.ok  # each look at these makes an object anew
            if sample is not None:
                replied(*_parts(sample))
            elif (error := reply.err) is not None:
                kind = str(error.encoding).partition(";")[2]
                text = error.payload.to_bytes().decode(errors="replace")
                failed(text, kind or (TIMEOUT if text == TIMEOUT else ""))

        token = zenoh.CancellationToken() if is_cancelable else None
        try:
            self._querier.get(
                Callback(take, ended, indirect=False),
                payload=payload,
                attachment=attachment,
                cancellation_token=token,
            )
        except zenoh.ZError as error:
            raise _error("send a request", error) from error
        return None if token is None else token.cancel

    @property
    def is_matching(self) -> bool:
        """Whether Zenoh knows of a server elsewhere."""
        return _is_matching(self._querier)

    def undeclare(self) -> None:
        """Take it back."""
        with _mapped("close a client"):
            self._querier.undeclare()  # type: ignore[no-untyped-call]  # zenoh leaves it so


class Query:
    """A request that has come; to be answered once, and to be dropped at last.

    Attributes:
        payload: The request.
        attachment: What came beside it.
    """

    def __init__(self, query: zenoh.Query, key: zenoh.KeyExpr) -> None:
        payload, attachment = query.payload, query.attachment  # made anew at each look
        self.payload = b"" if payload is None else payload.to_bytes()
        self.attachment = b"" if attachment is None else attachment.to_bytes()
        self._query = query
        self._key = key

    def reply(self, payload: bytes, attachment: bytes) -> None:
        """Answer it."""
        try:
            with self._query:
                self._query.reply(self._key, payload, attachment=attachment)
        except zenoh.ZError as error:
            raise _error("reply", error) from error

    def fail(self, text: str, kind: str) -> None:
        """Answer that it has failed: a text for people, and a kind for peers like us."""
        with _mapped("reply"), self._query:
            self._query.reply_err(encodable(text).encode(), encoding=f"text/plain;{kind}")

    def drop(self) -> None:
        """Give no answer."""
        self._query.drop()  # type: ignore[no-untyped-call]  # zenoh leaves it so


def _is_matching(declared: zenoh.Publisher | zenoh.Querier) -> bool:
    status: Any = declared.matching_status  # zenoh's own types call it a bool
    return bool(status.matching)


def stay_attached() -> None:
    """Have the calling thread keep its Python thread state, from its first call on.

    A thread of Zenoh that calls Python gets a thread state for the call and gives it up after it.
    Making it anew costs 9 us and more for each message. Without this call a client takes 28 us for
    a feedback message, with it 9 (CPython 3.11, two cores).

    The interpreter counts how often a state was asked for. This asks once more than it is given up,
    so the state stays until the thread and then Python end: for threads that live long.

    Source: CPython ``Doc/c-api/init.rst``, "Non-Python created threads".
    """
    if not hasattr(ATTACHED, "is_so"):
        ATTACHED.is_so = True
        if ENSURE_STATE is not None:
            ENSURE_STATE()


#: What each thread of Zenoh keeps for itself.
ATTACHED = threading.local()

#: Of the public C API; None where there is no such thing.
ENSURE_STATE = getattr(ctypes.pythonapi, "PyGILState_Ensure", None)


def _close(session: zenoh.Session) -> None:
    try:
        session.close()  # type: ignore[no-untyped-call]  # zenoh leaves it so
    except zenoh.ZError as error:
        logger.error("%s; it is left behind", _error("close its session", error))


def _parts(sample: zenoh.Sample) -> tuple[bytes, bytes]:
    """Payload and attachment, copied: a sample that is kept holds the whole batch it came in."""
    attachment = sample.attachment
    return sample.payload.to_bytes(), b"" if attachment is None else attachment.to_bytes()


def _direct(callback: Callable[[Any], object]) -> Any:  # noqa: ANN401  # of whatever is declared
    """A handler that runs in the thread that receives: no thread and no queue of its own.

    That thread stays attached to Python.
    """

    def take(value: object) -> None:
        stay_attached()
        callback(value)

    return Callback(take, indirect=False)


def _congestion(is_reliable: bool) -> zenoh.CongestionControl:
    control = zenoh.CongestionControl
    return control.BLOCK if is_reliable else control.DROP


@contextmanager
def _mapped(what: str) -> Iterator[None]:
    """Errors of Zenoh as ours. Takes 1 to 4 us, so what is done for each message does without."""
    try:
        yield
    except zenoh.ZError as error:
        raise _error(what, error) from error


def _error(what: str, error: zenoh.ZError) -> TurtleactError:
    return TurtleactError(f"Zenoh cannot {what}: {words(str(error))}")


#: What Zenoh's own configuration has where it is not null.
_UNTOUCHED = {
    "transport/unicast/open_timeout": "10000",
    "transport/link/tx/queue/congestion_control/block/wait_before_close": "5000000",
}


def census(
    connect: Sequence[str] | None,
    domain: int,
    config: Mapping[str, object] | None = None,
    mode: Mode = "peer",
) -> Graph:
    """Who is on a graph, asked once, unseen; blocks, some hundredths of a second as a rule.

    Args:
        connect: Endpoints of the graph; the router of this machine if None.
        domain: Its ROS domain.
        config: Paths and values of Zenoh's configuration.
        mode: As for `open_zenoh`.

    Raises:
        InvalidOption: if one of them has a value that it cannot have.
        TurtleactError: if there is no graph in reach.
    """
    session = Session.open(session_config(connect, None, mode, domain, config or {}))
    try:
        graph = Graph(session.zid)
        for key in session.tokens(all_tokens(domain)):
            graph.add(key)
        return graph
    finally:
        session.close()
