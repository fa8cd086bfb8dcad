"""Finds and runs the programs of users and packages, for ``turtleact run``.

Packages near the working directory need no build. Their executables are the console scripts that
``setup.py`` or ``pyproject.toml`` declares, and the Python programs that ``CMakeLists.txt``
installs. ``setup.py`` is read, never executed. A file, or a function of a module, runs as Python
itself would run it.

Source: ros2cli ``ros2pkg/api``; setuptools' documentation of entry points.
"""

from __future__ import annotations

import ast
import os
import re
import sys
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

from turtleact.commands.output import leave
from turtleact.errors import TurtleactError, syntax_hint

if TYPE_CHECKING:
    from turtleact.rclpy.program import Options

__all__ = ["Program", "Programs", "nearby", "place_of", "run_program", "runnable_here"]

FAILED, INTERRUPTED = 1, 130

SHEBANG = 200
"""This many bytes at the beginning of a file are searched for ``python``."""

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

_MARKS: Final = ("package.xml", "setup.py", "pyproject.toml")
"""One of these files makes a folder a package."""

_INSTALLED: Final = re.compile(r"install\s*\(\s*PROGRAMS\s+(.*?)\sDESTINATION\s", re.DOTALL)
_ENTRY: Final = re.compile(r"\s*([^\s=]+)\s*=\s*([\w.]+\s*:\s*[\w.]+)\s*(?:\[.*\])?\s*")


class Program(NamedTuple):
    """Something that can be run: a file, or a function in a module.

    Attributes:
        name: The name that the program sees as its own, ``sys.argv[0]``.
        file: A Python file to run as ``__main__``; None if there is an entry point.
        entry: The entry point, such as ``lab.server:main``, if there is no file.
        folders: The folders that the program needs at the beginning of ``sys.path``.
    """

    name: str
    file: Path | None = None
    entry: str = ""
    folders: tuple[Path, ...] = ()


Programs: TypeAlias = dict[str, dict[str, Program | None]]
"""Programs by package name and then by executable name. A built-in program is None."""


def runnable_here() -> Programs:
    """Return the programs that can be run from the working directory.

    If several programs have the same package name and executable name, a program with sources wins,
    because it is the user's own.
    """
    from turtleact.interfaces.finders import folders_near, package_name

    found: Programs = {}
    for folder in folders_near(Path()):
        if any((folder / each).is_file() for each in _MARKS):
            name = package_name(folder) or folder.absolute().name
            found.setdefault(name, _programs_in(folder))
    for name, executable in PROGRAMS:
        found.setdefault(name, {}).setdefault(executable, None)
    return found


def _programs_in(folder: Path) -> dict[str, Program | None]:
    """Return the programs of the package whose sources are in a folder."""
    # A module may be beside setup.py, or in a folder of its own: setuptools knows both layouts.
    folders = (folder, folder / "src")
    programs: dict[str, Program | None] = {
        file.name: Program(str(file), file, folders=folders) for file in _cmake_programs(folder)
    }
    for text in _console_scripts(folder):
        if found := _ENTRY.fullmatch(text):
            name, entry = found.groups()
            programs[name] = Program(str(folder / name), entry=entry, folders=folders)
    return dict(sorted(programs.items()))


def _console_scripts(folder: Path) -> Iterator[str]:
    """Yield the console scripts that a package declares, each as ``name = module:function``.

    A malformed file declares no scripts.
    """
    with suppress(OSError, ValueError, SyntaxError):
        yield from _of_setup_py((folder / "setup.py").read_text("utf-8"))
    with suppress(OSError, ValueError, AttributeError):
        project = tomllib.loads((folder / "pyproject.toml").read_text("utf-8")).get("project", {})
        for name, target in project.get("scripts", {}).items():
            yield f"{name} = {target}"


def _of_setup_py(text: str) -> Iterator[str]:
    """Yield the lines of all texts in the entry points of a ``setup.py``."""
    for given in ast.walk(ast.parse(text)):
        if isinstance(given, ast.keyword) and given.arg == "entry_points":
            for each in ast.walk(given.value):
                if isinstance(each, ast.Constant) and isinstance(each.value, str):
                    yield from each.value.splitlines()


def _cmake_programs(folder: Path) -> list[Path]:
    """Return the Python programs that a ``CMakeLists.txt`` installs. Others need a build."""
    try:
        text = (folder / "CMakeLists.txt").read_text("utf-8")
    except (OSError, UnicodeDecodeError):
        return []
    files = [folder / name for said in _INSTALLED.findall(text) for name in said.split()]
    return [file for file in files if _is_python(file)]


def _is_python(file: Path) -> bool:
    """Whether a file is a Python program, judging by its ending and its first line."""
    if file.suffix == ".py":
        return True
    try:
        with file.open("rb") as opened:
            first = opened.readline(SHEBANG)
    except OSError:
        return False
    return first.startswith(b"#!") and b"python" in first


# how a program is run


def run_program(program: Program, arguments: Sequence[str], options: Options) -> int:
    """Run a program of the user to its end in this process, and return its exit status.

    This function prepares the process first, because the program's first imports may need modules
    that turtleact provides. The program gets what ``python`` would give it: its arguments in
    ``sys.argv``, its folders in ``sys.path``, and Python's own signal handlers. An executable file
    that is not a Python program replaces this process.

    Returns:
        The exit status: that of `sys.exit`, 1 after an exception, 130 after Ctrl-C.

    Raises:
        TurtleactError: if the program raises one. The message begins with the file and the line.
    """
    from turtleact.rclpy.program import end_threads, prepare

    prepare(options, *(program.folders if program.file is None else (program.file.parent,)))
    sys.argv = [program.name, *arguments]
    sys.path[:0] = [str(each) for each in program.folders]
    status = _status_of(program)
    if end_threads():
        leave(status)
    return status


def _status_of(program: Program) -> int:
    try:
        return _status(_run(program))
    except SystemExit as end:
        return _status(end.code)
    except KeyboardInterrupt:
        return INTERRUPTED
    except TurtleactError as error:
        place = place_of(error)
        if not place:
            raise
        raise TurtleactError(f"{place}: {error}") from error
    except BaseException as error:
        return _print_traceback(error)


def _run(program: Program) -> object:
    """Run a file as the module ``__main__``, or return what the function of the program returns."""
    from importlib.metadata import EntryPoint
    from runpy import run_path

    if program.file is None:
        return EntryPoint(program.name, program.entry, "console_scripts").load()()
    sys.path.insert(0, str(program.file.absolute().parent))
    run_path(str(program.file), run_name="__main__")
    return None


def _status(code: object) -> int:
    """Return the exit status for the argument of `sys.exit`.

    As in Python, an argument that is neither None nor an integer is printed on stderr.
    """
    if code is None or isinstance(code, int):
        return (code or 0) & 0xFF
    print(code, file=sys.stderr)
    return FAILED


def _print_traceback(error: BaseException) -> int:
    """Print a traceback as Python does, but only of the user's code. Return the exit status."""
    import traceback

    trace = error.__traceback__
    while trace is not None and _is_library(trace.tb_frame.f_code.co_filename):
        trace = trace.tb_next
    if hint := syntax_hint(error):
        error.add_note(hint)
    traceback.print_exception(error.with_traceback(trace))
    return FAILED


def place_of(error: BaseException) -> str:
    """Return the file and line of the user's code that led to an error; empty if there is none."""
    import traceback

    if isinstance(error, SyntaxError) and error.filename:
        return f"{nearby(error.filename)}:{error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    own = [each for each in frames if not _is_library(each.filename)]
    return f"{nearby(own[-1].filename)}:{own[-1].lineno}" if own else ""


def nearby(file: str) -> str:
    """Return the path of a file, relative to the working directory if the file is inside."""
    path = Path(file)
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)


def _is_library(file: str) -> bool:
    """Whether a file belongs to turtleact, to Python or to an installed package."""
    import sysconfig

    is_installed = {"site-packages", "dist-packages"} & {*Path(file).parts}
    ours = str(Path(__file__).parents[1]) + os.sep
    return bool(is_installed) or file.startswith(("<", ours, sysconfig.get_path("stdlib")))
