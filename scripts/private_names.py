"""Finds the private names of other modules and packages: ``python scripts/private_names.py``.

A private name begins with one underscore. Only the file that defines it may import, read or write
it. Names of asyncio, anyio, uvloop, trio or zenoh may change with any release, and names of
turtleact with any commit. A method may also use private names of a base class in the package, on
``self`` or ``cls``. Text may name a private name on ``self`` only: ``getattr(loop, "_ready")`` does
not mean a name of the same file.

A name counts as used where the code imports it (``import _signal``, ``from x._y import z``), spells
it as an attribute (``loop._ready``), or gives it as text to a function that looks up attributes
(``getattr(loop, "_ready")``, ``monkeypatch.setattr(loop, "_ready", …)``). Looking into objects
through ``gc`` and ``ctypes.pythonapi`` counts as well. `DOCUMENTED` lists names that are public in
spite of their underscore. `ALLOWED` lists other exceptions.
"""

from __future__ import annotations

import ast
import functools
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

FOLDERS = ("turtleact", "tests", "benchmarks", "examples", "scripts")

ALLOWED: set[tuple[str, str]] = {
    # Whether a loop has callbacks ready; falls back to polling.
    ("turtleact/tasks/clock.py", "_ready"),
    # `AsyncioTasks.is_shielded`: `asyncio.Task.cancel` would break into a shielded scope of anyio,
    # and anyio has no public way to ask for one. Without the names, the cancellation arrives at
    # once.
    ("turtleact/tasks/event_loops.py", "_task_states"),
    ("turtleact/tasks/event_loops.py", "_parent_scope"),
    # Nothing private: `PyGILState_Ensure` is in Python's public C API. Zenoh's threads call it once
    # each. It is listed because `pythonapi` could also reach what is private.
    ("turtleact/transports/rmw_zenoh/session.py", "pythonapi"),
}
"""Pairs of a file and a name that the file may use in spite of the rules.

Such a name is only read and has a fallback. A test removes the name to prove that."""

DOCUMENTED = {
    *("_asdict", "_field_defaults", "_fields", "_make", "_replace"),  # collections.namedtuple
    *("_exit", "_getframe"),  # of os and sys
    "_thread",  # a module of the library reference
}

INSIDES = {"get_referents", "get_referrers", "pythonapi"}
"""Functions that reach the insides of objects without a name."""

LOOKUPS = {
    "attrgetter",
    "delattr",
    "getattr",
    "hasattr",
    "methodcaller",
    "object",
    "patch",
    "setattr",
}
"""The functions that take a name as text. ``object`` is that of ``mock.patch.object``."""

TEXT = "text"
"""Stands for the owner of a name that is given as text."""

PRIVATE = re.compile(r"_(?!_)\w*(?<!_)")  # not `__init__`, nor `_fields_` of ctypes and enum


class Use(NamedTuple):
    """A private name, and the line of the file that uses it."""

    file: str
    line: int
    name: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.name}"


def is_private(name: str) -> bool:
    return PRIVATE.fullmatch(name) is not None and name not in DOCUMENTED and name != "_"


def private_uses(root: Path) -> list[Use]:
    """Every use of a private name that the rules above forbid."""
    inherited = set().union(*map(names_defined, sorted((root / "turtleact").rglob("*.py"))))
    return [
        Use(file, line, name)
        for folder in FOLDERS
        for path in sorted((root / folder).rglob("*.py"))
        for file in [path.relative_to(root).as_posix()]
        for line, owner, name in sorted(names_used(parsed(path)))
        if not (owner != TEXT and name in names_defined(path))
        and not (owner in {"self", "cls"} and name in inherited)
        and (file, name) not in ALLOWED
    ]


@functools.cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text("utf-8"))


@functools.cache
def names_defined(path: Path) -> frozenset[str]:
    """The names that a file defines: functions, classes, variables, fields, ``self.x = …``."""
    return frozenset(
        name for node in ast.walk(parsed(path)) for name in defined_by(node) if is_private(name)
    )


def defined_by(node: ast.AST) -> Iterator[str]:
    match node:
        case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
            yield name
        case ast.Name(id=name, ctx=ast.Store()):
            yield name
        case ast.Attribute(value=ast.Name(id="self" | "cls"), attr=name, ctx=ast.Store()):
            yield name


def names_used(module: ast.Module) -> Iterator[tuple[int, str, str]]:
    """Yield the line, the owner if it is a plain name, and the private name of each use."""
    for node in ast.walk(module):
        if isinstance(node, ast.stmt | ast.expr):
            for owner, name in used_by(node):
                if is_private(name) or name in INSIDES:
                    yield node.lineno, owner, name


def used_by(node: ast.stmt | ast.expr) -> Iterator[tuple[str, str]]:
    match node:
        case ast.Import(names=aliases):
            yield from (("", part) for alias in aliases for part in alias.name.split("."))
        case ast.ImportFrom(module=origin, names=aliases):
            parts = (origin or "").split(".")
            yield from (("", part) for part in [*parts, *(alias.name for alias in aliases)])
        case ast.Attribute(value=ast.Name(id=owner), attr=name):
            yield owner, name
        case ast.Attribute(attr=name):
            yield "", name
        case ast.Call(func=ast.Name(id=function) | ast.Attribute(attr=function), args=arguments):
            if function in LOOKUPS:
                on_self = any(
                    isinstance(each, ast.Name) and each.id == "self" for each in arguments
                )
                owner = "self" if on_self else TEXT
                texts = [each.value for each in arguments if isinstance(each, ast.Constant)]
                names = [text for text in texts if isinstance(text, str)]
                yield from ((owner, part) for name in names for part in name.split("."))


def main() -> int:
    """Print the uses, one per line."""
    uses = private_uses(Path(__file__).parents[1])
    print(*uses, sep="\n", end="\n" if uses else "")
    print(f"{len(uses)} uses of private names" if uses else "no private names of other modules")
    return 1 if uses else 0


if __name__ == "__main__":
    sys.exit(main())
