"""``bag record``: record a graph until a signal comes or the disk is full."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from turtleact.commands import graph
from turtleact.commands.output import counted, note
from turtleact.recording import Recording, Selection, record
from turtleact.recording.spool import CAPACITY

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts
    from turtleact.commands.settings import Reach
    from turtleact.node import Node
    from turtleact.recording.mcap_writing import Compression

__all__ = ["Order", "run"]

MOST_NAMED = 5
"""How many topics a note about lost messages names."""

PATIENCE = 10.0
"""How long the bag may take to be closed after a signal (s)."""


class Order(NamedTuple):
    """What to record.

    Attributes:
        path: The folder to create.
        selection: The topics, services and actions.
        max_size: When to begin another file (bytes); 0 for never.
        max_duration: Likewise (s).
        capacity: How many bytes may wait to be written; 0 for the default.
        compression: How chunks are compressed.
    """

    path: Path
    selection: Selection
    max_size: int
    max_duration: float
    capacity: int
    compression: Compression


def run(reach: Reach, order: Order, interrupts: Interrupts) -> int:
    """Record, and return the exit status: 0 if a signal has ended it, as for ``ros2 bag record``.

    Raises:
        BagError: if the bag cannot be created, or the disk is full.
        TurtleactError: if no graph is in reach.
    """
    interrupts.patience = PATIENCE
    recorded: list[Recording] = []

    async def record_graph(node: Node) -> int:
        try:
            async with record(
                node,
                order.path,
                selection=order.selection,
                max_size=order.max_size,
                max_duration=order.max_duration,
                compression=order.compression,
                capacity=order.capacity or CAPACITY,
            ) as recording:
                recorded.append(recording)
                note(f"recording to {order.path}; Ctrl-C ends it")
                await tell(recording)
        finally:
            if recorded:
                _sum_up(recorded[0])
        return 0

    status = graph.run(reach, record_graph, interrupts)
    return 0 if recorded else status


async def tell(recording: Recording) -> None:
    """Note each topic once it is recorded, until the recording ends early."""
    told = 0
    while not recording.is_over:
        for topic in recording.topics[told:]:
            note(f"subscribed to topic '{topic}'")
        told = len(recording.topics)
        await recording.wait_changed()


def _sum_up(recording: Recording) -> None:
    lost = recording.lost_by_topic
    note(f"{counted(recording.count, 'message')} recorded in {recording.path}")
    for topic, count in sorted(lost.items(), key=lambda each: -each[1])[:MOST_NAMED]:
        note(f"lost: {counted(count, 'message')} of topic '{topic}'")
    if len(lost) > MOST_NAMED:
        note(f"lost in all: {counted(sum(lost.values()), 'message')} of {len(lost)} topics")
