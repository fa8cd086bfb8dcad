"""Checks of what users pass to the methods of a node."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import get_args

from turtleact.body import ActionDeclaration, ServerOptions
from turtleact.errors import InvalidOption
from turtleact.node.conflicts import OnConflict

__all__ = ["check_declaration", "check_server_options", "expect"]


def expect(kind: type, given: object) -> None:
    """Raise TypeError unless an object is a subclass of ``kind``."""
    if not (isinstance(given, type) and issubclass(given, kind)):
        raise TypeError(f"expected a subclass of turtleact.{kind.__name__}, not {_named(given)}")


def check_declaration(given: object) -> None:
    """Raise TypeError unless an object was made by `turtleact.action`."""
    if not isinstance(given, ActionDeclaration):
        if inspect.iscoroutine(given) or inspect.isasyncgen(given):
            problem = "was called already: pass the function itself, without ()"
        else:
            problem = "is no action: declare it with @turtleact.action"
        raise TypeError(f"{_named(given)} {problem}")


def check_server_options(options: Mapping[str, object], on_conflict: str) -> None:
    """Check that the options of an action server exist; `check_options` checks their values.

    Raises:
        InvalidOption: if the value of ``on_conflict`` is not allowed.
        TypeError: if an option does not exist.
    """
    for unknown in options.keys() - ServerOptions.__annotations__.keys():
        raise TypeError(f"an action server has no option '{unknown}'")
    if on_conflict not in get_args(OnConflict):
        words = ", ".join(get_args(OnConflict))
        raise InvalidOption("on_conflict", f"expected one of {words}, not {on_conflict!r}")


def _named(given: object) -> str:
    return getattr(given, "__qualname__", "") or repr(given)
