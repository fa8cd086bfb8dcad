"""Reads and writes the text of ``metadata.yaml``, which describes a bag.

A bag's MCAP files contain the type hash of each channel. ``metadata.yaml`` contains no type hashes,
because the package rosbags would compare them with its own hashes. For the types of actions, the
hashes of rosbags differ.

Source: rosbag2 ``metadata_io.cpp``, ``yaml.hpp`` and ``qos.cpp``. This module writes version 9 of
``metadata.yaml``, and also reads older versions.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, cast

import msgspec
import yaml

from turtleact.errors import TurtleactError, UsageError
from turtleact.transports.base import QoS, TimePolicies

__all__ = [
    "ABOUT",
    "METADATA",
    "ROOT",
    "BagError",
    "BagFile",
    "BagInfo",
    "BagTopic",
    "Description",
    "Offer",
    "embedded",
    "offers_text",
    "read_description",
    "read_embedded",
    "read_offers",
    "read_qos_overrides",
    "read_yaml",
    "write_info",
]

VERSION: Final = 9
"""The version of the format that is written."""

METADATA: Final = "metadata.yaml"

ABOUT: Final = "rosbag2"
"""The name of the records in a file that describe the bag."""

ROOT: Final = "rosbag2_bagfile_information"

FOREVER: Final = {"sec": 9223372036, "nsec": 854775807}
"""The value that ROS 2 writes for a policy without a limit."""


class BagError(TurtleactError):
    """A bag cannot be written or read.

    Attributes:
        path: The bag's file or folder.
        problem: What is wrong, and what to do about it.
    """

    def __init__(self, path: Path, problem: str) -> None:
        super().__init__(path, problem)
        self.path = path
        self.problem = problem

    def __str__(self) -> str:
        return f"bag '{self.path}': {self.problem}"


class Offer(msgspec.Struct, frozen=True):
    """The quality of service that a publisher offered."""

    qos: QoS = QoS()
    times: TimePolicies = TimePolicies()


class BagTopic(msgspec.Struct, frozen=True, kw_only=True):
    """A topic of a bag.

    Attributes:
        name: The fully qualified name.
        type_name: The type, ``pkg/kind/Name``.
        count: How many messages the topic has in the bag.
        offers: The quality of service that its publishers offered.
        type_hash: The hash of the type; empty if the bag does not have it.
        format: The encoding of the messages: ``"cdr"`` for everything that ROS 2 sends.
    """

    name: str
    type_name: str
    count: int = 0
    offers: tuple[Offer, ...] = ()
    type_hash: str = ""
    format: str = "cdr"


class BagFile(msgspec.Struct, frozen=True, kw_only=True):
    """A file of a bag.

    Attributes:
        path: The path, relative to the bag's folder.
        start: The time of the first message (ns since 1970).
        duration: The time from the first message to the last (ns).
        count: How many messages the file has.
    """

    path: str
    start: int = 0
    duration: int = 0
    count: int = 0


class BagInfo(msgspec.Struct, frozen=True, kw_only=True):
    """What is known about a bag without reading its messages.

    Attributes:
        files: The files, in the order of their messages.
        topics: The topics, in the order in which they were first seen.
        storage: The format of the files, ``"mcap"`` or ``"sqlite3"``.
        start: The time of the first message (ns since 1970).
        duration: The time from the first message to the last (ns).
        count: How many messages the bag has.
        size: The size of all files (bytes).
        distro: The name of the ROS distribution or of the program that recorded the bag.
        custom: Texts that the recorder added, by their names.
        is_closed: Whether the recorder closed every file. A recorder that is killed, or that finds
            the disk full, does not close its last file.
    """

    files: tuple[BagFile, ...] = ()
    topics: tuple[BagTopic, ...] = ()
    storage: str = "mcap"
    start: int = 0
    duration: int = 0
    count: int = 0
    size: int = 0
    distro: str = ""
    custom: Mapping[str, str] = {}
    is_closed: bool = True


class Description(msgspec.Struct, frozen=True, kw_only=True):
    """What only the text that describes a bag says; the files say the rest.

    Attributes:
        files: The names of the files, in the order of their messages.
        compression: What rosbag2 has compressed: ``"file"`` (whole files) or ``"message"`` (each
            message); otherwise empty. It is also empty if only the chunks inside a file are
            compressed.
        distro: The name of the ROS distribution or of the program that recorded the bag.
        custom: Texts that the recorder added, by their names.
    """

    files: tuple[str, ...] = ()
    compression: str = ""
    distro: str = ""
    custom: Mapping[str, str] = {}


def read_yaml(text: str) -> object:
    """Parse YAML into plain values.

    Raises:
        ValueError: if the text is not YAML.
    """
    try:
        value: object = yaml.load(text, Loader=_LOADER)  # noqa: S506  # a safe loader
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise ValueError(f"{where}{error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise ValueError(" ".join(str(error).split())) from error
    return value


def write_info(info: BagInfo) -> str:
    """Return the text of ``metadata.yaml``."""
    return _dump({ROOT: _described(info)})


def embedded(info: BagInfo) -> str:
    """Return the description of a bag in the form that the bag's MCAP files contain."""
    return _dump(_described(info))


def read_description(text: str, path: Path) -> Description:
    """Parse the text of ``metadata.yaml``.

    Raises:
        BagError: if ``text`` is not a valid ``metadata.yaml``.
    """
    hint = "delete or rename this file to read the bag without it"
    try:
        said: Any = read_yaml(text)
    except ValueError as error:
        raise BagError(path, f"it is not YAML: {error}; {hint}") from error
    if not isinstance(said, dict) or not isinstance(said.get(ROOT), dict):
        raise BagError(path, f"it has no '{ROOT}' with the description of a bag; {hint}")
    try:
        return _description(said[ROOT])
    except (AttributeError, LookupError, TypeError) as error:
        what = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise BagError(path, f"it does not describe a bag: {what}; {hint}") from error


def read_embedded(text: str) -> Description:
    """Parse the description in an MCAP file; return an empty one if it is missing or invalid."""
    try:
        return _description(read_yaml(text))
    except (AttributeError, LookupError, TypeError, ValueError):
        return Description()


def offers_text(offers: Iterable[Offer]) -> str:
    """Return the QoS profiles of a channel's publishers as text for the channel's metadata."""
    said = [_offer(each) for each in offers]
    return _dump(said).strip() if said else ""


def read_offers(given: object) -> tuple[Offer, ...]:
    """Read the QoS profiles of publishers from YAML text, or from values parsed from YAML.

    If the input is invalid, return an empty tuple.

    >>> read_offers("- {depth: 1, reliability: 2, durability: transient_local}")[0].qos
    QoS(depth=1, durability='transient_local', reliability='best_effort')
    """
    if isinstance(given, str):
        try:
            given = read_yaml(given)
        except ValueError:
            return ()
    entries = given if isinstance(given, list) else []
    return tuple(_read_offer(each) for each in entries if isinstance(each, dict))


def read_qos_overrides(path: Path) -> dict[str, QoS]:
    """Read the file given by ``--qos-profile-overrides-path``: a quality of service per topic.

    The file has the same format as for ``ros2 bag``. Policies about time, such as ``deadline``, are
    accepted but have no effect.

    Raises:
        UsageError: if the file cannot be read, or has another format.
    """
    try:
        given = read_yaml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"'{path}' cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(f"'{path}' is not YAML: {error}") from error
    if not isinstance(given, dict) or not all(isinstance(each, dict) for each in given.values()):
        raise UsageError(f"'{path}' must have names of topics, each with policies below it")
    for topic, policies in given.items():
        for policy, value in policies.items():
            words = _POLICIES.get(policy)
            if words is None:
                known = ", ".join(_POLICIES)
                raise UsageError(f"'{path}': {topic}: no policy is called '{policy}', only {known}")
            if words and value not in words:
                expected = " or ".join(words)
                problem = f"expected {expected}, not {value!r}"
                raise UsageError(f"'{path}': {topic}: {policy}: {problem}")
    return {topic: _read_offer(policies).qos for topic, policies in given.items()}


_POLICIES: Final[dict[str, tuple[str, ...]]] = {
    "history": ("keep_last", "keep_all", "system_default"),
    "depth": (),
    "reliability": ("reliable", "best_effort", "system_default"),
    "durability": ("volatile", "transient_local", "system_default"),
    "deadline": (),
    "lifespan": (),
    "liveliness": (),
    "liveliness_lease_duration": (),
    "avoid_ros_namespace_conventions": (),
}
"""The QoS policies that a file of QoS overrides may set, each with the allowed values.

An empty tuple allows any value.
"""

_LOADER: Final[Any] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]  # as _LOADER
    """Writes YAML without aliases, as yaml-cpp does: a value that occurs twice is written twice."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002  # any
        return True


def _dump(value: object) -> str:
    text: str = yaml.dump(value, Dumper=_Dumper, sort_keys=False, default_flow_style=False)
    return text


def _described(info: BagInfo) -> dict[str, object]:
    return {
        "version": VERSION,
        "storage_identifier": info.storage,
        "duration": {"nanoseconds": info.duration},
        "starting_time": {"nanoseconds_since_epoch": info.start},
        "message_count": info.count,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": topic.format,
                    "offered_qos_profiles": [_offer(each) for each in topic.offers],
                    "type_description_hash": "",
                },
                "message_count": topic.count,
            }
            for topic in info.topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.path for file in info.files],
        "files": [
            {
                "path": file.path,
                "starting_time": {"nanoseconds_since_epoch": file.start},
                "duration": {"nanoseconds": file.duration},
                "message_count": file.count,
            }
            for file in info.files
        ],
        "custom_data": dict(info.custom) or None,
        "ros_distro": info.distro,
    }


def _description(said: Any) -> Description:  # noqa: ANN401  # parsed YAML
    """Read the parsed description of a bag.

    A missing or wrong value raises LookupError, TypeError or AttributeError.
    """
    mode = str(said.get("compression_mode") or "").lower()
    return Description(
        # Before version 4, paths began with the folder's own name.
        files=tuple(str(each).rpartition("/")[2] for each in said["relative_file_paths"]),
        compression="" if mode == "none" else mode,
        distro=str(said.get("ros_distro") or ""),
        custom={str(key): str(value) for key, value in (said.get("custom_data") or {}).items()},
    )


def _offer(offer: Offer) -> dict[str, object]:
    qos, times = offer.qos, offer.times
    return {
        "history": "keep_last",
        "depth": qos.depth,
        "reliability": qos.reliability,
        "durability": qos.durability,
        "deadline": _limit(times.deadline),
        "lifespan": _limit(times.lifespan),
        "liveliness": times.liveliness,
        "liveliness_lease_duration": _limit(times.lease),
        "avoid_ros_namespace_conventions": False,
    }


def _limit(nanoseconds: int | None) -> dict[str, int]:
    if nanoseconds is None:
        return FOREVER
    seconds, rest = divmod(nanoseconds, 10**9)
    return {"sec": seconds, "nsec": rest}


def _read_offer(said: dict[str, Any]) -> Offer:
    # Before version 9, policies are numbers.
    is_latched = said.get("durability") in ("transient_local", 1)
    is_best_effort = said.get("reliability") in ("best_effort", 2)
    depth = said.get("depth")
    qos = QoS(
        depth=depth if isinstance(depth, int) and depth > 0 else QoS().depth,
        durability="transient_local" if is_latched else "volatile",
        reliability="best_effort" if is_best_effort else "reliable",
    )
    liveliness = said.get("liveliness")
    times = TimePolicies(
        _read_limit(said.get("deadline")),
        _read_limit(said.get("lifespan")),
        liveliness if isinstance(liveliness, str) else "automatic",
        _read_limit(said.get("liveliness_lease_duration")),
    )
    return Offer(qos, times)


def _read_limit(said: object) -> int | None:
    limits = cast("dict[str, Any]", said) if isinstance(said, dict) else FOREVER
    seconds, rest = limits.get("sec"), limits.get("nsec")
    if not isinstance(seconds, int) or not isinstance(rest, int):
        return None
    total = seconds * 10**9 + rest
    # Foxy wrote "for ever" as 0x7FFFFFFF seconds or the largest int64; zero means no limit as well.
    return total if total > 0 and seconds < 0x7FFFFFFF else None
