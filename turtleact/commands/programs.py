"""Runs a user's program, after ``turtleact run`` has found it.

`turtleact.commands.packages` finds the programs of packages. This module knows nothing of packages.
It runs a file, or a function of a module, as Python itself would.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import os
import runpy
import subprocess
import sys
import sysconfig
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, NoReturn

from turtleact.commands.output import leave, note
from turtleact.errors import TurtleactError, UsageError

if TYPE_CHECKING:
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
"""The kinds of statements that only declare something and do not make a file a program."""

FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
"""The kinds of syntax nodes with code that does not run when their file is executed."""

PREPARING = ("load_interfaces", "basicConfig")
"""Calls of these functions outside of functions do not make a file a program."""

MAIN = "main"
"""By convention, the function that runs a file's program."""

SHEBANG = 200
"""This many bytes at the beginning of a file are searched for ``python``."""


class Program(NamedTuple):
    """Something that can be run: a file, or a function in a module.

    Attributes:
        name: The name that the program sees as its own, ``sys.argv[0]``.
        file: A Python file to run as ``__main__``, or another executable file. None if there is a
            module.
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
    options: Options | None = None,
) -> int:
    """Run a program to its end in this process, and return its exit status.

    Every Python program of a user is started here. This function prepares the process first,
    because the program's first imports may need modules that turtleact provides.

    The program gets what ``python`` would give it: its arguments in ``sys.argv``, its folders in
    ``sys.path``, and Python's own signal handlers. A file runs as the module ``__main__``. The
    return value of a function becomes the exit status, as in a script that pip installs. An
    executable file that is not a Python program replaces this process, except on Windows.

    Args:
        program: What to run.
        arguments: The words that the user typed after the program's name.
        options: Which rclpy the program imports, and which graph it joins. None for the defaults.

    Returns:
        The exit status: that of `sys.exit`, 1 after an exception, 130 after Ctrl-C.

    Raises:
        UsageError: if ``program.module`` has no function ``program.function``.
        TurtleactError: if the program raises one. The message begins with the file and the line.
    """
    if program.file is not None and not is_python(program.file):
        return _start(program.file, arguments)
    from turtleact.rclpy.program import Options, end_threads, prepare

    here = program.folders if program.file is None else (program.file.parent,)
    prepare(Options() if options is None else options, *here)
    sys.argv = [program.name, *arguments]
    sys.path[:0] = [str(each) for each in program.folders]
    status = _run(program)
    if end_threads():
        leave(status)
    return status


def _run(program: Program) -> int:
    try:
        if program.file is not None:
            sys.path.insert(0, str(program.file.absolute().parent))
            names = runpy.run_path(str(program.file), run_name="__main__")
            _tell_what_is_missing(program.file, names)
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


def is_python(file: Path) -> bool:
    """Whether a file is a Python program, judging by its ending and its first line."""
    if file.suffix == ".py":
        return True
    try:
        with file.open("rb") as opened:
            first = opened.readline(SHEBANG)
    except OSError:
        return False
    return first.startswith(b"#!") and b"python" in first


def _tell_what_is_missing(file: Path, names: Mapping[str, object]) -> None:
    """If a file declares actions or a ``main`` but runs nothing, tell the user how to run the file.

    Args:
        file: The file, after it has been executed.
        names: The global variables of the file.
    """
    declares = _declares(names)
    has_main = getattr(names.get(MAIN), "__module__", "") == "__main__"
    if not (declares or has_main):
        return
    statements = ast.parse(file.read_bytes()).body
    if not all(map(_only_declares, statements)) or any(map(_uses_main, statements)):
        return
    if declares:
        note(f"{file} declares {declares}, but runs nothing: use 'turtleact serve {file}'")
        return
    is_async = inspect.iscoroutinefunction(names[MAIN])
    call = f"asyncio.run({MAIN}())" if is_async else f"{MAIN}()"
    imports = (
        "'import asyncio' at its beginning and " if is_async and "asyncio" not in names else ""
    )
    lines = f"{imports}'if __name__ == \"__main__\": {call}'"
    note(f"{file} defines {MAIN}, but runs nothing: add {lines} at its end")


def _declares(names: Mapping[str, object]) -> str:
    """Return what a file declares for ``turtleact serve``, as text; empty if there is nothing.

    The text names background functions only if the file declares no action.
    """
    from turtleact.goals.body import (  # help does without them
        ActionDeclaration,
        BackgroundDeclaration,
    )

    actions, tasks = list[str](), list[str]()
    for each in names.values():
        if isinstance(each, ActionDeclaration) and each.execute.__module__ == "__main__":
            actions.append(each.name)
        elif isinstance(each, BackgroundDeclaration) and each.run.__module__ == "__main__":
            tasks.append(each.run.__name__)
    kind, found = ("action", actions) if actions else ("background function", tasks)
    if not found:
        return ""
    return f"{kind}{'s' * (len(found) > 1)} {', '.join(found)}"


def _only_declares(statement: ast.stmt) -> bool:
    """Whether a top-level statement of a file only declares something, and runs nothing."""
    if isinstance(statement, ast.Expr):
        value = statement.value
        called = ast.unparse(value.func) if isinstance(value, ast.Call) else ""
        return isinstance(value, ast.Constant) or called.rpartition(".")[2] in PREPARING
    if isinstance(statement, ast.If):
        return all(map(_only_declares, [*statement.body, *statement.orelse]))
    return isinstance(statement, DECLARING)


def _uses_main(node: ast.AST) -> bool:
    """Whether code outside of functions uses the name ``main``, as in ``code = main()``."""
    if isinstance(node, FUNCTIONS):
        return False
    if isinstance(node, ast.Name):
        return node.id == MAIN and isinstance(node.ctx, ast.Load)
    return any(map(_uses_main, ast.iter_child_nodes(node)))


def _function(program: Program) -> Callable[[], object]:
    """Import the module of a program and return its function.

    Raises:
        UsageError: if ``program.module`` has no function ``program.function``.
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
    """Run an executable file that is not a Python program.

    On POSIX, the program replaces this process. On Windows, wait until it ends, and return its exit
    status.
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
    """Return the exit status for the argument of `sys.exit`.

    As in Python, an argument that is neither None nor an integer is printed on stderr.
    """
    if code is None:
        return 0
    if isinstance(code, int):
        return code & 0xFF
    print(code, file=sys.stderr)
    return FAILED


def _told(error: BaseException) -> int:
    """Print a traceback as Python does, but only of the user's code. Return the exit status."""
    trace = error.__traceback__
    while trace is not None and _is_ours(trace.tb_frame.f_code.co_filename):
        trace = trace.tb_next
    error.__traceback__ = trace
    from turtleact.summaries import field_hint, syntax_hint  # help does without it

    if hint := field_hint(error) or syntax_hint(error):
        error.add_note(hint)
    traceback.print_exception(error)
    return FAILED


def _place_of(error: BaseException) -> str:
    """Return the file and line of the user's code that led to an error; empty if there is none."""
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
