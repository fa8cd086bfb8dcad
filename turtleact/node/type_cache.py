"""Keeps learned types in the user's cache folder, one file for each type name and hash.

A file has the description of a type and the texts that came with it. Defaults are left out, because
the hash does not cover them: another node of the same hash may have others. A file is verified
again whenever it is read, so a file that was changed or that lies under a wrong name is not used.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from turtleact.errors import TurtleactError
from turtleact.interfaces import from_dict, to_dict, type_hash
from turtleact.interfaces.definition import type_name_pattern
from turtleact.interfaces.learned import LearnedTypes
from turtleact.interfaces.standard.type_description_interfaces.msg import (
    IndividualTypeDescription,
    TypeSource,
)
from turtleact.interfaces.types import REGISTRY, Interface

__all__ = ["Known", "cached", "cached_names", "cached_types", "keep", "remember"]

LARGEST = 4_000_000
"""The most bytes of a file that is read."""


class Known(NamedTuple):
    """A learned type, as the cache has it.

    Attributes:
        interface: The class.
        type_hash: The hash of the class.
        node: The node that described it.
        described: The descriptions of the type and of all types in it.
        sources: Their texts.
        has_own_defaults: Whether the node also sent defaults, which the cache does not keep.
    """

    interface: Interface
    type_hash: str
    node: str
    described: tuple[IndividualTypeDescription, ...]
    sources: tuple[TypeSource, ...] = ()
    has_own_defaults: bool = False


def folder() -> Path:
    """Return the folder with the files of all learned types."""
    import platformdirs  # only this module needs it

    return platformdirs.user_cache_path("turtleact") / "types"


def keep(known: Known) -> None:
    """Write a learned type to the cache. If that fails, it is learned again the next time."""
    described = [to_dict(each) for each in known.described]
    for each in described:
        for field in each["fields"]:  # type: ignore[attr-defined]  # a list of dicts
            field["default_value"] = ""
    content = {
        "node": known.node,
        "has_own_defaults": known.has_own_defaults,
        "types": described,
        "sources": [to_dict(each) for each in known.sources],
    }
    path = folder() / known.interface.type_name / f"{known.type_hash}.json"
    part = path.with_suffix(f".{os.getpid()}")
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(json.dumps(content), "utf-8")
        part.replace(path)


def remember(known: Known) -> Interface:
    """Keep a learned type for this process, and return its class."""
    holder = known.node if known.has_own_defaults else ""
    REGISTRY.learned[known.interface.type_name, known.type_hash] = known.interface, holder
    return known.interface


def cached(type_name: str) -> Iterator[Known]:
    """Yield every version of a type that the cache has, the one that was learned last first."""
    if type_name_pattern.fullmatch(type_name):
        files = (folder() / type_name).glob("RIHS01_*.json")
        for path in sorted(files, key=_changed, reverse=True):
            with suppress(OSError, ValueError, KeyError, TypeError, TurtleactError):
                yield _read(path, type_name)


def cached_names() -> list[str]:
    """Return the names of all types in the cache, sorted."""
    root = folder()
    names = ("/".join(path.relative_to(root).parts) for path in root.glob("*/*/*"))
    return sorted(name for name in names if type_name_pattern.fullmatch(name))


def cached_types() -> Iterator[Known]:
    """Yield all learned types in the cache, sorted by name."""
    for name in cached_names():
        yield from cached(name)


def _read(path: Path, type_name: str) -> Known:
    if path.stat().st_size > LARGEST:
        raise ValueError(path)
    content = json.loads(path.read_text("utf-8"))
    described = tuple(from_dict(IndividualTypeDescription, each) for each in content["types"])
    sources = tuple(from_dict(TypeSource, each) for each in content["sources"])
    types = LearnedTypes(described, sources, with_defaults=False)
    interface = types.interface(type_name)
    if type_hash(interface) != path.stem:
        raise ValueError(path)
    node, has_own = str(content["node"]), bool(content["has_own_defaults"])
    return Known(interface, path.stem, node, described, sources, has_own)


def _changed(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0
