"""Runs a user's program, after ``turtleact run`` has found it.

`turtleact.commands.packages` finds the programs of packages. This module knows nothing of packages.
It gets a file, or a module and a function, and runs it as Python itself would.
"""

from __future__ import annotations

import ast
import importlib
import os
import runpy
import subprocess
import sys
import sysconfig
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, NoReturn

from turtleact.commands.output import note
from turtleact.errors import TurtleactError, UsageError

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts
    from turtleact.rclpy.program import Options

__all__ = ["Program", "run_program"]

OURS = str(Path(__file__))
PACKAGE = str(Path(__file__).parents[1]) + os.sep

FAILED, INTERRUPTED = 1, 130

DECLARING = (
    ast.Import,
    ast.ImportFrom,
    ast.FunctionDef,
    ast.AsyncFunctionDef,
    ast.ClassDef,
    ast.Assign,
    ast.AnnAssign,
    ast.AugAssign,
    ast.Pass,
)
"""The kinds of statements in a file that declares actions but runs nothing."""

SHEBANG = 200
"""This many bytes at the beginning of a file are searched for ``python``."""


class Program(NamedTuple):
    """Something that can be run: a file, or a function in a module.

    Attributes:
        name: The name that the program sees as its own, ``sys.argv[0]``.
        file: A Python file to run as ``__main__``, or a program in machine code. None if there is
            a module.
        module: The module to import, if there is no file.
        function: The function in that module, such as ``main`` or ``App.main``.
        folders: The folders that the program needs at the beginning of ``sys.path``.
    """

    name: str
    file: Path | None = None
    module: str = ""
    function: str = ""
    folders: tuple[Path, ...] = ()


def run_program(
    program: Program,
    arguments: Sequence[str],
    interrupts: Interrupts,
    options: Options | None = None,
) -> int:
    """Run a program to its end in this process, and return its exit status.

    All users' programs begin here. Everything that they need in the process, such as modules that
    turtleact provides, is set up here before their first import.

    The program finds what it would find under ``python``: its arguments in ``sys.argv``, its
    folders in ``sys.path``, Python's own signal handlers, and ``__main__`` if it is a file. A
    function's result becomes the exit status, as in a script that pip installs. A program in
    machine code replaces this process.

    Args:
        program: What to run.
        arguments: The words that the user typed after the program's name.
        interrupts: The signals, which are given back to Python.
        options: Which rclpy the program imports, and which graph it then joins.

    Returns:
        The exit status: that of `sys.exit`, 1 after an exception, 130 after Ctrl-C.

    Raises:
        UsageError: if the module has no such function.
        TurtleactError: if the program raises one. The text names the line.
    """
    if program.file is not None and not is_python(program.file):
        return _start(program.file, arguments)
    from turtleact.rclpy.program import Options, end_threads, prepare

    here = program.folders if program.file is None else (program.file.parent,)
    prepare(Options() if options is None else options, *here)
    interrupts.release()
    sys.argv = [program.name, *arguments]
    sys.path[:0] = [str(each) for each in program.folders]
    try:
        if program.file is not None:
            sys.path.insert(0, str(program.file.absolute().parent))
            names = runpy.run_path(str(program.file), run_name="__main__")
            _tell_how_to_serve(program.file, names)
            return 0
        return _status(_function(program)())
    except SystemExit as end:
        return _status(end.code)
    except KeyboardInterrupt:
        return INTERRUPTED
    except TurtleactError as error:
        place = _place_of(error)
        if not place:
            raise
        raise TurtleactError(f"{place}: {error}") from error
    except BaseException as error:
        return _told(error)
    finally:
        if end_threads():
            interrupts.must_leave = True


def is_python(file: Path) -> bool:
    """Whether a file is a Python program: by its ending, or by its first line."""
    if file.suffix == ".py":
        return True
    try:
        with file.open("rb") as opened:
            first = opened.readline(SHEBANG)
    except OSError:
        return False
    return first.startswith(b"#!") and b"python" in first


def _tell_how_to_serve(file: Path, names: Mapping[str, object]) -> None:
    """Tell the user how to serve a file that only declares actions.

    Args:
        file: The file, which has run to its end.
        names: Its global names.
    """
    from turtleact.body import ActionDeclaration  # help does without it

    declared = [each for each in names.values() if isinstance(each, ActionDeclaration)]
    own = [each.name for each in declared if each.execute.__module__ == "__main__"]
    if own and all(map(_only_declares, ast.parse(file.read_bytes()).body)):
        actions = f"action {own[0]}" if len(own) == 1 else f"actions {', '.join(own)}"
        note(f"{file} declares {actions}, but runs nothing: use 'turtleact serve {file}'")


def _only_declares(statement: ast.stmt) -> bool:
    """Whether a top-level statement of a file only declares something, and runs nothing."""
    if isinstance(statement, ast.Expr):
        return isinstance(statement.value, ast.Constant)
    if isinstance(statement, ast.If):
        return all(map(_only_declares, [*statement.body, *statement.orelse]))
    return isinstance(statement, DECLARING)


def _function(program: Program) -> Callable[[], object]:
    """Import the module of a program and return its function.

    Raises:
        UsageError: if the module has no such function.
    """
    found: object = importlib.import_module(program.module)
    for attribute in program.function.split("."):
        if not hasattr(found, attribute):
            where = f"{program.module}:{program.function}"
            raise UsageError(f"{program.name} is {where}, but there is no '{attribute}'")
        found = getattr(found, attribute)
    if not callable(found):
        raise UsageError(f"{program.name} is {program.module}:{program.function}, not a function")
    return found


def _start(file: Path, arguments: Sequence[str]) -> int:
    """Run a program in machine code.

    On POSIX, the program takes over this process and its terminal.
    """
    command = [str(file), *arguments]
    try:
        if os.name == "posix":
            _become(command)
        return subprocess.call(command)  # noqa: S603  # the program that the user typed
    except OSError as error:
        raise TurtleactError(f"{file} cannot be run: {error.strerror}") from None


def _become(command: list[str]) -> NoReturn:
    os.execv(command[0], command)  # noqa: S606  # as above


def _status(code: object) -> int:
    """The exit status for the argument of `sys.exit`. A text is printed, as in Python."""
    if code is None:
        return 0
    if isinstance(code, int):
        return code & 0xFF
    print(code, file=sys.stderr)
    return FAILED


def _told(error: BaseException) -> int:
    """Print the traceback of the user's own code as Python does, and return the exit status."""
    trace = error.__traceback__
    while trace is not None and _is_ours(trace.tb_frame.f_code.co_filename):
        trace = trace.tb_next
    error.__traceback__ = trace
    from turtleact.summaries import field_hint  # help does without it

    if hint := field_hint(error):
        error.add_note(hint)
    traceback.print_exception(error)
    return FAILED


def _place_of(error: BaseException) -> str:
    """The last line of the user's own code before an error; empty if there is none."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [
        each for each in frames if not _is_ours(each.filename) and not _is_library(each.filename)
    ]
    return f"{own[-1].filename}:{own[-1].lineno}" if own else ""


def _is_ours(file: str) -> bool:
    """Whether a file is this module, or a part of Python that imports or runs programs."""
    return file in (OURS, importlib.__file__) or file.startswith("<frozen ")


def _is_library(file: str) -> bool:
    """Whether a file belongs to turtleact, to Python or to an installed package."""
    is_installed = {"site-packages", "dist-packages"} & {*Path(file).parts}
    return bool(is_installed) or file.startswith((PACKAGE, sysconfig.get_path("stdlib")))
