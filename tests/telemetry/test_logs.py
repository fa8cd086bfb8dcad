"""Records of a body say which goal they belong to."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Iterator

import anyio
import pytest
from opentelemetry import trace
from opentelemetry.sdk.trace import TracerProvider

import turtleact
from turtleact.telemetry import GoalFilter, JsonFormatter, TextFormatter

from ..lab import Count, goal, result

ID = bytes(range(16))
logger = logging.getLogger("robot.arm")


class Lines(logging.Handler):
    """Keeps the lines it formats."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(self.format(record))


@pytest.fixture
def handler() -> Iterator[Lines]:
    handler = Lines()
    handler.addFilter(GoalFilter())
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    yield handler
    logger.removeHandler(handler)


async def run(execute) -> None:
    async with turtleact.open_node("lab", namespace="/here") as node:
        node.action_server(Count, "count", execute)
        await node.action_client(Count, "count").send_goal(goal(), goal_id=ID)


async def test_a_record_of_a_body_names_goal_action_and_node(handler):
    async def execute(request):
        logger.info("inside")
        await anyio.to_thread.run_sync(logger.info, "in a thread")
        return result()

    handler.setFormatter(logging.Formatter("%(message)s %(goal_id)s %(action)s %(node)s"))
    logger.info("outside")
    await run(execute)
    logger.info("after")
    said = f"{ID.hex()} /here/count /here/lab"
    assert handler.lines == [
        "outside   ",
        f"inside {said}",
        f"in a thread {said}",
        "after   ",
    ]


async def test_the_text_of_a_body_ends_with_its_goal(handler):
    async def execute(request):
        logger.warning("too hot: %d", 80)
        return result()

    handler.setFormatter(TextFormatter())
    await run(execute)
    logger.info("outside")
    inside, outside = (line.split(" ", 2)[2] for line in handler.lines)  # without the time
    assert inside == (
        f"WARNING robot.arm: too hot: 80 [goal_id={ID.hex()} action=/here/count node=/here/lab]"
    )
    assert outside == "INFO robot.arm: outside"


async def test_a_record_as_json(handler):
    async def execute(request):
        logger.info("inside", extra={"joint": 3, "node": "of the user's"})
        return result()

    handler.setFormatter(JsonFormatter())
    await run(execute)
    told = json.loads(handler.lines[0])
    assert told.pop("time").endswith("+00:00")
    assert told == {
        "level": "INFO",
        "logger": "robot.arm",
        "message": "inside",
        "goal_id": ID.hex(),
        "action": "/here/count",
        "node": "of the user's",
        "joint": 3,
    }


def test_a_record_outside_of_a_body_as_json_has_no_goal(handler):
    handler.setFormatter(JsonFormatter())
    try:
        raise ValueError("bad")
    except ValueError:
        logger.exception("failed")
    told = json.loads(handler.lines[0])
    assert list(told) == ["time", "level", "logger", "message", "exception"]
    assert told["exception"].endswith("ValueError: bad")


def test_a_record_in_a_span_has_its_ids(handler, monkeypatch):
    handler.setFormatter(JsonFormatter())
    with TracerProvider(shutdown_on_exit=False).get_tracer("lab").start_as_current_span("x") as it:
        logger.info("here")
    here = it.get_span_context()
    told = json.loads(handler.lines[0])
    assert told["trace_id"] == trace.format_trace_id(here.trace_id)
    assert told["span_id"] == trace.format_span_id(here.span_id)
    monkeypatch.delitem(sys.modules, "opentelemetry.trace")
    logger.info("without OpenTelemetry")
    assert "trace_id" not in json.loads(handler.lines[1])
