"""Where the fuzzers begin: what is right, a few of each."""

from __future__ import annotations

from pathlib import Path

from turtleact.interfaces import cdr, known_interfaces, to_json, to_yaml
from turtleact.interfaces.loading import interface_source
from turtleact.transports.base import Endpoint, QoS
from turtleact.transports.rmw_zenoh.wire import endpoint_token, node_token, write_attachment

from .properties import CLASSES, KINDS

__all__ = ["seeds"]

POINT = "geometry_msgs/msg/Point"


def seeds(name: str) -> list[bytes]:
    """The inputs that one property begins with."""
    return {
        "interface": interfaces,
        "text": texts,
        "cdr": messages,
        "anytype": lambda: [bytes(range(i, i + 100)) for i in range(0, 150, 10)],
        "attachment": lambda: [
            write_attachment(1, 10**18, bytes(16), note)
            for note in ("", '{"reason":"no","feedback":3}')
        ],
        "token": tokens,
        "name": lambda: [b"pose", b"/a/b_1", b"~/pose\n/sim\nturtle1", b"~\n/a\nn", b"_x/y"],
        "error": lambda: [
            f"{kind}\n.a: b".encode()
            for kind in ("InvalidMessage", "Timeout", "ServerUnavailable", "")
        ],
    }[name]()


def interfaces() -> list[bytes]:
    """The interfaces that ship, and the recorded ones."""
    found = []
    for name in known_interfaces():
        kind = KINDS.index(name.split("/")[1])
        found.append(bytes([kind]) + interface_source(name).encode())
    for path in sorted(Path("tests/interfaces/golden").rglob("*.*")):
        if path.suffix[1:] in KINDS:
            found.append(bytes([KINDS.index(path.suffix[1:])]) + path.read_bytes())
    return found


def texts() -> list[bytes]:
    """Default messages as YAML and as JSON, and some odd ones."""
    found = []
    for number, cls in enumerate(CLASSES):
        for say in (to_yaml, to_json):
            found.append(number.to_bytes(2, "big") + say(cls()).encode())
    odd = [
        "{x: &a 1, y: *a}",
        "a: !!str b",
        "? x\n: 1\n",
        "- |\n  a\n- >-\n  b",
        "\"\\u1234\": 'x'",
    ]
    odd += ["{x: .5, y: 0x1F, z: 1e3}", "{x: .nan, y: -.inf}", "%YAML 1.1\n---\nx: 1\n...\n"]
    return found + [bytes([0, 3]) + text.encode() for text in odd]


def messages() -> list[bytes]:
    """Default messages, in little endian."""
    return [number.to_bytes(2, "big") + cdr.encode(cls()) for number, cls in enumerate(CLASSES)]


def tokens() -> list[bytes]:
    """A token of each kind."""
    described = [
        Endpoint(kind, "/sim/at", POINT, "/sim/n", qos=qos, type_hash="RIHS01_6")
        for kind in ("publisher", "subscription", "service", "client")
        for qos in (
            QoS(),
            QoS(depth=1, durability="transient_local"),
            QoS(depth=9, reliability="best_effort"),
        )
    ]
    found = [endpoint_token(0, "a1", 0, 3, each) for each in described]
    return [each.encode() for each in (*found, node_token(0, "a1", 0, "/sim/n"))]
