"""The names that programs import from ``turtleact`` itself."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import turtleact
from turtleact import errors

from .tables import together

PAGE = Path(__file__).parent.parent / "docs" / "architecture.md"


def documented() -> list[str]:
    section = PAGE.read_text("utf-8").partition("## Public names\n")[2].partition("\n## ")[0]
    rows = [line.split("|")[2] for line in section.splitlines() if line.startswith("|")]
    return [name for row in rows for name in re.findall(r"`(\w+)`", row)]


def run(code: str) -> list[str]:
    ran = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return ran.stdout.split()


@together
@pytest.mark.parametrize("name", turtleact.__all__)
def test_a_public_name_can_be_imported(name):
    assert getattr(turtleact, name).__module__.startswith("turtleact.") or name == "Event"


def test_the_page_lists_all_public_names():
    assert documented() == turtleact.__all__


def test_dir_lists_all_public_names():
    assert set(turtleact.__all__) <= set(dir(turtleact))


def test_all_errors_are_public():
    assert set(errors.__all__) <= set(turtleact.__all__)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'Nod'"):
        _ = turtleact.Nod


@pytest.mark.parametrize("code", ["import turtleact", "import turtleact; dir(turtleact)"])
def test_an_import_brings_nothing_that_takes_long(code):
    heavy = {"anyio", "asyncio", "msgspec", "numpy", "rich", "typer", "typing", "yaml", "zenoh"}
    before = set(run("import sys; print(*sys.modules)"))
    assert not (set(run(f"import sys; {code}; print(*sys.modules)")) - before) & heavy
