"""Virtual time for pytest: every async test runs on asyncio and, if installed, on trio.

This module defines the fixture ``anyio_backend``, which anyio's pytest plug-in uses to run async
tests. There are three ways to use it:

- For one test module, write ``from turtleact.testing.plugin import anyio_backend`` there.
- For all tests in a folder, write the same line in the folder's ``conftest.py``.
- For all tests, write ``pytest_plugins = ["turtleact.testing.plugin"]`` in the top ``conftest.py``.
  A folder or test module can still define another fixture named ``anyio_backend`` for its tests.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import pytest

from turtleact.testing.time import virtual_backend

__all__ = ["anyio_backend"]


@pytest.fixture(params=[name for name in ("asyncio", "trio") if find_spec(name)])
def anyio_backend(request: pytest.FixtureRequest) -> tuple[str, dict[str, Any]]:
    """Return a backend with virtual time for an async test. Each test begins at time 0."""
    return virtual_backend(request.param)
