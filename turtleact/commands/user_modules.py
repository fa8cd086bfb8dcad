"""Finds what ``serve`` serves: the user's modules, and the actions and parameters in them.

A target is a module (``lab``, ``lab.robot``), a file (``lab.py``, ``./src/lab.py``), or one object
in a module or file (``lab:fibonacci``, ``lab.py:fibonacci``). To import a file as a module, the
folder of the file is put at the beginning of ``sys.path``. For a file in a package, the folder that
contains the package is put there instead.

`Modules` also tells which files are the user's own, because ``serve --reload`` watches these.
"""

from __future__ import annotations

import asyncio
import importlib
import os
import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from turtleact.commands.programs import nearby, place_of
from turtleact.errors import TurtleactError, UsageError, summary, syntax_hint
from turtleact.goals.body import ActionDeclaration, BackgroundDeclaration
from turtleact.interfaces.definition import did_you_mean, names_like
from turtleact.node.parameter_rules import ParameterDeclaration

__all__ = ["Found", "Modules", "Target", "read_target"]

OURS = Path(__file__).parents[1]
"""The folder of turtleact's own modules."""


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

        The user's own files are in the folder of a target, but neither in site-packages nor in
        turtleact itself.
        """
        is_installed = not {"site-packages", "dist-packages"}.isdisjoint(file.parts)
        if is_installed or file.is_relative_to(OURS):
            return False
        return any(file.is_relative_to(folder) for folder in self._folders)


def _file(module: ModuleType) -> Path | None:
    file = getattr(module, "__file__", None)
    return Path(file) if file else None


def _actions_of(target: Target) -> list[ActionDeclaration[..., object]]:
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
