"""Adds the current goal to log records, and formats the records as text or JSON.

>>> import logging
>>> handler = logging.StreamHandler()
>>> handler.addFilter(GoalFilter())
>>> handler.setFormatter(JsonFormatter())

With the filter, every record logged in a body carries the goal id, the action and the node, even if
another module logs the record. A record that is logged in a thread also carries these three fields
if the thread has the body's context. Threads of `asyncio.to_thread` and `anyio.to_thread` have this
context.
"""

from __future__ import annotations

import json
import logging
import sys
from datetime import UTC, datetime
from typing import Any, Final

from turtleact.goals.running import BodyTask
from turtleact.goals.state import CURRENT_GOAL

__all__ = ["GoalFilter", "JsonFormatter", "TextFormatter"]

FIELDS: Final = ("goal_id", "action", "node")

PLAIN: Final = frozenset({*logging.makeLogRecord({}).__dict__, "message", "asctime", "taskName"})
"""The attributes that every record has.

All other attributes of a record were passed as ``extra``."""


class GoalFilter(logging.Filter):
    """Adds ``goal_id``, ``action`` and ``node`` to records, and lets every record pass.

    Outside of bodies, these three fields are empty. If a record already has one of these fields,
    that field is kept. Add the filter to a handler, not to a logger, because a logger's filters do
    not see the records of its child loggers.
    """

    def filter(self, record: logging.LogRecord) -> bool:
        """Add the fields to a record."""
        goal = CURRENT_GOAL.get()
        values = "", "", ""
        if goal is not None and isinstance(goal.body, BodyTask):
            server = goal.body.runner.server
            values = goal.hex, server.name, server.spec.node
        for field, value in zip(FIELDS, values, strict=True):
            record.__dict__.setdefault(field, value)
        return True


class TextFormatter(logging.Formatter):
    """Writes each record with its time, level, logger and message.

    If a record was logged in a body, its line ends with the goal id, the action and the node.
    """

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(name)s: %(message)s")

    def formatMessage(self, record: logging.LogRecord) -> str:  # logging's name
        """Return a record's line, which ends with the record's goal, if there is one."""
        line = super().formatMessage(record)
        said = [f"{field}={value}" for field in FIELDS if (value := getattr(record, field, ""))]
        return f"{line} [{' '.join(said)}]" if said else line


class JsonFormatter(logging.Formatter):
    """Writes each record as a JSON object on one line.

    Each object has the members ``time`` (UTC, ISO 8601), ``level``, ``logger`` and ``message``. A
    record that was logged in a body also has ``goal_id``, ``action`` and ``node``. A record that
    was logged in a span of OpenTelemetry also has ``trace_id`` and ``span_id``. A traceback is in
    ``exception``. Values passed as ``extra`` also become members, as text if JSON has no form for
    them. If one has the name of another member, an underscore is appended to its name.
    """

    def format(self, record: logging.LogRecord) -> str:
        """Return a record as JSON."""
        members: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="microseconds"),
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
        }
        members |= {name: said for name in FIELDS if (said := getattr(record, name, ""))}
        members |= _current_span()
        if record.exc_info:
            members["exception"] = self.formatException(record.exc_info)
        for name, value in record.__dict__.items():
            if name not in PLAIN and name not in FIELDS:
                members[f"{name}_" if name in members else name] = value
        return json.dumps(members, default=str)


def _current_span() -> dict[str, str]:
    """Return the ids of OpenTelemetry's current span; an empty dict if there is none."""
    trace = sys.modules.get("opentelemetry.trace")
    if trace is None:
        return {}
    here = trace.get_current_span().get_span_context()
    if not here.is_valid:
        return {}
    return {"trace_id": f"{here.trace_id:032x}", "span_id": f"{here.span_id:016x}"}
