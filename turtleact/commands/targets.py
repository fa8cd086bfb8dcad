"""Finds what ``serve`` serves: the user's modules, and the actions and parameters in them.

A target is a module (``lab``, ``lab.robot``), a file (``lab.py``, ``./src/lab.py``), or one object
in a module or file (``lab:fibonacci``, ``lab.py:Robot.drive``). To import a file as a module, the
folder of the file is put at the beginning of ``sys.path``. For a file in a package, the folder that
contains the package is put there instead.

`Modules` also tells which files are the user's own, because ``serve --reload`` watches these.
"""

from __future__ import annotations

import asyncio
import importlib
import logging
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from inspect import iscoroutine
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import anyio

from turtleact.errors import TurtleactError, UsageError
from turtleact.goals.body import ActionDeclaration, BackgroundDeclaration
from turtleact.interfaces.definition import names_like
from turtleact.node.parameter_rules import ParameterDeclaration
from turtleact.summaries import summary, syntax_hint

__all__ = ["Found", "Modules", "Target", "read_target"]

logger = logging.getLogger("turtleact.serve")

OURS = Path(__file__).parents[1]
"""The folder of turtleact's own modules."""

NOT_SERVED = ("setup.py", "conftest.py", "noxfile.py", "__init__.py")
"""Names of files with a special meaning. Error messages never suggest these files as targets."""

DECLARES = re.compile(rb"^\s*@(?:\w+\.)*action\(", re.MULTILINE)
"""Matches the line with the decorator that declares an action."""

MOST_READ = 50
"""To suggest files in an error, at most this many files of a folder are searched for actions."""


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
        path: The dotted path of an action in the module; empty for all actions of the module.
        file: The file that the target names; None if the target names a module.
    """

    text: str
    module: str
    path: str
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
    name, separator, path = text.rpartition(":") if _has_object(text) else (text, "", "")
    if separator and not all(part.isidentifier() for part in path.split(".")):
        raise UsageError(f"'{text}' is not a target: after the colon comes the name of an action")
    if file := _file_of(name):
        return Target(text, _module_name(file), path, file)
    if all(part.isidentifier() for part in name.split(".")):
        return Target(text, name, path, None)
    raise UsageError(f"'{text}' is not a target such as lab.py, lab or lab.robot:drive")


def _has_object(text: str) -> bool:
    r"""Whether a text names an object after a colon.

    The colon after a drive's letter, as in ``C:\lab.py``, does not count.
    """
    _, colon, after = text.rpartition(":")
    return bool(colon) and after[:1] not in ("/", "\\")


def _file_of(name: str) -> Path | None:
    """The file that a name refers to; None if the name is that of a module.

    Raises:
        UsageError: if the name is a path, but the file does not exist.
    """
    is_path = name.endswith(".py") or "/" in name or os.sep in name or name in (".", "..")
    if not name or (not is_path and name.isidentifier()):
        return None
    path = Path(os.path.abspath(name))  # noqa: PTH100  # keeps the name of a link
    for file in (path, path.parent / f"{path.name}.py", path / "__init__.py"):
        if file.suffix == ".py" and file.is_file():
            return file
    if not is_path:
        return None
    folder = path if path.is_dir() else path.parent
    if not folder.is_dir():
        raise UsageError(f"'{name}': there is no folder '{folder}'")
    if path.is_dir():
        raise UsageError(f"'{name}' is a folder: {_files_to_name(Path(name))}")
    there = [each.name for each in folder.glob("*.py") if each.name not in NOT_SERVED]
    wanted = path.name if path.suffix == ".py" else f"{path.name}.py"
    raise UsageError(f"there is no file '{name}'{names_like(wanted, there)}")


def _files_to_name(folder: Path) -> str:
    """Return advice on which file of a folder the user can name as a target.

    The advice names the files that seem to declare actions. If no file seems to declare an action,
    the advice names all Python files directly in the folder, except tests and `NOT_SERVED`.
    """
    files = [
        each
        for pattern in ("*.py", "*/*.py")
        for each in sorted(folder.glob(pattern))
        if each.name not in NOT_SERVED and not each.name.startswith("test_")
    ]
    declaring = [each for each in files[:MOST_READ] if _declares(each)]
    named = declaring or [each for each in files if each.parent == folder]
    if not named:
        return "it has no file with actions"
    return f"name a file in it ({', '.join(map(str, named))})"


def _declares(file: Path) -> bool:
    """Whether a file seems to declare an action. The file is only read, not imported."""
    try:
        return bool(DECLARES.search(file.read_bytes()))
    except OSError:
        return False


def _module_name(file: Path) -> str:
    """The full module name of a file, with the packages that contain it."""
    names = [] if file.name == "__init__.py" else [file.stem]
    folder = file.parent
    while (folder / "__init__.py").is_file() and folder != folder.parent:
        names.insert(0, folder.name)
        folder = folder.parent
    if any("." in each for each in names):
        raise UsageError(f"'{file.name}' cannot be imported: take the dots out of its name")
    return ".".join(names)


class Modules:
    """Imports the modules of the targets, and finds the actions in them.

    Args:
        targets: The targets as the user wrote them.

    Attributes:
        files: The files to watch. After a failed import, these include files that were not found.

    Raises:
        UsageError: if a text is not a target, or names a file that does not exist.
    """

    def __init__(self, targets: Sequence[str]) -> None:
        self.targets = [read_target(each) for each in targets]
        self.files = frozenset(self._named_files())
        # The program of a package has imported its own module before it serves it.
        own = {each.module.partition(".")[0] for each in self.targets}
        self._others = frozenset(each for each in sys.modules if each.partition(".")[0] not in own)
        self._folders = tuple(dict.fromkeys(each.folder for each in self.targets))

    def find(self) -> Found:
        """Import the modules, and find the actions, parameters and background functions in them.

        Modules are looked for in the folder of the target's file, then in the working directory,
        then in the rest of ``sys.path``.

        Raises:
            UsageError: if a target's module or object does not exist, or contains nothing to serve.
            TurtleactError: if a module raises an error while it is imported. The error text names
                the file and the line.
        """
        try:
            actions = [each for target in self.targets for each in _actions_of(target)]
        except BaseException as error:
            self.files |= self._own_files() | self._files_in(error) | self._named_files()
            raise
        self.files = frozenset(self._own_files())
        modules = self._own() | {each.module: sys.modules[each.module] for each in self.targets}
        values = [each for module in modules.values() for each in vars(module).values()]
        unique = {id(each): each for each in values}.values()
        parameters = [each for each in unique if isinstance(each, ParameterDeclaration)]
        tasks = [each for each in unique if isinstance(each, BackgroundDeclaration)]
        return Found(actions, parameters, tuple(tasks))

    def _own(self) -> dict[str, ModuleType]:
        """The user's modules that were imported for the targets, keyed by name."""
        names = [name for name in sys.modules if name not in self._others]
        files = {name: _file(sys.modules[name]) for name in names}
        return {name: sys.modules[name] for name, file in files.items() if file and self.has(file)}

    def has(self, file: Path) -> bool:
        """Whether a file is the user's own.

        The user's own files are in the folder of a target, but neither in site-packages nor in
        turtleact itself.
        """
        if file.is_relative_to(OURS):
            return False
        if not {"site-packages", "dist-packages"}.isdisjoint(file.parts):
            return False
        return any(file.is_relative_to(folder) for folder in self._folders)

    def _own_files(self) -> set[Path]:
        return {file for module in self._own().values() if (file := _file(module)) is not None}

    def _named_files(self) -> set[Path]:
        """The files of all targets, including targets that have not been imported."""
        return {
            each.file or each.folder.joinpath(*each.module.split(".")).with_suffix(".py")
            for each in self.targets
        }

    def _files_in(self, error: BaseException | None) -> set[Path]:
        """The user's files that may have caused the error of a failed import.

        The result has the files in the error's traceback, and the files that the import looked for.
        """
        found: set[Path] = set()
        while error is not None:
            found |= {Path(frame.filename) for frame in traceback.extract_tb(error.__traceback__)}
            if isinstance(error, SyntaxError) and error.filename:
                found.add(Path(error.filename))
            if isinstance(error, ModuleNotFoundError) and error.name:
                missing = [each.joinpath(*error.name.split(".")) for each in self._folders]
                found.update(each.with_name(f"{each.name}.py") for each in missing)
                found.update(each / "__init__.py" for each in missing)
            error = error.__cause__ or error.__context__
        return {file for file in found if self.has(file)}


def _file(module: ModuleType) -> Path | None:
    file = getattr(module, "__file__", None)
    return Path(file) if file else None


def _actions_of(target: Target) -> list[ActionDeclaration[..., object]]:
    module = _import_module(target)
    if not target.path:
        own = [each for each in _declared_in(module) if _is_own(each, module)]
        kinds = {type(each) for each in vars(module).values()}
        if not own and BackgroundDeclaration not in kinds:
            raise UsageError(_nothing_in(module, target))
        return own
    try:
        found = _look_up(module, target)
    except TurtleactError:
        raise
    except Exception as error:  # a property or a ``__getattr__`` of the user's fails
        problem = f"'{target.text}' cannot be looked up: {summary(error)}"
        raise TurtleactError(f"{_place_of(error)}: {problem}") from None
    if not isinstance(found, ActionDeclaration):
        problem = f"is of type {type(found).__name__}, not an action; see turtleact.action"
        raise UsageError(f"'{target.text}' {problem}{_actions_there(module)}")
    return [found]


def _declared_in(module: ModuleType) -> list[ActionDeclaration[..., object]]:
    return [each for each in vars(module).values() if isinstance(each, ActionDeclaration)]


def _is_own(action: ActionDeclaration[..., object], module: ModuleType) -> bool:
    return action.execute.__module__ == module.__name__


def _nothing_in(module: ModuleType, target: Target) -> str:
    """Explain why a module has nothing to serve, and what to do about it."""
    what = f"module '{target.module}'" if target.file is None else f"'{target.text}'"
    if _file(module) is None and hasattr(module, "__path__"):
        return f"{what} is a folder: {_files_to_name(Path(*target.module.split('.')))}"
    if imported := [each.execute.__module__ for each in _declared_in(module)]:
        others = ", ".join(dict.fromkeys(imported))
        return f"{what} declares no action, but imports some: serve {others}"
    functions = [
        name
        for name, each in vars(module).items()
        if callable(each) and getattr(each, "__module__", "") == module.__name__
    ]
    shown = f" (its functions: {', '.join(functions)})" if functions else ""
    problem = f"{what} declares no action: put @turtleact.action(TYPE, NAME) above a body{shown}"
    if target.file is None:
        return problem
    return f"{problem}, or run it as a program: turtleact run {target.text}"


def _look_up(module: ModuleType, target: Target) -> object:
    """The object at a dotted path in a module."""
    found: object = module
    for attribute in target.path.split("."):
        if not hasattr(found, attribute):
            actions = [
                name for name, each in _members(found) if isinstance(each, ActionDeclaration)
            ]
            names = actions or [name for name, _ in _members(found)]
            raise UsageError(
                f"'{target.text}': no {attribute} is there{names_like(attribute, names)}"
            )
        found = getattr(found, attribute)
    return found


def _members(found: object) -> Iterable[tuple[str, object]]:
    """The names and values of an object's public attributes. Properties are not evaluated."""
    members = getattr(found, "__dict__", {})
    return [(name, each) for name, each in members.items() if not name.startswith("_")]


def _actions_there(module: ModuleType) -> str:
    names = [each.execute.__name__ for each in _declared_in(module)]
    return f" (there are: {', '.join(names)})" if names else ""


def _import_module(target: Target) -> ModuleType:
    for folder in map(str, (Path.cwd(), target.folder)):
        if folder not in sys.path:
            sys.path.insert(0, folder)
    name = target.module
    try:
        with _programs_skipped():
            module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and f"{name}.".startswith(f"{error.name}."):
            missing = _no_module(error.name) if target.file is None else _no_file(target.file)
            raise UsageError(missing) from error
        raise _import_error(target, error) from error
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:
        raise _import_error(target, error) from error
    if target.file is not None and not _is_same_file(_file(module), target.file):
        problem = f"another module has its name ({_file(module) or 'a part of Python'})"
        raise UsageError(f"'{target.text}' cannot be imported: {problem}; rename the file")
    return module


@contextmanager
def _programs_skipped() -> Iterator[None]:
    """During a block, make ``asyncio.run`` and ``anyio.run`` log a warning and do nothing else.

    A file with actions often ends with ``asyncio.run(main())``. Without this function, importing
    the file would start ``main``, which might never return.
    """
    is_importing = True

    def skipping(run: Callable[..., object]) -> Callable[..., object]:
        @wraps(run)
        def skip(main: object, *args: object, **options: object) -> object:
            if not is_importing:  # a module may have imported this function by name
                return run(main, *args, **options)
            if iscoroutine(main):
                main.close()  # else Python warns that nobody has awaited it
            caller = traceback.extract_stack(limit=2)[0]
            logger.warning(
                "%s:%s: the program is skipped, because serve runs the actions itself; put "
                "it below 'if __name__ == \"__main__\":'",
                _nearby(caller.filename),
                caller.lineno,
            )
            return None

        return skip

    before = {module: module.run for module in (asyncio, anyio)}
    for module, run in before.items():
        setattr(module, "run", skipping(run))  # noqa: B010  # mypy allows no assignment
    try:
        yield
    finally:
        is_importing = False
        for module, run in before.items():
            setattr(module, "run", run)  # noqa: B010  # as above


def _is_same_file(one: Path | None, other: Path) -> bool:
    return one is not None and one.samefile(other)


def _no_module(missing: str) -> str:
    """Return the error text for a missing module.

    The text suggests a module with a similar name in the working directory.
    """
    here = [path.stem for path in Path().glob("*.py")]
    here += [path.parent.name for path in Path().glob("*/__init__.py")]
    hint = "" if "." in missing or not here else names_like(missing, here)
    return f"there is no module '{missing}' here, or on the path{hint}"


def _no_file(file: Path) -> str:
    """Return the error text for a file that has been removed since the target was parsed."""
    return f"there is no file '{_nearby(str(file))}' any more"


def _import_error(target: Target, error: BaseException) -> TurtleactError:
    """The error for a module whose import fails, with the file and line in the user's code."""
    where = _place_of(error)
    if isinstance(error, TurtleactError):  # it says what is wrong
        return TurtleactError(f"{where}: {error}")
    what = f"SyntaxError: {error.msg}" if isinstance(error, SyntaxError) else summary(error)
    if hint := syntax_hint(error):
        what += f": {hint}"
    if isinstance(error, ModuleNotFoundError) and error.name == "rclpy":
        file = _nearby(str(target.file)) if target.file else f"{target.module.replace('.', '/')}.py"
        what += f"; to run a program with rclpy: turtleact run {file}"
    return TurtleactError(f"{where}: module '{target.module}' cannot be imported: {what}")


def _place_of(error: BaseException) -> str:
    """The file and line of the user's code that raised an error, such as ``lab.py:10``."""
    if isinstance(error, SyntaxError):
        return f"{_nearby(error.filename)}:{error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    outside = [each for each in frames if "importlib" not in each.filename]
    own = [each for each in outside if not Path(each.filename).is_relative_to(OURS)]
    last = (own or frames)[-1]
    return f"{_nearby(last.filename)}:{last.lineno}"


def _nearby(file: str | None) -> str:
    """Return the path of a file, relative to the working directory if the file is inside."""
    path = Path(str(file))
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)
