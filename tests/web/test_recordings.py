"""What turtleact records is read by the libraries of Foxglove and Lichtblick, to the last value."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from turtleact import open_world, recording
from turtleact.actions.patrol import Patrol
from turtleact.interfaces.standard import Point
from turtleact.interfaces.text import to_json

READER = Path(__file__).with_name("bag_reader.mjs")


async def record_patrol(path: Path) -> None:
    async with open_world(speed="max", introspection="contents") as node:
        client = node.action_client(Patrol, "patrol")
        topics = ["/turtle1/pose", "/turtle1/cmd_vel"]
        async with recording.record(node, path, actions=["/patrol"], topics=topics):
            await client.send_goal(Patrol.Goal(targets=[Point(x=7.0, y=6.0)]))


@pytest.mark.loops("asyncio")
async def test_foxglove_reads_every_message_of_a_patrol(javascript, tmp_path):
    await record_patrol(tmp_path / "run.mcap")
    ours = [each async for each in recording.read(tmp_path / "run.mcap")]
    script = shutil.copy(READER, javascript.parent)  # it imports what is beside it
    node = ["node", str(script), str(tmp_path / "run.mcap")]
    outcome = subprocess.run(node, capture_output=True, text=True, timeout=30, check=False)
    assert outcome.returncode == 0, outcome.stderr
    theirs = [json.loads(line) for line in outcome.stdout.splitlines()]
    assert len(theirs) == len(ours) > 50
    topics = {topic for topic, _, _ in theirs}
    assert len(topics) == 6  # the cancel service was not used
    for (topic, _, value), message in zip(theirs, ours, strict=True):
        assert topic == message.topic
        same(value, json.loads(to_json(message.value)))


def same(theirs: object, ours: object) -> None:
    """Compare values; their times are called nsec, and their bytes are lists."""
    if isinstance(ours, dict):
        assert isinstance(theirs, dict)
        names = {"nsec": "nanosec"}
        assert {names.get(key, key) for key in theirs} == set(ours)
        for key, value in theirs.items():
            same(value, ours[names.get(key, key)])
    elif isinstance(ours, list):
        assert isinstance(theirs, list)
        for one, other in zip(theirs, ours, strict=True):
            same(one, other)
    else:
        assert theirs == pytest.approx(ours)
