# In a checkout: pip install . fastapi httpx
"""A web app: a goal outlives the request that started it, and later requests find it by its id.

The app keeps no list of goals: a detached goal belongs to its server alone. ``visit`` plays the
browser, without a port and in virtual time. ``uvicorn --app-dir examples 20_fastapi:app`` serves
the same app in real time. Only there does the feedback stream arrive piece by piece, because the
client in ``visit`` (httpx's ``ASGITransport``) delivers a response when it is complete.

Prints:

    POST /patrol: 422 ['body', 'targets', 0, 'x'] expected a number (float64), got 'nine'
    POST /patrol: 202
    POST /patrol: 409 the goal was rejected: turtle 'turtle1' is being driven by another goal
    GET /goals/…: EXECUTING
    GET /goals/…/feedback:
        data: {"reached": 0, "left": 4.7}
        data: {"reached": 1, "left": 3.0}
        data: {"reached": 1, "left": 1.1}
        data: {"reached": 2, "left": 0.0}
        event: result
        data: "SUCCEEDED"
    POST /patrol: 202
    DELETE /goals/…: 202
    GET /goals/…: CANCELING
    GET /goals/… a second later: CANCELED
    GET /goals/… a minute later: 404
"""

import uuid
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Annotated, Any, TypeAlias

import anyio
import httpx
from fastapi import Depends, FastAPI, HTTPException, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent

from turtleact import ClientGoalHandle, open_world, testing
from turtleact.actions.patrol import Patrol
from turtleact.interfaces import from_dict, to_dict
from turtleact.web import add_error_handlers

Handle: TypeAlias = ClientGoalHandle[Patrol.Result, Patrol.Feedback]


@asynccontextmanager
async def lifespan(app: FastAPI) -> AsyncIterator[None]:
    async with open_world() as node:
        app.state.patrol = node.action_client(Patrol, "patrol")
        yield


app = FastAPI(lifespan=lifespan)
add_error_handlers(app)


# FastAPI runs plain functions in threads, but a handle must stay in its event loop's thread.
async def find(request: Request, goal_id: uuid.UUID) -> Handle:
    handle: Handle = await request.app.state.patrol.attach(goal_id)
    return handle


Found: TypeAlias = Annotated[Handle, Depends(find)]


@app.post("/patrol", status_code=202)
async def start(request: Request, goal: dict[str, Any]) -> dict[str, uuid.UUID]:
    message = from_dict(Patrol.Goal, goal, root="goal")
    async with request.app.state.patrol.send_goal(message) as handle:
        handle.detach()
        return {"goal_id": uuid.UUID(bytes=handle.goal_id)}


@app.get("/goals/{goal_id}")
async def look(goal: Found) -> dict[str, Any]:
    feedback = goal.last_feedback
    return {"status": goal.status.name, "feedback": feedback and to_dict(feedback)}


@app.get("/goals/{goal_id}/feedback", response_class=EventSourceResponse)
async def listen(goal: Found) -> AsyncIterator[ServerSentEvent]:
    async for feedback in goal:
        left = round(feedback.distance_remaining, 1)
        yield ServerSentEvent(data={"reached": feedback.reached, "left": left})
    yield ServerSentEvent(event="result", data=goal.status.name)


@app.delete("/goals/{goal_id}", status_code=202)
async def cancel(goal: Found) -> None:
    answer = await goal.cancel()
    if not answer.goals_canceling:
        raise HTTPException(409, f"the goal is {goal.status.name}")


async def visit() -> None:
    places = {"targets": [{"x": 9.0, "y": 7.0}, {"x": 9.0, "y": 10.0}]}
    transport = httpx.ASGITransport(app)  # does not run the app's lifespan
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=transport, base_url="http://turtle") as http,
    ):
        answer = await http.post("/patrol", json={"targets": [{"x": "nine"}]})
        (problem,) = answer.json()["detail"]
        print("POST /patrol:", answer.status_code, problem["loc"], problem["msg"])
        answer = await http.post("/patrol", json=places)
        print("POST /patrol:", answer.status_code)
        goal = f"/goals/{answer.json()['goal_id']}"
        answer = await http.post("/patrol", json=places)
        print("POST /patrol:", answer.status_code, answer.json()["detail"])
        print("GET /goals/…:", (await http.get(goal)).json()["status"])
        print("GET /goals/…/feedback:")
        answer = await http.get(f"{goal}/feedback")
        print(*(f"    {line}" for line in answer.text.splitlines() if line), sep="\n")

        answer = await http.post("/patrol", json=places)
        print("POST /patrol:", answer.status_code)
        goal = f"/goals/{answer.json()['goal_id']}"
        print("DELETE /goals/…:", (await http.delete(goal)).status_code)
        print("GET /goals/…:", (await http.get(goal)).json()["status"])
        await anyio.sleep(1)
        print("GET /goals/… a second later:", (await http.get(goal)).json()["status"])
        await anyio.sleep(60)  # a result is kept for 10 s
        print("GET /goals/… a minute later:", (await http.get(goal)).status_code)


if __name__ == "__main__":
    testing.run(visit)
