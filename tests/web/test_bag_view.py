"""A bag on a page: scrubbed, played, with goals as bars; and only what is shown is read."""

from __future__ import annotations

import json
import math
import signal
import urllib.error
import urllib.request
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import anyio
import anyio.to_thread
import pytest

from turtleact import cli, open_world, recording
from turtleact.actions.patrol import Patrol
from turtleact.commands import bag as bag_verbs
from turtleact.interfaces import encode
from turtleact.interfaces.standard import Point, TurtlePose, Twist
from turtleact.recording.bag_writer import BagWriter, Split
from turtleact.recording.schemas import schema_of
from turtleact.recording.storage import Channel
from turtleact.sim.pictures import hue_of
from turtleact.web.bag_view import open_bag_view

from .browser import CHROMIUM, open_tab, running_browser

START = 1_800_000_000_000_000_000

in_a_browser = pytest.mark.skipif(not CHROMIUM, reason="no Chromium is installed")


@pytest.fixture(scope="module")
def patrol(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with a patrol of two targets."""
    path = tmp_path_factory.mktemp("bags") / "patrol"

    async def record() -> None:
        async with open_world(speed="max", introspection="contents") as node:
            client = node.action_client(Patrol, "patrol")
            async with recording.record(node, path):
                await node.clock.sleep(1)
                targets = [Point(x=8.0, y=6.0), Point(x=8.0, y=9.0)]
                await client.send_goal(Patrol.Goal(targets=targets))

    anyio.run(record)
    return path


@pytest.fixture
async def url(patrol: Path) -> AsyncIterator[str]:
    async with open_bag_view(patrol) as shown:
        yield shown.url


async def get(url: str, **headers: str) -> tuple[int, bytes]:
    def ask() -> tuple[int, bytes]:
        request = urllib.request.Request(url, headers=headers)
        try:
            with urllib.request.urlopen(request) as answer:
                return answer.status, answer.read()
        except urllib.error.HTTPError as error:
            return error.code, error.read()

    return await anyio.to_thread.run_sync(ask)


async def values(url: str) -> Any:
    status, content = await get(url)
    assert status == 200, content
    return json.loads(content)


async def test_the_page_gets_what_it_shows(url):
    about = await values(f"{url}bag")
    assert about["poses"] == {"/turtle1/pose": "turtlesim/msg/Pose"}
    assert about["hues"] == {"/turtle1/pose": hue_of("turtle1")}
    assert about["is_closed"]
    poses = (await values(f"{url}poses?start=0.5&end=1.5"))["/turtle1/pose"]
    assert 0.5 <= poses[0][0] < poses[-1][0] <= 1.5
    assert len(poses) < 45
    [goal] = await values(f"{url}goals")
    assert (goal["action"], goal["status"]) == ("/patrol", "SUCCEEDED")
    assert goal["start"] == pytest.approx(1, abs=0.1)
    assert goal["end"] == pytest.approx(about["duration"], abs=0.1)
    assert goal["request"]["targets"][0]["x"] == 8.0
    assert len(goal["reached"]) == 2
    assert (await get(url))[1].startswith(b"<!doctype html>")
    assert (await get(f"{url}world.js"))[0] == 200


REFUSED = [
    ("poses?start=0&end=100", 400, b"ask for 60 s at most"),
    ("poses?start=1&end=0", 400, b"ask for 60 s at most"),
    ("poses?start=x&end=1", 400, b"could not convert"),
    ("poses", 400, b"ask for 60 s at most"),
    ("etc", 404, b"the only page is at the path /"),
]


async def test_what_makes_no_sense_is_refused(url):
    for path, status, text in REFUSED:
        found = await get(f"{url}{path}")
        assert found[0] == status
        assert text in found[1]


async def test_pages_of_other_sites_get_nothing(url):
    assert (await get(f"{url}bag", Host="evil.example"))[0] == 403
    assert (await get(f"{url}bag", Origin="https://evil.example"))[0] == 403


async def test_a_pose_that_is_no_number_is_left_out(tmp_path):
    writer = BagWriter(tmp_path / "odd.mcap", Split())
    writer.add(0, Channel(topic="/turtle1/pose", schema=schema_of(TurtlePose)))
    for second, x in enumerate((1.0, math.nan, 3.0)):
        stamp = START + second * 10**9
        writer.write(0, stamp, stamp, encode(TurtlePose(x=x)))
    writer.close({})
    async with open_bag_view(tmp_path / "odd.mcap") as shown:
        poses = await values(f"{shown.url}poses?start=0&end=3")
        assert (await values(f"{shown.url}bag"))["first"] == {"/turtle1/pose": [0.0, 1.0, 0.0, 0.0]}
    assert [x for _, x, _, _ in poses["/turtle1/pose"]] == [1.0, 3.0]


@pytest.fixture
def late(tmp_path: Path) -> Path:
    """A bag with a long topic name and a turtle whose first pose comes after 20 s."""
    writer = BagWriter(tmp_path / "late.mcap", Split())
    writer.add(0, Channel(topic="/turtle1/pose", schema=schema_of(TurtlePose)))
    writer.add(1, Channel(topic=f"/{'robot_' * 9}status", schema=schema_of(Twist)))
    writer.add(2, Channel(topic="/turtle2/pose", schema=schema_of(TurtlePose)))
    writer.write(1, START, START, encode(Twist()))
    for second, x in ((19, math.nan), (20, 3.0), (21, 4.0)):
        stamp = START + second * 10**9
        writer.write(0, stamp, stamp, encode(TurtlePose(x=x)))
    writer.close({})
    return tmp_path / "late.mcap"


async def test_the_first_pose_of_each_turtle_is_known_from_the_start(late):
    async with open_bag_view(late) as shown:
        about = await values(f"{shown.url}bag")
    assert about["first"] == {"/turtle1/pose": [20.0, 3.0, 0.0, 0.0]}


@in_a_browser
async def test_a_bag_is_scrubbed_and_played(url, tmp_path):
    with running_browser(tmp_path) as devtools:
        async with open_tab(devtools, url) as page:
            await page.until("document.querySelectorAll('#rows i.good').length === 1")
            assert await page.text("#rows .name") == "/patrol"
            await page.run("$('scrub').value = 1.5; $('scrub').oninput()")
            assert await page.text("#time") == "1.5 s"
            place = (
                "import('./bag.js').then(({bag}) => bag.world.turtles.get('turtle1').pose?.x ?? 0)"
            )
            early = await page.run(place)
            await page.click("#rows i")
            assert "SUCCEEDED after" in await page.text("#told")
            assert '"targets"' in await page.text("#told")
            await page.run("$('speed').value = 50")
            await page.click("#play")
            await page.until(
                "$('play').textContent === 'Play' && $('scrub').value == $('scrub').max"
            )
            late = await page.run(place)
            assert 5 < early < late
            assert page.complaints == []


def test_the_command_prints_the_address_and_ends_at_a_signal(tmp_path, capsys, monkeypatch):
    path = tmp_path / "run.mcap"
    BagWriter(path, Split()).close({})
    opened = list[str]()
    monkeypatch.setattr(bag_verbs, "has_display", lambda: True)

    def open_tab(address: str) -> None:
        opened.append(address)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr("webbrowser.open", open_tab)
    assert cli.run(["bag", "view", str(path)]) == 0
    address = capsys.readouterr().out.strip()
    assert address.startswith("http://127.0.0.1:")
    assert opened == [address]
