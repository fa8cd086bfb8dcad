"""All that rmw_zenoh writes beside the encoded messages: names, attachments and errors.

A topic or service has a *key expression*. Endpoints with the same key communicate with each other,
so the key includes the type and its hash. A node or endpoint is on the graph while its *liveliness
token* exists. The token is a key expression. Its chunks, the parts between the slashes, describe
the node or endpoint. An endpoint's gid is a hash of its token.

::

    DOMAIN/NAME/TYPE/HASH                                                          data
    @ros2_lv/DOMAIN/ZID/NODE_ID/NODE_ID/NN/ENCLAVE/NAMESPACE/NODE                  a node
    @ros2_lv/DOMAIN/ZID/NODE_ID/ID/KIND/ENCLAVE/NAMESPACE/NODE/NAME/TYPE/HASH/QOS  an endpoint

This module writes tokens in rmw_zenoh's form. It also reads tokens with additional chunks or with
an unknown quality of service, because newer and older peers send such tokens.

An *attachment* travels with each message and holds its sender, time and sequence number.

==  ====  =============================================================================
at  size
==  ====  =============================================================================
0   8     sequence number, a little-endian int64 from 1, counted by publisher or client
8   8     time of sending, a little-endian int64: ns since the Unix epoch
16  1     16, the size of the gid
17  16    gid of the publisher; in requests and replies, of the client
33  …     a note: text in UTF-8, written and read only by turtleact
==  ====  =============================================================================

A reply carries the sequence number and gid of its request. rmw_zenoh reads only the first 33 bytes
of an attachment, so it ignores the note that turtleact appends.

The error of a service is a text and a kind, which names the exception's class. Servers encode
errors and clients decode them. Zenoh itself sends an error if a call takes too long.

Source: rmw_zenoh_cpp ``detail/liveliness_utils.cpp``, ``detail/attachment_helpers.cpp`` and
``docs/design.md``, Jazzy from 0.2.4 to Rolling.
"""

from __future__ import annotations

import struct
from time import time_ns

import msgspec
import xxhash

from turtleact.errors import (
    InvalidMessage,
    ServerUnavailable,
    ServiceError,
    ServiceTimeout,
    TurtleactError,
    shortened,
    summary,
)
from turtleact.transports.base import Endpoint, EndpointKind, QoS, TimePolicies
from turtleact.transports.rmw_zenoh.config import PATIENCE

__all__ = [
    "Attachment",
    "Attachments",
    "Graph",
    "Token",
    "all_nodes",
    "all_tokens",
    "count_in",
    "data_key",
    "dds_type",
    "decode_error",
    "domain_of_node",
    "encode_error",
    "endpoint_token",
    "gid_in",
    "gid_of",
    "node_token",
    "note_in",
    "parse_token",
    "read_attachment",
    "ros_type",
    "stamp_in",
    "write_attachment",
]

PREFIX = "@ros2_lv"
NODE = "NN"
KINDS: dict[str, EndpointKind] = {
    "MP": "publisher",
    "MS": "subscription",
    "SS": "service",
    "SC": "client",
}
CODES = {kind: code for code, kind in KINDS.items()}

NODE_CHUNKS = 9
ENDPOINT_CHUNKS = 13

#: Longer tokens are ignored (characters); names and types of ROS 2 are far shorter.
LONGEST = 8192

#: The meaning of an empty chunk of a quality of service, and of a depth of 0.
DEFAULT_DEPTH = 42
TRANSIENT_LOCAL = "1"
BEST_EFFORT = "2"
LIVELINESS = {
    "0": "system_default",
    "": "automatic",
    "1": "automatic",
    "3": "manual_by_topic",
    "5": "best_available",
}

#: Durations from here on are infinite (s): ROS 2 writes 9,223,372,036 s, or nothing.
INFINITE = 9_223_372_036


class Token(msgspec.Struct, frozen=True):
    """A parsed liveliness token: the node or endpoint that the token announces.

    Attributes:
        zid: The id of the session that declared the token.
        node: The fully qualified name of the node, or of the endpoint's node.
        endpoint: The endpoint; None if the token is that of a node.
    """

    zid: str
    node: str
    endpoint: Endpoint | None = None


class Graph:
    """The nodes and endpoints of all other sessions, in the order they appeared.

    Args:
        zid: The id of our own session, whose tokens are ignored.

    Attributes:
        tokens: The meaning of each token, by the token's text.
    """

    def __init__(self, zid: str) -> None:
        self._zid = zid
        self.tokens: dict[str, Token] = {}
        self._by_name: dict[str, dict[str, Endpoint]] = {}  # token to endpoint

    def add(self, key: str) -> Token | None:
        """Add a liveliness token, and return the parsed token.

        Return None if the token is already known, belongs to our own session or cannot be
        understood.
        """
        token = None if key in self.tokens else parse_token(key)
        if token is None or token.zid == self._zid:
            return None
        self.tokens[key] = token
        if token.endpoint is not None:
            self._by_name.setdefault(token.endpoint.name, {})[key] = token.endpoint
        return token

    def remove(self, key: str) -> Token | None:
        """Remove a token, and return its meaning. Return None if the token was not known."""
        token = self.tokens.pop(key, None)
        if token is not None and token.endpoint is not None:
            namesakes = self._by_name[token.endpoint.name]
            del namesakes[key]
            if not namesakes:
                del self._by_name[token.endpoint.name]
        return token

    def endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """All endpoints, or only those of the topic or service ``name``."""
        if name:
            return tuple(self._by_name.get(name, {}).values())
        return tuple(token.endpoint for token in self.tokens.values() if token.endpoint is not None)

    def nodes(self) -> tuple[str, ...]:
        """The fully qualified names of the nodes."""
        return tuple(token.node for token in self.tokens.values() if token.endpoint is None)


def data_key(domain: int, endpoint: Endpoint) -> str:
    """Return the key expression of an endpoint's topic or service.

    >>> point = Endpoint("publisher", "/at", "geometry_msgs/msg/Point", "/n", type_hash="RIHS01_6")
    >>> data_key(0, point)
    '0/at/geometry_msgs::msg::dds_::Point_/RIHS01_6'
    """
    name = endpoint.name.removeprefix("/").removesuffix("/")
    return f"{domain}/{name}/{dds_type(endpoint.type_name)}/{endpoint.type_hash}"


def all_tokens(domain: int) -> str:
    """Return a key expression that matches all tokens of a domain."""
    return f"{PREFIX}/{domain}/**"


def all_nodes() -> str:
    """Return a key expression that matches the tokens of all nodes in all domains."""
    return f"{PREFIX}/*/*/*/*/{NODE}/**"


def domain_of_node(token: str) -> int | None:
    """Return the domain in a node's token; None if the node is hidden or the token is malformed.

    >>> domain_of_node("@ros2_lv/3/a/0/0/NN/%/%/lab")
    3
    """
    chunks = token.split("/", NODE_CHUNKS)
    is_hidden = len(chunks) < NODE_CHUNKS or chunks[8].startswith("_")
    return None if is_hidden or not chunks[1].isdecimal() else int(chunks[1])


def node_token(domain: int, zid: str, node_id: int, node: str) -> str:
    """Return the token of a node.

    Args:
        domain: The ROS domain.
        zid: The id of the node's session.
        node_id: The node's number, unique in the session among nodes and endpoints.
        node: The node's fully qualified name.
    """
    return f"{PREFIX}/{domain}/{zid}/{node_id}/{node_id}/{NODE}/{_node_chunks(node)}"


def endpoint_token(domain: int, zid: str, node_id: int, number: int, endpoint: Endpoint) -> str:
    """Return the token of an endpoint.

    Args:
        domain: The ROS domain.
        zid: The id of the endpoint's session.
        node_id: The number of the endpoint's node.
        number: The endpoint's own number, unique in the session among nodes and endpoints.
        endpoint: The endpoint, with its type hash.
    """
    return "/".join(
        (
            f"{PREFIX}/{domain}/{zid}/{node_id}/{number}/{CODES[endpoint.kind]}",
            _node_chunks(endpoint.node),
            _mangle(endpoint.name),
            dds_type(endpoint.type_name),
            _mangle(endpoint.type_hash),
            _qos_chunk(endpoint.qos),
        )
    )


def parse_token(key: str) -> Token | None:
    """Return the meaning of a token; None if the token cannot be understood.

    The gid of an endpoint is computed from the token, in the same way as in other processes.
    """
    chunks = key.split("/", ENDPOINT_CHUNKS) if len(key) <= LONGEST else []
    if len(chunks) < NODE_CHUNKS or chunks[0] != PREFIX or not all(chunks[:NODE_CHUNKS]):
        return None
    node = f"{_demangle(chunks[7]).rstrip('/')}/{chunks[8]}"
    if chunks[5] == NODE:
        return Token(chunks[2], node)
    if chunks[5] not in KINDS or len(chunks) < ENDPOINT_CHUNKS or not all(chunks[9:12]):
        return None
    endpoint = Endpoint(
        kind=KINDS[chunks[5]],
        name=_demangle(chunks[9]),
        type_name=ros_type(_demangle(chunks[10])),
        node=node,
        qos=_parse_qos(chunks[12]),
        times=_parse_times(chunks[12]),
        type_hash=_demangle(chunks[11]),
        gid=gid_of(key),
    )
    return Token(chunks[2], node, endpoint)


def gid_of(token: str) -> bytes:
    """Return the gid of an endpoint, 16 bytes: the XXH3-128 hash of its token, little-endian.

    >>> gid_of("@ros2_lv/0/a/0/0/NN/%/%/lab").hex()
    'a69d7ac3e2c03c91abab72e6833b800c'
    """
    return xxhash.xxh3_128_digest(token.encode())[::-1]


def dds_type(type_name: str) -> str:
    """Convert a type name to DDS's form.

    The ending ``_Request`` or ``_Response`` is not added to service types.

    >>> dds_type("turtlesim/srv/Spawn")
    'turtlesim::srv::dds_::Spawn_'
    """
    *packages, name = type_name.split("/")
    return "::".join((*packages, "dds_", f"{name}_"))


def ros_type(dds_name: str) -> str:
    """Convert a type name from DDS's form to ROS 2's. Other names are returned unchanged."""
    packages, separator, name = dds_name.rpartition("::dds_::")
    if not separator or not name.endswith("_"):
        return dds_name
    return f"{packages.replace('::', '/')}/{name.removesuffix('_')}"


def _node_chunks(node: str) -> str:
    namespace, _, name = node.rpartition("/")
    return f"%/{_mangle(namespace or '/')}/{name}"


def _mangle(text: str) -> str:
    return text.replace("/", "%")


def _demangle(chunk: str) -> str:
    return chunk.replace("%", "/")


def _qos_chunk(qos: QoS) -> str:
    reliability = BEST_EFFORT if qos.reliability == "best_effort" else ""
    durability = TRANSIENT_LOCAL if qos.durability == "transient_local" else ""
    depth = "" if qos.depth == DEFAULT_DEPTH else qos.depth
    return f"{reliability}:{durability}:,{depth}:,:,:,,"


def _parse_qos(chunk: str) -> QoS:
    """Parse depth, durability and reliability. Unknown values are replaced by the defaults."""
    reliability, durability, history, *_ = (*chunk.split(":"), "", "", "")
    _, _, depth = history.partition(",")
    is_depth = _is_number(depth) and len(depth) < 10
    return QoS(
        depth=(int(depth) if is_depth else 0) or DEFAULT_DEPTH,
        durability="transient_local" if durability == TRANSIENT_LOCAL else "volatile",
        reliability="best_effort" if reliability == BEST_EFFORT else "reliable",
    )


def _parse_times(chunk: str) -> TimePolicies:
    """Parse the QoS policies deadline, lifespan and liveliness.

    Unknown or missing durations are infinite, as in rmw_zenoh.
    """
    parts = chunk.split(":")
    deadline, lifespan, liveliness = (*parts[3:6], "", "", "")[:3]
    kind, _, lease = liveliness.partition(",")
    return TimePolicies(
        deadline=_duration(deadline),
        lifespan=_duration(lifespan),
        liveliness=LIVELINESS.get(kind, "unknown"),
        lease=_duration(lease),
    )


def _duration(text: str) -> int | None:
    """Convert ``SECONDS,NANOSECONDS`` to ns; None if the duration is infinite.

    >>> _duration("10,0"), _duration("0,500000000"), _duration(","), _duration("9223372036,")
    (10000000000, 500000000, None, None)
    """
    seconds, _, nanoseconds = text.partition(",")
    if not _is_number(seconds) or int(seconds) >= INFINITE:
        return None
    return int(seconds) * 10**9 + (int(nanoseconds) if _is_number(nanoseconds) else 0)


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) <= 20


GID_SIZE = 16

#: An attachment without a note.
LAYOUT = struct.Struct("<qqB16s")

#: The size of an attachment without a note.
SIZE = LAYOUT.size

#: The longest note (bytes); longer ones are cut.
LONGEST_NOTE = 4096

#: Where the note is in an attachment.
NOTE = slice(SIZE, SIZE + LONGEST_NOTE)


class Attachment(msgspec.Struct, frozen=True):
    """The data attached to a message.

    Attributes:
        sequence: The sequence number, at least 0.
        stamp: When the message was sent (ns since the Unix epoch).
        gid: The 16 bytes that identify the publisher or client.
        note: A text that only turtleact writes and reads; empty if there is none.
    """

    sequence: int
    stamp: int
    gid: bytes
    note: str = ""


class Attachments:
    """Makes the attachments of one endpoint's messages, with sequence numbers and times.

    Args:
        gid: The gid of the endpoint.
    """

    def __init__(self, gid: bytes) -> None:
        self._gid = gid
        self._sequence = 0

    def next(self, note: str = "") -> bytes:
        """Return the attachment of the next message."""
        self._sequence += 1
        return write_attachment(self._sequence, time_ns(), self._gid, note)


def write_attachment(sequence: int, stamp: int, gid: bytes, note: str = "") -> bytes:
    """Encode an attachment. A note longer than 4,096 bytes is cut to that size."""
    data = LAYOUT.pack(sequence, stamp, GID_SIZE, gid)
    tail = note.encode(errors="backslashreplace")  # a note must never make its message fail
    if len(tail) > LONGEST_NOTE:
        tail = tail[:LONGEST_NOTE].decode(errors="ignore").encode()
    return data + tail


def read_attachment(data: bytes) -> Attachment:
    """Decode an attachment.

    A note longer than 4,096 bytes is cut. Bytes of a note that are not UTF-8 are replaced.

    Raises:
        InvalidMessage: if the bytes are not an attachment.
    """
    if len(data) < SIZE:
        raise _invalid(f"expected {SIZE} bytes, got {len(data)}")
    sequence, stamp, size, gid = LAYOUT.unpack_from(data)
    if size != GID_SIZE:
        raise _invalid(f"expected a gid of {GID_SIZE} bytes, not of {size}")
    if sequence < 0 or stamp < 0:
        raise _invalid(f"sequence number and time must not be negative: {sequence}, {stamp}")
    note = note_in(data) if len(data) > SIZE else ""  # most requests carry none
    return Attachment(sequence, stamp, gid, note)


def note_in(data: bytes) -> str:
    """Return the note in an attachment. Unlike `read_attachment`, this accepts any bytes."""
    return data[NOTE].decode(errors="replace")


def gid_in(data: bytes) -> bytes:
    """Return the gid in an attachment. Unlike `read_attachment`, this accepts any bytes."""
    return data[SIZE - GID_SIZE : SIZE]


def count_in(data: bytes) -> int:
    """Return the sequence number in an attachment. Like `gid_in`, this accepts any bytes."""
    return int.from_bytes(data[:8], "little")


def stamp_in(data: bytes) -> int:
    """Return the time of sending in an attachment. Like `gid_in`, this accepts any bytes."""
    return int.from_bytes(data[8:16], "little")


def _invalid(problem: str) -> InvalidMessage:
    return InvalidMessage("attachment", problem)


def encode_error(error: TurtleactError) -> tuple[str, str]:
    """Encode an error as the text and the kind from which `decode_error` restores the error."""
    if isinstance(error, InvalidMessage):
        return shortened(str(error)), "InvalidMessage"
    if isinstance(error, ServerUnavailable):
        return shortened(error.problem), "ServerUnavailable"
    if isinstance(error, ServiceError):
        return shortened(error.reason), "ServiceError"
    return summary(error), "ServiceError"


def decode_error(name: str, text: str, kind: str) -> TurtleactError:
    """Restore an error of the service ``name`` from the text and the kind.

    An error from a program other than turtleact becomes a `ServiceError` with the same text.

    >>> text, kind = encode_error(ServiceError("/add", "too many: at most 3"))
    >>> decode_error("/add", text, kind)
    ServiceError('/add', 'too many: at most 3')
    """
    if kind == "InvalidMessage":
        path, _, problem = text.partition(": ")
        return InvalidMessage(path, problem)
    if kind == "Timeout":
        return ServiceTimeout(name, PATIENCE)
    if kind == "ServerUnavailable":
        return ServerUnavailable(name, text, kind="service")
    return ServiceError(name, text)
