"""What the tests of goals share."""

from __future__ import annotations

import pytest

from ..lab import Send, awaited, entered


@pytest.fixture(params=[awaited, entered])
def send(request) -> Send:
    """The two ways to wait for a goal."""
    way: Send = request.param
    return way
