"""The interface of a bag's files, the same for every file format."""

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
"""The longest time that an option may give (s): 31 years, which fit in the stamps of all files."""


class Channel(msgspec.Struct, frozen=True, kw_only=True):
    """A topic in a file.

    Attributes:
        topic: The topic's name.
        schema: The schema of its messages.
        offers: The quality of service that its publishers offered.
        type_hash: The hash of the type, if the file has it.
        format: The encoding of its messages.
    """

    topic: str
    schema: Schema
    offers: tuple[Offer, ...] = ()
    type_hash: str = ""
    format: str = "cdr"


class Raw(NamedTuple):
    """A message as it is in a file.

    Attributes:
        stamp: When it was received (ns since 1970).
        sent: When it was published (ns since 1970).
        channel: Its topic.
        data: Its bytes.
    """

    stamp: int
    sent: int
    channel: Channel
    data: bytes


class Range(msgspec.Struct, frozen=True):
    """Which messages to read.

    Attributes:
        start: The earliest stamp (ns).
        end: The latest stamp (ns); None for no limit.
        wants: A function that says whether to read a topic; None for all topics.
    """

    start: int = 0
    end: int | None = None
    wants: Callable[[str], bool] | None = None

    def has(self, topic: str) -> bool:
        """Whether a topic is read."""
        return self.wants is None or self.wants(topic)


def in_nanoseconds(option: str, seconds: float) -> int:
    """Return a length of time in nanoseconds.

    Raises:
        InvalidOption: if it is negative or above `LONGEST`, or is no number.
    """
    if not 0 <= seconds <= LONGEST:
        raise InvalidOption(option, f"expected 0 to {LONGEST:,} seconds, not {seconds!r}")
    return round(seconds * 1e9)


class BagStorage(Protocol):
    """A file of a bag, open for reading.

    Attributes:
        path: The file.
        start: The time of the earliest message (ns); 0 if there is none.
        end: The time of the latest message (ns).
        is_closed: Whether the recorder closed the file.
        about: The text in the file that describes the bag; empty if there is none.
        flaw: What is missing because the file is cut off or damaged; empty if nothing is.
    """

    path: Path
    start: int
    end: int
    is_closed: bool
    about: str
    flaw: str

    @property
    def channels(self) -> Mapping[int, Channel]:
        """The topics of the file, by number."""

    @property
    def counts(self) -> Mapping[int, int]:
        """How many messages each topic has."""

    def messages(self, wanted: Range) -> Iterator[Raw]:
        """Yield the messages of a range, ordered by stamp. Raise BagError at a damaged place."""

    def close(self) -> None:
        """Close the file."""
