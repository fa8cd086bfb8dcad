"""Shows a bag in the browser: turtles on a map, goals as bars on a time line, and a time slider.

The page requests only the poses of some seconds around the chosen moment. The server finds these
poses through the index of the bag, so a large bag opens as quickly as a small one. The page
requests the goals separately, because their messages are spread over the whole bag.

This server listens on a loopback address. It refuses requests whose Host header is neither an IP
address nor a loopback name.
"""

from __future__ import annotations

import json
import math
import secrets
from collections.abc import AsyncIterator, Callable
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import anyio
import anyio.to_thread
import msgspec
from starlette.requests import Request
from starlette.responses import Response

from turtleact.http_server import Access, Config, bound, serving
from turtleact.interfaces import to_json
from turtleact.interfaces.types import fields
from turtleact.recording.bag import Bag, reader_of
from turtleact.recording.metadata import BagError
from turtleact.recording.recorded_goals import RecordedGoal, goals
from turtleact.recording.schemas import class_of
from turtleact.recording.selection import part_of
from turtleact.recording.storage import Channel, Range, Raw
from turtleact.tasks import opening
from turtleact.web.bridge import HEADERS, page_response, plain_text
from turtleact.web.page_values import hues

if TYPE_CHECKING:
    from starlette.types import Receive, Scope, Send

__all__ = ["BagView", "open_bag_view"]

LONGEST: Final = 60.0
"""The longest part of a bag that is sent at once (s)."""

CLOSEST: Final = 25_000_000
"""A turtle's pose is left out if it comes less than this time after the last one kept (ns)."""

LAST_ORDERS: Final = 2
"""How long uvicorn waits at its end for requests that are under way (s)."""

MOST_TURTLES: Final = 64
MOST_SKIPPED: Final = 100
"""How many messages of a topic are searched for its first pose."""

COORDINATES: Final = frozenset({"x", "y", "theta"})
"""The fields of a pose that can be drawn."""


class BagView:
    """An ASGI app that shows a bag.

    Args:
        bag: The bag.
    """

    def __init__(self, bag: Bag) -> None:
        self._bag = bag
        self._access = Access()
        self._reading = anyio.Lock()  # threads share the file
        self._poses: dict[str, Channel] = {}
        self._answers: dict[str, Callable[[Request], Any]] = {
            "/bag": self._describe,
            "/poses": self._find_poses,
            "/goals": self._find_goals,
        }

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer an HTTP request."""
        if scope["type"] == "http":
            response = await self._answer(Request(scope))
            await response(scope, receive, send)

    async def _answer(self, asked: Request) -> Response:
        host, origin = asked.headers.get("host", ""), asked.headers.get("origin")
        problem = self._access.problem(host=host, origin=origin)
        if problem:
            return plain_text(403, problem)
        answer = self._answers.get(asked.url.path)
        if answer is None:
            return page_response(asked.url.path, "bag_page", "page")
        try:
            async with self._reading:
                found = await anyio.to_thread.run_sync(partial(answer, asked))
        except (BagError, ValueError) as error:
            return plain_text(400, str(error))
        content = msgspec.json.encode(found)  # unlike json, this writes null for NaN
        return Response(content, headers=HEADERS, media_type="application/json")

    # what the page asks for; in a thread

    def _describe(self, _: Request) -> dict[str, object]:
        info = self._bag.info
        return {
            "name": self._bag.path.name,
            "start": info.start / 1e9,
            "duration": info.duration / 1e9,
            "messages": info.count,
            "is_closed": info.is_closed,
            "poses": {topic: each.schema.name for topic, each in self._channels().items()},
            "hues": hues(self._channels()),
            "first": self._first_poses(),
            "topics": [[each.name, each.type_name, each.count] for each in info.topics],
        }

    def _first_poses(self) -> dict[str, list[float]]:
        """Return the first pose of each topic, in the form of `_pose`.

        Topics without a finite pose in their first `MOST_SKIPPED` messages are left out.
        """
        found: dict[str, list[float]] = {}
        counts = {each.name: each.count for each in self._bag.info.topics}
        for topic, channel in self._channels().items():
            if not counts.get(topic):
                continue  # do not search the whole bag
            read = reader_of(channel)
            for raw in islice(self._bag.messages(Range(wants=topic.__eq__)), MOST_SKIPPED):
                if pose := self._pose(raw, read):
                    found[topic] = pose
                    break
        return found

    def _pose(self, raw: Raw, read: Callable[[bytes], Any]) -> list[float] | None:
        """Return the time since the start of the bag (s), and the x, y and theta of a message.

        The result is None if the message cannot be decoded, or if one of the numbers is not finite.
        """
        pose = read(raw.data)
        if pose is None or not all(map(math.isfinite, (pose.x, pose.y, pose.theta))):
            return None
        return [(raw.stamp - self._bag.info.start) / 1e9, pose.x, pose.y, pose.theta]

    def _find_poses(self, asked: Request) -> dict[str, list[list[float]]]:
        """Return the poses of each topic between two moments, in the form of `_pose`."""
        origin, channels = self._bag.info.start, self._channels()
        start, end = (float(asked.query_params.get(name, "nan")) for name in ("start", "end"))
        if not 0 <= end - start <= LONGEST:
            raise ValueError(f"ask for {LONGEST:g} s at most")
        first, last = (origin + round(moment * 1e9) for moment in (start, end))
        wanted = Range(first, last, channels.__contains__)
        readers = {topic: reader_of(each) for topic, each in channels.items()}
        found: dict[str, list[list[float]]] = {topic: [] for topic in channels}
        latest = dict.fromkeys(channels, -CLOSEST)
        for raw in self._bag.messages(wanted):
            topic = raw.channel.topic
            if raw.stamp - latest[topic] < CLOSEST:
                continue
            latest[topic] = raw.stamp
            if pose := self._pose(raw, readers[topic]):
                found[topic].append(pose)
        return found

    def _find_goals(self, _: Request) -> list[dict[str, object]]:
        found = anyio.run(goals, self._bag.path)  # in this thread
        origin, reached = self._bag.info.start, self._reached()
        return [{**_goal(each, origin), "reached": reached.get(each.id, [])} for each in found]

    def _reached(self) -> dict[bytes, list[float]]:
        """Return the times at which each goal reached its targets, keyed by goal id.

        The times are in seconds since the start of the bag. Only goals whose feedback has a number
        ``reached`` are included.
        """
        times: dict[bytes, list[float]] = {}
        readers: dict[str, Callable[[bytes], Any]] = {}
        for raw in self._bag.messages(Range(wants=lambda topic: part_of(topic).part == "feedback")):
            topic = raw.channel.topic
            if topic not in readers:
                readers[topic] = reader_of(raw.channel)
            message = readers[topic](raw.data)
            count = getattr(getattr(message, "feedback", None), "reached", None)
            if isinstance(count, int):
                known = times.setdefault(bytes(message.goal_id.uuid), [])
                known += [(raw.stamp - self._bag.info.start) / 1e9] * (count - len(known))
        return times

    def _channels(self) -> dict[str, Channel]:
        """Return the bag's channels of poses by topic, at most `MOST_TURTLES`."""
        if not self._poses:
            found = (each for each in self._bag.channels() if _is_pose(each))
            self._poses = {each.topic: each for each in [*found][:MOST_TURTLES]}
        return self._poses


class Shown(msgspec.Struct, frozen=True):
    """A bag that is shown on a page.

    Attributes:
        url: The address of the page.
    """

    url: str


@opening
async def open_bag_view(
    path: str | Path, host: str = "127.0.0.1", port: int = 0
) -> AsyncIterator[Shown]:
    """Serve a page that shows a bag, for the length of a block.

    The event loop must be that of asyncio or uvloop.

    Args:
        path: The folder of the bag, or a single file.
        host: The loopback address to bind.
        port: The port, or 0 for any free one.

    Raises:
        BagError: if the bag does not exist or cannot be read.
        InvalidOption: if the host or the port cannot be bound.
    """
    bag = await anyio.to_thread.run_sync(Bag, path)
    with bound(host, port) as listener:
        at: tuple[str, int] = listener.getsockname()[:2]
        config = Config(BagView(bag), timeout_graceful_shutdown=LAST_ORDERS)
        async with serving(config, listener):
            yield Shown(f"http://{at[0]}:{at[1]}/")


def _is_pose(channel: Channel) -> bool:
    cls = class_of(channel.schema, channel.type_hash)
    if cls is None:
        return False
    numbers = {each.name for each in fields(cls) if str(each.type) in ("float32", "float64")}
    return numbers >= COORDINATES


def _goal(goal: RecordedGoal, origin: int) -> dict[str, object]:
    end = goal.ended
    return {
        "id": goal.id.hex() or secrets.token_hex(4),
        "action": goal.action,
        "status": "REJECTED" if goal.accepted is False else goal.status.name,
        "has_ended": goal.status.is_terminal or goal.accepted is False,
        "start": (goal.stamp - origin) / 1e9,
        "end": (end - origin) / 1e9 if end else None,
        "feedback_count": goal.feedback_count,
        "request": None if goal.goal is None else json.loads(to_json(goal.goal)),
        "result": None if goal.result is None else json.loads(to_json(goal.result)),
    }
