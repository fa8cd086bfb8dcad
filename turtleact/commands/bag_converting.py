"""Implements ``bag convert``, which writes all or some messages of bags into new bags.

Source: rosbag2 ``README.md``, for the format of the file that describes the output bags.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, cast

from turtleact.commands.output import counted, note
from turtleact.errors import UsageError
from turtleact.names import resolve_name
from turtleact.recording import Bag, Selection
from turtleact.recording.bag_writer import Split
from turtleact.recording.converting import Output, convert
from turtleact.recording.metadata import read_yaml

__all__ = ["cut", "outputs_in", "run"]

LISTS: Final = {
    "topics": "topics",
    "services": "services",
    "actions": "actions",
    "topic_types": "types",
    "exclude_topics": "exclude",
    "exclude_topic_types": "exclude_types",
}
"""The options that are lists, and the names of their fields in `Selection`."""

FLAGS: Final = ("all_topics", "all_services", "all_actions")

OTHERS: Final = frozenset(
    {
        *("uri", "storage_id", "max_bagfile_size", "max_bagfile_duration", "all"),
        *("storage_preset_profile", "start_time_ns", "end_time_ns", "regex", "exclude_regex"),
    }
)


def cut(path: Path, offset: float, duration: float | None) -> tuple[int, int | None]:
    """Return the first and last stamp of a section of a bag (ns since the epoch).

    The last stamp is None if ``duration`` is None.

    Args:
        path: The bag.
        offset: Where the section begins (s from the start of the bag).
        duration: The length of the section (s); None for the rest of the bag.
    """
    bag = Bag(path)
    bag.close()
    start = bag.info.start + round(offset * 1e9)
    return start, None if duration is None else start + round(duration * 1e9)


def outputs_in(path: Path) -> list[Output]:
    """Read the descriptions of output bags from an options file of ``ros2 bag convert``.

    Raises:
        UsageError: if the file is not a valid options file, or has an option that turtleact lacks.
    """
    try:
        said = cast("Any", read_yaml(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise UsageError(f"'{path}' cannot be read: {error}") from None
    wanted = said.get("output_bags") if isinstance(said, dict) else None
    if not isinstance(wanted, list) or not all(isinstance(each, dict) for each in wanted):
        raise UsageError(f"'{path}' needs a list 'output_bags', as for ros2 bag convert")
    try:
        return [_output(path, each) for each in wanted]
    except (TypeError, ValueError, OverflowError) as error:  # another type, or infinite
        raise UsageError(f"'{path}' cannot be understood: {error}") from None


def run(inputs: Sequence[Path], outputs: Sequence[Output]) -> int:
    """Convert bags, and return the exit status. Ctrl-C removes the bags that are not complete.

    Raises:
        BagError: if a bag cannot be read or written.
    """
    counts = convert(inputs, outputs)
    for output, count in zip(outputs, counts, strict=True):
        note(f"{counted(count, 'message')} written to {output.path}")
    return 0


def _output(path: Path, said: Mapping[str, Any]) -> Output:
    unknown = sorted(said.keys() - OTHERS - LISTS.keys() - set(FLAGS))
    if unknown:
        raise UsageError(f"'{path}': turtleact has no option {', '.join(unknown)}")
    if not said.get("uri") or said.get("storage_id", "mcap") not in ("", "mcap"):
        raise UsageError(f"'{path}': each bag needs a 'uri', and the storage_id mcap")
    end = said.get("end_time_ns", -1)
    return Output(
        path=Path(str(said["uri"])),
        selection=_selection(said),
        start=max(0, int(said.get("start_time_ns", 0))),
        end=None if int(end) < 0 else int(end),
        split=Split(
            max_size=int(said.get("max_bagfile_size", 0)),
            max_duration=int(said.get("max_bagfile_duration", 0)) * 10**9,
            compression=_compression(str(said.get("storage_preset_profile", "none"))),
        ),
    )


def _selection(said: Mapping[str, Any]) -> Selection:
    lists: dict[str, Any] = {
        ours: frozenset(str(each) if "types" in name else resolve_name(str(each)) for each in given)
        for name, ours in LISTS.items()
        if (given := said.get(name))
    }
    everything = bool(said.get("all"))
    flags: dict[str, Any] = {name: everything or bool(said.get(name)) for name in FLAGS}
    expressions: dict[str, Any] = {
        name: str(said.get(name) or "") for name in ("regex", "exclude_regex")
    }
    return Selection(hidden=True, **lists, **flags, **expressions)


def _compression(preset: str) -> Any:  # noqa: ANN401  # `Compression`
    return preset if preset in ("zstd_fast", "zstd_small") else "none"
