"""Runs goals as MCP Tasks: the call of a tool returns a task at once, while the goal still runs.

This is the MCP extension ``io.modelcontextprotocol/tasks``. Only clients that declare this
extension can use tasks. The id of a task is the id of its goal, so this MCP server need not store
its tasks. After a restart of the MCP server, the server of the action still knows the goal. An
action server with a journal also knows the goal after a restart of the action server.

====================== ==========================================================
goal                   task
====================== ==========================================================
ACCEPTED to CANCELING  working; the last feedback is its status message
SUCCEEDED              completed
ABORTED                completed, with a tool error (``failed`` is for JSON-RPC errors)
CANCELED               cancelled
rejected               no task: the call returns a tool error
====================== ==========================================================

Source: the MCP extension "Tasks" of 2026-07-28.
"""

from __future__ import annotations

import binascii
from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import anyio
from mcp import MCPError
from mcp.types import (
    INVALID_PARAMS,
    METHOD_NOT_FOUND,
    MISSING_REQUIRED_CLIENT_CAPABILITY,
    CallToolResult,
    RequestParams,
)

from turtleact.errors import ServerUnavailable, TurtleactError
from turtleact.goals.server import new_goal_id
from turtleact.goals.state import GoalStatus
from turtleact.mcp.messages import data_of, failure, one_line
from turtleact.tasks import Background

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from mcp.server.lowlevel import Server

    from turtleact.goals.client import ClientGoalHandle
    from turtleact.interfaces import Message
    from turtleact.mcp.goals import AnyClient, Goals
    from turtleact.mcp.messages import Request

__all__ = ["EXTENSION", "FIRST_VERSION", "TASK_IDS", "Tasks", "declares_tasks", "require_tasks"]

EXTENSION: Final = "io.modelcontextprotocol/tasks"
TASK_IDS: Final = "taskIds"
"""The key in ``subscriptions/listen`` with which a client asks to be told of tasks."""

METHODS: Final = ("tasks/get", "tasks/update", "tasks/cancel")
FIRST_VERSION: Final = "2026-07-28"
"""The first version of the protocol in which a reply to a tool call can be a task or a question."""

KEEP_MS: Final = 3_600_000
"""The minimum time to keep an ended task (ms).

If too many tasks have ended, the oldest tasks are removed earlier.
"""

POLL_MS: Final = 500
RETURN: Final = 600.0
"""How long a goal's server may be unreachable before the goal's task ends with an error (s)."""

PAUSE: Final = 0.5
"""How long to wait before looking again for a server that was lost (s, event loop time)."""


class TaskParams(RequestParams):
    """The parameters of ``tasks/get``, ``tasks/update`` and ``tasks/cancel``."""

    task_id: str


class _Task:
    """A goal that runs as a task."""

    def __init__(self, goal_id: bytes) -> None:
        self.goal_id = goal_id
        self.created = self.updated = datetime.now(UTC)
        self.status = "working"
        self.reply: CallToolResult | None = None
        self.latest: Message | None = None
        self.handle: ClientGoalHandle[Any, Any] | None = None
        self.known = anyio.Event()  # the goal was accepted, or never will be
        self.over = anyio.Event()
        self.following: Background | None = None

    def take(self, feedback: Any) -> None:  # noqa: ANN401  # of the action's class
        self.latest = feedback
        self.updated = datetime.now(UTC)

    def end(self, reply: CallToolResult, status: str) -> None:
        self.reply, self.status = reply, status
        self.updated = datetime.now(UTC)
        self.over.set()

    def told(self) -> dict[str, Any]:
        """Return the task in the form that the protocol prescribes."""
        told = {
            "taskId": self.goal_id.hex(),
            "status": self.status,
            "createdAt": self.created.isoformat(),
            "lastUpdatedAt": self.updated.isoformat(),
            "ttlMs": KEEP_MS,
            "pollIntervalMs": POLL_MS,
        }
        latest = self.newest()
        if self.status == "working" and latest is not None:
            told["statusMessage"] = one_line(latest)
        if self.status == "completed" and self.reply is not None:
            told["result"] = self.reply.model_dump(by_alias=True, mode="json", exclude_none=True)
        return told

    def newest(self) -> Message | None:
        """Return the newest feedback that is known."""
        return self.latest or (None if self.handle is None else self.handle.last_feedback)


class Tasks:
    """The tasks of an MCP server.

    If a client asks for an unknown task, this object looks on the graph for the goal with the
    task's id.

    Args:
        goals: Sends the goals, and finds goals that this server did not send, or sent before its
            restart.
    """

    def __init__(self, goals: Goals) -> None:
        self._goals = goals
        self._tasks: dict[bytes, _Task] = {}

    def install(self, server: Server[Any]) -> None:
        """Let an MCP server handle the requests about tasks, and announce the extension."""
        server.extensions[EXTENSION] = {}
        for method, handler in zip(METHODS, (self._get, self._update, self._cancel), strict=True):
            server.add_request_handler(method, TaskParams, handler)

    async def begin(self, client: AnyClient, goal: Message) -> dict[str, Any] | CallToolResult:
        """Send a goal, and return its task once the goal is accepted.

        If this call is cancelled, the goal is canceled, because no client knows the goal's id yet.
        """
        task = _Task(new_goal_id())
        self._start(task, partial(self._send, client, goal, task))
        try:
            await task.known.wait()
        except anyio.get_cancelled_exc_class():
            await self._stop(task)
            raise
        if task.handle is None:
            return task.reply or failure("the goal was not sent: the server is closing")
        task.handle.detach()
        self._remember(task)
        return {"resultType": "task", **task.told()}

    async def aclose(self) -> None:
        """Stop waiting for the ends of goals. The goals themselves go on."""
        for task in self._tasks.values():
            await self._stop(task)

    def _start(self, task: _Task, following: Callable[[], Awaitable[None]]) -> None:
        async def follow() -> None:
            try:
                await following()
            except TurtleactError as error:
                task.end(failure(error), "completed")
            finally:
                task.known.set()

        task.following = Background(follow(), f"task {task.goal_id.hex()}")

    async def _stop(self, task: _Task) -> None:
        if task.following is not None:
            await task.following.aclose()

    async def _send(self, client: AnyClient, goal: Message, task: _Task) -> None:
        with self._goals.place():
            order = client.send_goal(
                goal, goal_id=task.goal_id, feedback_callback=task.take, reattach=RETURN
            )
            async with order as handle:
                await self._follow(task, handle)

    async def _attach(self, client: AnyClient, task: _Task) -> None:
        """Wait for the end of a goal that its server already holds.

        After a restart of the goal's server, attach to the goal again, because the server's journal
        may have kept the goal.
        """
        while task.reply is None:
            try:
                async with client.attach(task.goal_id) as handle:
                    await self._follow(task, handle)
            except ServerUnavailable:
                await anyio.sleep(PAUSE)
                if not await client.wait_for_server(RETURN):
                    raise

    async def _follow(self, task: _Task, handle: ClientGoalHandle[Any, Any]) -> None:
        task.handle = handle
        task.known.set()
        outcome = await handle.outcome()
        is_canceled = outcome.status is GoalStatus.CANCELED
        reply = data_of(handle.goal_id, outcome, task.newest())
        task.end(reply, "cancelled" if is_canceled else "completed")

    def _remember(self, task: _Task) -> None:
        self._tasks[task.goal_id] = task
        ended = [each for each in self._tasks.values() if each.reply is not None]
        for oldest in ended[: max(0, len(ended) - self._goals.limits.kept_tasks)]:
            del self._tasks[oldest.goal_id]

    async def _find(self, ctx: Request, text: str) -> _Task:
        """Return the task with this id.

        Raises:
            MCPError: if there is no such task, if the client has not declared the extension, or if
                the client's version of the protocol has no tasks.
        """
        if ctx.protocol_version < FIRST_VERSION:
            raise MCPError(METHOD_NOT_FOUND, "Method not found", ctx.method)
        require_tasks(ctx)
        try:
            goal_id = binascii.unhexlify(text)
        except ValueError:
            goal_id = b""
        task = self._tasks.get(goal_id) or await self._recover(goal_id)
        if task is None:
            raise MCPError(INVALID_PARAMS, f"there is no task {text[:64]}")
        return task

    async def _recover(self, goal_id: bytes) -> _Task | None:
        """Make a task for an existing goal of an offered action.

        Return None if no server of an offered action has the goal.
        """
        found = await self._goals.find(goal_id)
        if found is None:
            return None
        goal, client = found
        task = _Task(goal_id)
        self._start(task, partial(self._attach, client, task))
        await task.known.wait()
        if goal.status.is_terminal:
            await task.over.wait()  # the result is on its way
        self._remember(task)
        return task

    async def _get(self, ctx: Request, params: TaskParams) -> dict[str, Any]:
        return (await self._find(ctx, params.task_id)).told()

    async def _update(self, ctx: Request, params: TaskParams) -> dict[str, Any]:
        """Answer ``tasks/update``. No task ever asks for input, so the input is ignored."""
        await self._find(ctx, params.task_id)
        return {}

    async def _cancel(self, ctx: Request, params: TaskParams) -> dict[str, Any]:
        """Ask the server to cancel the goal.

        This does not wait for the server. The status of the task shows later whether the server
        agreed.
        """
        task = await self._find(ctx, params.task_id)
        if task.handle is not None and not task.handle.done:
            task.handle.cancel_nowait()
        return {}


def declares_tasks(ctx: Request) -> bool:
    """Whether the client that sent a request has declared the tasks extension."""
    capabilities = ctx.session.client_capabilities
    declared = None if capabilities is None else capabilities.extensions
    return ctx.protocol_version >= FIRST_VERSION and EXTENSION in (declared or {})


def require_tasks(ctx: Request) -> None:
    """Raise an error if the client of a request has not declared the extension.

    Raises:
        MCPError: if the client has not declared the extension.
    """
    if not declares_tasks(ctx):
        needed: dict[str, Any] = {"requiredCapabilities": {"extensions": {EXTENSION: {}}}}
        problem = f"the client has not declared the extension {EXTENSION}"
        raise MCPError(MISSING_REQUIRED_CLIENT_CAPABILITY, problem, needed)
