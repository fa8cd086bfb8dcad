"""Implements ``bag info`` and ``bag goals``, which print what is in a bag.

``bag info`` prints the contents as ``ros2 bag info`` does. It also says which messages and goals
are missing from the bag.

Source: rosbag2 ``format_bag_metadata.cpp``, ``format_action_info.cpp``.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from turtleact.commands.output import counted, duration, note, say, say_lines, say_table
from turtleact.interfaces import to_json
from turtleact.interfaces.conversion import to_dict
from turtleact.interfaces.text import flow
from turtleact.names import EVENT_SUFFIX, resolve_name
from turtleact.recording.bag import Bag
from turtleact.recording.metadata import BagInfo, BagTopic
from turtleact.recording.selection import REQUESTS, owner_of, part_of
from turtleact.recording.storage import Range

if TYPE_CHECKING:
    from turtleact.recording import RecordedGoal

__all__ = ["messages_told", "missing_goals", "print_goals", "print_info"]

INDENT = 19
"""The width of the column of names at the left."""

_SIZES = ("B", "KiB", "MiB", "GiB", "TiB")

HEADINGS = ("id", "action", "state", "took", "feedback", "goal", "result", "reason")

LONGEST = 40
"""In a table, a goal or result is cut after this many characters."""


def print_info(path: Path, *, verbose: bool, names_only: bool) -> None:
    """Print what is in a bag.

    With ``verbose``, requests and responses are counted separately. With ``names_only``, only the
    names of the topics are printed.

    Raises:
        BagError: if there is no bag, or one of its files cannot be opened.
    """
    bag = Bag(path)
    info = bag.info
    if names_only:
        say_lines(sorted({each.name for each in info.topics}))
        return
    reading = _Reading(bag) if verbose else None
    lines = [*_head(info), *_topics(info), *_services(info, reading), *_actions(info, reading)]
    say_lines(["", *lines, *_remarks(info)])


def print_goals(path: Path, name: str | None, *, as_json: bool) -> None:
    """Print the goals in a bag.

    Raises:
        BagError: if there is no bag, or a part of the bag is damaged.
        InvalidName: if the name breaks ROS 2's rules for names.
    """
    import anyio  # `print_info` does without it

    from turtleact.recording import goals

    actions = None if name is None else [resolve_name(name)]

    found = anyio.run(partial(goals, path, actions=actions))
    if as_json:
        say("".join(f"{_json_line(each)}\n" for each in found))
    elif found:
        say_table([HEADINGS, *map(_goal_row, found)])
    else:
        note("the bag has no goals")


def messages_told(info: BagInfo) -> str:
    """Return the number of messages as text.

    If the bag has messages of actions or services, the text also says how many.
    """
    others = _count_of_owners(info)
    if not others:
        return counted(info.count, "message")
    split = f"{info.count - others} of topics, {others} of actions and services"
    return f"{counted(info.count, 'message')} ({split})"


def missing_goals(info: BagInfo) -> str:
    """Name the actions whose goals and results are missing from a bag, and explain why."""
    silent = [each.name for each in _actions_of(info) if _lacks_goals(each)]
    if not silent:
        return ""
    return (
        f"the goals and results of {', '.join(silent)}. No service events were published; "
        "to record them, serve the actions with 'turtleact serve --introspection contents', or "
        "call configure_introspection on rclpy's ActionServer."
    )


class _Action(NamedTuple):
    """An action in a bag: its type, and the topics of its parts, such as ``"feedback"``."""

    name: str
    type_name: str
    parts: dict[str, BagTopic]


class _Reading:
    """Counts the requests, responses and bytes of each topic by reading all messages of a bag."""

    def __init__(self, bag: Bag) -> None:
        self.sizes: Counter[str] = Counter()
        self.requests: Counter[str] = Counter()
        self.responses: Counter[str] = Counter()
        for raw in bag.messages(Range()):
            topic = raw.channel.topic
            self.sizes[topic] += len(raw.data)
            if topic.endswith(EVENT_SUFFIX) and len(raw.data) > 4:
                # The kind of event is the first byte behind the header of CDR.
                (self.requests if raw.data[4] in REQUESTS else self.responses)[topic] += 1


def _head(info: BagInfo) -> list[str]:
    end = info.start + info.duration
    files = [each.path for each in info.files]
    return [
        *_under("Files:", files),
        _row("Bag size:", _size(info.size)),
        _row("Storage id:", info.storage),
        _row("ROS Distro:", info.distro or "unknown"),
        _row("Duration:", f"{_seconds(info.duration)}s"),
        _row("Start:", _moment(info.start)),
        _row("End:", _moment(end)),
        _row("Messages:", str(info.count - _count_of_owners(info))),
    ]


def _count_of_owners(info: BagInfo) -> int:
    """Return how many messages belong to actions and services.

    ``ros2 bag info`` leaves messages of actions and services out of its total.
    """
    return sum(each.count for each in info.topics if part_of(each.name).owner != "topic")


def _topics(info: BagInfo) -> list[str]:
    rows = [
        f"Topic: {each.name} | Type: {each.type_name} | Count: {each.count} | "
        f"Serialization Format: {each.format}"
        for each in _sorted(info.topics)
        if part_of(each.name).owner == "topic"
    ]
    return _under("Topic information:", rows)


def _services(info: BagInfo, reading: _Reading | None) -> list[str]:
    events = [each for each in _sorted(info.topics) if part_of(each.name).owner == "service"]
    rows = [
        f"Service: {part_of(each.name).name} | Type: {owner_of(each.name, each.type_name)} | "
        f"{_events(each, reading)} | Serialization Format: {each.format}"
        for each in events
    ]
    return [
        _row("Services:", str(len(events))),
        *_under("Service information:", rows, INDENT + 2),
    ]


def _actions(info: BagInfo, reading: _Reading | None) -> list[str]:
    actions = _actions_of(info)
    lines = [_row("Actions:", str(len(actions))), "Action information: "]
    for action in actions:
        topics = ["feedback", "status", *(["reason"] if "reason" in action.parts else [])]
        lines.append(
            f"  Action: {action.name} | Type: {action.type_name} | Topics: {len(topics)} | "
            "Service: 3 | Serialization Format: cdr"
        )
        for part in topics:
            topic = action.parts.get(part)
            lines.append(f"    Topic: {part} | Count: {topic.count if topic else 0}")
        for part in ("send_goal", "cancel_goal", "get_result"):
            lines.append(f"    Service: {part} | {_events(action.parts.get(part), reading)}")
    return lines


def _events(topic: BagTopic | None, reading: _Reading | None) -> str:
    if reading is None:
        return f"Event Count: {topic.count if topic else 0}"
    name = topic.name if topic else ""
    requests, responses = reading.requests[name], reading.responses[name]
    return f"Request Count: {requests} | Response Count: {responses}"


def _actions_of(info: BagInfo) -> list[_Action]:
    """Return the actions in a bag, sorted by name.

    If a part of an action has several topics, because its type changed, only the topic with the
    most messages is used.
    """
    found = dict[str, dict[str, BagTopic]]()
    types = dict[str, str]()
    for topic in info.topics:
        owner, name, part = part_of(topic.name)
        if owner == "action":
            held = found.setdefault(name, {})
            if part not in held or topic.count > held[part].count:
                held[part] = topic
            types[name] = types.get(name) or owner_of(topic.name, topic.type_name)
    return [_Action(name, types[name], found[name]) for name in sorted(found)]


def _remarks(info: BagInfo) -> list[str]:
    """Return sentences about what is missing in the bag."""
    remarks = list[str]()
    if not info.is_closed:
        remarks.append(
            "The file was not closed: the recorder was killed, or the disk was full. "
            "All that is counted above can be read."
        )
    for key, count in info.custom.items():
        kind, _, topic = key.partition(":")
        if kind == "lost":
            remarks.append(f"Lost: {count} messages of {topic} were not recorded.")
    if missing := missing_goals(info):
        remarks.append(f"Missing: {missing}")
    return ["", *remarks] if remarks else []


def _lacks_goals(action: _Action) -> bool:
    """Return whether an action had goals, but none of them was recorded."""
    counts = {part: topic.count for part, topic in action.parts.items()}
    # One status of each server comes when the recorder subscribes, and may list no goal. A goal has
    # three: accepted, executing, ended.
    was_active = counts.get("feedback", 0) or counts.get("status", 0) > 2
    return bool(was_active and not (counts.get("send_goal") or counts.get("get_result")))


def _sorted(topics: Iterable[BagTopic]) -> list[BagTopic]:
    return sorted(topics, key=lambda each: (each.name, each.type_name))


def _row(name: str, value: str) -> str:
    return f"{name:<{INDENT}}{value}"


def _under(name: str, values: list[str], indent: int = INDENT) -> list[str]:
    """Return one line for each value. The first line begins with the name."""
    first, *others = values or [""]
    return [f"{name:<{indent - 1}} {first}", *(" " * indent + each for each in others)]


def _size(size: int) -> str:
    """Return a size in bytes as text, in the largest unit that fits.

    >>> _size(40858)
    '39.9 KiB'
    """
    number, unit = float(size), 0
    while number >= 1024 and unit < len(_SIZES) - 1:
        number, unit = number / 1024, unit + 1
    return f"{number:.{min(unit, 1)}f} {_SIZES[unit]}"


def _seconds(nanoseconds: int) -> str:
    return f"{nanoseconds // 10**9}.{nanoseconds % 10**9:09d}"


def _moment(stamp: int) -> str:
    at = time.localtime(stamp // 10**9)
    day = f"{time.strftime('%b', at)} {at.tm_mday:2d} {at.tm_year}"
    clock = f"{time.strftime('%H:%M:%S', at)}.{stamp % 10**9:09d}"
    return f"{day} {clock} ({_seconds(stamp)})"


def _goal_row(goal: RecordedGoal) -> tuple[str, ...]:
    return (
        goal.id.hex(),
        goal.action,
        "rejected" if goal.accepted is False else goal.status.name,
        "" if goal.duration is None else duration(goal.duration),
        str(goal.feedback_count),
        _short(goal.goal),
        _short(goal.result),
        goal.reason if goal.accepted is not False else goal.told,
    )


def _short(message: object) -> str:
    if message is None:
        return "?"
    text = " ".join(flow(to_dict(message)).split())  # type: ignore[arg-type]  # a message
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}…"


def _json_line(goal: RecordedGoal) -> str:
    values: dict[str, object] = {
        "id": goal.id.hex(),
        "action": goal.action,
        "type": goal.type_name,
        "state": "REJECTED" if goal.accepted is False else goal.status.name,
        "stamp": goal.stamp,
        "duration": goal.duration,
        "feedback": goal.feedback_count,
        "states": [{"stamp": stamp, "state": status.name} for stamp, status in goal.states],
        "goal": None if goal.goal is None else json.loads(to_json(goal.goal)),
        "result": None if goal.result is None else json.loads(to_json(goal.result)),
        "reason": goal.reason,
    }
    return json.dumps(values, ensure_ascii=False)
