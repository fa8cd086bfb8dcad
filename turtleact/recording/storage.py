"""The interface for reading a file of a bag, the same for every file format."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final, NamedTuple, Protocol

import msgspec

from turtleact.errors import InvalidOption
from turtleact.recording.metadata import Offer
from turtleact.recording.schemas import Schema

__all__ = ["LONGEST", "BagStorage", "Channel", "Range", "Raw", "in_nanoseconds"]

LONGEST: Final = 1_000_000_000
"""The longest time that a user may pass as an option (s): about 31 years.

The stamps of every format can hold this time.
"""


class Channel(msgspec.Struct, frozen=True, kw_only=True):
    """A topic in a file.

    Attributes:
        topic: The topic's name.
        schema: The schema of its messages.
        offers: The quality of service that its publishers offered.
        type_hash: The hash of the type; empty if the file does not have it.
        format: The encoding of its messages, such as ``"cdr"``.
    """

    topic: str
    schema: Schema
    offers: tuple[Offer, ...] = ()
    type_hash: str = ""
    format: str = "cdr"


class Raw(NamedTuple):
    """A message in a file, not decoded.

    Attributes:
        stamp: When the message was received (ns since 1970).
        sent: When the message was published (ns since 1970).
        channel: The topic of the message.
        data: The encoded message.
    """

    stamp: int
    sent: int
    channel: Channel
    data: bytes


class Range(msgspec.Struct, frozen=True):
    """Selects the messages to read, by time and topic.

    Attributes:
        start: The lowest stamp of the messages to read (ns since 1970).
        end: The highest stamp of the messages to read (ns since 1970); None for no limit.
        wants: A function that gets a topic's name and returns whether to read the topic; None to
            read all topics.
    """

    start: int = 0
    end: int | None = None
    wants: Callable[[str], bool] | None = None

    def has(self, topic: str) -> bool:
        """Whether the messages of a topic are read."""
        return self.wants is None or self.wants(topic)


def in_nanoseconds(option: str, seconds: float) -> int:
    """Convert the value of an option from seconds to nanoseconds.

    Raises:
        InvalidOption: if ``seconds`` is negative, above `LONGEST` or NaN.
    """
    if not 0 <= seconds <= LONGEST:
        raise InvalidOption(option, f"expected 0 to {LONGEST:,} seconds, not {seconds!r}")
    return round(seconds * 1e9)


class BagStorage(Protocol):
    """A file of a bag, open for reading.

    Attributes:
        path: The file.
        start: The time of the earliest message (ns since 1970); 0 if there is none.
        end: The time of the latest message (ns since 1970); 0 if there is none.
        is_closed: Whether the recorder closed the file.
        about: The text in the file that describes the bag; empty if there is none.
        flaw: What is missing because the file is cut off or damaged; empty if nothing is missing.
    """

    path: Path
    start: int
    end: int
    is_closed: bool
    about: str
    flaw: str

    @property
    def channels(self) -> Mapping[int, Channel]:
        """The topics in the file, by their numbers."""

    @property
    def counts(self) -> Mapping[int, int]:
        """How many messages each topic has, by the topic's number."""

    def messages(self, wanted: Range) -> Iterator[Raw]:
        """Yield the messages that ``wanted`` selects, ordered by stamp.

        Raises:
            BagError: if a part of the file is damaged.
        """

    def close(self) -> None:
        """Close the file."""
