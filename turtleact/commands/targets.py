"""What ``serve`` is told to serve: ``module:object`` or ``module``, as Python declares it.

Source: the notation of ``importlib.metadata.EntryPoint``, and of ASGI servers.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
import traceback
from pathlib import Path
from types import ModuleType

from turtleact.body import ActionDeclaration
from turtleact.errors import TurtleactError, UsageError
from turtleact.interfaces.definition import did_you_mean
from turtleact.summaries import summary

__all__ = ["find_actions"]

OURS = str(Path(__file__).parents[1]) + os.sep
"""Where our own modules are."""


def find_actions(target: str) -> list[ActionDeclaration[..., object]]:
    """The actions that a target means, in the order of their declaration.

    Modules are looked for in the working directory first, as by ``python -m``.

    Args:
        target: ``module:object`` for one action, ``module`` for all that are declared in it.

    Raises:
        UsageError: if it means none; the text says why.
        TurtleactError: if the module fails when it is imported; the text names the line.
    """
    name, separator, path = target.partition(":")
    if not all(part.isidentifier() for part in name.split(".")) or (separator and not path):
        raise UsageError(f"'{target}' is not a target such as lab or lab.robot:drive")
    module = _import(name)
    if not separator:
        declared = [each for each in vars(module).values() if isinstance(each, ActionDeclaration)]
        own = [each for each in declared if each.execute.__module__ == module.__name__]
        if not own:
            raise UsageError(f"module '{name}' declares no action; see turtleact.action")
        return own
    try:
        found = _look_up(module, path, target)
    except TurtleactError:
        raise
    except Exception as error:  # a property or a ``__getattr__`` of the user's fails
        problem = f"'{target}' cannot be looked up: {summary(error)}"
        raise TurtleactError(f"{problem} ({_place_of(error)})") from None
    if not isinstance(found, ActionDeclaration):
        problem = f"is of type {type(found).__name__}, not an action; see turtleact.action"
        raise UsageError(f"'{target}' {problem}")
    return [found]


def _look_up(module: ModuleType, path: str, target: str) -> object:
    """The object at a dotted path in a module."""
    found: object = module
    for attribute in path.split("."):
        if not hasattr(found, attribute):
            names = [each for each in dir(found) if not each.startswith("_")]
            raise UsageError(f"'{target}': no {attribute} is there{did_you_mean(attribute, names)}")
        found = getattr(found, attribute)
    return found


def _import(name: str) -> ModuleType:
    here = os.getcwd()  # noqa: PTH109  # as it is, a Path would resolve nothing
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and f"{name}.".startswith(f"{error.name}."):
            raise UsageError(f"there is no module '{error.name}' here, or on the path") from None
        raise _failed(name, error) from None
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:
        raise _failed(name, error) from None


def _failed(name: str, error: BaseException) -> TurtleactError:
    """The error to raise when a module fails, with the place in the user's own file."""
    where = _place_of(error)
    if isinstance(error, TurtleactError):  # it says what is wrong
        return TurtleactError(f"{where}: {error}")
    return TurtleactError(f"module '{name}' cannot be imported: {summary(error)} ({where})")


def _place_of(error: BaseException) -> str:
    """Where in the user's own files an error was raised."""
    if isinstance(error, SyntaxError):
        return f"{error.filename}, line {error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    outside = [each for each in frames if "importlib" not in each.filename]
    own = [each for each in outside if not each.filename.startswith(OURS)]
    last = (own or frames)[-1]
    return f"{last.filename}, line {last.lineno}"
