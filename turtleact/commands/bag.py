"""The verbs of ``bag``."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import typer

from turtleact.commands import completion
from turtleact.commands.app import Verb, new_group, verb
from turtleact.commands.options import (
    Json,
    argument,
    flag,
    hertz,
    in_seconds,
    value,
    whole,
)
from turtleact.commands.settings import WrongOptions, quoted
from turtleact.errors import TurtleactError

if TYPE_CHECKING:
    from turtleact.commands.settings import Reach
    from turtleact.recording import Selection

__all__ = ["app"]

SHORT = {
    "--max-size": "--max-bag-size",
    "--max-duration": "--max-bag-duration",
    "--output-options": "--output",
}
"""Maps alternative names of options to the names that ``--help`` shows."""

FREQUENCY = "40"
"""How often ``--clock`` publishes (Hz), as in ``ros2 bag play``."""

WHAT = "What is taken"
FILES = "Files"
PLAYING = "Playing"

Preset: TypeAlias = Literal["none", "fastwrite", "zstd_fast", "zstd_small"]


class ManyVerb(Verb):
    """A verb with options that take several values, as in argparse: ``--topics /a /b``."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # Typer makes no other context
        """Turn ``--topics /a /b`` into ``--topics /a --topics /b``, and parse the arguments."""
        many = {name for each in self.params if _is_list(each) for name in each.opts}
        args = [SHORT.get(each, each) for each in _with_frequency(args)]
        for option, following in pairwise([*args, "--"]):
            if option in many and following.startswith("-"):
                ctx.fail(f"Option '{option}' requires an argument.")
        return super().parse_args(ctx, _repeated(args, many))


def _is_list(param: Any) -> bool:  # noqa: ANN401  # of click, as in `load`
    return bool(getattr(param, "multiple", False))


def _repeated(args: Sequence[str], many: set[str]) -> list[str]:
    """Insert the name of an option in ``many`` before each of its values.

    >>> _repeated(["--topics", "/a", "/b", "-o", "run", "/c"], {"--topics"})
    ['--topics', '/a', '--topics', '/b', '-o', 'run', '/c']
    """
    found: list[str] = []
    option = ""
    for arg in args:
        if arg.startswith("-"):
            option = arg if arg in many else ""
            if not option:
                found.append(arg)
        else:
            found += [option, arg] if option else [arg]
    return found


def _with_frequency(args: Sequence[str]) -> list[str]:
    """If ``--clock`` has no frequency, add the default frequency of ``ros2 bag play``.

    >>> _with_frequency(["run", "--clock", "--loop"])
    ['run', '--clock', '40', '--loop']
    """
    found: list[str] = []
    for arg, following in pairwise([*args, ""]):
        found.append(arg)
        if arg == "--clock" and not following[:1].isdigit():
            found.append(FREQUENCY)
    return found


def _several(name: str, text: str, names: Callable[..., Any] | None = None) -> Any:  # noqa: ANN401  # as typer.Option
    return value(name, metavar="NAME...", text=text, panel=WHAT, autocompletion=names)


def _played(*names: str, text: str) -> Any:  # noqa: ANN401  # likewise
    return in_seconds(*names, text=text, panel=PLAYING, is_of_bag=True)


Topics: TypeAlias = Annotated[
    list[str] | None, _several("--topics", "These topics.", completion.topics)
]
Services: TypeAlias = Annotated[list[str] | None, _several("--services", "These services.")]
Actions: TypeAlias = Annotated[
    list[str] | None, _several("--actions", "These actions.", completion.actions)
]
Regex: TypeAlias = Annotated[
    str,
    value(
        *("--regex", "-e"),
        metavar="EXPR",
        text="Everything whose name this regular expression finds.",
        panel=WHAT,
    ),
]
ExcludeRegex: TypeAlias = Annotated[
    str,
    value(
        *("--exclude-regex", "-x"),
        metavar="EXPR",
        text="Leave out everything whose name this regular expression finds.",
        panel=WHAT,
    ),
]
ExcludeTopics: TypeAlias = Annotated[
    list[str] | None, _several("--exclude-topics", "Leave these out.", completion.topics)
]
ExcludeServices: TypeAlias = Annotated[
    list[str] | None, _several("--exclude-services", "Leave these out.")
]
ExcludeActions: TypeAlias = Annotated[
    list[str] | None, _several("--exclude-actions", "Leave these out.", completion.actions)
]
MaxSize: TypeAlias = Annotated[
    int,
    value(
        *("--max-bag-size", "-b"),
        metavar="BYTES",
        text="Begin another file after so many bytes; 0 for never.",
        panel=FILES,
        parser=whole,
    ),
]
MaxDuration: TypeAlias = Annotated[
    float,
    in_seconds(
        *("--max-bag-duration", "-d"),
        text="Begin another file after this time; 0 for never.",
        panel=FILES,
        is_of_bag=True,
    ),
]
PresetProfile: TypeAlias = Annotated[
    Preset,
    value(
        "--storage-preset-profile",
        metavar="NAME",
        text="Whether to compress: zstd_fast or zstd_small.",
        panel=FILES,
    ),
]
Overrides: TypeAlias = Annotated[
    Path | None,
    value(
        "--qos-profile-overrides-path",
        metavar="FILE",
        text="Quality of service by topic, in a YAML file of 'ros2 bag'.",
    ),
]
Ignored: TypeAlias = Annotated[
    bool, flag("--disable-keyboard-controls", text="For scripts of ros2.", hidden=True)
]
BagPath: TypeAlias = Annotated[Path, argument("BAG", "The folder of the bag, or one of its files.")]
ReadStorage: TypeAlias = Annotated[
    str | None, value("--storage", "-s", text="Not needed: the file tells.", hidden=True)
]
StartOffset: TypeAlias = Annotated[
    float, _played("--start-offset", text="Begin this many seconds after the start of the bag.")
]
PlayDuration: TypeAlias = Annotated[
    float | None, _played("--playback-duration", text="Leave out what was recorded later.")
]

app = new_group("bag")


Output: TypeAlias = Annotated[
    Path | None,
    value(
        *("--output", "-o"),
        metavar="NAME",
        text="The folder to create; by default, one with the time in its name.",
        panel=FILES,
        show_default=False,
    ),
]
Cache: TypeAlias = Annotated[
    int,
    value(
        "--max-cache-size",
        metavar="BYTES",
        text="How much may wait to be written. Beyond that, messages are dropped and counted.",
        panel=FILES,
        parser=whole,
    ),
]
Everything: TypeAlias = Annotated[
    bool,
    flag(
        *("--all", "-a"),
        text="All topics, services and actions, except hidden topics.",
        panel=WHAT,
    ),
]
Positional: TypeAlias = Annotated[
    list[str] | None,
    argument("TOPIC", "Topics to record.", completion.topics, show_default=False),
]
Hidden: TypeAlias = Annotated[
    bool,
    flag("--include-hidden-topics", text="Hidden topics too, with --all.", panel=WHAT),
]
ExcludeTypes: TypeAlias = Annotated[
    list[str] | None,
    _several("--exclude-topic-types", "Leave topics of these types out."),
]
Storage: TypeAlias = Annotated[
    Literal["mcap"] | None,
    value("--storage", "-s", text="The format of the files.", panel=FILES),
]
AllTopics: TypeAlias = Annotated[
    bool, flag("--all-topics", text="All topics, except hidden ones.", panel=WHAT)
]


@verb(app, cls=ManyVerb, knows=True)
def record(
    reach: Reach,
    positional: Positional = None,
    *,
    topics: Topics = None,
    services: Services = None,
    actions: Actions = None,
    types: Annotated[list[str] | None, _several("--topic-types", "Topics of these types.")] = None,
    everything: Everything = False,
    all_topics: AllTopics = False,
    all_services: Annotated[bool, flag("--all-services", text="All services.", panel=WHAT)] = False,
    all_actions: Annotated[bool, flag("--all-actions", text="All actions.", panel=WHAT)] = False,
    hidden: Hidden = False,
    regex: Regex = "",
    exclude_regex: ExcludeRegex = "",
    exclude_topics: ExcludeTopics = None,
    exclude_services: ExcludeServices = None,
    exclude_actions: ExcludeActions = None,
    exclude_types: ExcludeTypes = None,
    output: Output = None,
    max_size: MaxSize = 0,
    max_duration: MaxDuration = 0,
    cache: Cache = 100 * 1024 * 1024,
    storage: Storage = None,  # noqa: ARG001  # there is one
    preset: PresetProfile = "none",
    overrides: Overrides = None,
    _keyboard: Ignored = False,  # there are none
) -> int:
    """Record topics, services and actions to a bag, until Ctrl-C."""
    named: dict[str, Any] = {
        "topics": [*(positional or ()), *(topics or ())],
        "services": services,
        "actions": actions,
        "types": types,
        "regex": regex,
        "all_topics": everything or all_topics,
        "all_services": everything or all_services,
        "all_actions": everything or all_actions,
    }
    if not any(named.values()):
        raise WrongOptions(
            "nothing to record: name topics, or give --all, --actions, --services, --regex or "
            "another option of --help"
        )
    sessions = _work("bag_sessions")
    left_out = [*(exclude_topics or ()), *(exclude_services or ()), *(exclude_actions or ())]
    named |= {"exclude": left_out, "exclude_types": exclude_types, "exclude_regex": exclude_regex}
    order = sessions.RecordOrder(
        output or Path(time.strftime("rosbag2_%Y_%m_%d-%H_%M_%S")),
        _selection(**named, hidden=hidden),
        max_size,
        max_duration,
        cache,
        _compression(preset),
        overrides,
    )
    status: int = sessions.record_graph(reach, order)
    return status


@verb(app)
def info(
    bag: BagPath,
    *,
    names_only: Annotated[
        bool, flag("--topic-name", "-t", text="Print only the names of the topics.")
    ] = False,
    verbose: Annotated[
        bool,
        flag(
            *("--verbose", "-v"),
            text="Count requests and responses apart; reads all of the bag.",
        ),
    ] = False,
    storage: ReadStorage = None,  # noqa: ARG001  # the file tells
) -> int:
    """Print what is in a bag, and what is missing from it."""
    print_info = _work("bag_contents").print_info
    status: int = print_info(bag, verbose=verbose, names_only=names_only and not verbose)
    return status


Clock: TypeAlias = Annotated[
    float | None,
    value(
        "--clock",
        metavar="[HZ]",
        text="Publish the time in the bag on /clock, 40 times a second.",
        panel=PLAYING,
        parser=hertz,
        show_default=False,
    ),
]
Rate: TypeAlias = Annotated[
    str,
    value(
        *("--rate", "-r"),
        metavar="FACTOR",
        text="How much faster than recorded; max plays without any waiting.",
        panel=PLAYING,
    ),
]
Remap: TypeAlias = Annotated[
    list[str] | None,
    value(
        *("--remap", "-m"),
        metavar="OLD:=NEW...",
        text="Give topics and actions other names.",
        panel=PLAYING,
    ),
]


@verb(app, cls=ManyVerb, knows=True)
def play(
    reach: Reach,
    bag: BagPath,
    *,
    topics: Topics = None,
    services: Services = None,
    actions: Actions = None,
    regex: Regex = "",
    exclude_regex: ExcludeRegex = "",
    exclude_topics: ExcludeTopics = None,
    exclude_services: ExcludeServices = None,
    exclude_actions: ExcludeActions = None,
    rate: Rate = "1.0",
    loop: Annotated[
        bool, flag("--loop", "-l", text="Start over at the end.", panel=PLAYING)
    ] = False,
    offset: StartOffset = 0,
    duration: PlayDuration = None,
    delay: Annotated[float, _played("--delay", "-d", text="Wait before playing.")] = 0,
    remap: Remap = None,
    send_goals: Annotated[
        bool,
        flag(
            "--send-actions-as-client",
            text="Send the goals and cancel requests again, with new ids, instead of publishing "
            "the topics of actions.",
            panel=PLAYING,
        ),
    ] = False,
    clock: Clock = None,
    overrides: Overrides = None,
    storage: ReadStorage = None,  # noqa: ARG001  # the file tells
    _keyboard: Ignored = False,  # there are none
) -> int:
    """Publish the messages of a bag again, or send its goals again."""
    options: dict[str, Any] = {
        "rate": _rate(rate),
        "loop": loop,
        "start_offset": offset,
        "duration": duration,
        "send_goals": send_goals,
        "remap": dict(map(_renamed, remap or ())),
        "clock": clock or 0.0,
    }
    sessions = _work("bag_sessions")
    left_out = [*(exclude_topics or ()), *(exclude_services or ()), *(exclude_actions or ())]
    options["selection"] = _taken(
        {"topics": topics, "services": services, "actions": actions, "regex": regex},
        exclude=left_out,
        exclude_regex=exclude_regex,
    )
    order = sessions.PlayOrder(bag, options, delay, overrides)
    status: int = sessions.play_bag(reach, order)
    return status


@verb(app, knows=True)
def goals(
    bag: BagPath,
    action: Annotated[
        str | None, argument("ACTION", "Only goals of this action.", show_default=False)
    ] = None,
    *,
    as_json: Json = False,
) -> int:
    """List the goals in a bag."""
    status: int = _work("bag_contents").print_goals(bag, action, as_json=as_json)
    return status


@verb(app, cls=ManyVerb)
def convert(
    bags: Annotated[list[str], value("--input", "-i", metavar="BAG...", text="The bags to read.")],
    output: Annotated[
        Path,
        value(
            *("--output", "-o"),
            metavar="NAME",
            text="The folder to create, or a YAML file of 'ros2 bag convert'.",
        ),
    ],
    *,
    topics: Topics = None,
    services: Services = None,
    actions: Actions = None,
    regex: Regex = "",
    exclude_regex: ExcludeRegex = "",
    exclude_topics: ExcludeTopics = None,
    offset: StartOffset = 0,
    duration: PlayDuration = None,
    max_size: MaxSize = 0,
    max_duration: MaxDuration = 0,
    preset: PresetProfile = "none",
) -> int:
    """Convert bags: merge, cut by time or topic, split or compress them."""
    converting = _work("bag_converting")
    inputs = [Path(each) for each in bags if each not in ("mcap", "sqlite3")]  # ids of storages
    if output.suffix in (".yaml", ".yml"):
        outputs = converting.outputs_in(output)
    else:
        start, end = converting.cut(inputs[0], offset, duration)
        split = converting.Split(
            max_size=max_size,
            max_duration=round(max_duration * 1e9),
            compression=_compression(preset),
        )
        selection = _taken(
            {"topics": topics, "services": services, "actions": actions, "regex": regex},
            exclude=exclude_topics,
            exclude_regex=exclude_regex,
        )
        outputs = [
            converting.Output(path=output, selection=selection, start=start, end=end, split=split)
        ]
    status: int = converting.run(inputs, outputs)
    return status


@verb(app)
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
    status: int = _work("bag_sessions").view_bag(bag, port, is_opened=not no_open)
    return status


def _compression(preset: Preset) -> str:
    return "none" if preset == "fastwrite" else preset


def _taken(named: dict[str, Any], **left_out: Any) -> Selection:  # noqa: ANN401  # as Selection
    """Make the selection of messages from a bag: those named, or all if none are named."""
    flags = ("all_topics", "all_services", "all_actions")
    everything = dict.fromkeys(flags, not any(named.values()))
    return _selection(**named, **left_out, **everything, hidden=True)


def _rate(text: str) -> float | str:
    """Parse how fast a bag is played: a factor above zero, or ``max``."""
    if text == "max":
        return text
    try:
        return hertz(text)
    except typer.BadParameter:
        raise WrongOptions(f"--rate takes a factor above zero or max, not {quoted(text)}") from None


def _renamed(rule: str) -> tuple[str, str]:
    """Parse a remapping rule such as ``/old:=/new``, and return both full names."""
    from turtleact.names import resolve_name

    old, sign, new = rule.partition(":=")
    if not sign:
        raise WrongOptions(f"--remap takes rules such as /old:=/new, not {quoted(rule)}")
    return resolve_name(old), resolve_name(new)


def _work(module: str) -> Any:  # noqa: ANN401  # a module
    """Import a module of `turtleact.commands` that needs the packages of the extra ``bag``.

    Raises:
        TurtleactError: if one of these packages is missing. The error text says how to install it.
    """
    from importlib import import_module

    try:
        return import_module(f"turtleact.commands.{module}")
    except ImportError as error:
        if (error.name or "").partition(".")[0] not in ("mcap", "zstandard", "lz4"):
            raise
        problem = "turtleact bag needs one more package: pip install 'mcap>=1.6,<2'"
        raise TurtleactError(problem) from None


def _selection(**given: Any) -> Selection:  # noqa: ANN401  # as Selection
    """Make a `Selection` from options. Lists become sets, and relative names become absolute."""
    from turtleact.names import resolve_name
    from turtleact.recording import Selection

    named = ("topics", "services", "actions", "exclude")
    values: dict[str, Any] = {
        key: _set(value, resolve_name if key in named else str)
        if value is None or isinstance(value, list)
        else value
        for key, value in given.items()
    }
    return Selection(**values)


def _set(values: Iterable[str] | None, resolve: Callable[[str], str]) -> frozenset[str]:
    return frozenset(resolve(each) for each in values or ())
