"""Adds the current goal to log records, and formats the records as text or JSON.

>>> import logging
>>> handler = logging.StreamHandler()
>>> handler.addFilter(GoalFilter())
>>> handler.setFormatter(JsonFormatter())

Each record of a body then carries the goal id, the action and the node, whichever module logs it.
Records from a thread carry them, too, if the thread has the body's context. Threads of
`asyncio.to_thread` and `anyio.to_thread` have it.
"""

from __future__ import annotations

import logging
import sys
from datetime import UTC, datetime
from typing import Any, Final

import msgspec

from turtleact.goal import CURRENT_GOAL
from turtleact.server.execution import Execution
from turtleact.summaries import encodable, summary, text_of

__all__ = ["GoalFilter", "JsonFormatter", "TextFormatter"]

FIELDS: Final = ("goal_id", "action", "node")

PLAIN: Final = frozenset({*logging.makeLogRecord({}).__dict__, "message", "asctime", "taskName"})
"""The attributes of every record. The user passes any others as ``extra``."""


class GoalFilter(logging.Filter):
    """Adds ``goal_id``, ``action`` and ``node`` to records, and lets every record pass.

    Outside of bodies, the three are empty. If the record has one of these values already, that
    value is kept. Add the filter to a handler, because a logger's filters do not see the records of
    its children.
    """

    def filter(self, record: logging.LogRecord) -> bool:
        """Add the fields."""
        goal = CURRENT_GOAL.get()
        values = "", "", ""
        if goal is not None and isinstance(goal.runner, Execution):
            served = goal.runner.served
            values = goal.runner.name_goal(goal).hex(), served.name, served.node
        for field, value in zip(FIELDS, values, strict=True):
            record.__dict__.setdefault(field, value)
        return True


class TextFormatter(logging.Formatter):
    """Writes one line with time, level, logger and message.

    A body's records also name their goal.
    """

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(name)s: %(message)s")

    def formatMessage(self, record: logging.LogRecord) -> str:  # logging's name
        """Add the goal to the line."""
        line = super().formatMessage(record)
        said = [f"{field}={value}" for field in FIELDS if (value := getattr(record, field, ""))]
        return f"{line} [{' '.join(said)}]" if said else line


class JsonFormatter(logging.Formatter):
    """Writes each record as a JSON object on one line.

    The members are ``time`` (UTC, ISO 8601), ``level``, ``logger`` and ``message``. In a body,
    there are also ``goal_id``, ``action`` and ``node``; in a span of OpenTelemetry, ``trace_id``
    and ``span_id``. A traceback is in ``exception``. Values passed as ``extra`` are members, too.
    An extra with one of these names gets an underscore at its end.
    """

    def format(self, record: logging.LogRecord) -> str:
        """Return a record as text."""
        members: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="microseconds"),
            "level": record.levelname,
            "logger": record.name,
            "message": _message(record),
        }
        members |= {name: said for name in FIELDS if (said := getattr(record, name, ""))}
        members |= _current_span()
        if record.exc_info:
            members["exception"] = self.formatException(record.exc_info)
        for name, value in record.__dict__.items():
            if name not in PLAIN and name not in FIELDS:
                members[f"{name}_" if name in members else name] = value
        return _written(members)


def _message(record: logging.LogRecord) -> str:
    """The message. If its arguments do not fit, describe the error, so that the line stays JSON."""
    try:
        return record.getMessage()
    except Exception as error:
        return f"{_text(record.msg)} {_text(record.args)} ({summary(error)})"


def _text(value: object) -> str:
    """The text of a value. If its class fails to give one, a text that says so."""
    try:
        return str(value)
    except Exception:
        return text_of(value)


def _current_span() -> dict[str, str]:
    """The ids of the current span, if the program uses OpenTelemetry."""
    trace = sys.modules.get("opentelemetry.trace")
    if trace is None:
        return {}
    here = trace.get_current_span().get_span_context()
    if not here.is_valid:
        return {}
    return {"trace_id": f"{here.trace_id:032x}", "span_id": f"{here.span_id:016x}"}


def _written(members: dict[str, Any]) -> str:
    """Write JSON. A value that JSON cannot hold is written as its text."""
    try:
        return msgspec.json.encode(members, enc_hook=_text).decode()
    except Exception:
        plain = {name: encodable(_text(value)) for name, value in members.items()}
        return msgspec.json.encode(plain).decode()
