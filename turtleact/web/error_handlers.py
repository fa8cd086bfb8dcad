"""Turns errors of goals into HTTP responses, for apps made with Starlette or FastAPI.

The bodies of the responses have FastAPI's form ``{"detail": "text"}``. If a goal does not fit its
type, ``detail`` is a list of objects with ``loc``, ``msg`` and ``type``. Clients that understand
FastAPI's validation errors therefore understand these responses, too.

Source: FastAPI, "Handling Errors", and its ``HTTPValidationError``; RFC 9110, section 15.5.
"""

from __future__ import annotations

import re
from typing import Final

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.websockets import WebSocket

from turtleact.errors import (
    GoalRejected,
    InvalidGoal,
    InvalidGoalId,
    ServerUnavailable,
    TurtleactError,
    UnknownGoal,
)

__all__ = ["STATUS_CODES", "add_error_handlers", "location"]

STATUS_CODES: Final[dict[type[TurtleactError], int]] = {
    InvalidGoal: 422,
    InvalidGoalId: 422,
    GoalRejected: 409,
    UnknownGoal: 404,
    ServerUnavailable: 503,
}
"""The HTTP status of each error."""

part_pattern = re.compile(r"[^.\[\]]+")


def add_error_handlers(app: Starlette) -> None:
    """Make an app answer failed goals with the right HTTP status instead of 500.

    The errors in `STATUS_CODES` become JSON responses, in all routes of the app. Other apps that
    are mounted in the app are not affected. WebSocket routes still raise the errors.

    Args:
        app: An app of Starlette or FastAPI that has not started yet.

    Raises:
        TurtleactError: if the app has started, because it would ignore the handlers.
    """
    if app.middleware_stack is not None:
        raise TurtleactError(
            "the app has started and takes no more handlers: call add_error_handlers(app) next to "
            "the line that creates the app, not in its lifespan"
        )
    for error in STATUS_CODES:
        app.add_exception_handler(error, _answer)


def location(path: str) -> list[str | int]:
    """Return the path of a value in a request's body, in the form of FastAPI's ``loc``.

    Args:
        path: The attribute ``path`` of an `InvalidGoal`. The first part of the path, such as
            ``goal``, names the whole message and is replaced by ``body``.

    >>> location("goal.targets[1].x")
    ['body', 'targets', 1, 'x']
    """
    parts = part_pattern.findall(path)[1:]
    return ["body", *(int(part) if part.isdecimal() else part for part in parts)]


async def _answer(connection: Request | WebSocket, error: Exception) -> JSONResponse:
    if isinstance(connection, WebSocket):  # it cannot take a response once it is accepted
        raise error
    code = next(code for kind, code in STATUS_CODES.items() if isinstance(error, kind))
    if isinstance(error, InvalidGoal):
        problem = {"loc": location(error.path), "msg": error.problem, "type": "value_error"}
        return JSONResponse({"detail": [problem]}, code)
    if isinstance(error, InvalidGoalId):  # its text has a caret on a line of its own
        return JSONResponse({"detail": f"{error.problem}: {error.name}"}, code)
    return JSONResponse({"detail": str(error)}, code)
