"""What ``serve`` shows to other programs: traces, metrics and log records."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

import turtleact
from turtleact.interfaces.standard import Fibonacci

from .. import warm
from ..lab import free_endpoint
from ..telemetry.collector import collecting, values

LAB = """
import logging
import turtleact
from turtleact.interfaces.standard import Fibonacci


@turtleact.action(Fibonacci, "outer")
async def outer(goal, handle):
    logging.getLogger("lab").info("order %d", goal.order)
    return await handle.node.action_client(Fibonacci, "inner").send_goal(goal)


@turtleact.action(Fibonacci, "inner")
async def inner(goal):
    yield Fibonacci.Result(sequence=[goal.order])
"""


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    (tmp_path / "tracedlab.py").write_text(LAB)
    return tmp_path


async def test_serve_exports_traces_and_serves_metrics_and_logs_in_json(lab):
    at = free_endpoint()
    options = ["--otel", "--metrics", "0", "--log-format", "json", "--listen", at, "--no-sim"]
    options += ["-p", "gripper:=1"]
    with collecting() as collector:
        process = warm.start(
            [sys.executable, "-m", "turtleact", "serve", "tracedlab", *options],
            cwd=lab,
            env={**os.environ, "ROS_DOMAIN_ID": "0", "OTEL_EXPORTER_OTLP_ENDPOINT": collector.url},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            assert process.stdout is not None
            url = json.loads(process.stdout.readline())["message"].removeprefix("metrics at ")
            assert json.loads(process.stdout.readline())["message"].startswith("ready at")
            async with (
                turtleact.open_zenoh([at], domain=0) as graph,
                turtleact.open_node("sender", transport=graph) as node,
            ):
                await node.action_client(Fibonacci, "outer").send_goal(Fibonacci.Goal(order=3))
            async with httpx.AsyncClient() as client:
                metrics = (await client.get(url)).text
            process.send_signal(signal.SIGTERM)
            out, err = process.communicate(timeout=30)
        finally:
            process.kill()
            process.wait()
    assert process.returncode == 0
    families = {each.name: each for each in text_string_to_metric_families(metrics)}
    ended = {each.labels["action"]: each.value for each in families["ros_action_goals"].samples}
    assert ended == {"/inner": 1, "/outer": 1}
    outer, sent, inner = (
        collector.the(name) for name in ("execute /outer", "send_goal /inner", "execute /inner")
    )
    assert (sent.parent_span_id, inner.parent_span_id) == (outer.span_id, sent.span_id)
    assert collector.resources[0]["service.name"] == "turtleact"
    goal_id = values(outer.attributes)["ros.goal.id"]
    changes = [json.loads(line) for line in out.splitlines()]
    told = [(each["action"], each["status"]) for each in changes if "status" in each]
    assert told[-2:] == [("/inner", "SUCCEEDED"), ("/outer", "SUCCEEDED")]
    assert changes[-1]["goal_id"] == goal_id
    records = [json.loads(line) for line in err.splitlines()]
    assert any("no module declares a parameter 'gripper'" in each["message"] for each in records)
    (said,) = [each for each in records if each["logger"] == "lab"]
    assert (said["message"], said["goal_id"], said["action"]) == ("order 3", goal_id, "/outer")
    assert said["trace_id"] == outer.trace_id.hex()
    assert collector.points("ros.action.goals")["/outer", "succeeded"].as_int == 1


OTEL = "serve", "--no-sim", "--otel"


def test_a_missing_package_for_traces_is_named(turtleact, monkeypatch):
    monkeypatch.setitem(sys.modules, "opentelemetry", None)
    monkeypatch.delitem(sys.modules, "turtleact.telemetry.exporting", raising=False)
    ran = turtleact(*OTEL)
    assert ran.status == 1
    assert ran.err.startswith("turtleact: --otel needs the extra otel-export: pip install '")


def test_a_port_that_cannot_be_bound_is_told_with_its_option(turtleact):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        ran = turtleact("serve", "--no-sim", "--metrics", str(port))
    assert ran.status == 1
    assert ran.err.startswith(f"turtleact: --metrics: 127.0.0.1:{port} cannot be bound")
