"""Each test finds the registry as it is after the import, and leaves no interface behind."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from turtleact.interfaces.types import REGISTRY


@pytest.fixture(autouse=True)
def own_registry() -> Iterator[None]:
    with REGISTRY.isolated():
        REGISTRY.prefixes = ()
        yield
