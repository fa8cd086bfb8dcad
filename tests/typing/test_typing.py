"""Type checkers take what is right in `good.py`, and refuse the marked lines of `bad_*.py`."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
FILES = sorted(HERE.glob("good*.py")) + sorted(HERE.glob("bad_*.py"))

pytestmark = pytest.mark.timeout(300)


def marked(file: Path) -> list[int]:
    lines = file.read_text().splitlines()
    return [number for number, line in enumerate(lines, 1) if line.endswith("# error")]


@pytest.fixture(scope="module")
def mypy() -> dict[str, list[int]]:
    """The lines in which mypy finds an error, by file name."""
    pytest.importorskip("mypy")
    command = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary", *map(str, FILES)]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    found: dict[str, set[int]] = {file.name: set() for file in FILES}
    for path, line in re.findall(r"^(\S+):(\d+): error", ran.stdout, re.MULTILINE):
        found[Path(path).name].add(int(line))
    assert ran.returncode in (0, 1), ran.stdout + ran.stderr
    return {name: sorted(lines) for name, lines in found.items()}


@pytest.fixture(scope="module")
def pyright(tmp_path_factory) -> dict[str, list[int]]:
    """The same of pyright, from the wheel that brings its own node."""
    pytest.importorskip("basedpyright")
    config = tmp_path_factory.mktemp("pyright") / "pyrightconfig.json"
    settings = {
        "typeCheckingMode": "strict",
        "include": [str(HERE)],
        "extraPaths": [str(ROOT)],
        "reportUnusedFunction": False,
    }
    config.write_text(json.dumps(settings))
    python = ["--pythonpath", sys.executable]
    command = [sys.executable, "-m", "basedpyright", "--outputjson", "-p", str(config), *python]
    ran = subprocess.run(command, capture_output=True, text=True)
    found: dict[str, set[int]] = {file.name: set() for file in FILES}
    for each in json.loads(ran.stdout)["generalDiagnostics"]:
        name = Path(each["file"]).name
        if each["severity"] == "error" and name in found:
            found[name].add(each["range"]["start"]["line"] + 1)
    return {name: sorted(lines) for name, lines in found.items()}


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_mypy_finds_the_marked_lines(mypy, file):
    assert mypy[file.name] == marked(file)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_pyright_finds_the_marked_lines(pyright, file):
    assert pyright[file.name] == marked(file)
