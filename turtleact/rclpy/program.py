"""Prepares the process for a program that imports rclpy, and ends the process after the program.

`run` implements ``python -m turtleact.rclpy [OPTIONS] FILE.py|-m MODULE [ARGUMENTS]``.
`prepare` must be called before the program's first import. This module imports little, so it hardly
delays a program that does not use rclpy.
"""

from __future__ import annotations

import os
import runpy
import signal
import sys
import threading
import time
from argparse import REMAINDER, ArgumentParser
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NoReturn

import msgspec

from turtleact.errors import TurtleactError
from turtleact.interfaces import load_interfaces, load_workspace, offer_interfaces
from turtleact.interfaces.finders import find_interfaces
from turtleact.rclpy.face import FACES, SETTINGS, JoinOptions, chosen_face
from turtleact.rclpy.finder import install

__all__ = ["Options", "end_threads", "leave", "offer_neighbours", "prepare", "run"]

PARENTS = 5
"""How many parents of the program's folder are searched for a folder ``src``."""

ENDING = 1.5
"""How long the program's threads may continue to run after the program's end (s)."""


DESCRIPTION = """
The program behaves as under ``python FILE.py``. The program gets the same arguments, finds modules
in its own folder, and has the same tracebacks and exit statuses.
"""


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
    context = sys.modules.get("turtleact.rclpy.context")
    if context is None:
        return []
    context.PROCESS.shut_down()
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


def run(begin: Callable[[], object]) -> None:
    """Run the program that the command line names.

    Args:
        begin: Called right before the program begins.
    """
    parser = ArgumentParser("python -m turtleact.rclpy", description=DESCRIPTION)
    parser.add_argument("--face", choices=FACES, default="auto", help="whose rclpy to use")
    parser.add_argument("--embedded", action="store_true", help="have a world of turtles, too")
    parser.add_argument("--alone", action="store_true", help="join no graph of other processes")
    parser.add_argument("--connect", metavar="ENDPOINT", help="where the graph is")
    parser.add_argument("--interfaces", metavar="DIR", help="a folder with more interfaces")
    parser.add_argument("-m", dest="module", action="store_true", help="run a module")
    parser.add_argument("program", help="the file or module")
    parser.add_argument("arguments", nargs=REMAINDER, help="the program's own arguments")
    given = parser.parse_args()
    if given.alone and given.embedded:
        parser.error("--embedded needs a graph: leave --alone out")
    connect = tuple(given.connect.split(",")) if given.connect else ()
    place = JoinOptions(connect, is_embedded=given.embedded, is_alone=given.alone)
    options = Options(given.face, place, given.interfaces)
    file = None if given.module else Path(given.program)
    if file is not None and not file.is_file():
        parser.error(f"there is no file '{file}'")
    load_workspace(*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    offer_interfaces(find_interfaces(Path()))
    try:
        prepare(options, *([] if file is None else [file.parent]))
    except TurtleactError as error:
        parser.error(str(error))
    sys.argv = [given.program, *given.arguments]
    # As Python itself does: the program's folder comes first, or the working directory.
    sys.path[0] = str(Path.cwd()) if file is None else str(file.absolute().parent)
    begin()
    _run(given.program, file)


def _run(program: str, file: Path | None) -> None:
    """Run a file or a module to its end. An exception of the program is raised again."""
    error: BaseException | None = None
    try:
        if file is None:
            runpy.run_module(program, run_name="__main__", alter_sys=True)
        else:
            runpy.run_path(str(file), run_name="__main__")
    except BaseException as raised:
        error = raised
        raise
    finally:
        if end_threads():
            leave(error)


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
