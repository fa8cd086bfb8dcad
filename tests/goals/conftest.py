"""What the tests of goals share."""

from __future__ import annotations

from typing import Any

import pytest

from ..lab import Send, apart, awaited, entered, lab


@pytest.fixture(params=[awaited, entered])
def send(request) -> Send:
    """The two ways to wait for a goal."""
    way: Send = request.param
    return way


@pytest.fixture(params=[lab, apart])
def where(request) -> Any:
    """Where the server is: in the client's process, or reached by messages alone."""
    return request.param
