"""What instrumentation means for programs that do not ask for it or have no OpenTelemetry."""

from __future__ import annotations

import subprocess
import sys

import pytest

import turtleact
from turtleact import TurtleactError
from turtleact.telemetry import instrument

UNASKED = """
import sys
import turtleact
import turtleact.commands.serve
import turtleact.commands.serving
import turtleact.web
print([name for name in sys.modules if name.startswith(("opentelemetry", "turtleact.telemetry"))])
import turtleact.telemetry
print([name for name in sys.modules if name.startswith("opentelemetry")])
"""


def test_nobody_imports_opentelemetry_without_asking_for_it():
    ran = subprocess.run(
        [sys.executable, "-c", UNASKED], capture_output=True, text=True, check=True
    )
    assert ran.stdout == "[]\n[]\n"


async def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.delitem(sys.modules, "turtleact.telemetry.tracing", raising=False)
    monkeypatch.setitem(sys.modules, "opentelemetry", None)
    async with turtleact.open_node("lab") as node:
        with pytest.raises(TurtleactError, match="the extra otel: pip install 'opentelemetry-api"):
            instrument(node)


async def test_without_a_program_that_sets_up_opentelemetry_goals_run_as_ever():
    from ..lab import Count, count, goal, result

    async with turtleact.open_node("lab") as node:
        instrument(node)
        node.action_server(Count, "count", count)
        assert await node.action_client(Count, "count").send_goal(goal(2)) == result(0, 1)
