"""Builds the wheel and the sdist: ``python scripts/build_dist.py [FOLDER]`` (default: dist).

The script uses the build backend of its own environment. If there is none, it first installs the
backend into a new environment.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import tomllib
import venv
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).parents[1]


def build(python: Path, folder: Path) -> None:
    """Build the wheel and the sdist with the backend of a Python."""
    command: list[Path | str] = [
        python,
        "-m",
        "hatchling",
        "build",
        "-t",
        "sdist",
        "-t",
        "wheel",
        "-d",
        folder,
    ]
    subprocess.run(command, cwd=ROOT, check=True)  # noqa: S603


def with_backend(folder: Path) -> Path:
    """Make an environment with the build backend, and return its Python."""
    venv.create(folder, with_pip=True)
    python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    required = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["build-system"]
    install = [python, "-m", "pip", "install", "--quiet", *required["requires"]]
    subprocess.run(install, check=True)  # noqa: S603
    return python


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", default=ROOT / "dist", type=Path)
    folder = parser.parse_args().folder.resolve()
    if find_spec("hatchling") is not None:
        build(Path(sys.executable), folder)
        return
    with tempfile.TemporaryDirectory() as environment:
        build(with_backend(Path(environment)), folder)


if __name__ == "__main__":
    main()
