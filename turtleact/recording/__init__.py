"""Recordings of topics and goals, in MCAP files as ROS 2 writes and reads them.

Record with a node, and read without one::

    async with recording.record(node, "run", actions=["/patrol"], topics=["/turtle1/pose"]):
        await client.send_goal(...)

    async for message in recording.read("run"):
        print(message.topic, message.stamp, message.value)

Needs the extra ``bag``.
"""

from turtleact.recording.bag import Bag, Recorded, read
from turtleact.recording.goals import RecordedGoal, goals
from turtleact.recording.metadata import BagError, BagFile, BagInfo, BagTopic
from turtleact.recording.player import Played, play
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
