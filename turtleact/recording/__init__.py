"""Records topics and goals to MCAP files, in the form that ROS 2 writes and reads.

Record with a node, and read without one::

    async with recording.record(node, "run", actions=["/patrol"], topics=["/turtle1/pose"]):
        await client.send_goal(...)

    async for message in recording.read("run"):
        print(message.topic, message.stamp, message.value)

This package needs turtleact's extra ``bag``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from turtleact.recording.bag import Bag, Recorded, read
    from turtleact.recording.metadata import BagError, BagFile, BagInfo, BagTopic
    from turtleact.recording.player import Played, play
    from turtleact.recording.recorded_goals import RecordedGoal, goals
    from turtleact.recording.recorder import Recording, record
    from turtleact.recording.selection import Selection

__all__ = [
    "Bag",
    "BagError",
    "BagFile",
    "BagInfo",
    "BagTopic",
    "Played",
    "Recorded",
    "RecordedGoal",
    "Recording",
    "Selection",
    "goals",
    "play",
    "read",
    "record",
]

_HOMES = {
    "bag": ("Bag", "Recorded", "read"),
    "recorded_goals": ("RecordedGoal", "goals"),
    "metadata": ("BagError", "BagFile", "BagInfo", "BagTopic"),
    "player": ("Played", "play"),
    "recorder": ("Recording", "record"),
    "selection": ("Selection",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> object:
    """Import a name from its module on first use, so that unused modules cost no time."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    value = getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value
