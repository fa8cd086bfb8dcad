"""Prepares the process for a program that imports rclpy, and ends the process after the program.

`prepare` must be called before the program's first import. This module imports little, so it hardly
delays a program that does not use rclpy.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NoReturn

import msgspec

from turtleact.interfaces import load_interfaces, offer_interfaces
from turtleact.interfaces.finders import find_interfaces
from turtleact.rclpy.face import SETTINGS, JoinOptions, chosen_face
from turtleact.rclpy.finder import install

__all__ = ["Options", "end_threads", "leave", "offer_neighbours", "prepare"]

PARENTS = 5
"""How many parents of the program's folder are searched for a folder ``src``."""

ENDING = 1.5
"""How long the program's threads may continue to run after the program's end (s)."""


class Options(msgspec.Struct, frozen=True):
    """How a program is run.

    Attributes:
        face: The rclpy that the program imports; see `turtleact.rclpy.face`.
        place: The graph that the program joins.
        interfaces: A folder with additional interface files, or None.
    """

    face: str = "auto"
    place: JoinOptions = JoinOptions()
    interfaces: str | None = None


def prepare(options: Options, *folders: Path) -> None:
    """Make turtleact's rclpy and interface packages importable, unless the genuine ones are used.

    The caller must already have called `turtleact.interfaces.load_workspace` for the sourced
    workspace, and `turtleact.interfaces.offer_interfaces` for the working directory.

    Args:
        options: How the program is run.
        *folders: Folders of the program. Packages near these folders are also searched for
            interfaces.

    Raises:
        UsageError: if ``options.face`` is unknown, or if ``options.face`` is "ros" and the
            genuine rclpy cannot be imported.
        InvalidInterface: if the folder ``options.interfaces`` does not exist, or a file in it has
            an invalid name.
    """
    face, middleware = chosen_face(options.face)
    if face == "ros":
        if "zenoh" not in middleware:
            _note(
                f"this program uses the rclpy of ROS with {middleware}; only with "
                "RMW_IMPLEMENTATION=rmw_zenoh_cpp does it see turtleact's nodes"
            )
        return
    offer_neighbours(*folders)
    if options.interfaces is not None:
        load_interfaces(options.interfaces)
    SETTINGS.place = options.place
    install(_searched(options, folders))


def offer_neighbours(*folders: Path) -> None:
    """Offer the program the interfaces of packages near these folders.

    A parent folder is searched as well if it is named ``src`` or has a subfolder ``src``. If the
    sourced workspace or a package near the working directory has an interface with the same name,
    that interface is used instead.
    """
    known = find_interfaces(Path())
    found: dict[str, Path] = {}
    for place in _places(folders):
        found = find_interfaces(place) | found
    new = {name: path for name, path in found.items() if name not in known}
    if new:
        offer_interfaces(new)


def end_threads() -> list[str]:
    """Leave the graph, and wait at most `ENDING` seconds until the program's threads have ended.

    Call this function after the program has ended. The function returns the names of the threads
    that still run, for example because a callback sleeps for ever. Python would wait for these
    threads before it ends the process. If there are such threads, the caller must therefore end the
    process itself, for example with `leave`.
    """
    process = sys.modules.get("turtleact.rclpy.impl.process")
    if process is None:
        return []
    process.PROCESS.shut_down()
    due = time.monotonic() + ENDING
    own = threading.current_thread()
    others = [each for each in threading.enumerate() if each is not own and not each.daemon]
    for thread in others:
        thread.join(max(0.0, due - time.monotonic()))
    stuck = [each.name for each in others if each.is_alive()]
    if stuck:
        _note(f"leaving without threads that do not end: {', '.join(stuck)}")
    return stuck


def leave(error: BaseException | None) -> NoReturn:
    """End the process as Python would, but without waiting for threads."""
    if error is not None and not isinstance(error, SystemExit):
        sys.excepthook(type(error), error, error.__traceback__)
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    if isinstance(error, KeyboardInterrupt):
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.raise_signal(signal.SIGINT)
    if isinstance(error, SystemExit):
        os._exit(error.code if isinstance(error.code, int) else int(error.code is not None))
    os._exit(0 if error is None else 1)


def _places(folders: Sequence[Path]) -> Iterator[Path]:
    """Yield each folder and, above it, the nearest folders that belong to a workspace.

    Such a parent is named ``src`` or contains a folder ``src``.
    """
    for folder in folders:
        yield folder
        for above in list(folder.absolute().parents)[:PARENTS]:
            if (above / "src").is_dir() or above.name == "src":
                yield above


def _searched(options: Options, folders: Sequence[Path]) -> list[str]:
    """Describe the places that are searched for interfaces, for an error message."""
    given = [] if options.interfaces is None else [f"{options.interfaces} (--interfaces)"]
    sourced = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    near = [str(place.absolute()) for place in (Path(), *_places(folders))]
    return [*given, *sourced, *near, "turtleact's own interfaces"]


def _note(text: str) -> None:
    print(f"turtleact: {text}", file=sys.stderr)
