"""Virtual time for pytest: every async test runs on asyncio and, where it is installed, on trio.

A fixture of the name that anyio's own plug-in looks for. For all tests of a folder, its
``conftest.py`` says ``from turtleact.testing.plugin import anyio_backend``; for those of a module,
the module does. The suite's own ``conftest.py`` may say instead
``pytest_plugins = ["turtleact.testing.plugin"]``, and then a folder or module can still have
another fixture of this name.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import pytest

from turtleact.testing.time import virtual_backend

__all__ = ["anyio_backend"]


@pytest.fixture(params=[name for name in ("asyncio", "trio") if find_spec(name)])
def anyio_backend(request: pytest.FixtureRequest) -> tuple[str, dict[str, Any]]:
    """The backend of an async test, in virtual time that begins at 0 with each test."""
    return virtual_backend(request.param)
