"""What a user installs: the dependencies, the wheel, the commands that pages and messages show."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]

# --- what is imported ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def modules_of_the_front_door():
    code = "import sys, turtleact; print(*sys.modules)"
    return set(subprocess.check_output([sys.executable, "-c", code], text=True).split())


@pytest.mark.parametrize(
    "module", ["cbor2", "h11", "starlette", "turtleact.web", "uvicorn", "websockets"]
)
def test_the_front_door_imports_nothing_of_the_page(module, modules_of_the_front_door):
    assert module not in modules_of_the_front_door


def test_the_extra_web_is_empty_so_that_old_requirements_resolve():
    assert PROJECT["optional-dependencies"]["web"] == []
