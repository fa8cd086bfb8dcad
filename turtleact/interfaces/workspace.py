"""Finds ROS packages and their interface files near a folder, without an index of packages.

These folders may hold a package:

- the given folder, and the folders directly in it
- the folders one or two levels below ``src`` in the given folder
- the folders one or two levels below the nearest ``src`` among the given folder and its parents
- the folders where colcon installs packages: ``install/PACKAGE/share/PACKAGE`` or
  ``install/share/PACKAGE``

The search is limited, so that it is quick even in a home folder. The search looks at no more than
`MOST_FOLDERS` folders, and opens no file except ``package.xml``. Folders that cannot be read are
skipped.
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
    "package_name",
    "proper_name",
]

KINDS = ("msg", "srv", "action")

MOST_FOLDERS = 1000
"""The maximum number of folders that the search looks at."""

LONGEST = 10_000
"""How many characters of a ``package.xml`` are searched for the name."""

_NAME = re.compile(r"<name>\s*([^<\s]+)\s*</name>")
_PACKAGE = re.compile(r"[a-z](?:_?[a-z0-9])*")
_INTERFACE = re.compile(r"[A-Z][A-Za-z0-9]*(?:_[A-Z][A-Za-z0-9]*)*")


def find_interfaces(root: Path) -> dict[str, Path]:
    """Return the paths of the interface files near a folder, by type name.

    If several folders hold an interface with the same type name, the nearest folder is used.
    Sources are preferred to installed files.
    """
    found: dict[str, Path] = {}
    for folder in folders_near(root):
        for name, path in interface_files(folder).items():
            found.setdefault(name, path)
    return found


def interface_files(folder: Path) -> dict[str, Path]:
    """Return the paths of the interface files of the package in a folder, by type name.

    The result is empty if the folder has no interface files, or if `package_name` finds no name.
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


def proper_name(name: str) -> str:
    """Turn a name into the spelling that ROS 2 demands for interfaces.

    >>> proper_name("count_down"), proper_name("GoTo")
    ('CountDown', 'GoTo')
    """
    parts = re.split(r"[^A-Za-z0-9]+", name)
    return "".join(f"{part[:1].upper()}{part[1:]}" for part in parts)


def package_name(folder: Path) -> str:
    """Return the package name in a folder's ``package.xml``, or else the folder's name.

    The result is empty if that name is not valid for a ROS package.
    """
    try:
        with (folder / "package.xml").open(encoding="utf-8", errors="replace") as file:
            said = _NAME.search(file.read(LONGEST))
    except OSError:
        said = None
    name = said[1] if said else folder.absolute().name
    return name if _PACKAGE.fullmatch(name) else ""


def folders_near(root: Path) -> Iterator[Path]:
    """Yield the folders that may hold a package, nearest first, at most `MOST_FOLDERS`."""
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
    """Return a folder and its parents, nearest first; nothing if the current folder is gone."""
    try:
        whole = folder.absolute()
    except OSError:
        return ()
    return (whole, *whole.parents)


def _folders(folder: Path) -> Iterator[Path]:
    """Return the folders in a folder, sorted by name.

    Names with a dot are left out, because most such names belong to files or hidden folders.
    Leaving them out saves a check of the file type for most files.
    """
    found = [path for path in _entries(folder) if "." not in path.name]
    return (path for path in _sorted(found)[:MOST_FOLDERS] if _is_folder(path))


def _entries(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return []


def _sorted(paths: list[Path]) -> list[Path]:
    """Sort paths in one folder by name.

    Comparing whole paths would take five times as long.
    """
    return sorted(paths, key=lambda path: path.name)


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:
        return False
