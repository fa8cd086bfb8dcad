"""Measures the structure of a package: ``python scripts/count.py [PACKAGE]``.

The script prints one table. All figures are about the package's ``.py`` files. Generated modules,
which say "generated" in a comment on their first line, are left out. The definitions:

- A code line holds code: it is not blank, no comment, and no string that stands alone, such as a
  docstring. The length of a module is the number of all its lines. The length of a function is the
  number of its code lines from ``def`` to its end. Inner functions are included, and also count by
  themselves.
- A small module has under 60 code lines. ``__init__.py`` is never counted as small.
- The complexity of a function is McCabe's: one, and one more for each ``if``, loop, ``except``,
  ``case``, ``assert``, each ``for`` and ``if`` of a comprehension, and each further operand of
  ``and`` and ``or``.
- Every ``#`` counts as a comment, even behind code.
- All classes and functions without a leading underscore are public, wherever they are defined.
- Tests to source is the ratio of all lines of ``tests`` beside the package to the package's.
- A cycle is a largest group of modules that import each other, directly or not. "Run time" counts
  imports while modules are loaded. "With typing" counts every import statement, including those for
  the type checker and inside functions. A package's ``__init__.py`` counts as a module of its own.
"""

from __future__ import annotations

import ast
import io
import statistics
import sys
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import NamedTuple

SMALL = 60
NO_CODE = {
    *(tokenize.COMMENT, tokenize.ENDMARKER, tokenize.INDENT, tokenize.DEDENT),
    *(tokenize.NEWLINE, tokenize.NL),
}
BRANCHES = (
    *(ast.If, ast.IfExp, ast.For, ast.AsyncFor, ast.While),
    *(ast.ExceptHandler, ast.match_case, ast.Assert),
)
Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Module:
    """One file of the package that has been read."""

    name: str
    path: Path
    text: str
    tree: ast.Module

    @property
    def length(self) -> int:
        """How many lines the file has."""
        return len(self.text.splitlines())

    @cached_property
    def tokens(self) -> list[tokenize.TokenInfo]:
        """The tokens of the file."""
        return list(tokenize.generate_tokens(io.StringIO(self.text).readline))

    @cached_property
    def code(self) -> frozenset[int]:
        """The numbers of its code lines."""
        lines = {
            line
            for token in self.tokens
            if token.type not in NO_CODE
            for line in range(token.start[0], token.end[0] + 1)
        }
        return frozenset(lines - text_lines(self.tree))

    @property
    def comments(self) -> int:
        """How many comments the file has."""
        return sum(token.type == tokenize.COMMENT for token in self.tokens)

    @property
    def is_package(self) -> bool:
        """Whether it is the ``__init__.py`` of a package."""
        return self.path.name == "__init__.py"


class Cycles(NamedTuple):
    """Groups of modules that import each other."""

    run_time: list[list[str]]
    typing: list[list[str]]


# --- reading ----------------------------------------------------------------------------------


def modules_of(package: Path) -> list[Module]:
    """Every module of a package that is not generated."""
    found = [read(path, package) for path in sorted(package.rglob("*.py"))]
    return [module for module in found if module is not None]


def read(path: Path, package: Path) -> Module | None:
    text = path.read_text("utf-8")
    first = text.partition("\n")[0]
    if first.startswith("#") and "generated" in first.lower():
        return None
    parts = path.relative_to(package.parent).with_suffix("").parts
    name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
    return Module(name, path, text, ast.parse(text))


def text_lines(tree: ast.Module) -> set[int]:
    """The lines of the strings that stand alone."""
    return {
        line
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
        for line in lines_of(node)
    }


def lines_of(node: ast.stmt) -> range:
    return range(node.lineno, (node.end_lineno or node.lineno) + 1)


# --- functions --------------------------------------------------------------------------------


def functions_of(module: Module) -> list[Function]:
    return [node for node in ast.walk(module.tree) if isinstance(node, Function)]


def complexity(function: Function) -> int:
    return 1 + sum(map(branches, ast.walk(function)))


def branches(node: ast.AST) -> int:
    match node:
        case ast.BoolOp(values=values):
            return len(values) - 1
        case ast.comprehension(ifs=conditions):
            return 1 + len(conditions)
        case _:
            return isinstance(node, BRANCHES)


def documented(module: Module) -> list[bool]:
    """For each public class and function, whether it has a docstring."""
    return [
        ast.get_docstring(node) is not None
        for node in ast.walk(module.tree)
        if isinstance(node, ast.ClassDef | Function) and not node.name.startswith("_")
    ]


# --- cycles -----------------------------------------------------------------------------------


def cycles_of(modules: list[Module]) -> Cycles:
    """The groups of modules that import each other, each sorted."""
    names = {module.name for module in modules}
    loaded = {module.name: set(imports(module, names, loaded=True)) for module in modules}
    stated = {module.name: set(imports(module, names, loaded=False)) for module in modules}
    return Cycles(groups(loaded), groups(stated))


def imports(module: Module, names: set[str], *, loaded: bool) -> Iterator[str]:
    """The modules that a module imports while it is loaded, or at any time."""
    for node in statements(module.tree, loaded=loaded):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in names)
        else:
            base = origin(module, node)
            for alias in node.names:
                inner = f"{base}.{alias.name}"
                if inner in names or base in names:
                    yield inner if inner in names else base


def statements(node: ast.AST, *, loaded: bool) -> Iterator[ast.Import | ast.ImportFrom]:
    """The imports below a node.

    With ``loaded``, only imports that run when the module is loaded.
    """
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child
        elif isinstance(child, ast.expr) or (loaded and isinstance(child, Function)):
            continue
        elif loaded and isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            yield from (each for other in child.orelse for each in statements(other, loaded=True))
        else:
            yield from statements(child, loaded=loaded)


def origin(module: Module, node: ast.ImportFrom) -> str:
    """The full name of the module between ``from`` and ``import``."""
    if not node.level:
        return node.module or ""
    parts = module.name.split(".")
    up = node.level - module.is_package
    return ".".join([*parts[: len(parts) - up], *([node.module] if node.module else [])])


def groups(graph: dict[str, set[str]]) -> list[list[str]]:
    """The strongly connected components of more than one node (Tarjan, 1972)."""
    order = count()
    index: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = lowest[node] = next(order)
        stack.append(node)
        for other in sorted(graph[node] - {node}):
            if other not in index:
                visit(other)
            if other in stack:
                lowest[node] = min(lowest[node], lowest[other])
        if lowest[node] == index[node]:
            start = stack.index(node)
            if len(stack) - start > 1:
                found.append(sorted(stack[start:]))
            del stack[start:]

    for node in graph:
        if node not in index:
            visit(node)
    return sorted(found)


# --- the table --------------------------------------------------------------------------------


def table(package: Path) -> list[tuple[str, str]]:
    """The rows of the table: what was counted, and the figures."""
    modules = modules_of(package)
    functions = [(module, each) for module in modules for each in functions_of(module)]
    lengths = sorted(len(module.code.intersection(lines_of(each))) for module, each in functions)
    branching = [complexity(each) for _, each in functions]
    public = [has for module in modules for has in documented(module)]
    code = sum(len(module.code) for module in modules)
    small = sum(len(module.code) < SMALL and not module.is_package for module in modules)
    sizes = [module.length for module in modules]
    comments = sum(module.comments for module in modules)
    tests = sum(
        len(path.read_text("utf-8").splitlines())
        for path in (package.parent / "tests").rglob("*.py")
    )
    run_time, typing = map(len, cycles_of(modules))
    p90 = lengths[int(len(lengths) * 0.9)]
    return [
        ("code lines", f"{code:,}"),
        (f"modules; under {SMALL} code lines", f"{len(modules)}; {small}"),
        ("module lines, median / max", f"{statistics.median(sizes):g} / {max(sizes)}"),
        (
            "function lines, median / p90 / max",
            f"{statistics.median(lengths):g} / {p90} / {lengths[-1]}",
        ),
        ("complexity, mean / max", f"{statistics.mean(branching):.1f} / {max(branching)}"),
        ("comments per 100 code lines", f"{100 * comments / code:.1f}"),
        ("public with docstring", f"{100 * sum(public) / len(public):.1f} %"),
        ("tests : source", f"{tests / sum(sizes):.2f}"),
        ("import cycles, run time / with typing", f"{run_time} / {typing}"),
    ]


def main() -> None:
    """Print the table of the named package, or of turtleact, and its cycles below the table."""
    here = Path(__file__).resolve().parents[1] / "turtleact"
    package = Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else here
    for name, figures in table(package):
        print(f"{name:<40}{figures}")
    for cycle in cycles_of(modules_of(package)).typing:
        print("cycle:", *cycle)


if __name__ == "__main__":
    main()
