"""Implements ``bag record``, ``bag play`` and ``bag view``."""

from __future__ import annotations

import asyncio
import os
import sys
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import anyio

from turtleact.commands import graph
from turtleact.commands.bag_contents import messages_told, missing_goals
from turtleact.commands.interrupts import Interrupts
from turtleact.commands.output import counted, duration, note, printable, say
from turtleact.recording import Bag, Played, Recording, Selection, play, record
from turtleact.recording.metadata import BagError, read_qos_overrides
from turtleact.recording.spool import CAPACITY
from turtleact.tasks import Background

if TYPE_CHECKING:
    from turtleact.commands.settings import Reach
    from turtleact.node import Node
    from turtleact.recording.mcap_writing import Compression
    from turtleact.recording.player import PlayOptions

__all__ = ["PlayOrder", "RecordOrder", "has_display", "play_bag", "record_graph", "view_bag"]

MOST_NAMED = 5
"""A note about lost messages names at most this many topics."""

TELL = 2.0
"""After a signal, this much time separates two notes on the number of unwritten messages (s)."""

FAILED = 1
"""The exit status if nothing could be played, or a topic could not be recorded."""


class RecordOrder(NamedTuple):
    """What ``bag record`` records, and how.

    Attributes:
        path: The folder of the bag, which is created.
        selection: The topics, services and actions to record.
        max_size: The size after which the next file begins (bytes); 0 for no limit.
        max_duration: The duration after which the next file begins (s); 0 for no limit.
        capacity: How many bytes may wait to be written; 0 for the default.
        compression: How the chunks of each file are compressed.
        overrides: The file that sets the quality of service of topics; None for no file.
    """

    path: Path
    selection: Selection
    max_size: int
    max_duration: float
    capacity: int
    compression: Compression
    overrides: Path | None = None


def record_graph(reach: Reach, order: RecordOrder) -> int:
    """Record until a signal comes, and return the exit status.

    The exit status is 0 if a signal ends the recording, as for ``ros2 bag record``. The exit status
    is 1 if a topic could not be recorded.

    Raises:
        BagError: if the bag cannot be created, or the disk is full.
        TurtleactError: if no graph can be reached.
    """
    interrupts = Interrupts()
    recorded: list[Recording] = []
    qos = {} if order.overrides is None else read_qos_overrides(order.overrides)

    async def record_on(node: Node) -> int:
        try:
            async with record(
                node,
                order.path,
                selection=order.selection,
                max_size=order.max_size,
                max_duration=order.max_duration,
                compression=order.compression,
                capacity=order.capacity or CAPACITY,
                qos=qos,
            ) as recording:
                recorded.append(recording)
                interrupts.last_words = partial(_last_words, recording)
                watch = Background(_watch_closing(recording, interrupts), "closing the bag")
                note(f"recording to {order.path}; Ctrl-C ends it")
                await tell(recording)
        finally:
            if recorded:
                await watch.aclose()
                interrupts.last_words = str
                _sum_up_recording(recorded[0])
        return 0

    status = graph.run(reach, record_on, interrupts)
    if not recorded:
        return status
    if recorded[0].error is not None:  # not raised yet if a signal came before it was noticed
        raise recorded[0].error
    return FAILED if recorded[0].unrecorded else 0


async def _watch_closing(recording: Recording, interrupts: Interrupts) -> None:
    """After a signal, print a note about the number of unwritten messages at intervals."""
    await interrupts.wait()
    while True:
        await anyio.sleep(TELL)
        waiting = counted(recording.waiting, "message")
        note(f"closing {recording.path}: {waiting} still to write; Ctrl-C gives them up")


def _last_words(recording: Recording) -> str:
    """Return the text to print if a second signal ends the process before the bag is closed."""
    lost = counted(recording.waiting + recording.lost, "message")
    path = printable(str(recording.path))
    return (
        f"turtleact: {path} was not closed, because a second signal came: {lost} lost; "
        f"'turtleact bag info {path}' counts the others and says that the file was not closed\n"
    )


async def tell(recording: Recording) -> None:
    """Print a note for each topic when its recording begins.

    The call returns when the recording ends by itself, for example because of an error.
    """
    told = 0
    while not recording.is_over:
        for topic in recording.topics[told:]:
            note(f"subscribed to topic '{topic}'")
        told = len(recording.topics)
        await recording.wait_changed()


class PlayOrder(NamedTuple):
    """What ``bag play`` plays, and how.

    Attributes:
        path: The bag's folder, or a single file.
        options: The options of `turtleact.recording.play`.
        delay: How long to wait before playing (s).
        overrides: The file that sets the quality of service of topics; None for no file.
    """

    path: Path
    options: PlayOptions
    delay: float
    overrides: Path | None = None


def play_bag(reach: Reach, order: PlayOrder) -> int:
    """Play a bag, and return the exit status.

    Raises:
        BagError: if there is no bag, or a part of the bag is damaged.
        TurtleactError: if no graph can be reached.
    """
    bag = Bag(order.path)
    bag.close()
    qos = {} if order.overrides is None else read_qos_overrides(order.overrides)

    async def play_on(node: Node) -> int:
        length = duration(bag.info.duration / 1e9)
        note(f"playing {order.path}: {length}, {messages_told(bag.info)}")
        await node.clock.sleep(order.delay)
        options: PlayOptions = {**order.options, "qos": qos}
        return _sum_up_playing(await play(node, order.path, **options))

    return graph.run(reach, play_on)


def view_bag(path: Path, port: int, *, is_opened: bool) -> int:
    """Serve a web page that shows a bag, until a signal comes. Return the exit status.

    Raises:
        BagError: if there is no bag.
        InvalidOption: if the server cannot listen on the port.
    """
    import webbrowser

    interrupts = Interrupts()
    from turtleact.web.bag_view import open_bag_view  # only this verb needs a web server

    async def show() -> int:
        async with open_bag_view(path, port=port) as shown:
            say(f"{shown.url}\n")
            note("Ctrl-C ends it")
            interrupts.cancels = False
            if is_opened and has_display():
                await asyncio.to_thread(webbrowser.open, shown.url)
            await interrupts.wait()
        return 0

    return interrupts.run(show())


def has_display() -> bool:
    """Return whether a web browser would open in a window.

    Without a display, the default browser may be a text browser that takes over the terminal.
    """
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _sum_up_recording(recording: Recording) -> None:
    lost = recording.lost_by_topic
    if not recording.path.exists():
        return
    told, missing = counted(recording.count, "message"), list[str]()
    if recording.error is None:
        with suppress(BagError), closing(Bag(recording.path)) as bag:
            told, missing = messages_told(bag.info), missing_goals(bag)
    note(f"{told} recorded in {recording.path}")
    for sentence in missing:
        note(f"missing: {sentence}")
    for topic, count in sorted(lost.items(), key=lambda each: -each[1])[:MOST_NAMED]:
        note(f"lost: {counted(count, 'message')} of topic '{topic}'")
    for topic, reason in sorted(recording.unrecorded.items()):
        note(f"not recorded: topic '{topic}': {reason}")
    if len(lost) > MOST_NAMED:
        note(f"lost in all: {counted(sum(lost.values()), 'message')} of {len(lost)} topics")


def _sum_up_playing(played: Played) -> int:
    for topic, reason in played.skipped.items():
        note(f"'{topic}' was not played: {reason}; give --interfaces DIR")
    for (action, ended), count in sorted(played.goals.items()):
        note(f"{counted(count, 'goal')} of '{action}': {ended}")
    note(f"played {counted(played.messages, 'message')}")
    if played.failed:
        return FAILED
    return 0 if played.messages or played.goals else FAILED
