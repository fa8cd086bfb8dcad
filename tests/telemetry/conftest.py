"""What the tests of telemetry share."""

import shutil
import tempfile
from pathlib import Path

import pytest


@pytest.fixture
def free_address():
    """Where two sessions of this machine meet; short, as the path of a socket must be."""
    folder = tempfile.mkdtemp(prefix="zenoh")
    yield f"unixsock-stream/{Path(folder) / 'socket'}"
    shutil.rmtree(folder)
