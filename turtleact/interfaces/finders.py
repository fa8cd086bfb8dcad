"""The places where interfaces are looked for, in order.

`Finders` is the list of places. Each finder gives the class of an interface, or the file from which
the class can be made. A class that already exists goes before all of them.

`find_interfaces` looks for packages near a folder, without an index: in the folder itself, in the
folders directly in it, and in those one or two levels below ``src``. Inside a folder called
``src``, all its packages are found.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Protocol

import msgspec

from turtleact.interfaces.definition import type_name_pattern

__all__ = [
    "BUILT_IN",
    "KINDS",
    "Files",
    "Finder",
    "Finders",
    "Workspace",
    "built_in_class",
    "built_in_file",
    "files_in",
    "find_interfaces",
    "folders_near",
    "interface_files",
    "name_of",
    "package_name",
    "proper_name",
]

KINDS = ("msg", "srv", "action")

MOST_FOLDERS = 1000
"""How many folders are looked at near a folder, so that a search in a home folder is quick."""


class Finder(Protocol):
    """One place where interfaces are looked for."""

    def find(self, type_name: str) -> type | Path | None:
        """Return an interface's class, or the file from which it can be made, or None."""

    def names(self) -> Iterable[str]:
        """Return the names of the interfaces in this place."""


class Files(msgspec.Struct, frozen=True):
    """Files whose paths are known.

    Attributes:
        files: The file of each interface, by type name.
        on_use: Called with the type name and the file when a class is made from the file.
    """

    files: Mapping[str, Path] = {}
    on_use: Callable[[str, str], object] | None = None

    def find(self, type_name: str) -> Path | None:
        """Return an interface's file, or None."""
        return self.files.get(type_name)

    def names(self) -> Iterable[str]:
        """Return the names of all files."""
        return self.files


class Workspace(msgspec.Struct, frozen=True):
    """Installed ROS packages: the files ``share/PACKAGE/KIND/NAME.EXT`` in several folders.

    Attributes:
        prefixes: The folders, in order of precedence.
    """

    prefixes: tuple[str, ...] = ()

    def find(self, type_name: str) -> Path | None:
        """Return an interface's file in the first folder that has one, or None."""
        package, kind, name = type_name.split("/")
        places = [Path(prefix, "share", package, kind) for prefix in self.prefixes]
        files = (place / f"{name}.{kind}" for place in places)
        try:
            return next((file for file in files if file.is_file()), None)
        except OSError:  # the name is too long for the system
            return None

    def names(self) -> Iterable[str]:
        """Return the names of all files in these folders."""
        files = [path for prefix in self.prefixes for path in files_in(Path(prefix), "share/*")]
        return {name_of(path) for path in files} - {""}


class BuiltIn(msgspec.Struct, frozen=True):
    """The generated classes in ``turtleact.interfaces.standard``."""

    def find(self, type_name: str) -> type | None:
        """Return the class of an interface, or None."""
        return built_in_class(type_name)

    def names(self) -> Iterable[str]:
        """Return the names of the files beside the generated classes."""
        return {name_of(path) for path in files_in(FOLDER, "*")}


BUILT_IN = "turtleact.interfaces.standard"
"""The package with the built-in interfaces."""

FOLDER = Path(__file__).parent / "standard"


class Finders(msgspec.Struct, frozen=True):
    """All finders, in the order in which they are asked.

    Attributes:
        loaded: The files of `load_interfaces`.
        workspace: The folders of `load_workspace`.
        nearby: The files of `offer_interfaces`.
        built_in: What turtleact contains.
    """

    loaded: Files = Files()
    workspace: Workspace = Workspace()
    nearby: Files = Files()
    built_in: BuiltIn = BuiltIn()

    def __iter__(self) -> Iterator[Finder]:
        """Yield the finders, the first one first."""
        return iter((self.loaded, self.workspace, self.nearby, self.built_in))


def built_in_class(type_name: str) -> type | None:
    """Return the built-in class with this full name, or None if there is none."""
    package, kind, name = type_name.split("/")
    try:
        module = import_module(f"{BUILT_IN}.{package}.{kind}")
    except ModuleNotFoundError:
        return None
    found: type | None = vars(module).get(name) if name in module.__all__ else None
    return found


def built_in_file(type_name: str) -> Path | None:
    """Return the built-in file of an interface, or None."""
    package, kind, name = type_name.split("/")
    file = FOLDER / package / kind / f"{name}.{kind}"
    return file if file.is_file() else None


def files_in(root: Path, *layouts: str) -> list[Path]:
    """Return the interface files under a folder.

    The layouts are glob patterns for the folders of packages, relative to ``root``.
    """
    patterns = [f"{packages}/{kind}/*.{kind}" for packages in layouts for kind in KINDS]
    return [path for pattern in patterns for path in sorted(root.glob(pattern))]


def name_of(path: Path) -> str:
    """Return the full name of an interface, derived from its file's path, or an empty string."""
    package, kind, _ = ("", "", "", *path.absolute().parts)[-3:]
    name = f"{package}/{kind}/{path.stem}"
    return name if type_name_pattern.fullmatch(name) and path.suffix == f".{kind}" else ""


def find_interfaces(root: Path) -> dict[str, Path]:
    """Return the paths of the interface files near a folder, by type name.

    If several folders hold an interface with the same type name, the nearest folder is used.
    """
    found: dict[str, Path] = {}
    for folder in folders_near(root):
        found = interface_files(folder) | found
    return found


def interface_files(folder: Path) -> dict[str, Path]:
    """Return the paths of the interface files of the package in a folder, by type name."""
    files = [file for kind in KINDS for file in sorted((folder / kind).glob(f"*.{kind}"))]
    package = package_name(folder) if files else ""
    named = {f"{package}/{file.parent.name}/{file.stem}": file for file in files}
    return {name: file for name, file in named.items() if type_name_pattern.fullmatch(name)}


def folders_near(root: Path) -> Iterator[Path]:
    """Yield the folders that may hold a package, nearest first."""
    whole = root.absolute()
    source = next((each for each in (whole, *whole.parents) if each.name == "src"), whole / "src")
    places = ((root, "[!.]*"), (source, "[!.]*"), (source, "[!.]*/[!.]*"))
    found = (path for place, pattern in places for path in sorted(place.glob(pattern)))
    yield root
    yield from islice((path for path in found if path.is_dir()), MOST_FOLDERS)


def package_name(folder: Path) -> str:
    """Return the package name in a folder's ``package.xml``, or else the folder's name.

    The result is empty if that name is not valid for a ROS package.
    """
    try:
        said = _NAME.search((folder / "package.xml").read_text("utf-8", "replace"))
    except OSError:
        said = None
    name = said[1] if said else folder.absolute().name
    return name if _PACKAGE.fullmatch(name) else ""


_NAME = re.compile(r"<name>\s*([^<\s]+)\s*</name>")
_PACKAGE = re.compile(r"[a-z](?:_?[a-z0-9])*")


def proper_name(name: str) -> str:
    """Turn a name into the spelling that ROS 2 demands for interfaces.

    >>> proper_name("count_down"), proper_name("GoTo")
    ('CountDown', 'GoTo')
    """
    parts = re.split(r"[^A-Za-z0-9]+", name)
    return "".join(f"{part[:1].upper()}{part[1:]}" for part in parts)
