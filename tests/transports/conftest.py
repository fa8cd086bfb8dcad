"""What the tests of transports share."""

import shutil
import tempfile
from pathlib import Path

import pytest

pytest.register_assert_rewrite("tests.transports.conformance")  # its asserts explain themselves


@pytest.fixture
def address():
    """Where two sessions of this machine meet; short, as the path of a socket must be."""
    folder = tempfile.mkdtemp(prefix="zenoh")
    yield f"unixsock-stream/{Path(folder) / 'socket'}"
    shutil.rmtree(folder)
