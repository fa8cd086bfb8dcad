"""``bag play``: publish the messages of a bag, or send its goals again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from turtleact.commands import graph
from turtleact.commands.output import counted, duration, note
from turtleact.recording import Bag, Played, play

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts
    from turtleact.commands.settings import Reach
    from turtleact.node import Node
    from turtleact.recording.player import PlayOptions

__all__ = ["Order", "run"]

FAILED = 1
"""The exit status if nothing could be played."""


class Order(NamedTuple):
    """What to play.

    Attributes:
        path: The bag.
        options: The options of `turtleact.recording.play`.
        delay: How long to wait before (s).
    """

    path: Path
    options: PlayOptions
    delay: float


def run(reach: Reach, order: Order, interrupts: Interrupts) -> int:
    """Play, and return the exit status.

    Raises:
        BagError: if there is no bag, or a place in it is damaged.
        TurtleactError: if no graph is in reach.
    """
    bag = Bag(order.path)
    bag.close()

    async def play_on(node: Node) -> int:
        length = duration(bag.info.duration / 1e9)
        note(f"playing {order.path}: {counted(bag.info.count, 'message')} of {length}")
        await node.clock.sleep(order.delay)
        return _sum_up(await play(node, order.path, **order.options))

    return graph.run(reach, play_on, interrupts)


def _sum_up(played: Played) -> int:
    for topic, reason in played.skipped.items():
        note(f"'{topic}' was not played: {reason}; give --interfaces DIR")
    for (action, ended), count in sorted(played.goals.items()):
        note(f"{counted(count, 'goal')} of '{action}': {ended}")
    note(f"played {counted(played.messages, 'message')}")
    return 0 if played.messages or played.goals or not played.skipped else FAILED
