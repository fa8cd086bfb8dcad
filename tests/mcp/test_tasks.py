"""Goals as MCP Tasks, for clients that declare the extension."""

from __future__ import annotations

from typing import Any, Literal

import anyio
import pytest
from mcp import MCPError
from mcp.client.extension import ClientExtension, ResultClaim
from mcp.types import (
    CallToolResult,
    RequestParams,
    Result,
    SubscriptionFilter,
    SubscriptionsListenRequest,
    SubscriptionsListenRequestParams,
)
from mcp.types import Request as McpRequest

from turtleact.interfaces.standard import Fibonacci
from turtleact.mcp import Limits, open_mcp
from turtleact.mcp.tasks import EXTENSION

from .line import FOREVER, client_of, connect, open_lab

NOBODY = "ab" * 16
INVALID_PARAMS, MISSING_CAPABILITY, NO_METHOD = -32602, -32021, -32601


class Task(Result):
    """A task, as the answer to a call or to ``tasks/get``."""

    result_type: Literal["task"] = "task"
    task_id: str
    status: str
    status_message: str | None = None
    poll_interval_ms: int | None = None
    ttl_ms: int | None = None
    result: Any = None


class AnyTask(Task):
    """A task as ``tasks/get`` gives it."""

    result_type: str = "complete"  # type: ignore[assignment]


class TaskParams(RequestParams):
    task_id: str


class TaskRequest(McpRequest[TaskParams, str]):
    """One of the requests about a task."""

    method: str
    params: TaskParams


class TakesTasks(ClientExtension):
    """Declares the extension; keeps the tasks that calls are answered with."""

    identifier = EXTENSION

    def __init__(self) -> None:
        self.tasks: list[Task] = []

    def claims(self):
        return [ResultClaim(result_type="task", model=Task, resolve=self.keep)]

    async def keep(self, task, _):
        self.tasks.append(task)
        return CallToolResult(content=[], is_error=True)  # the SDK checks any other


async def ask(client: Any, method: str, task_id: str) -> Any:
    """Send a request about a task."""
    request = TaskRequest(method=method, params=TaskParams(task_id=task_id))
    kind = AnyTask if method == "tasks/get" else Result
    return await client.session.send_request(request, kind)


async def begin(client: Any, extension: TakesTasks, order: int) -> Task:
    """Call the action, and return the task that comes back."""
    await client.call_tool("count", {"order": order})
    return extension.tasks[-1]


async def ended(client: Any, task_id: str) -> Any:
    """Poll a task to its end."""
    while True:
        task = await ask(client, "tasks/get", task_id)
        if task.status != "working":
            return task
        await anyio.sleep(0.001)


@pytest.mark.loops("asyncio", "trio")
async def test_a_goal_goes_on_as_a_task_and_leaves_its_result():
    takes = TakesTasks()
    async with connect(client={"extensions": [takes]}) as (_, client):
        begun = await begin(client, takes, 50)
        assert (begun.status, len(begun.task_id)) == ("working", 32)
        assert begun.poll_interval_ms
        assert begun.ttl_ms
        task = await ended(client, begun.task_id)
        assert task.status == "completed"
        assert task.result["structuredContent"]["result"] == {"sequence": list(range(50))}
        assert task.result["structuredContent"]["goal_id"] == begun.task_id


@pytest.mark.loops("asyncio", "trio")
async def test_a_task_tells_the_last_feedback():
    takes = TakesTasks()
    async with connect(client={"extensions": [takes]}) as (_, client):
        begun = await begin(client, takes, FOREVER)
        message = None
        while not message:
            task = await ask(client, "tasks/get", begun.task_id)
            message = task.status_message
        assert message.startswith("partial_sequence: [")
        await ask(client, "tasks/cancel", begun.task_id)
        assert (await ended(client, begun.task_id)).status == "cancelled"


async def test_an_aborted_goal_is_a_completed_task_with_a_tool_error():
    takes = TakesTasks()
    async with connect(client={"extensions": [takes]}) as (_, client):
        task = await ended(client, (await begin(client, takes, -1)).task_id)
        assert (task.status, task.result["isError"]) == ("completed", True)
        text = task.result["content"][0]["text"]
        assert text == "the goal was aborted: the arm is stuck at joint 3"


async def test_a_rejected_goal_is_no_task():
    takes = TakesTasks()
    async with connect(client={"extensions": [takes]}) as (_, client):
        reply = await client.call_tool("count", {"order": 1001})
        assert reply.is_error
        assert not takes.tasks


@pytest.mark.loops("asyncio", "trio")
async def test_tasks_survive_a_restart_of_this_server():
    takes = TakesTasks()
    options: Any = {"extensions": [takes]}
    async with open_lab() as (_, node, server):
        async with client_of(server, **options) as client:
            begun = await begin(client, takes, FOREVER)
            short = await begin(client, takes, 3)
            await ended(client, short.task_id)
        async with (
            open_mcp(node, actions=["/count"]) as second,
            client_of(second, **options) as client,
        ):
            task = await ask(client, "tasks/get", begun.task_id)
            assert task.status == "working"
            done = await ask(client, "tasks/get", short.task_id)
            assert done.result["structuredContent"]["result"] == {"sequence": [0, 1, 2]}
            await ask(client, "tasks/update", begun.task_id)
            await ask(client, "tasks/cancel", begun.task_id)
            assert (await ended(client, begun.task_id)).status == "cancelled"


@pytest.mark.parametrize(
    ("method", "task_id"), [("tasks/get", NOBODY), ("tasks/cancel", "zz"), ("tasks/update", "")]
)
async def test_an_unknown_task_is_an_invalid_parameter(method, task_id):
    async with connect(client={"extensions": [TakesTasks()]}) as (_, client):
        with pytest.raises(MCPError, match="there is no task") as caught:
            await ask(client, method, task_id)
    assert caught.value.error.code == INVALID_PARAMS


@pytest.mark.parametrize(("mode", "code"), [("auto", MISSING_CAPABILITY), ("legacy", NO_METHOD)])
async def test_a_client_that_declares_no_tasks_gets_none(mode, code):
    async with connect(mode) as (_, client):
        reply = await client.call_tool("count", {"order": 2})
        assert reply.structured_content["status"] == "SUCCEEDED"
        with pytest.raises(MCPError) as caught:
            await ask(client, "tasks/get", NOBODY)
    assert caught.value.error.code == code


def listening(task_id: str) -> SubscriptionsListenRequest:
    """A request to be told of a task."""
    wanted = SubscriptionFilter.model_validate({"taskIds": [task_id]})
    return SubscriptionsListenRequest(params=SubscriptionsListenRequestParams(notifications=wanted))


async def test_a_client_that_declares_no_tasks_cannot_listen_to_one():
    async with connect() as (_, client):
        with pytest.raises(MCPError) as caught:
            await client.session.send_request(listening(NOBODY), Result)
    assert caught.value.error.code == MISSING_CAPABILITY


async def test_tasks_that_have_ended_are_forgotten_if_there_are_too_many():
    takes = TakesTasks()
    limits = Limits(kept_tasks=1)
    async with connect(client={"extensions": [takes]}, limits=limits) as (_, client):
        ids = []
        for _ in range(3):
            ids.append((await begin(client, takes, 1)).task_id)
            await ended(client, ids[-1])
        # The server of the action still holds the goals, so they are found again.
        assert [(await ended(client, each)).status for each in ids] == ["completed"] * 3


async def test_a_goal_of_somebody_else_is_a_task_too():
    options: Any = {"extensions": [TakesTasks()]}
    async with open_lab() as (_, node, server), client_of(server, **options) as client:
        sender = node.action_client(Fibonacci, "/count")
        async with sender.send_goal(Fibonacci.Goal(0)) as handle:
            task = await ask(client, "tasks/get", handle.goal_id.hex())
            assert task.status == "working"
