"""Finds packages and their executables, near the working directory or in a sourced ROS workspace.

Packages near the working directory need no build. Their executables are the console scripts that
``setup.py``, ``setup.cfg`` or ``pyproject.toml`` declares, and the Python programs that
``CMakeLists.txt`` installs. ``setup.py`` is read, never executed. The executables of an installed
package are the files in ``lib/PACKAGE`` of its prefix, where ``ros2 run`` looks too.

Source: ros2cli ``ros2pkg/api``; setuptools' documentation of entry points.
"""

from __future__ import annotations

import ast
import configparser
import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

from turtleact.commands.programs import Program, is_python
from turtleact.workspace import folders_near, package_name

__all__ = ["Package", "find_installed", "find_sources", "runnable", "runnable_here"]

PROGRAMS: Final = (
    ("turtlesim", "turtlesim_node"),
    ("turtlesim", "turtle_teleop_key"),
    ("action_tutorials_py", "fibonacci_action_server"),
    ("action_tutorials_cpp", "fibonacci_action_server"),
    ("examples_rclpy_minimal_action_server", "server"),
    ("examples_rclcpp_minimal_action_server", "action_server_member_functions"),
)
"""The programs of ROS 2 that have a counterpart in turtleact.

All programs except those of the package turtlesim serve the Fibonacci action.
"""

_MARKS: Final = ("package.xml", "setup.py", "setup.cfg", "pyproject.toml")
"""One of these files makes a folder a package."""

_INSTALLED: Final = re.compile(r"install\s*\(\s*PROGRAMS\s+(.*?)\sDESTINATION\s", re.DOTALL)
_ENTRY: Final = re.compile(r"\s*([^\s=]+)\s*=\s*([\w.]+)\s*:\s*([\w.]+)\s*(?:\[.*\])?\s*")


class Package(NamedTuple):
    """A package and its executables.

    Attributes:
        name: Its name.
        folder: The folder of its sources, or the prefix in which it is installed.
        programs: Its executables, keyed by name.
    """

    name: str
    folder: Path
    programs: Mapping[str, Program]


def find_sources(here: Path) -> dict[str, Package]:
    """Return the packages whose sources are near a folder, keyed by name.

    `turtleact.workspace` defines which folders are near.
    """
    found: dict[str, Package] = {}
    for folder in folders_near(here):
        if (package := _source(folder)) is not None:
            found.setdefault(package.name, package)
    return found


def find_installed() -> dict[str, Package]:
    """Return the packages of the sourced ROS workspace (``AMENT_PREFIX_PATH``), keyed by name."""
    found: dict[str, Package] = {}
    for prefix in map(
        Path, filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    ):
        for place in _listed(prefix / "share" / "ament_index" / "resource_index" / "packages"):
            if place.name not in found:
                found[place.name] = Package(place.name, prefix, _installed(prefix, place.name))
    return found


def runnable(
    here: Path, built_in: Iterable[tuple[str, str]]
) -> dict[str, dict[str, Program | None]]:
    """Return the programs that can be run, keyed by package name and then by executable name.

    If several programs have the same package name and executable name, a program with sources wins,
    because it is the user's own. A built-in program wins over an installed one: ``turtlesim
    turtlesim_node`` runs turtleact's turtlesim, even if the real one is installed. In the returned
    dict, the value for a built-in program is None.
    """
    found: dict[str, dict[str, Program | None]] = {}
    for package in find_sources(here).values():
        found.setdefault(package.name, {}).update(package.programs)
    for name, executable in built_in:
        found.setdefault(name, {}).setdefault(executable, None)
    for package in find_installed().values():
        found[package.name] = {**package.programs, **found.get(package.name, {})}
    return found


def runnable_here() -> dict[str, dict[str, Program | None]]:
    """Return the programs that can be run from the working directory; see `runnable`."""
    return runnable(Path(), PROGRAMS)


def _source(folder: Path) -> Package | None:
    """Return the package whose sources are in a folder, or None."""
    if not any((folder / each).is_file() for each in _MARKS):
        return None
    name = package_name(folder) or folder.absolute().name
    # A module may be beside setup.py, or in a folder of its own: setuptools knows both layouts.
    folders = tuple(each for each in (folder, folder / "src") if each == folder or each.is_dir())
    programs = {
        entry[1]: Program(
            str(folder / entry[1]), module=entry[2], function=entry[3], folders=folders
        )
        for text in _console_scripts(folder)
        if (entry := _ENTRY.fullmatch(text))
    }
    return Package(name, folder, dict(sorted({**_cmake_programs(folder), **programs}.items())))


def _console_scripts(folder: Path) -> Iterator[str]:
    """Yield the console scripts that a package declares, each as ``name = module:function``.

    A malformed file declares no scripts.
    """
    with suppress(OSError, ValueError, SyntaxError, RecursionError):
        yield from _of_setup_py((folder / "setup.py").read_text("utf-8"))
    with suppress(OSError, ValueError, configparser.Error):
        parser = configparser.ConfigParser(interpolation=None)
        parser.read_string((folder / "setup.cfg").read_text("utf-8"))
        yield from parser.get("options.entry_points", "console_scripts", fallback="").splitlines()
    with suppress(OSError, ValueError, AttributeError, TypeError):
        tool = tomllib.loads((folder / "pyproject.toml").read_text("utf-8"))
        for tables in (tool, tool.get("tool", {}).get("poetry", {})):
            scripts = tables.get("project", tables).get("scripts", {})
            yield from (f"{name} = {target}" for name, target in scripts.items())


def _of_setup_py(text: str) -> Iterator[str]:
    """Yield the console scripts in a ``setup.py``, as far as they can be found by reading it."""
    known: dict[str, object] = {}
    tree = ast.parse(text)
    for node in tree.body:
        if isinstance(node, ast.Assign):
            value = _value(node.value, known)
            known.update({each.id: value for each in node.targets if isinstance(each, ast.Name)})
    for given in ast.walk(tree):
        if isinstance(given, ast.keyword) and given.arg == "entry_points":
            yield from _scripts_in(_value(given.value, known))


def _scripts_in(declared: object) -> list[str]:
    """Return the console scripts in ``declared``, which holds the entry points of a package.

    ``declared`` is a dict or the text of an INI file.
    """
    if isinstance(declared, str):
        _, _, text = declared.partition("[console_scripts]")
        return text.partition("[")[0].splitlines()
    scripts = declared.get("console_scripts") if isinstance(declared, dict) else None
    if isinstance(scripts, str):
        return scripts.splitlines()
    return [each for each in scripts if isinstance(each, str)] if isinstance(scripts, list) else []


def _value(node: ast.expr, known: Mapping[str, object]) -> object:
    """Evaluate an expression of strings, lists, dicts and known names. Other parts become None."""
    match node:
        case ast.Constant(value=value):
            return value
        case ast.Name(id=name):
            return known.get(name)
        case ast.List(elts=elements) | ast.Tuple(elts=elements):
            return [_value(each, known) for each in elements]
        case ast.Dict(keys=keys, values=values):
            pairs = zip(keys, values, strict=True)
            return {_value(key, known): _value(value, known) for key, value in pairs if key}
        case ast.JoinedStr(values=parts):
            return _joined([_value(each, known) for each in parts])
        case ast.FormattedValue(value=inner):
            return _value(inner, known)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return _joined([_value(left, known), _value(right, known)])
    return None


def _joined(parts: list[object]) -> object:
    """Concatenate strings or lists. Return None if the parts are of different or unknown types."""
    if all(isinstance(each, str) for each in parts):
        return "".join(map(str, parts))
    if all(isinstance(each, list) for each in parts):
        return [element for each in parts if isinstance(each, list) for element in each]
    return None


def _cmake_programs(folder: Path) -> dict[str, Program]:
    """Return the Python programs that a ``CMakeLists.txt`` installs.

    Other programs are left out, because they need a build.
    """
    try:
        text = (folder / "CMakeLists.txt").read_text("utf-8")
    except (OSError, UnicodeDecodeError):
        return {}
    files = [folder / name for said in _INSTALLED.findall(text) for name in said.split()]
    return {file.name: _of_file(file, (folder,)) for file in files if is_python(file)}


def _installed(prefix: Path, package: str) -> dict[str, Program]:
    """The executables of an installed package."""
    # Sourcing the workspace puts these folders on Python's path; so do we, if it was not sourced.
    libraries = tuple(sorted((prefix / "lib").glob("python3*/*-packages")))
    files = [each for each in _listed(prefix / "lib" / package) if os.access(each, os.X_OK)]
    return {file.name: _of_file(file, libraries) for file in files if file.is_file()}


def _of_file(file: Path, folders: tuple[Path, ...]) -> Program:
    return Program(str(file), file=file, folders=folders)


def _listed(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []
