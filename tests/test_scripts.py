"""The scripts that check and count the source: each on a small package made for the test."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[1] / "scripts"
PRIVATE_NAMES = runpy.run_path(str(SCRIPTS / "private_names.py"))
COUNT = runpy.run_path(str(SCRIPTS / "count.py"))


# --- private names ----------------------------------------------------------------------------

ALLOWED = [
    "class A:\n    def __init__(self): self._x = 1\n    def same(self, other): return other._x",
    "class A(Base):\n    def read(self): return self._inherited",
    "row._replace(x=1)",
    "import os; os._exit(1)",
    "enum._missing_",
    "from __future__ import annotations",
    "class A:\n    def f(self): self._x = 1; return getattr(self, '_x')",
    "for _ in range(3): print('_text')",
]
FORBIDDEN = [
    ("import _signal", "_signal"),
    ("from anyio._backends import x", "_backends"),
    ("from anyio import _core", "_core"),
    ("import asyncio\nasyncio.tasks._current_tasks", "_current_tasks"),
    ("loop._ready.append(1)", "_ready"),
    ("task._must_cancel = True", "_must_cancel"),
    ("class Loop(asyncio.SelectorEventLoop):\n    def f(self): return self._ready", "_ready"),
    ("other._inherited", "_inherited"),
    ("getattr(loop, '_ready', None)", "_ready"),
    ("self._ready = 1\ngetattr(loop, '_ready', None)", "_ready"),
    ("monkeypatch.setattr(node, '_wall', 0)", "_wall"),
    ("monkeypatch.setattr('anyio._core.x', 0)", "_core"),
    ("import gc; gc.get_referents(loop)", "get_referents"),
    ("from ctypes import pythonapi", "pythonapi"),
]


@pytest.fixture
def uses(tmp_path):
    """The private names used by a tree that has this code in one of its folders, as text."""

    def find(code: str, folder: str = "turtleact") -> list[str]:
        for name in {"turtleact", folder}:
            (tmp_path / name).mkdir()
        (tmp_path / "turtleact" / "base.py").write_text(
            "class Base:\n    def __init__(self): self._inherited = 1", "utf-8"
        )
        (tmp_path / folder / "planted.py").write_text(code, "utf-8")
        return [str(use) for use in PRIVATE_NAMES["private_uses"](tmp_path)]

    return find


@pytest.mark.parametrize("code", ALLOWED)
def test_a_file_may_use_what_it_defines_or_inherits(uses, code):
    assert uses(code) == []


@pytest.mark.parametrize(("code", "name"), FORBIDDEN)
def test_a_private_name_from_elsewhere_is_found_with_its_line(uses, code, name):
    assert uses(code) == [f"turtleact/planted.py:{len(code.splitlines())}: {name}"]


@pytest.mark.parametrize("folder", ["tests", "benchmarks", "examples", "scripts"])
def test_every_folder_with_code_is_checked(uses, folder):
    assert uses("loop._ready", folder) == [f"{folder}/planted.py:1: _ready"]


# --- counting ---------------------------------------------------------------------------------


def test_no_modules_of_turtleact_import_each_other():
    cycles = COUNT["cycles_of"](COUNT["modules_of"](SCRIPTS.parent / "turtleact"))
    assert (cycles.run_time, cycles.typing) == ([], [])
