"""A Python that has rclpy, for the tests of this folder; they are left out where there is none.

``TURTLEACT_ROS`` names it, or asks for one: ``wheels`` makes a virtual environment in pytest's
cache and installs ``requirements.txt`` there, which takes half a minute and 300 MB; that is what CI
does. Nobody else gets it unasked.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent
REQUIREMENTS = HERE / "requirements.txt"
ASKED = os.environ.get("TURTLEACT_ROS") or ("wheels" if "CI" in os.environ else "")

INSTALLING = 120.0
"""How long an installation may take (s); the next run finds what pip has fetched."""

RUNNING = 40.0
"""How long one program of the peer may take (s)."""

NO_PEER = 77
"""The exit status of a program that does not find its own endpoints."""

FOUND: dict[str, str] = {}
"""The ``python`` to compare with, or ``missing``: why there is none."""


class Ros:
    """A Python that has rclpy.

    Attributes:
        prefixes: Where its packages are installed.
    """

    def __init__(self, python: str) -> None:
        self._python = python
        code = "import os, rclpy, sys; print(sys.prefix); print(os.getenv('AMENT_PREFIX_PATH', ''))"
        prefix, installed = self._output(["-c", code]).splitlines()
        self.prefixes = [Path(each) for each in [*installed.split(os.pathsep), prefix] if each]

    def run(self, program: str, asked: object = None) -> Any:
        """What a program of this folder makes of ``asked``, both as JSON.

        Raises:
            pytest.fail.Exception: if it fails; with what it said.
        """
        return json.loads(self._output([str(HERE / program)], json.dumps(asked)))

    def start(self, program: str) -> subprocess.Popen[str]:
        """Start a program of this folder that is asked on stdin and answers on stdout."""
        return subprocess.Popen(
            [self._python, str(HERE / program)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"},
        )

    def _output(self, arguments: list[str], text: str = "") -> str:
        done = subprocess.run(
            [self._python, *arguments],
            input=text,
            capture_output=True,
            text=True,
            timeout=RUNNING,
            check=False,
            env=os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"},  # nobody else is to be seen
        )
        if done.returncode == NO_PEER:
            FOUND["missing"] = "rclpy does not find its own endpoints on this machine"
            pytest.skip(FOUND["missing"])
        if done.returncode:
            pytest.fail(f"{self._python} {arguments[0]}: {done.stderr.strip()}")
        return done.stdout


def pytest_itemcollected(item: pytest.Item) -> None:
    """Gives the first test the time of an installation, too."""
    item.add_marker(pytest.mark.timeout(INSTALLING + RUNNING))


def find(config: pytest.Config) -> None:
    """Find the Python to compare with, or why there is none."""
    if not ASKED:
        FOUND["missing"] = "TURTLEACT_ROS names no Python that has rclpy; see CONTRIBUTING.md"
    elif ASKED != "wheels":
        FOUND["python"] = ASKED
    elif not config.pluginmanager.hasplugin("cacheprovider") or config.cache is None:
        FOUND["missing"] = "pytest has no cache to install rclpy's wheels in"
    elif os.name != "posix":
        FOUND["missing"] = "there are no wheels of rclpy for this system"
    else:
        installed_once(config.cache.mkdir("ros"))


def installed_once(folder: Path) -> None:
    """Install the wheels unless they are there; the other workers of this run wait for it.

    A worker that waited does not repeat an installation that has failed.
    """
    import fcntl

    run = os.environ.get("PYTEST_XDIST_TESTRUNUID", str(os.getpid()))
    failed = folder.with_name("ros-failed.json")
    with folder.with_name("ros.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if failed.exists():
            before = json.loads(failed.read_text("utf-8"))
            if before["run"] == run:
                FOUND["missing"] = before["missing"]
                return
        install(folder)
        if "missing" in FOUND:
            failed.write_text(json.dumps({"run": run, "missing": FOUND["missing"]}), "utf-8")


def install(folder: Path) -> None:
    """Make an environment with the packages of ``requirements.txt``, unless it is there.

    The pip of this Python installs them, for an environment with a pip of its own takes longer.
    """
    wanted = f"{sys.version}\n{REQUIREMENTS.read_text('utf-8')}"
    python, note = folder / "bin" / "python", folder / "installed.txt"
    if not note.exists() or note.read_text("utf-8") != wanted:
        end = time.monotonic() + INSTALLING
        if find_spec("pip"):
            venv, pip = ["--without-pip"], [sys.executable, "-m", "pip", "--python", str(python)]
        else:
            venv, pip = [], [str(python), "-m", "pip"]
        options = ["--quiet", "--prefer-binary", "--no-compile", "--retries=1"]
        try:
            carry_out([sys.executable, "-m", "venv", "--clear", *venv, str(folder)], end)
            carry_out([*pip, "install", *options, "--requirement", str(REQUIREMENTS)], end)
        except subprocess.TimeoutExpired:
            FOUND["missing"] = f"rclpy's wheels were not installed within {INSTALLING:g} s"
            return
        except subprocess.CalledProcessError as error:
            said = error.stderr.strip().splitlines() or [str(error)]
            FOUND["missing"] = f"rclpy's wheels cannot be installed: {said[-1]}"
            return
        note.write_text(wanted, "utf-8")
    FOUND["python"] = str(python)


def carry_out(command: list[str], end: float) -> None:
    left = end - time.monotonic()
    subprocess.run(command, check=True, capture_output=True, text=True, timeout=left)


@pytest.fixture(scope="session")
def ros(pytestconfig: pytest.Config) -> Ros:
    """rclpy, in processes of its own."""
    if not FOUND:
        find(pytestconfig)
    if "missing" in FOUND:
        pytest.skip(FOUND["missing"])
    return Ros(FOUND["python"])
