"""Forgets interfaces that a test has declared or loaded."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy

from turtleact.interfaces.types import REGISTRY


@contextmanager
def isolated_registry() -> Iterator[None]:
    """Forget, at the end of a block, everything that was registered inside the block."""
    kept = {name: copy(value) for name, value in vars(REGISTRY).items()}
    try:
        yield
    finally:
        vars(REGISTRY).update(kept)
