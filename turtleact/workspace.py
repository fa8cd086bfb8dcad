"""Looks for ROS packages and their interface files near a folder, without any index.

A package is found in the folder itself, one level below it, one or two levels below its ``src``,
and where colcon installs packages: ``install/PACKAGE/share/PACKAGE`` or ``install/share/PACKAGE``.
In a folder below a ``src``, the other packages in that ``src`` are found as well.

The search is limited, so that it is quick even in a home folder. It goes no deeper than that, looks
at no more than `MOST_FOLDERS` folders, and opens only ``package.xml``. Folders that cannot be read
are skipped.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

__all__ = [
    "KINDS",
    "find_interfaces",
    "folders_near",
    "interface_files",
    "misnamed",
    "package_name",
    "proper_name",
]

KINDS = ("msg", "srv", "action")

MOST_FOLDERS = 1000
"""The search looks at no more than this many folders."""

LONGEST = 10_000
"""How many characters of a ``package.xml`` are searched for the name."""

_NAME = re.compile(r"<name>\s*([^<\s]+)\s*</name>")
_PACKAGE = re.compile(r"[a-z](?:_?[a-z0-9])*")
_INTERFACE = re.compile(r"[A-Z][A-Za-z0-9]*(?:_[A-Z][A-Za-z0-9]*)*")


def find_interfaces(root: Path) -> dict[str, Path]:
    """Find the interface files of the packages near a folder, by type name.

    If two packages have the same interface, the nearer package wins, and sources win over installed
    files.
    """
    found: dict[str, Path] = {}
    for folder in folders_near(root):
        for name, path in interface_files(folder).items():
            found.setdefault(name, path)
    return found


def interface_files(folder: Path) -> dict[str, Path]:
    """The interface files of the package in a folder, by type name.

    The result is empty if there are none, or if the package has no name; see `package_name`.
    """
    kinds = [(kind, path) for kind in KINDS if _is_folder(path := folder / kind)]
    package = package_name(folder) if kinds else ""
    if not package:
        return {}
    return {
        f"{package}/{kind}/{file.stem}": file
        for kind, path in kinds
        for file in _sorted(_entries(path))
        if file.suffix == f".{kind}" and _INTERFACE.fullmatch(file.stem)
    }


def misnamed(root: Path, type_name: str) -> tuple[Path, Path] | None:
    """A misnamed or misplaced interface file near a folder, and the path that it should have.

    For example, ``action/count.action`` and ``actions/Count.action`` are not found as interfaces.
    """
    package, _, rest = type_name.partition("/")
    name = rest.rpartition("/")[2]
    for folder in folders_near(root):
        if package_name(folder) != package:
            continue
        for place in _folders(folder):
            kind = place.name.casefold().removesuffix("s")
            for file in _sorted(_entries(place)) if kind in KINDS else ():
                if file.suffix.casefold() == f".{kind}" and _alike(file.stem, name):
                    proper = name if _INTERFACE.fullmatch(name) else proper_name(file.stem)
                    wanted = folder / kind / f"{proper}.{kind}"
                    if str(wanted) != str(file):
                        return file, wanted
    return None


def proper_name(name: str) -> str:
    """Turn a name that is not spelled as ROS 2 demands into the name of an interface.

    >>> proper_name("count_down"), proper_name("GoTo")
    ('CountDown', 'GoTo')
    """
    parts = re.split(r"[^A-Za-z0-9]+", name)
    return "".join(f"{part[:1].upper()}{part[1:]}" for part in parts)


def _alike(one: str, other: str) -> bool:
    return proper_name(one).casefold() == proper_name(other).casefold()


def package_name(folder: Path) -> str:
    """The name of the package in a folder: that in its ``package.xml``, or else the folder's name.

    The result is empty if neither is a valid name of a ROS package.
    """
    try:
        with (folder / "package.xml").open(encoding="utf-8", errors="replace") as file:
            said = _NAME.search(file.read(LONGEST))
    except OSError:
        said = None
    name = said[1] if said else folder.absolute().name
    return name if _PACKAGE.fullmatch(name) else ""


def folders_near(root: Path) -> Iterator[Path]:
    """The folders in which a package may be, nearest first, at most `MOST_FOLDERS`."""
    return islice(_folders_near(root), MOST_FOLDERS)


def _folders_near(root: Path) -> Iterator[Path]:
    yield root
    yield from _folders(root)
    around = next((each for each in _parents(root) if each.name == "src"), None)
    for source in (root / "src", around):
        for folder in _folders(source) if source is not None else ():
            yield folder
            yield from _folders(folder)
    install = root / "install"
    for prefix in (install, *_folders(install)):
        yield from _folders(prefix / "share")


def _parents(folder: Path) -> tuple[Path, ...]:
    """A folder and all its parent folders, nearest first; nothing if the folder is gone."""
    try:
        whole = folder.absolute()
    except OSError:
        return ()
    return (whole, *whole.parents)


def _folders(folder: Path) -> Iterator[Path]:
    """The folders in a folder, in the order of their names.

    Names with a dot are left out, because they are hidden or belong to files. In a folder full of
    files, the files are therefore not looked at one by one.
    """
    found = [path for path in _entries(folder) if "." not in path.name]
    return (path for path in _sorted(found)[:MOST_FOLDERS] if _is_folder(path))


def _entries(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return []


def _sorted(paths: list[Path]) -> list[Path]:
    """Sort the paths of one folder by name.

    Comparing the paths themselves is five times as slow.
    """
    return sorted(paths, key=lambda path: path.name)


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:
        return False
