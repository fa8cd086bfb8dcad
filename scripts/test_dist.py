"""Tries a wheel in an empty environment: ``python scripts/test_dist.py [FOLDER]`` (default: dist).

``--tests`` then runs the tests of the sdist in the same folder against the installed wheel. All
further arguments are for pytest. ``--borrow`` installs no dependencies, and uses the packages of
the environment that runs this script. That is quick and needs no network.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = """
import asyncio, pathlib, sys, urllib.request
import turtleact, turtleact.web
from turtleact.interfaces import get_interface

async def main():
    async with turtleact.open_world() as node, turtleact.web.open_web(node, port=0) as web:
        with await asyncio.to_thread(urllib.request.urlopen, web.url) as page:
            assert b"</html>" in page.read()

assert pathlib.Path(sys.prefix).resolve() in pathlib.Path(turtleact.__file__).resolve().parents
assert get_interface("turtlesim/msg/Pose")
asyncio.run(main())
"""
GOAL = ["send-goal", "fibonacci", "order: 5", "--embedded", "--speed", "max"]


class Environment:
    """An environment with the wheel, and an empty folder to work in.

    Args:
        folder: Where to make both.
        borrows: Whether to use the packages of this environment.
    """

    def __init__(self, folder: Path, *, borrows: bool) -> None:
        self._borrows = borrows
        self.folder = folder / "work"
        self.folder.mkdir()
        venv.create(folder / "venv")
        where = {"base": str(folder / "venv"), "platbase": str(folder / "venv")}
        self._bin = Path(sysconfig.get_path("scripts", "venv", where))
        if borrows:
            others = [each for each in sys.path if Path(each).name == "site-packages"]
            library = Path(sysconfig.get_path("purelib", "venv", where))
            (library / "borrowed.pth").write_text("\n".join(others), "utf-8")

    def install(self, *requirements: str) -> None:
        """Install packages.

        If the environment borrows the others, install only the wheel itself.
        """
        offline = ["--no-index", "--no-deps", "--ignore-installed"] if self._borrows else []
        pip = [
            sys.executable,
            "-m",
            "pip",
            "--quiet",
            "--python",
            str(self._bin / "python"),
            "install",
        ]
        self._call([*pip, *offline, *requirements], self.folder)

    def run(self, *command: str) -> str:
        """Run a command that the wheel installed."""
        return self._call([str(self._bin / command[0]), *command[1:]], self.folder)

    def python(self, *arguments: str, folder: Path | None = None) -> str:
        """Run Python."""
        return self._call([str(self._bin / "python"), *arguments], folder or self.folder)

    def _call(self, command: list[str], folder: Path) -> str:
        kept = {each: os.environ[each] for each in os.environ if not each.startswith("PYTHON")}
        called = subprocess.run(  # noqa: S603
            command, cwd=folder, env=kept | {"PYTHONUTF8": "1"}, stdout=-1, text=True, check=False
        )
        print(called.stdout, end="", flush=True)
        if called.returncode:
            sys.exit(f"test_dist: exit status {called.returncode}: {' '.join(command)}")
        return called.stdout


def try_out(environment: Environment, version: str) -> None:
    """Run the command line, an action, and the page."""
    said = environment.run("turtleact", "--version")
    if version not in said:
        sys.exit(f"test_dist: expected version {version}: {said}")
    if "SUCCEEDED" not in environment.run("turtleact", *GOAL):
        sys.exit("test_dist: the goal did not succeed")
    environment.python("-W", "error", "-c", PAGE)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", default=ROOT / "dist", type=Path)
    parser.add_argument("--borrow", action="store_true")
    parser.add_argument("--tests", nargs=argparse.REMAINDER)
    arguments = parser.parse_args()
    wheel, sdist = (next(arguments.folder.resolve().glob(name)) for name in ("*.whl", "*.tar.gz"))
    with tempfile.TemporaryDirectory() as temporary:
        environment = Environment(Path(temporary), borrows=arguments.borrow)
        environment.install(str(wheel))
        try_out(environment, wheel.name.split("-")[1])
        if arguments.tests is not None:
            if not arguments.borrow:
                environment.install(f"{wheel}[test]", "pip")  # a test runs pip
            with tarfile.open(sdist) as archive:
                archive.extractall(temporary, filter="data")
            source = Path(temporary, sdist.name.removesuffix(".tar.gz"))
            # With -P, Python does not import turtleact from the working directory.
            environment.python("-P", "-m", "pytest", *arguments.tests, folder=source)


if __name__ == "__main__":
    main()
