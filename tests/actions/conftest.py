"""The tests of the actions run in virtual time, which leaps at once on these event loops only."""

from __future__ import annotations

import pytest


@pytest.fixture(params=["asyncio", "trio"])
def anyio_backend(request: pytest.FixtureRequest) -> object:
    """uvloop does not say when it is idle, so each leap of virtual time takes 0.1 s on it."""
    return request.param
