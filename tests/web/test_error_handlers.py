"""What an app answers when a goal fails: one call, for FastAPI and for plain Starlette."""

from __future__ import annotations

import httpx
import pytest
from fastapi import FastAPI
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.websockets import WebSocket

from turtleact.errors import (
    GoalAborted,
    GoalRejected,
    InvalidGoal,
    InvalidGoalId,
    InvalidMessage,
    InvalidName,
    ServerUnavailable,
    TurtleactError,
    UnknownGoal,
)
from turtleact.web import add_error_handlers

from .line import Line, websocket_scope

FIELD = {"loc": ["body", "targets", 1, "x"], "msg": "expected a number", "type": "value_error"}
CASES = [
    (InvalidGoal("goal.targets[1].x", "expected a number"), 422, [FIELD]),
    (InvalidGoalId("0" * 32, "not all zeros", 0), 422, f"not all zeros: {'0' * 32}"),
    (GoalRejected("the queue is full"), 409, "the goal was rejected: the queue is full"),
    (UnknownGoal("no goal 12"), 404, "the goal is not known to the server: no goal 12"),
    (ServerUnavailable("/count"), 503, "action '/count': no server answers"),
]


def raising(error: Exception, kind: type[Starlette] = Starlette) -> Starlette:
    """An app with handlers whose only endpoint raises an error."""
    app = kind()
    add_error_handlers(app)

    async def fail(request: Request) -> Response:
        raise error

    app.router.add_route("/", fail)
    return app


async def get(app: Starlette) -> httpx.Response:
    transport = httpx.ASGITransport(app)
    async with httpx.AsyncClient(transport=transport, base_url="http://turtle") as http:
        return await http.get("/")


@pytest.mark.parametrize("kind", [Starlette, FastAPI])
@pytest.mark.parametrize(("error", "code", "detail"), CASES)
async def test_an_error_of_a_goal_is_a_response(kind, error, code, detail):
    answer = await get(raising(error, kind))
    assert (answer.status_code, answer.json()) == (code, {"detail": detail})


@pytest.mark.parametrize(
    "error",
    [
        GoalAborted("lost"),
        InvalidMessage("msg.x", "wrong"),
        InvalidName("bad name", "no blanks", 3),  # the app's own mistake, not the client's
    ],
)
async def test_any_other_error_stays_an_error(error):
    with pytest.raises(type(error)):
        await get(raising(error))


async def test_an_app_that_has_started_takes_no_handlers():
    app = raising(GoalRejected("no"))
    await get(app)
    with pytest.raises(TurtleactError, match="not in its lifespan"):
        add_error_handlers(app)


async def test_a_websocket_raises_as_before():
    app = Starlette()
    add_error_handlers(app)

    async def fail(websocket: WebSocket) -> None:
        await websocket.accept()
        raise GoalRejected("no")

    app.router.add_websocket_route("/", fail)
    connection = Line()
    with pytest.raises(GoalRejected):
        await app(websocket_scope(), connection.receive, connection.send)
    connection.close()
