"""Each test finds the registry as it is after the import, and leaves no interface behind."""

from __future__ import annotations

import pytest

from turtleact.interfaces.registry import REGISTRY


@pytest.fixture(autouse=True)
def own_registry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(REGISTRY, "_known", dict(REGISTRY._known))
    monkeypatch.setattr(REGISTRY, "files", dict(REGISTRY.files))
    monkeypatch.setattr(REGISTRY, "prefixes", ())
