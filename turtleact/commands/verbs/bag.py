"""Declares the group ``bag`` for Typer."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import typer

from turtleact.commands import completion
from turtleact.commands.settings import quoted
from turtleact.commands.verbs import Job, Verb, new_group
from turtleact.commands.verbs.options import (
    Config,
    Connect,
    Domain,
    Interfaces,
    folder,
    hertz,
    in_seconds,
    reach,
    whole,
)
from turtleact.errors import TurtleactError, UsageError

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


def _several(name: str, text: str, *, panel: str = WHAT, names: Callable[..., Any] | None) -> Any:  # noqa: ANN401  # as typer.Option
    return typer.Option(
        name, metavar="NAME...", help=text, rich_help_panel=panel, autocompletion=names
    )


def _flag(*names: str, text: str, panel: str = WHAT) -> Any:  # noqa: ANN401  # as typer.Option
    return typer.Option(*names, help=text, rich_help_panel=panel)


Positional: TypeAlias = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="TOPIC",
        help="Topics to record.",
        autocompletion=completion.topics,
        show_default=False,
    ),
]
Topics: TypeAlias = Annotated[
    list[str] | None, _several("--topics", "These topics.", names=completion.topics)
]
Services: TypeAlias = Annotated[
    list[str] | None, _several("--services", "These services.", names=None)
]
Actions: TypeAlias = Annotated[
    list[str] | None, _several("--actions", "These actions.", names=completion.actions)
]
Types: TypeAlias = Annotated[
    list[str] | None, _several("--topic-types", "Topics of these types.", names=None)
]
All: TypeAlias = Annotated[
    bool, _flag("--all", "-a", text="All topics, services and actions, except hidden topics.")
]
AllTopics: TypeAlias = Annotated[
    bool, _flag("--all-topics", text="All topics, except hidden ones.")
]
AllServices: TypeAlias = Annotated[bool, _flag("--all-services", text="All services.")]
AllActions: TypeAlias = Annotated[bool, _flag("--all-actions", text="All actions.")]
Hidden: TypeAlias = Annotated[
    bool, _flag("--include-hidden-topics", text="Hidden topics too, with --all.")
]
Regex: TypeAlias = Annotated[
    str,
    typer.Option(
        "--regex",
        "-e",
        metavar="EXPR",
        help="Everything whose name this regular expression finds.",
        rich_help_panel=WHAT,
    ),
]
ExcludeRegex: TypeAlias = Annotated[
    str,
    typer.Option(
        "--exclude-regex",
        "-x",
        metavar="EXPR",
        help="Leave out everything whose name this regular expression finds.",
        rich_help_panel=WHAT,
    ),
]
ExcludeTopics: TypeAlias = Annotated[
    list[str] | None, _several("--exclude-topics", "Leave these out.", names=completion.topics)
]
ExcludeServices: TypeAlias = Annotated[
    list[str] | None, _several("--exclude-services", "Leave these out.", names=None)
]
ExcludeActions: TypeAlias = Annotated[
    list[str] | None, _several("--exclude-actions", "Leave these out.", names=completion.actions)
]
ExcludeTypes: TypeAlias = Annotated[
    list[str] | None,
    _several("--exclude-topic-types", "Leave topics of these types out.", names=None),
]
Output: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="NAME",
        help="The folder to create; by default, one with the time in its name.",
        rich_help_panel=FILES,
        show_default=False,
    ),
]
MaxSize: TypeAlias = Annotated[
    int,
    typer.Option(
        "--max-bag-size",
        "-b",
        metavar="BYTES",
        parser=whole,
        help="Begin another file after so many bytes; 0 for never.",
        rich_help_panel=FILES,
    ),
]
MaxDuration: TypeAlias = Annotated[
    float,
    in_seconds(
        "--max-bag-duration",
        "-d",
        text="Begin another file after this time; 0 for never.",
        panel=FILES,
        is_of_bag=True,
    ),
]
CacheSize: TypeAlias = Annotated[
    int,
    typer.Option(
        "--max-cache-size",
        metavar="BYTES",
        parser=whole,
        help="How much may wait to be written. Beyond that, messages are dropped and counted.",
        rich_help_panel=FILES,
    ),
]
Storage: TypeAlias = Annotated[
    Literal["mcap"] | None,
    typer.Option("--storage", "-s", help="The format of the files.", rich_help_panel=FILES),
]
PresetProfile: TypeAlias = Annotated[
    Preset,
    typer.Option(
        "--storage-preset-profile",
        metavar="NAME",
        help="Whether to compress: zstd_fast or zstd_small.",
        rich_help_panel=FILES,
    ),
]
Overrides: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--qos-profile-overrides-path",
        metavar="FILE",
        help="Quality of service by topic, in a YAML file of 'ros2 bag'.",
    ),
]
Ignored: TypeAlias = Annotated[
    bool, typer.Option("--disable-keyboard-controls", hidden=True, help="For scripts of ros2.")
]
BagPath: TypeAlias = Annotated[
    Path, typer.Argument(metavar="BAG", help="The folder of the bag, or one of its files.")
]
ReadStorage: TypeAlias = Annotated[
    str | None,
    typer.Option("--storage", "-s", hidden=True, help="Not needed: the file tells."),
]
NamesOnly: TypeAlias = Annotated[
    bool, typer.Option("--topic-name", "-t", help="Print only the names of the topics.")
]
Verbose: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--verbose", "-v", help="Count requests and responses apart; reads all of the bag."
    ),
]

PlayRate: TypeAlias = Annotated[
    str,
    typer.Option(
        "--rate",
        "-r",
        metavar="FACTOR",
        help="How much faster than recorded; max plays without any waiting.",
        rich_help_panel=PLAYING,
    ),
]
Loop: TypeAlias = Annotated[
    bool, _flag("--loop", "-l", text="Start over at the end.", panel=PLAYING)
]
StartOffset: TypeAlias = Annotated[
    float,
    in_seconds(
        "--start-offset",
        text="Begin this many seconds after the start of the bag.",
        panel=PLAYING,
        is_of_bag=True,
    ),
]
PlayDuration: TypeAlias = Annotated[
    float | None,
    in_seconds(
        "--playback-duration",
        text="Leave out what was recorded later.",
        panel=PLAYING,
        is_of_bag=True,
    ),
]
Delay: TypeAlias = Annotated[
    float, in_seconds("--delay", "-d", text="Wait before playing.", panel=PLAYING, is_of_bag=True)
]
Remap: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--remap",
        "-m",
        metavar="OLD:=NEW...",
        help="Give topics and actions other names.",
        rich_help_panel=PLAYING,
    ),
]
SendGoals: TypeAlias = Annotated[
    bool,
    _flag(
        "--send-actions-as-client",
        text="Send the goals and cancel requests again, with new ids, instead of publishing the "
        "topics of actions.",
        panel=PLAYING,
    ),
]
ClockFrequency: TypeAlias = Annotated[
    float | None,
    typer.Option(
        "--clock",
        metavar="[HZ]",
        parser=hertz,
        help="Publish the time in the bag on /clock, 40 times a second.",
        rich_help_panel=PLAYING,
        show_default=False,
    ),
]
Action: TypeAlias = Annotated[
    str | None,
    typer.Argument(metavar="ACTION", help="Only goals of this action.", show_default=False),
]
AsJson: TypeAlias = Annotated[bool, typer.Option("--json", help="Print one JSON object a line.")]
Bags: TypeAlias = Annotated[
    list[str],
    typer.Option("--input", "-i", metavar="BAG...", help="The bags to read."),
]
ConvertOutput: TypeAlias = Annotated[
    Path,
    typer.Option(
        "--output",
        "-o",
        metavar="NAME",
        help="The folder to create, or a YAML file of 'ros2 bag convert'.",
    ),
]

Port: TypeAlias = Annotated[
    int, typer.Option("--port", metavar="N", parser=whole, help="The port; 0 for any free one.")
]
NoOpen: TypeAlias = Annotated[
    bool, typer.Option("--no-open", help="Only print the address, and open no browser.")
]

app = new_group("bag")


@app.command(cls=ManyVerb)
def record(
    positional: Positional = None,
    *,
    topics: Topics = None,
    services: Services = None,
    actions: Actions = None,
    types: Types = None,
    everything: All = False,
    all_topics: AllTopics = False,
    all_services: AllServices = False,
    all_actions: AllActions = False,
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
    cache: CacheSize = 100 * 1024 * 1024,
    storage: Storage = None,  # noqa: ARG001  # there is one
    preset: PresetProfile = "none",
    overrides: Overrides = None,
    _keyboard: Ignored = False,  # there are none
    interfaces: Interfaces = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
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
        raise UsageError(
            "nothing to record: name topics, or give --all, --actions, --services, --regex or "
            "another option of --help"
        )
    left_out = [*(exclude_topics or ()), *(exclude_services or ()), *(exclude_actions or ())]
    named |= {"exclude": left_out, "exclude_types": exclude_types, "exclude_regex": exclude_regex}
    path = output or Path(time.strftime("rosbag2_%Y_%m_%d-%H_%M_%S"))
    compression = "none" if preset == "fastwrite" else preset
    files = path, max_size, max_duration, cache, compression, overrides
    return _recording(
        reach(connect, domain, config), interfaces, {**named, "hidden": hidden}, files
    )


def _recording(
    where: Reach, interfaces: Path | None, named: dict[str, Any], files: tuple[object, ...]
) -> Job:
    """Return the job that records messages to a bag; see `bag_sessions.RecordOrder`."""

    def job() -> int:
        from turtleact.commands.interfaces import make_known

        sessions = _work("bag_sessions")
        make_known(folder(interfaces))
        path, *limits = files
        order = sessions.RecordOrder(path, _selection(**named), *limits)
        status: int = sessions.record_graph(where, order)
        return status

    return job


@app.command(cls=Verb)
def info(
    bag: BagPath,
    *,
    names_only: NamesOnly = False,
    verbose: Verbose = False,
    storage: ReadStorage = None,  # noqa: ARG001  # the file tells
) -> Job:
    """Print what is in a bag, and what is missing from it."""

    def job() -> int:
        contents = _work("bag_contents")
        status: int = contents.print_info(
            bag, verbose=verbose, names_only=names_only and not verbose
        )
        return status

    return job


@app.command(cls=ManyVerb)
def play(
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
    rate: PlayRate = "1.0",
    loop: Loop = False,
    offset: StartOffset = 0,
    duration: PlayDuration = None,
    delay: Delay = 0,
    remap: Remap = None,
    send_goals: SendGoals = False,
    clock: ClockFrequency = None,
    overrides: Overrides = None,
    storage: ReadStorage = None,  # noqa: ARG001  # the file tells
    _keyboard: Ignored = False,  # there are none
    interfaces: Interfaces = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Publish the messages of a bag again, or send its goals again."""
    named: dict[str, Any] = {
        "topics": topics,
        "services": services,
        "actions": actions,
        "regex": regex,
    }
    is_all = not any(named.values())
    left_out = [*(exclude_topics or ()), *(exclude_services or ()), *(exclude_actions or ())]
    named |= {"exclude": left_out, "exclude_regex": exclude_regex, "hidden": True}
    named |= dict.fromkeys(("all_topics", "all_services", "all_actions"), is_all)
    options = {
        "rate": _rate(rate),
        "loop": loop,
        "start_offset": offset,
        "duration": duration,
        "send_goals": send_goals,
        "remap": dict(map(_renamed, remap or ())),
        "clock": clock or 0.0,
    }
    where = reach(connect, domain, config)

    def job() -> int:
        from turtleact.commands.interfaces import make_known

        sessions = _work("bag_sessions")
        make_known(folder(interfaces))
        taken = {**options, "selection": _selection(**named)}
        order = sessions.PlayOrder(bag, taken, delay, overrides)
        status: int = sessions.play_bag(where, order)
        return status

    return job


@app.command(cls=Verb)
def goals(
    bag: BagPath,
    action: Action = None,
    *,
    as_json: AsJson = False,
    interfaces: Interfaces = None,
) -> Job:
    """List the goals in a bag."""

    def job() -> int:
        from turtleact.commands.interfaces import make_known

        contents = _work("bag_contents")
        make_known(folder(interfaces))
        status: int = contents.print_goals(bag, action, as_json=as_json)
        return status

    return job


@app.command(cls=ManyVerb)
def convert(
    bags: Bags,
    output: ConvertOutput,
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
) -> Job:
    """Convert bags: merge, cut by time or topic, split or compress them."""
    named: dict[str, Any] = {
        "topics": topics,
        "services": services,
        "actions": actions,
        "regex": regex,
    }
    is_all = not any(named.values())
    named |= {"exclude": exclude_topics, "exclude_regex": exclude_regex, "hidden": True}
    named |= dict.fromkeys(("all_topics", "all_services", "all_actions"), is_all)
    inputs = [Path(each) for each in bags if each not in ("mcap", "sqlite3")]  # ids of storages

    def job() -> int:
        converting = _work("bag_converting")
        if output.suffix in (".yaml", ".yml"):
            outputs = converting.outputs_in(output)
        else:
            start, end = converting.cut(inputs[0], offset, duration)
            split = converting.Split(
                max_size=max_size,
                max_duration=round(max_duration * 1e9),
                compression="none" if preset == "fastwrite" else preset,
            )
            selection = _selection(**named)
            outputs = [
                converting.Output(
                    path=output, selection=selection, start=start, end=end, split=split
                )
            ]
        status: int = converting.run(inputs, outputs)
        return status

    return job


@app.command(cls=Verb)
def view(bag: BagPath, *, port: Port = 0, no_open: NoOpen = False) -> Job:
    """Show a bag in a browser, with a time line."""

    def job() -> int:
        status: int = _work("bag_sessions").view_bag(bag, port, is_opened=not no_open)
        return status

    return job


def _rate(text: str) -> float | str:
    """Parse how fast a bag is played: a factor above zero, or ``max``."""
    if text == "max":
        return text
    try:
        return hertz(text)
    except typer.BadParameter:
        raise UsageError(f"--rate takes a factor above zero or max, not {quoted(text)}") from None


def _renamed(rule: str) -> tuple[str, str]:
    """Parse a remapping rule such as ``/old:=/new``, and return both full names."""
    from turtleact.names import resolve_name

    old, sign, new = rule.partition(":=")
    if not sign:
        raise UsageError(f"--remap takes rules such as /old:=/new, not {quoted(rule)}")
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
