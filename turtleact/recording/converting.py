"""Rewrites bags: merges, filters, splits or compresses them, or restores a missing index.

Source: rosbag2 ``bag_rewrite.cpp``.
"""

from __future__ import annotations

import heapq
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from operator import attrgetter
from pathlib import Path

import msgspec

from turtleact.recording.bag import Bag
from turtleact.recording.bag_writer import BagWriter, Split
from turtleact.recording.metadata import BagError
from turtleact.recording.selection import EVERYTHING, Selection
from turtleact.recording.storage import Channel, Range, Raw

__all__ = ["Output", "convert"]

CHECK = 1000
"""After each group of this many messages, `convert` asks ``goes_on`` whether to continue."""


class Output(msgspec.Struct, frozen=True, kw_only=True):
    """A bag to write.

    Attributes:
        path: The folder to create. A path that ends in ``.mcap`` names a single file instead.
        selection: Which messages to write to the bag.
        start: The lowest stamp of the messages to write (ns since 1970).
        end: The highest stamp of the messages to write (ns since 1970); None for no limit.
        split: When to begin another file, and how to compress the files.
    """

    path: Path
    selection: Selection = EVERYTHING
    start: int = 0
    end: int | None = None
    split: Split = Split()


def convert(
    inputs: Sequence[Path], outputs: Sequence[Output], goes_on: Callable[[], bool] = lambda: True
) -> list[int]:
    """Write the messages of bags to new bags, in the order of their stamps. This call blocks.

    If an error is raised, all outputs are removed.

    Args:
        inputs: The bags to read.
        outputs: The bags to write.
        goes_on: Returns whether to continue. `convert` calls this function before the first message
            and after every 1,000 messages. If ``goes_on`` returns False, `convert` stops reading,
            and the outputs keep the messages written so far.

    Returns:
        How many messages were written to each output.

    Raises:
        BagError: if a bag cannot be read or written.
    """
    wanted = _range(outputs)
    found = [Bag(path).messages(wanted) for path in inputs]
    writers: list[_Writing] = []
    try:
        writers.extend(map(_Writing, outputs))  # if one raises, those before it are in the list
        for count, raw in enumerate(heapq.merge(*found, key=attrgetter("stamp"))):
            if not count % CHECK and not goes_on():
                break
            for writer in writers:
                writer.take(raw)
        for writer in writers:
            writer.close()
    except BaseException:
        for writer in writers:
            writer.discard()
        raise
    return [writer.count for writer in writers]


def _range(outputs: Sequence[Output]) -> Range:
    """Return the smallest time range that covers the ranges of all outputs."""
    ends = [each.end for each in outputs if each.end is not None]
    start = min((each.start for each in outputs), default=0)
    return Range(start, max(ends) if ends and len(ends) == len(outputs) else None)


class _Writing:
    """Writes one bag."""

    def __init__(self, output: Output) -> None:
        self.count = 0
        self._output = output
        self._writer = BagWriter(output.path, output.split)
        self._numbers: dict[Channel, int | None] = {}

    def take(self, raw: Raw) -> None:
        """Write a message, if the output's range and selection include it."""
        output = self._output
        if raw.stamp < output.start or (output.end is not None and raw.stamp > output.end):
            return
        number = self._number(raw.channel)
        if number is not None:
            try:
                self._writer.write(number, raw.stamp, raw.sent, raw.data)
            except OSError as error:
                raise self._error(error) from error
            self.count += 1

    def close(self) -> None:
        """Close the bag."""
        try:
            self._writer.close({})
        except OSError as error:
            raise self._error(error) from error

    def discard(self) -> None:
        """Remove the bag, because an unfinished bag would look complete."""
        with suppress(OSError):
            self._writer.close({})
        path = self._output.path
        if path.is_dir():  # the writer has made it, so nothing else is in it
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)

    def _number(self, channel: Channel) -> int | None:
        if channel not in self._numbers:
            wanted = self._output.selection.wants(channel.topic, channel.schema.name)
            self._numbers[channel] = len(self._numbers) if wanted else None
            if wanted:
                self._writer.add(len(self._numbers) - 1, channel)
        return self._numbers[channel]

    def _error(self, error: OSError) -> BagError:
        return BagError(self._output.path, f"it cannot be written: {error.strerror}")
