"""What ``serve`` shows to other programs: traces, metrics and log records."""

from __future__ import annotations

import io
import json
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import redirect_stderr
from pathlib import Path

import httpx
import pytest
from opentelemetry import metrics, trace
from prometheus_client.parser import text_string_to_metric_families

import turtleact
from turtleact import TurtleactError
from turtleact.commands.observing import json_line, observing, set_up_logging
from turtleact.commands.settings import Watched
from turtleact.interfaces.standard import Fibonacci

from .. import warm
from ..telemetry.collector import collecting, values
from .test_serve import free_endpoint

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


@pytest.fixture
def root() -> Iterator[logging.Logger]:
    """The root logger, which is put right afterwards."""
    root = logging.getLogger()
    uvicorn, before, level = logging.getLogger("uvicorn"), list(root.handlers), root.level
    uvicorn_level = uvicorn.level
    yield root
    root.handlers[:] = before
    root.setLevel(level)
    uvicorn.setLevel(uvicorn_level)


def test_records_as_text_are_harmless_for_a_terminal(root, capsys):
    set_up_logging("text")
    logging.getLogger("robot").info("\x1b[2J")
    assert capsys.readouterr().err.rstrip().endswith("INFO robot: \\x1b[2J")


def test_records_follow_stderr_where_a_dashboard_redirects_it(root, capsys, monkeypatch):
    set_up_logging("text")
    shown = io.StringIO()
    with redirect_stderr(shown):
        logging.getLogger("robot").info("here")
    assert shown.getvalue().endswith("INFO robot: here\n")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys, "stderr", None)
    logging.getLogger("robot").info("nowhere")


def test_a_record_that_cannot_be_written_is_told_by_logging(root, capsys, monkeypatch):
    set_up_logging("text")
    monkeypatch.delattr(root.handlers[-1], "formatter")
    logging.getLogger("robot").info("here")
    assert "--- Logging error ---" in capsys.readouterr().err


def test_without_a_format_logging_is_left_alone(root):
    before = list(root.handlers)
    set_up_logging(None)
    assert root.handlers == before


def test_a_line_in_json_has_the_members_that_are_given():
    line = json.loads(json_line("ready", goal_id="1f", status="ACCEPTED"))
    assert line.pop("time")
    assert line == {
        "level": "INFO",
        "logger": "turtleact.serve",
        "message": "ready",
        "goal_id": "1f",
        "status": "ACCEPTED",
    }


KINDS = "metric", "trace"
REFUSED = (
    "Transient error HTTPConnectionPool(host='127.0.0.1', port=4318): Max retries exceeded with "
    "url: /v1/traces (Caused by NewConnectionError(\"HTTPConnection(host='127.0.0.1', port=4318): "
    'Failed to establish a new connection: [Errno 111] Connection refused")) encountered while '
    "exporting spans batch, retrying in 1.07s."
)
BUSY = (
    "Transient error Service Unavailable encountered while exporting spans batch, retrying in 1s."
)
GIVEN_UP = "Failed to export spans batch due to timeout, max retries or shutdown."
MISSING = "Failed to export metrics batch code: 404, reason: Not Found"
MOVED = "Failed to export spans batch code: 307, reason: Temporary Redirect to https://a"
AT = "spans and measurements do not reach the collector at http://localhost:4318"
SET = "start it, or set OTEL_EXPORTER_OTLP_ENDPOINT"


@pytest.mark.parametrize(
    ("problems", "told"),
    [
        ([REFUSED, GIVEN_UP], [f"{AT}: Connection refused; {SET}"]),
        ([BUSY, GIVEN_UP], [f"{AT}: Service Unavailable; {SET}"]),
        (
            [MOVED],
            [
                f"the collector takes no {what}: 307 Temporary Redirect to https://a; "
                "set OTEL_EXPORTER_OTLP_ENDPOINT to the address that it redirects to"
                for what in ("measurements", "spans")
            ],
        ),
        ([GIVEN_UP], [f"{AT}: no answer; {SET}"]),
        (
            [MISSING],
            [
                "the collector takes no measurements: 404 Not Found; OTEL_METRICS_EXPORTER=none "
                "sends none",
                "the collector takes no spans: 404 Not Found; OTEL_TRACES_EXPORTER=none sends none",
            ],
        ),
    ],
)
async def test_a_collector_that_takes_nothing_is_told_of_once(monkeypatch, caplog, problems, told):
    monkeypatch.delenv("OTEL_EXPORTER_OTLP_ENDPOINT", raising=False)
    for signal_ in ("TRACES", "METRICS"):
        monkeypatch.setenv(f"OTEL_{signal_}_EXPORTER", "none")
    monkeypatch.setattr(trace, "set_tracer_provider", lambda _: None)  # a process can do so once
    monkeypatch.setattr(metrics, "set_meter_provider", lambda _: None)
    names = [f"opentelemetry.exporter.otlp.proto.http.{kind}_exporter" for kind in KINDS]
    exporters = [logging.getLogger(name) for name in names]
    before = [list(each.filters) for each in exporters]
    try:
        async with observing(Watched(otel=True), print):
            for problem in problems * 2:
                for each in exporters:
                    each.error(problem)
    finally:
        for each, filters in zip(exporters, before, strict=True):
            each.filters[:] = filters
    assert [each.getMessage() for each in caplog.records] == told


async def test_a_missing_package_for_traces_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "opentelemetry", None)
    monkeypatch.delitem(sys.modules, "turtleact.telemetry.exporting", raising=False)
    with pytest.raises(TurtleactError, match="--otel needs the extra otel-export: pip install"):
        async with observing(Watched(otel=True), print):
            pytest.fail("it was not missed")


async def test_a_variable_that_the_sdk_reads_at_its_import_is_named(monkeypatch):
    monkeypatch.setenv("OTEL_SPAN_ATTRIBUTE_COUNT_LIMIT", "many")
    monkeypatch.delitem(sys.modules, "turtleact.telemetry.exporting", raising=False)
    monkeypatch.delitem(sys.modules, "opentelemetry.sdk.trace", raising=False)
    with pytest.raises(TurtleactError, match="cannot be set up: OTEL_SPAN_ATTRIBUTE_COUNT_LIMIT"):
        async with observing(Watched(otel=True), print):
            pytest.fail("it was not read")


async def test_a_port_that_cannot_be_bound_is_told_with_its_option():
    said: list[str] = []
    async with observing(Watched(metrics=("127.0.0.1", 0)), said.append):
        port = int(said[0].rpartition(":")[2].partition("/")[0])
        with pytest.raises(TurtleactError, match=f"--metrics: 127.0.0.1:{port} cannot be bound"):
            async with observing(Watched(metrics=("127.0.0.1", port)), print):
                pytest.fail("it was bound")
