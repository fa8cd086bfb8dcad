"""Finds and runs the code of users: programs for ``run``, and modules with actions for ``serve``.

Packages near the working directory need no build. Their executables are the console scripts that
``setup.py`` or ``pyproject.toml`` declares, and the Python programs that ``CMakeLists.txt``
installs. ``setup.py`` is read, never executed. A file, or a function of a module, runs as Python
itself would run it.

A target of ``serve`` is a module (``lab``, ``lab.robot``), a file (``lab.py``, ``./src/lab.py``),
or one object in a module or file (``lab:fibonacci``, ``lab.py:fibonacci``). To import a file as a
module, the folder of the file is put at the beginning of ``sys.path``. For a file in a package, the
folder that contains the package is put there instead. `Modules` also tells which files are the
user's own, because ``serve --reload`` watches these.

Source: ros2cli ``ros2pkg/api``; setuptools' documentation of entry points.
"""

from __future__ import annotations

import ast
import importlib
import os
import re
import sys
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

from turtleact.commands.output import leave
from turtleact.errors import TurtleactError, UsageError, summary, syntax_hint
from turtleact.interfaces.definition import did_you_mean, names_like

if TYPE_CHECKING:
    from turtleact.goals.body import ActionDeclaration, BackgroundDeclaration
    from turtleact.node.parameter_rules import ParameterDeclaration
    from turtleact.rclpy.program import Options

__all__ = [
    "Found",
    "Modules",
    "Program",
    "Programs",
    "Target",
    "read_target",
    "run_program",
    "runnable_here",
]

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


# modules with actions


class Found(NamedTuple):
    """The actions, parameters and background functions that the targets contain.

    Attributes:
        actions: The actions to serve, in the order of the targets. The actions of one module are in
            the order of their declaration.
        parameters: The parameters in the modules of the targets, and in the user's modules that
            these import.
        tasks: The background functions in the same modules.
    """

    actions: list[ActionDeclaration[..., object]]
    parameters: list[ParameterDeclaration[Any]]
    tasks: tuple[BackgroundDeclaration[Any], ...] = ()


class Target(NamedTuple):
    """One target on the command line.

    Attributes:
        text: The target as the user wrote it.
        module: The name of the module to import.
        name: The name of an action in the module; empty for all actions of the module.
        file: The file that the target names; None if the target names a module.
    """

    text: str
    module: str
    name: str
    file: Path | None

    @property
    def folder(self) -> Path:
        """The folder to put at the beginning of ``sys.path``."""
        if self.file is None:
            return Path.cwd()
        package = self.file.parent if self.file.name == "__init__.py" else self.file
        return package.parents[self.module.count(".")]


def read_target(text: str) -> Target:
    """Parse a target of the command line.

    Raises:
        UsageError: if the text is not a target, or names a file that does not exist.
    """
    name, colon, action = text.rpartition(":")
    if not colon or action.startswith(("/", "\\")):  # the colon of a drive, as in C:\lab.py
        name, colon, action = text, "", ""
    if colon and not action.isidentifier():
        raise UsageError(f"'{text}' is not a target: after the colon comes the name of an action")
    if file := _file_of(name):
        return Target(text, _module_name(file), action, file)
    if all(part.isidentifier() for part in name.split(".")):
        return Target(text, name, action, None)
    raise UsageError(f"'{text}' is not a target such as lab.py, lab or lab.robot:drive")


def _file_of(name: str) -> Path | None:
    """The file that a name refers to; None if the name is that of a module.

    Raises:
        UsageError: if the name is a path, but the file does not exist.
    """
    is_path = name.endswith(".py") or "/" in name or os.sep in name or Path(name).is_dir()
    if not name or (not is_path and name.isidentifier()):
        return None
    path = Path(os.path.abspath(name))  # noqa: PTH100  # keeps the name of a link
    for file in (path, path.parent / f"{path.name}.py", path / "__init__.py"):
        if file.suffix == ".py" and file.is_file():
            return file
    if not is_path:
        return None
    if path.is_dir():
        raise UsageError(f"'{name}' is a folder: name a file in it")
    there = [each.name for each in path.parent.glob("*.py")]
    wanted = path.name if path.suffix == ".py" else f"{path.name}.py"
    raise UsageError(f"there is no file '{name}'{names_like(wanted, there)}")


def _module_name(file: Path) -> str:
    """The full module name of a file, with the packages that contain it."""
    names = [] if file.name == "__init__.py" else [file.stem]
    folder = file.parent
    while (folder / "__init__.py").is_file():
        names.insert(0, folder.name)
        folder = folder.parent
    return ".".join(names)


class Modules:
    """Imports the modules of the targets, and finds the actions in them.

    Args:
        targets: The targets as the user wrote them.

    Raises:
        UsageError: if a text is not a target, or names a file that does not exist.
    """

    def __init__(self, targets: Sequence[str]) -> None:
        self.targets = [read_target(each) for each in targets]
        # The program of a package has imported its own module before it serves it.
        own = {each.module.partition(".")[0] for each in self.targets}
        self._others = frozenset(each for each in sys.modules if each.partition(".")[0] not in own)
        self._folders = tuple(dict.fromkeys(each.folder for each in self.targets))
        self._is_imported = False

    @property
    def files(self) -> frozenset[Path]:
        """The files to watch: those of the user's modules.

        Unless all modules have been imported, these are also the other files in their folders,
        because one of them may be wrong, or may have been missing.
        """
        named = {each.file for each in self.targets if each.file is not None}
        imported = {Path(str(module.__file__)) for module in self._own().values()}
        patterns = () if self._is_imported else ("*.py", "*/*.py")
        nearby = {file for each in self._folders for ways in patterns for file in each.glob(ways)}
        return frozenset(named | imported | nearby)

    def find(self) -> Found:
        """Import the modules, and find the actions, parameters and background functions in them.

        Modules are looked for in the folder of the target's file, then in the working directory,
        then in the rest of ``sys.path``.

        Raises:
            UsageError: if a target's module or object does not exist, or contains nothing to serve.
            TurtleactError: if a module raises an error while it is imported. The error text names
                the file and the line.
        """
        from turtleact.goals.body import BackgroundDeclaration
        from turtleact.node.parameter_rules import ParameterDeclaration

        actions = [each for target in self.targets for each in _actions_of(target)]
        self._is_imported = True
        modules = self._own() | {each.module: sys.modules[each.module] for each in self.targets}
        values = [each for module in modules.values() for each in vars(module).values()]
        unique = {id(each): each for each in values}.values()
        parameters = [each for each in unique if isinstance(each, ParameterDeclaration)]
        tasks = [each for each in unique if isinstance(each, BackgroundDeclaration)]
        return Found(actions, parameters, tuple(tasks))

    def _own(self) -> dict[str, ModuleType]:
        """The user's modules that were imported for the targets, keyed by name."""
        imported = {name: each for name, each in sys.modules.items() if name not in self._others}
        return {
            name: module
            for name, module in imported.items()
            if (file := _file(module)) is not None and self.has(file)
        }

    def has(self, file: Path) -> bool:
        """Whether a file is the user's own.

        The user's own files are in the folder of a target, but neither part of turtleact nor
        installed.
        """
        is_near = any(file.is_relative_to(folder) for folder in self._folders)
        return is_near and not _is_library(str(file))


def _file(module: ModuleType) -> Path | None:
    file = getattr(module, "__file__", None)
    return Path(file) if file else None


def _actions_of(target: Target) -> list[ActionDeclaration[..., object]]:
    from turtleact.goals.body import ActionDeclaration, BackgroundDeclaration

    module = _import_module(target)
    declared = [each for each in vars(module).values() if isinstance(each, ActionDeclaration)]
    if not target.name:
        own = [each for each in declared if each.execute.__module__ == module.__name__]
        kinds = {type(each) for each in vars(module).values()}
        if not own and BackgroundDeclaration not in kinds:
            raise UsageError(
                f"'{target.text}' declares no action: put @turtleact.action(TYPE, NAME) above a "
                "body, or run it as a program: turtleact run FILE"
            )
        return own
    named = {each.execute.__name__: each for each in declared}
    found = vars(module).get(target.name)
    if not isinstance(found, ActionDeclaration):
        hint = names_like(target.name, named)
        raise UsageError(f"'{target.text}': no action {target.name} is there{hint}")
    return [found]


def _import_module(target: Target) -> ModuleType:
    import asyncio

    for folder in map(str, (Path.cwd(), target.folder)):
        if folder not in sys.path:
            sys.path.insert(0, folder)
    name = target.module
    try:
        with closing(asyncio.new_event_loop()) as loop:
            module = loop.run_until_complete(_import(name))
    except Exception as error:
        missing = (isinstance(error, ModuleNotFoundError) and error.name) or ""
        if missing and f"{name}.".startswith(f"{missing}."):
            here = [path.stem for path in Path().glob("*.py")]
            problem = f"there is no module '{missing}' here, or on the path"
            raise UsageError(f"{problem}{did_you_mean(missing, here)}") from error
        raise _import_error(target, error) from error
    file = _file(module)
    if target.file is not None and not (file and file.samefile(target.file)):
        problem = f"another module has its name ({file or 'a part of Python'})"
        raise UsageError(f"'{target.text}' cannot be imported: {problem}; rename the file")
    return module


async def _import(name: str) -> ModuleType:
    """Import a module inside an event loop.

    A file with actions often ends with ``asyncio.run(main())``, which might never return. Inside a
    loop, such a call is an error, like ``anyio.run`` and ``uvloop.run``. The loop is not that of
    ``asyncio.run``, whose first Ctrl-C would only cancel a task, and not interrupt the import.
    """
    return importlib.import_module(name)


def _import_error(target: Target, error: Exception) -> TurtleactError:
    """The error for a module whose import fails, with the file and line in the user's code."""
    where = place_of(error)
    if isinstance(error, TurtleactError):  # it says what is wrong
        return TurtleactError(f"{where}: {error}")
    what = f"SyntaxError: {error.msg}" if isinstance(error, SyntaxError) else summary(error)
    if hint := syntax_hint(error):
        what += f": {hint}"
    if isinstance(error, RuntimeError) and "running" in str(error):
        what += """; put it below 'if __name__ == "__main__":'"""
    if isinstance(error, ModuleNotFoundError) and error.name == "rclpy":
        file = nearby(str(target.file)) if target.file else f"{target.module.replace('.', '/')}.py"
        what += f"; to run a program with rclpy: turtleact run {file}"
    return TurtleactError(f"{where}: module '{target.module}' cannot be imported: {what}")
