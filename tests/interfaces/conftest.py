"""Each test finds the registry as it is after the import, and leaves no interface behind."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from turtleact.interfaces.finders import Finders
from turtleact.interfaces.types import REGISTRY

from ..conftest import COLLECTED
from ..registry import isolated_registry


@pytest.fixture(autouse=True)
def own_registry() -> Iterator[None]:
    with isolated_registry():
        REGISTRY.look_in(Finders())
        for name in REGISTRY.names():  # what pages and examples have defined in this process
            if name.startswith("example_msgs/") and name not in COLLECTED:
                REGISTRY.forget(name)
        yield
