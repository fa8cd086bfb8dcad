"""Checks a wheel and an sdist: ``python scripts/check_dist.py [FOLDER] [--tag TAG]``.

Their metadata must match ``pyproject.toml``, and they must contain what users and packagers need.
With a tag, the version must be that of the tag, and ``CHANGELOG.md`` must have it.
"""

from __future__ import annotations

import argparse
import configparser
import re
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Iterator
from email import message_from_bytes
from email.message import Message
from pathlib import Path

ROOT = Path(__file__).parents[1]
IN_WHEEL = (
    "turtleact/__init__.py",
    "turtleact/py.typed",
    "turtleact/interfaces/standard/example_interfaces/action/Fibonacci.action",
    "turtleact/web/page/page.html",
    "turtleact/web/page/page.css",
    "turtleact/web/page/main.js",
)
IN_SDIST = ("LICENSE", "README.md", "pyproject.toml", "scripts/check_dist.py", "tests/conftest.py")


def problems_of(folder: Path, tag: str | None) -> Iterator[str]:
    """Yield what is wrong with the files in a folder."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    wheels, sdists = sorted(folder.glob("*.whl")), sorted(folder.glob("*.tar.gz"))
    if len(wheels) != 1 or len(sdists) != 1:
        yield f"{folder} holds {len(wheels)} wheels and {len(sdists)} sdists: one of each is needed"
        return
    yield from problems_of_wheel(wheels[0], project)
    yield from problems_of_sdist(sdists[0], project)
    if tag is not None:
        yield from problems_of_tag(tag, project["version"])


def problems_of_wheel(path: Path, project: dict[str, object]) -> Iterator[str]:
    """Yield what is wrong with a wheel."""
    info = f"{project['name']}-{project['version']}.dist-info"
    with zipfile.ZipFile(path) as wheel:
        names = set(wheel.namelist())
        missing = {*IN_WHEEL, f"{info}/METADATA", f"{info}/licenses/LICENSE"} - names
        strange = {each for each in names if not each.startswith(("turtleact/", f"{info}/"))}
        if missing or strange:
            yield f"{path.name} lacks {sorted(missing)} and has {sorted(strange)} besides"
            return
        yield from problems_of_metadata(message_from_bytes(wheel.read(f"{info}/METADATA")), project)
        commands = configparser.ConfigParser()
        commands.read_string(wheel.read(f"{info}/entry_points.txt").decode())
    if dict(commands["console_scripts"]) != project["scripts"]:
        yield f"{path.name} has other commands than pyproject.toml"
    if "py3-none-any" not in path.name:
        yield f"{path.name} does not fit every system"


def problems_of_sdist(path: Path, project: dict[str, object]) -> Iterator[str]:
    """Yield what is wrong with an sdist."""
    root = f"{project['name']}-{project['version']}"
    with tarfile.open(path) as sdist:
        names = set(sdist.getnames())
    if missing := {f"{root}/{each}" for each in IN_SDIST} - names:
        yield f"{path.name} lacks {sorted(missing)}"


def problems_of_metadata(metadata: Message, project: dict[str, object]) -> Iterator[str]:
    """Yield the differences of the metadata from ``pyproject.toml``."""
    expected = {
        "Name": project["name"],
        "Version": project["version"],
        "Summary": project["description"],
        "License-Expression": project["license"],
        "Requires-Python": project["requires-python"],
        "Description-Content-Type": "text/markdown",
    }
    for name, value in expected.items():
        if metadata[name] != value:
            yield f"METADATA: {name} is {metadata[name]!r}, not {value!r}"
    if metadata.get_all("Classifier") != project["classifiers"]:
        yield "METADATA: the classifiers differ from pyproject.toml"
    if metadata.get_payload(decode=True) != (ROOT / "README.md").read_bytes():
        yield "METADATA: the description is not README.md"
    extras = project["optional-dependencies"]
    if set(metadata.get_all("Provides-Extra") or ()) != set(
        extras if isinstance(extras, dict) else ()
    ):
        yield "METADATA: the extras differ from pyproject.toml"
    if any("@" in each for each in metadata.get_all("Requires-Dist") or ()):
        yield "METADATA: a dependency is named by its address"


def problems_of_tag(tag: str, version: str) -> Iterator[str]:
    """Yield what is wrong with releasing a version under a tag."""
    if tag != f"v{version}":
        yield f"the tag is {tag!r}, but the version is {version}: expected 'v{version}'"
    changes = (ROOT / "CHANGELOG.md").read_text("utf-8")
    if not re.search(rf"^## \[{re.escape(version)}\]", changes, re.MULTILINE):
        yield f"CHANGELOG.md has no section [{version}]"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", default=ROOT / "dist", type=Path)
    parser.add_argument("--tag")
    arguments = parser.parse_args()
    problems = list(problems_of(arguments.folder, arguments.tag))
    for problem in problems:
        print(f"check_dist: {problem}", file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
