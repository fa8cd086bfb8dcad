"""The verbs of ``bag``: ``record``, ``play``, ``convert`` and ``view``, and the options of all.

`turtleact.commands.bag_contents` prints what is in a bag.
"""

from __future__ import annotations

import asyncio
import os
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from turtleact.commands import completion
from turtleact.commands.app import ManyVerb, new_group, verb
from turtleact.commands.options import (
    Json,
    argument,
    bag_seconds,
    factor,
    flag,
    hertz,
    or_max,
    value,
    whole,
)
from turtleact.commands.output import counted, note, say
from turtleact.commands.output import duration as told_duration
from turtleact.commands.settings import WrongOptions, quoted
from turtleact.errors import TurtleactError

if TYPE_CHECKING:
    from turtleact.commands.settings import ConnectOptions
    from turtleact.node import Node
    from turtleact.recording import Played, Recording, Selection
    from turtleact.recording.bag_writer import Compression

__all__ = ["app"]

FREQUENCY = "40"
"""How often ``--clock`` publishes (Hz), as in ``ros2 bag play``."""

FAILED = 1
"""The exit status if nothing could be played, or a topic could not be recorded."""

ALL = ("all_topics", "all_services", "all_actions")


class BagVerb(ManyVerb):
    """A verb that needs the packages of the extra ``bag``."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # as in `Verb`
        """Parse the arguments, with the default frequency of ``ros2 bag play`` for ``--clock``."""
        found: list[str] = []
        for arg, following in pairwise([*args, ""]):
            found.append(arg)
            if arg == "--clock" and not following[:1].isdigit():
                found.append(FREQUENCY)
        return super().parse_args(ctx, found)

    def invoke(self, ctx: typer.Context) -> Any:  # type: ignore[override]  # noqa: ANN401  # as in `Verb`
        """Run the verb. If a package is missing, say how to install it."""
        try:
            return super().invoke(ctx)
        except ImportError as error:
            if (error.name or "").partition(".")[0] not in ("mcap", "zstandard", "lz4"):
                raise
            problem = "turtleact bag needs one more package: pip install 'mcap>=1.6,<2'"
            raise TurtleactError(problem) from None


taking = partial(value, panel="What is taken")
switching = partial(flag, panel="What is taken")
filing = partial(value, panel="Files")
playing = partial(value, panel="Playing")
timing = partial(playing, metavar="SECONDS", parser=bag_seconds)

Preset = Literal["none", "fastwrite", "zstd_fast", "zstd_small"]

BagPath = Annotated[Path, argument("BAG", "The folder of the bag, or one of its files.")]
ReadStorage = Annotated[
    str | None, value("--storage", "-s", text="Not needed: the file tells.", hidden=True)
]
Keyboard = Annotated[
    bool, flag("--disable-keyboard-controls", text="For scripts of ros2.", hidden=True)
]
MaxSize = Annotated[
    int,
    filing(
        *("--max-bag-size", "-b"),
        metavar="BYTES",
        text="Begin another file after so many bytes; 0 for never.",
        parser=whole,
    ),
]
MaxDuration = Annotated[
    float,
    filing(
        *("--max-bag-duration", "-d"),
        metavar="SECONDS",
        text="Begin another file after this time; 0 for never.",
        parser=bag_seconds,
    ),
]
PresetProfile = Annotated[
    Preset,
    filing(
        "--storage-preset-profile",
        metavar="NAME",
        text="Whether to compress: zstd_fast or zstd_small.",
    ),
]
Overrides = Annotated[
    Path | None,
    value(
        "--qos-profile-overrides-path",
        metavar="FILE",
        text="Quality of service by topic, in a YAML file of 'ros2 bag'.",
    ),
]
Rate = Annotated[
    Any,  # a number or "max"
    playing(
        *("--rate", "-r"),
        metavar="FACTOR",
        text="How much faster than recorded; max plays without any waiting.",
        parser=or_max(factor),
    ),
]
StartOffset = Annotated[
    float, timing("--start-offset", text="Begin this many seconds after the start of the bag.")
]
PlayDuration = Annotated[
    float | None, timing("--playback-duration", text="Leave out what was recorded later.")
]

NewBag = Annotated[
    Path | None,
    filing(
        *("--output", "-o"),
        metavar="NAME",
        text="The folder to create; by default, one with the time in its name.",
    ),
]

Cache = Annotated[
    int,
    filing(
        "--max-cache-size",
        metavar="BYTES",
        text="How much may wait to be written. Beyond that, messages are dropped and counted.",
        parser=whole,
    ),
]

ExcludeTypes = Annotated[
    list[str] | None,
    taking("--exclude-topic-types", metavar="NAME...", text="Leave topics of these types out."),
]

app = new_group("bag")


@verb(app, cls=BagVerb, knows=True)
def record(
    reach: ConnectOptions,
    positional: Annotated[
        list[str] | None,
        argument("TOPIC", "Topics to record.", completion.topics),
    ] = None,
    *,
    taken: dict[str, Any],
    types: Annotated[
        list[str] | None, taking("--topic-types", metavar="NAME...", text="Topics of these types.")
    ] = None,
    everything: Annotated[
        bool,
        switching("--all", "-a", text="All topics, services and actions, except hidden topics."),
    ] = False,
    all_topics: Annotated[
        bool, switching("--all-topics", text="All topics, except hidden ones.")
    ] = False,
    all_services: Annotated[bool, switching("--all-services", text="All services.")] = False,
    all_actions: Annotated[bool, switching("--all-actions", text="All actions.")] = False,
    hidden: Annotated[
        bool, switching("--include-hidden-topics", text="Hidden topics too, with --all.")
    ] = False,
    exclude_types: ExcludeTypes = None,
    output: NewBag = None,
    max_size: MaxSize = 0,
    max_duration: MaxDuration = 0,
    cache: Cache = 100 * 1024 * 1024,
    storage: Annotated[  # noqa: ARG001  # there is one
        Literal["mcap"] | None, filing("--storage", "-s", text="The format of the files.")
    ] = None,
    preset: PresetProfile = "none",
    overrides: Overrides = None,
    _keyboard: Keyboard = False,  # there are none
) -> int:
    """Record topics, services and actions to a bag, until Ctrl-C."""
    taken["topics"] += positional or ()
    chosen: dict[str, Any] = {
        "types": frozenset(types or ()),
        "all_topics": everything or all_topics,
        "all_services": everything or all_services,
        "all_actions": everything or all_actions,
    }
    if not (_names_something(taken) or any(chosen.values())):
        raise WrongOptions(
            "nothing to record: name topics, or give --all, --actions, --services, --regex or "
            "another option of --help"
        )
    from turtleact.recording.writer_thread import CAPACITY

    chosen |= {"hidden": hidden, "exclude_types": frozenset(exclude_types or ())}
    return _record(
        reach,
        output or Path(time.strftime("rosbag2_%Y_%m_%d-%H_%M_%S")),
        overrides,
        selection=_selection(taken, **chosen),
        max_size=max_size,
        max_duration=max_duration,
        capacity=cache or CAPACITY,
        compression=_compression(preset),
    )


@verb(app, cls=BagVerb)
def info(
    bag: BagPath,
    *,
    names_only: Annotated[
        bool, flag("--topic-name", "-t", text="Print only the names of the topics.")
    ] = False,
    verbose: Annotated[
        bool,
        flag("--verbose", "-v", text="Count requests and responses apart; reads all of the bag."),
    ] = False,
    storage: ReadStorage = None,  # noqa: ARG001  # the file tells
) -> None:
    """Print what is in a bag, and what is missing from it."""
    from turtleact.commands.bag_contents import print_info

    print_info(bag, verbose=verbose, names_only=names_only and not verbose)


@verb(app, cls=BagVerb, knows=True)
def play(
    reach: ConnectOptions,
    bag: BagPath,
    *,
    taken: dict[str, Any],
    rate: Rate = 1.0,
    loop: Annotated[
        bool, flag("--loop", "-l", text="Start over at the end.", panel="Playing")
    ] = False,
    offset: StartOffset = 0,
    duration: PlayDuration = None,
    delay: Annotated[float, timing("--delay", "-d", text="Wait before playing.")] = 0,
    remap: Annotated[
        list[str] | None,
        playing(
            "--remap", "-m", metavar="OLD:=NEW...", text="Give topics and actions other names."
        ),
    ] = None,
    send_goals: Annotated[
        bool,
        flag(
            "--send-actions-as-client",
            text="Send the goals and cancel requests again, with new ids, instead of publishing "
            "the topics of actions.",
            panel="Playing",
        ),
    ] = False,
    clock: Annotated[
        float | None,
        playing(
            "--clock",
            metavar="[HZ]",
            text="Publish the time in the bag on /clock, 40 times a second.",
            parser=hertz,
        ),
    ] = None,
    overrides: Overrides = None,
    storage: ReadStorage = None,  # noqa: ARG001  # the file tells
    _keyboard: Keyboard = False,  # there are none
) -> int:
    """Publish the messages of a bag again, or send its goals again."""
    options: dict[str, Any] = {
        "rate": rate,
        "loop": loop,
        "start_offset": offset,
        "duration": duration,
        "send_goals": send_goals,
        "remap": dict(map(_renamed, remap or ())),
        "clock": clock or 0.0,
        "selection": _from_bag(taken),
    }
    return _play(reach, bag, delay, overrides, options)


@verb(app, cls=BagVerb, knows=True)
def goals(
    bag: BagPath,
    action: Annotated[str | None, argument("ACTION", "Only goals of this action.")] = None,
    *,
    as_json: Json = False,
) -> None:
    """List the goals in a bag."""
    from turtleact.commands.bag_contents import print_goals

    print_goals(bag, action, as_json=as_json)


@verb(app, cls=BagVerb)
def convert(
    bags: Annotated[list[str], value("--input", "-i", metavar="BAG...", text="The bags to read.")],
    output: Annotated[
        Path,
        value(*("--output", "-o"), metavar="NAME", text="The folder to create."),
    ],
    *,
    taken: dict[str, Any],
    offset: StartOffset = 0,
    duration: PlayDuration = None,
    max_size: MaxSize = 0,
    max_duration: MaxDuration = 0,
    preset: PresetProfile = "none",
) -> None:
    """Convert bags: merge, cut by time or topic, split or compress them."""
    from turtleact.recording import Bag
    from turtleact.recording.bag_writer import Output, Split, convert

    inputs = [Path(each) for each in bags if each not in ("mcap", "sqlite3")]  # ids of storages
    start = Bag(inputs[0]).info.start + round(offset * 1e9)
    split = Split(
        max_size=max_size,
        max_duration=round(max_duration * 1e9),
        compression=_compression(preset),
    )
    end = None if duration is None else start + round(duration * 1e9)
    wanted = Output(path=output, selection=_from_bag(taken), start=start, end=end, split=split)
    [count] = convert(inputs, [wanted])
    note(f"{counted(count, 'message')} written to {output}")


@verb(app, cls=BagVerb)
def view(
    bag: BagPath,
    *,
    port: Annotated[
        int, value("--port", metavar="N", text="The port; 0 for any free one.", parser=whole)
    ] = 0,
    no_open: Annotated[
        bool, flag("--no-open", text="Only print the address, and open no browser.")
    ] = False,
) -> int:
    """Show a bag in a browser, with a time line."""
    import webbrowser

    from turtleact.commands.interrupts import Interrupts
    from turtleact.web.bag_view import open_bag_view

    interrupts = Interrupts()

    async def show() -> int:
        async with open_bag_view(bag, port=port) as shown:
            say(f"{shown.url}\n")
            note("Ctrl-C ends it")
            interrupts.cancels = False
            if not no_open and has_display():
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


# options


def _compression(preset: Preset) -> Compression:
    return "none" if preset == "fastwrite" else preset


def _names_something(taken: Mapping[str, Any]) -> bool:
    return any(taken[each] for each in ("topics", "services", "actions", "regex"))


def _from_bag(taken: Mapping[str, Any]) -> Selection:
    """Make the selection of messages from a bag: those named, or all if none are named."""
    return _selection(taken, **dict.fromkeys(ALL, not _names_something(taken)), hidden=True)


def _selection(taken: Mapping[str, Any], **more: Any) -> Selection:  # noqa: ANN401  # as Selection
    from turtleact.names import resolve_name
    from turtleact.recording import Selection

    named = ("topics", "services", "actions", "exclude")
    lists = {each: frozenset(map(resolve_name, taken[each])) for each in named}
    return Selection(**{**taken, **more, **lists})


def _renamed(rule: str) -> tuple[str, str]:
    """Parse a remapping rule such as ``/old:=/new``, and return both full names."""
    from turtleact.names import resolve_name

    old, sign, new = rule.partition(":=")
    if not sign:
        raise WrongOptions(f"--remap takes rules such as /old:=/new, not {quoted(rule)}")
    return resolve_name(old), resolve_name(new)


# recording


def _record(reach: ConnectOptions, path: Path, overrides: Path | None, **options: Any) -> int:  # noqa: ANN401  # of `record`
    """Record until a signal comes, and return the exit status.

    The exit status is 0 if a signal ends the recording, as for ``ros2 bag record``. The exit status
    is 1 if a topic could not be recorded.
    """
    from turtleact import recording
    from turtleact.commands import graph
    from turtleact.recording.metadata import read_qos_overrides

    recorded: list[Recording] = []
    qos = {} if overrides is None else read_qos_overrides(overrides)

    async def record_on(node: Node) -> int:
        try:
            async with recording.record(node, path, qos=qos, **options) as run:
                recorded.append(run)
                note(f"recording to {path}; Ctrl-C ends it")
                await _tell_topics(run)
        finally:
            if recorded:
                _sum_up_recording(recorded[0])
        return 0

    status = graph.run(reach, record_on)
    if not recorded:
        return status
    if recorded[0].error is not None:  # not raised yet if a signal came before it was noticed
        raise recorded[0].error
    return FAILED if recorded[0].unrecorded else 0


async def _tell_topics(recording: Recording) -> None:
    """Print a note for each topic when its recording begins, until the recording ends by itself."""
    told = 0
    while not recording.is_over:
        for topic in recording.topics[told:]:
            note(f"subscribed to topic '{topic}'")
        told = len(recording.topics)
        await recording.wait_changed()


def _sum_up_recording(recording: Recording) -> None:
    from turtleact.commands.bag_contents import messages_told, missing_goals
    from turtleact.recording import Bag, BagError

    if not recording.path.exists():
        return
    told, missing = counted(recording.count, "message"), ""
    if recording.error is None:
        with suppress(BagError):
            info = Bag(recording.path).info
            told, missing = messages_told(info), missing_goals(info)
    note(f"{told} recorded in {recording.path}")
    if missing:
        note(f"missing: {missing}")
    for topic, count in sorted(recording.lost_by_topic.items()):
        note(f"lost: {counted(count, 'message')} of topic '{topic}'")
    for topic, reason in sorted(recording.unrecorded.items()):
        note(f"not recorded: topic '{topic}': {reason}")


# playing


def _play(
    reach: ConnectOptions, path: Path, delay: float, overrides: Path | None, options: dict[str, Any]
) -> int:
    """Play a bag, and return the exit status."""
    from turtleact import recording
    from turtleact.commands import graph
    from turtleact.commands.bag_contents import messages_told
    from turtleact.recording.metadata import read_qos_overrides

    info = recording.Bag(path).info
    qos = {} if overrides is None else read_qos_overrides(overrides)

    async def play_on(node: Node) -> int:
        note(f"playing {path}: {told_duration(info.duration / 1e9)}, {messages_told(info)}")
        await node.clock.sleep(delay)
        return _sum_up_playing(await recording.play(node, path, qos=qos, **options))

    return graph.run(reach, play_on)


def _sum_up_playing(played: Played) -> int:
    for topic, reason in played.skipped.items():
        note(f"'{topic}' was not played: {reason}; give --interfaces DIR")
    for (action, ended), count in sorted(played.goals.items()):
        note(f"{counted(count, 'goal')} of '{action}': {ended}")
    note(f"played {counted(played.messages, 'message')}")
    if played.failed:
        return FAILED
    return 0 if played.messages or played.goals else FAILED
