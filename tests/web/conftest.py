"""JavaScript clients: fetched by npm once for a run of the tests, where node and npm are."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

PACKAGES = [
    "roslib@2.1.0",
    "@foxglove/roslibjs@0.0.3",
    "@foxglove/rosmsg@5.0.5",
    "@foxglove/rosmsg2-serialization@3.1.0",
    "@mcap/core@2.2.2",
]
INSTALL = ["--engine-strict", "--prefer-offline", "--ignore-scripts", "--no-audit", "--no-fund"]
SECONDS = 20


@pytest.fixture(scope="session")
def javascript(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of packages that a client imports from."""
    npm = shutil.which("npm")
    if npm is None or shutil.which("node") is None:
        pytest.skip("node and npm are not installed")
    folder = tmp_path_factory.mktemp("javascript")
    options = ["--loglevel=error", "--fetch-retries=0", f"--prefix={folder}"]
    try:
        subprocess.run(
            [npm, "install", *INSTALL, *options, *PACKAGES],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=True,
            timeout=SECONDS,
        )
    except subprocess.CalledProcessError as error:
        reason = (error.stderr.strip() or f"exit status {error.returncode}").splitlines()[0]
        pytest.skip(f"npm cannot fetch {PACKAGES[0]} and the others: {reason}")
    except subprocess.TimeoutExpired:
        pytest.skip(f"npm has not fetched {PACKAGES[0]} and the others within {SECONDS} s")
    return folder / "node_modules"
