"""Virtual time for pytest: every async test runs on asyncio and, if installed, on trio.

This module has a fixture, ``anyio_backend``, with the name that anyio's own plug-in looks for. To
use it for a folder, write ``from turtleact.testing.plugin import anyio_backend`` in its
``conftest.py``. To use it for one test module, write the same line there. The suite's top
``conftest.py`` may instead have ``pytest_plugins = ["turtleact.testing.plugin"]``. In that case, a
folder or module can still define another fixture with this name.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import pytest

from turtleact.testing.time import virtual_backend

__all__ = ["anyio_backend"]


@pytest.fixture(params=[name for name in ("asyncio", "trio") if find_spec(name)])
def anyio_backend(request: pytest.FixtureRequest) -> tuple[str, dict[str, Any]]:
    """The backend of an async test, in virtual time. Each test begins at time 0."""
    return virtual_backend(request.param)
