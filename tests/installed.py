"""Runs a program as if only some distributions were installed.

``python installed.py HIDDEN SCRIPT ARGUMENT…`` runs a script and lets the import of each module
fail that is named in ``HIDDEN``, between commas.
"""

from __future__ import annotations

import re
import runpy
import sys
import tomllib
from functools import cache
from importlib.abc import MetaPathFinder
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


def only(names: list[str], *options: str, script: str | Path) -> list[str]:
    """The command that runs a script with some distributions and what they depend on."""
    allowed = set[str]()
    for name in names:
        add_with_dependencies(name, frozenset(), allowed)
    hidden = [
        module
        for module, distributions in modules().items()
        if not allowed.intersection(map(normal, distributions))
    ]
    return [sys.executable, *options, __file__, ",".join(hidden), str(script)]


def add_with_dependencies(name: str, extras: frozenset[str], allowed: set[str]) -> None:
    """Add a distribution, and all it depends on."""
    from packaging.requirements import Requirement

    if normal(name) in allowed and not extras:
        return
    allowed.add(normal(name))
    try:
        # The metadata of an editable turtleact may be old.
        needed = PROJECT["dependencies"] if name == "turtleact" else requires(name) or ()
    except PackageNotFoundError:  # for another system or Python
        return
    for requirement in map(Requirement, needed):
        asked = [{"extra": extra} for extra in extras] or [{"extra": ""}]
        if requirement.marker is None or any(map(requirement.marker.evaluate, asked)):
            add_with_dependencies(requirement.name, frozenset(requirement.extras), allowed)


@cache
def modules() -> dict[str, list[str]]:
    """The top-level modules that are installed, and the distributions they come from."""
    return {name: each for name, each in packages_distributions().items() if name.isidentifier()}


def normal(name: str) -> str:
    """The one spelling of a distribution's name."""
    return re.sub(r"[-_.]+", "-", name).lower()


class Hidden(MetaPathFinder):
    """Lets the import of some modules fail; None in `sys.modules` would say they are imported."""

    def find_spec(self, name: str, *_: object) -> None:
        if name in HIDDEN:
            raise ModuleNotFoundError(f"No module named '{name}'", name=name)


if __name__ == "__main__":
    HIDDEN = frozenset(sys.argv[1].split(","))
    sys.meta_path.insert(0, Hidden())
    for name in [each for each in sys.modules if each.partition(".")[0] in HIDDEN]:
        del sys.modules[name]  # the one that forked this process has imported it
    sys.argv = sys.argv[2:]
    sys.path[0] = str(Path(sys.argv[0]).parent)
    runpy.run_path(sys.argv[0], run_name="__main__")
