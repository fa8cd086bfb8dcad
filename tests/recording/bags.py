"""Bags for tests, and readers of bags that turtleact did not write."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from turtleact.interfaces import encode, get_message, type_hash
from turtleact.recording.bag_writer import BagWriter, Split
from turtleact.recording.metadata import Offer
from turtleact.recording.schemas import schema_of
from turtleact.recording.storage import Channel
from turtleact.transports.base import STATUS_QOS

FEEDBACK = get_message("example_interfaces/action/Fibonacci_FeedbackMessage")
POSE = get_message("turtlesim/msg/Pose")
START = 1_800_000_000_000_000_000
STEP = 1_000_000


def channel(topic: str, cls: Any, *offers: Offer) -> Channel:
    return Channel(
        topic=topic,
        schema=schema_of(cls),
        offers=offers or (Offer(),),
        type_hash=type_hash(cls),
    )


def opened(path: Path, split: Split | None = None) -> BagWriter:
    """A bag with two topics, 0 for feedback and 1 for poses, and no message yet."""
    writer = BagWriter(path, split or Split())
    writer.add(0, channel("/fibonacci/_action/feedback", FEEDBACK))
    writer.add(1, channel("/turtle1/pose", POSE, Offer(STATUS_QOS)))
    return writer


def message(number: int) -> bytes:
    """The message at a place: feedback and poses in turn."""
    if number % 2:
        return encode(POSE(x=float(number)))
    return encode(FEEDBACK(feedback=FEEDBACK().feedback.__class__(sequence=[number])))


def fill(writer: BagWriter, count: int, first: int = 0) -> None:
    for number in range(first, first + count):
        writer.write(number % 2, START + number * STEP, START + number * STEP, message(number))


def write_bag(path: Path, count: int = 10, split: Split | None = None) -> Path:
    writer = opened(path, split)
    fill(writer, count)
    writer.close({})
    return path


def by_rosbags(path: Path) -> list[tuple[str, int, Any]]:
    """Topic, stamp and decoded message, as rosbags reads them."""
    store = get_typestore(Stores.EMPTY)
    found = []
    with Reader(path) as reader:
        for each in reader.connections:
            store.register(get_types_from_msg(each.msgdef.data, each.msgtype))
        for each, stamp, data in reader.messages():
            # rosbags registers pkg/srv/Name as pkg/srv/msg/Name, whoever wrote the bag.
            name = each.msgtype.replace("/srv/", "/srv/msg/")
            found.append((each.topic, stamp, store.deserialize_cdr(data, name)))
    return found


def by_mcap(path: Path) -> list[tuple[str, int, bytes]]:
    """Topic, stamp and bytes, as the mcap package reads them, with every checksum compared."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        return [(one.topic, each.log_time, each.data) for _, one, each in reader.iter_messages()]


def of_unfinished(path: Path) -> list[int]:
    """The stamps in a file without an index, as the mcap package reads them."""
    found = []
    with path.open("rb") as stream, contextlib.suppress(McapError):
        for _, _, each in NonSeekingReader(stream).iter_messages(log_time_order=False):
            found.append(each.log_time)  # the reader raises at the end
    return found
