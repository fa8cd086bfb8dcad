"""What a user installs: the dependencies, the wheel, the commands that pages and messages show."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]

# --- what is imported ---------------------------------------------------------------------------


def test_the_extra_web_is_empty_so_that_old_requirements_resolve():
    assert PROJECT["optional-dependencies"]["web"] == []


# --- what pages and examples tell users to install ----------------------------------------------

SOURCES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *(ROOT / "docs").glob("*.md"),
    *(ROOT / "examples").glob("*.py"),
    *(ROOT / "turtleact").rglob("*.py"),
    ROOT / "scripts" / "check",
]
TEXTS = {path: path.read_text("utf-8") for path in SOURCES}
INSTALLS = sorted(
    {
        found.strip()
        for text in TEXTS.values()
        for found in re.findall(r"\b((?:pip install|pipx|uvx) [^`'\n&]*(?:'[^'\n]*')?)", text)
    }
)
PUBLISHED = ["pip install turtleact", "pipx install turtleact", "uvx turtleact serve"]
PUBLISHED += ["pip install 'turtleact[bag]'", "pip install 'turtleact[mcp]'"]
PUBLISHED += ["pip install 'turtleact[otel-export]'"]
OF_CLIENTS = ["uvx --from 'turtleact[mcp]'"]
"""Lines of configuration; the paragraph before them says what to write until then."""


def test_there_is_a_way_for_pip_pipx_and_uvx():
    assert {line.partition(" ")[0] for line in INSTALLS} == {"pip", "pipx", "uvx"}
    assert {"pip install .", "pipx install .", "uvx --from . turtleact serve"} <= set(INSTALLS)


OF_A_READER = ["pip install -e my_robot"]  # what `turtleact pkg create my_robot` has made
OFFLINE = ["--dry-run", "--no-index", "--no-deps", "--no-build-isolation", "--quiet"]


def test_what_is_to_be_installed_is_the_checkout_or_exists():
    """pip resolves it; without a network, what is not the checkout must be here already."""
    extras, others = set[str](), set[str]()
    for line in set(INSTALLS) - {*PUBLISHED, *OF_A_READER, *OF_CLIENTS}:
        tool, *arguments = shlex.split(line)
        if tool != "pip":
            assert arguments in (["install", "."], ["--from", ".", "turtleact", "serve"])
            continue
        # -e would need one more build requirement, which only a network brings
        for argument in {*arguments} - {"install", "-e", "."}:
            named = re.fullmatch(r"\.\[(.+)\]", argument)
            (extras if named else others).add(named[1] if named else argument)
    command = ["install", f".[{','.join(sorted(extras))}]", *sorted(others), *OFFLINE]
    outcome = subprocess.run(
        [sys.executable, "-m", "pip", *command],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert outcome.returncode == 0, outcome.stderr
    assert extras <= {*PROJECT["optional-dependencies"]}  # of others, pip says nothing


@pytest.mark.parametrize("line", PUBLISHED)
def test_what_needs_a_release_says_so(line):
    """Move it to the others once turtleact is published."""
    for text in TEXTS.values():
        for paragraph in text.split("\n\n"):
            if re.search(rf"\b{re.escape(line)}", paragraph):
                assert "Once turtleact is published" in paragraph
