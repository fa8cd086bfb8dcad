"""Implements ``python -m turtleact.rclpy [OPTIONS] FILE.py|-m MODULE [ARGUMENTS]``.

The program behaves as under ``python FILE.py``. The program gets the same arguments, finds modules
in its own folder, and has the same tracebacks and exit statuses.
"""

from __future__ import annotations

import os
import runpy
import sys
from argparse import REMAINDER, ArgumentParser
from collections.abc import Callable
from pathlib import Path

from turtleact.errors import TurtleactError
from turtleact.interfaces import load_workspace, offer_interfaces
from turtleact.interfaces.finders import find_interfaces
from turtleact.rclpy.face import FACES, JoinOptions
from turtleact.rclpy.program import Options, end_threads, leave, prepare

__all__ = ["run"]


def run(begin: Callable[[], object]) -> None:
    """Run the program that the command line names.

    Args:
        begin: Called right before the program begins.
    """
    parser = ArgumentParser(
        "python -m turtleact.rclpy", description=str(__doc__).partition("\n")[2]
    )
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
