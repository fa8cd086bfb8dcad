"""Runs a Model Context Protocol server on a node, to offer actions to language models as tools.

The official SDK implements all versions of the protocol. This module answers the clients' requests,
and tells clients when the list of tools changes.

Source: Model Context Protocol, versions 2024-11-05 to 2026-07-28.
"""

from __future__ import annotations

import base64
import json
import secrets
from collections.abc import AsyncIterator, Collection
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Final, cast

import anyio
from mcp import MCPError
from mcp.server.lowlevel import NotificationOptions, Server
from mcp.server.subscriptions import InMemorySubscriptionBus, ListenHandler, ToolsListChanged
from mcp.types import (
    INVALID_PARAMS,
    BlobResourceContents,
    CallToolRequestParams,
    CallToolResult,
    ElicitRequest,
    ElicitRequestFormParams,
    ElicitResult,
    InputRequiredResult,
    ListResourcesResult,
    ListResourceTemplatesResult,
    ListToolsResult,
    PaginatedRequestParams,
    ReadResourceRequestParams,
    ReadResourceResult,
    Resource,
    ResourceTemplate,
    SubscriptionsListenRequestParams,
    SubscriptionsListenResult,
    TextResourceContents,
)

from turtleact.errors import TurtleactError
from turtleact.interfaces import Action, Message
from turtleact.mcp.catalogue import Catalogue, Limits, Names, Offer, ToolEntry, resolved
from turtleact.mcp.goals import Goals
from turtleact.mcp.messages import failure, message_from, plain
from turtleact.mcp.tasks import FIRST_VERSION, TASK_IDS, Tasks, declares_tasks, require_tasks
from turtleact.mcp.tools import Tools, picture, read_topic
from turtleact.tasks import Background, opening

if TYPE_CHECKING:
    from mcp.server.context import CallNext, HandlerResult
    from mcp.server.models import InitializationOptions
    from mcp.server.session import ServerSession

    from turtleact.mcp.messages import Request
    from turtleact.node import Node

__all__ = ["McpServer", "open_mcp"]

NAME: Final = "turtleact"
INSTRUCTIONS: Final = (
    "Each tool that bears the name of a ROS 2 action sends one goal to a robot, and answers when "
    "the goal has ended. Cancel the call to stop the robot. Lengths are in metres, angles in "
    "radians, times in seconds, unless a description says otherwise."
)

GOALS_URI: Final = "ros://goals"
PICTURE_URI: Final = "ros://world.png"
TOPIC_URI: Final = "ros://topic"

TELLING: Final = 1.0
"""The time limit for notifying one session of a change (s, event loop time)."""

SETTLED: Final = 0.05
"""How long to wait after a change of the graph before notifying clients (s, event loop time)."""


QUESTION: Final = "confirm"
FORM: Final = {"type": "object", "properties": {}}
"""The form that the user fills in. It has no fields; the user only answers yes or no."""


class McpServer:
    """A running MCP server. Use `open_mcp` to start one.

    Attributes:
        sdk: The server object of the MCP SDK. Connect a client to it in memory, or run it on a
            transport.
    """

    def __init__(self, node: Node, offer: Offer) -> None:
        self._node = node
        self._offer = offer
        self._catalogue = Catalogue(node, offer)
        self._goals = Goals(node, self._catalogue.actions, offer.limits)
        self._tools = Tools(node, offer, self._goals)
        self._tasks = Tasks(self._goals)
        self._confirmation = Confirmation()
        self._bus = InMemorySubscriptionBus()
        self._listening = ListenHandler(self._bus)
        self._sessions: list[ServerSession] = []
        self.sdk = self._new_server()

    def _new_server(self) -> Server[Any]:
        server: Server[Any] = _Server(
            NAME,
            version=version("turtleact"),
            instructions=INSTRUCTIONS,
            get_tool_input_schema=self._input_schema,
            on_list_tools=self._list_tools,
            on_call_tool=self._call_tool,
            on_list_resources=self._list_resources,
            on_list_resource_templates=self._list_templates,
            on_read_resource=self._read_resource,
            on_subscriptions_listen=self._listen,
        )
        server.middleware.append(self._note_session)
        if not self._offer.is_read_only:
            self._tasks.install(server)
        return server

    # tools

    async def _list_tools(self, _: Request, __: PaginatedRequestParams | None) -> ListToolsResult:
        await self._catalogue.learn()
        return ListToolsResult(tools=[entry.tool for entry in self._catalogue.entries().values()])

    async def _call_tool(
        self, ctx: Request, params: CallToolRequestParams
    ) -> CallToolResult | InputRequiredResult:
        entry = self._catalogue.entries().get(params.name)
        if entry is None:
            return failure(self._why_not_there(params.name))
        try:
            reply = await self._run(ctx, params, entry)
        except TurtleactError as error:
            return failure(error)
        return cast("CallToolResult | InputRequiredResult", reply)  # a task is a dict

    async def _run(
        self, ctx: Request, params: CallToolRequestParams, entry: ToolEntry
    ) -> CallToolResult | InputRequiredResult | dict[str, Any]:
        arguments = params.arguments or {}
        interface = entry.interface
        if interface is None:
            return await self._tools.run(entry.tool, arguments)
        message: Message
        if issubclass(interface, Action):
            what = "Send this goal to"
            message = message_from(interface.Goal, arguments, root="goal")
        else:
            what = "Call the service"
            message = message_from(interface.Request, arguments, root="request")
        if self._offer.asks:
            question = f"{what} {entry.name}?\n{json.dumps(arguments, ensure_ascii=False)}"
            asking = await self._confirmation.ask(ctx, params, question)
            if asking is not None:
                return asking
        if not issubclass(interface, Action):
            return await self._tools.call(entry.name, interface, message)
        client = self._goals.client(entry.name, interface)
        if declares_tasks(ctx):
            return await self._tasks.begin(client, message)
        return await self._goals.run(client, message, ctx.session.report_progress)

    def _why_not_there(self, name: str) -> str:
        tools = ", ".join(self._catalogue.entries())
        return (
            f"there is no tool '{name}' now: the server of its action may have gone, or it is not "
            f"offered. There are: {tools}"
        )

    def _input_schema(self, name: str) -> dict[str, Any] | None:
        entry = self._catalogue.entries().get(name)
        return None if entry is None else entry.tool.input_schema

    # resources

    async def _list_resources(
        self, _: Request, __: PaginatedRequestParams | None
    ) -> ListResourcesResult:
        goals = Resource(
            uri=GOALS_URI,
            name="goals",
            description="The goals that servers hold.",
            mime_type="application/json",
        )
        world = Resource(
            uri=PICTURE_URI,
            name="world",
            description="A picture of the world of turtles.",
            mime_type="image/png",
        )
        return ListResourcesResult(resources=[goals, world])

    async def _list_templates(
        self, _: Request, __: PaginatedRequestParams | None
    ) -> ListResourceTemplatesResult:
        newest = ResourceTemplate(
            uri_template=f"{TOPIC_URI}/{{+name}}",
            name="topic",
            description="The newest message of a topic, such as ros://topic/turtle1/pose.",
            mime_type="application/json",
        )
        return ListResourceTemplatesResult(resource_templates=[newest])

    async def _read_resource(
        self, _: Request, params: ReadResourceRequestParams
    ) -> ReadResourceResult:
        uri = str(params.uri)
        try:
            if uri == PICTURE_URI:
                blob = base64.b64encode(await picture(self._node)).decode()
                shown = BlobResourceContents(uri=uri, mime_type="image/png", blob=blob)
                return ReadResourceResult(contents=[shown])
            text = json.dumps(await self._data(uri), ensure_ascii=False)
        except TurtleactError as error:
            raise MCPError(INVALID_PARAMS, str(error)) from None
        told = TextResourceContents(uri=uri, mime_type="application/json", text=text)
        return ReadResourceResult(contents=[told])

    async def _data(self, uri: str) -> Any:  # noqa: ANN401  # plain values
        if uri == GOALS_URI:
            return (await self._tools.list_goals()).structured_content
        if uri.startswith(f"{TOPIC_URI}/"):
            name = uri.removeprefix(TOPIC_URI)
            return plain(await read_topic(self._node, self._offer, name))
        raise TurtleactError(f"there is no resource {uri[:100]}")

    # changes

    async def _listen(
        self, ctx: Request, params: SubscriptionsListenRequestParams
    ) -> SubscriptionsListenResult:
        """Send a client notifications of changes until it disconnects.

        Changes of tasks are not sent, because clients poll their tasks.

        Raises:
            MCPError: if the client asks for changes of tasks but does not declare the tasks
                extension.
        """
        if TASK_IDS in (params.notifications.model_extra or {}):
            require_tasks(ctx)
        return await self._listening(ctx, params)

    async def _note_session(self, ctx: Request, call_next: CallNext) -> HandlerResult:
        """Remember sessions of older protocol versions, to tell their clients of changes later.

        Clients of newer versions ask for notifications of changes (``subscriptions/listen``).
        """
        reply = await call_next(ctx)
        if ctx.method == "notifications/initialized":
            self._sessions.append(ctx.session)
        return reply

    async def watch(self) -> None:
        """Tell clients whenever the list of tools changes."""
        known = self._shown()
        while True:
            await self._node.transport.wait_for_change()
            await anyio.sleep(SETTLED)  # a node that comes has many endpoints
            shown = self._shown()
            if shown != known:
                known = shown
                await self._tell()

    def _shown(self) -> list[tuple[str, object]]:
        return [(name, entry.interface) for name, entry in self._catalogue.entries().items()]

    async def _tell(self) -> None:
        await self._bus.publish(ToolsListChanged())
        for session in list(self._sessions):
            try:
                with anyio.move_on_after(TELLING):
                    await session.send_tool_list_changed()
            except (MCPError, anyio.ClosedResourceError, anyio.BrokenResourceError):
                self._sessions.remove(session)

    async def aclose(self) -> None:
        """End the notifications to clients, and stop following the goals of tasks.

        The goals go on.
        """
        self._listening.close()
        await self._tasks.aclose()


class Confirmation:
    """Asks the user before a goal is sent or a service is called (MCP's elicitation).

    Up to version 2025-11-25 of the protocol, the server sends the question to the client as a
    request. From version 2026-07-28 on, the server answers the call of a tool with the question and
    a token. The client then repeats the call with the user's answer and the token. The token is
    valid only once, and only for the same tool with the same arguments.

    Source: MCP 2026-07-28, "Elicitation" and "Multi Round-Trip Requests".
    """

    def __init__(self) -> None:
        self._asked: dict[str, tuple[str, object]] = {}

    async def ask(
        self, ctx: Request, params: CallToolRequestParams, question: str
    ) -> InputRequiredResult | None:
        """Ask the user, and return None if the user agrees.

        In protocol version 2026-07-28 and later, the first call returns a reply that contains the
        question. The client then repeats the tool's call with the user's answer.

        Raises:
            TurtleactError: if the user does not agree, or the client cannot ask its user.
        """
        capabilities = ctx.session.client_capabilities
        if capabilities is None or capabilities.elicitation is None:
            raise TurtleactError(
                "this needs the user's confirmation, but the client cannot ask its user: use a "
                "client with elicitation, or a server without --confirm"
            )
        if ctx.protocol_version < FIRST_VERSION:
            reply = await ctx.session.elicit_form(question, FORM, ctx.request_id)
        elif params.request_state is None:
            return self._begin(params, question)
        else:
            reply = self._take(params)
        if reply.action != "accept":
            raise TurtleactError(
                f"the user did not confirm this ({reply.action}): do not try again"
            )
        return None

    def _begin(self, params: CallToolRequestParams, question: str) -> InputRequiredResult:
        token = secrets.token_urlsafe(16)
        self._asked[token] = params.name, params.arguments
        asked = ElicitRequest(
            params=ElicitRequestFormParams(message=question, requested_schema=FORM)
        )
        return InputRequiredResult(input_requests={QUESTION: asked}, request_state=token)

    def _take(self, params: CallToolRequestParams) -> ElicitResult:
        """Return the user's answer to the question about a call with this tool and arguments.

        Raises:
            TurtleactError: if the question was about another call, or has been answered before.
        """
        asked = self._asked.pop(params.request_state or "", None)
        reply = (params.input_responses or {}).get(QUESTION)
        if asked != (params.name, params.arguments) or not isinstance(reply, ElicitResult):
            raise TurtleactError(
                "the confirmation does not belong to this call, or was used before: call again"
            )
        return reply


class _Server(Server[Any]):
    """The SDK's server. It announces to clients with an older protocol that tools may change."""

    def create_initialization_options(
        self,
        notification_options: NotificationOptions | None = None,
        experimental_capabilities: dict[str, dict[str, Any]] | None = None,
        extensions: dict[str, dict[str, Any]] | None = None,
    ) -> InitializationOptions:
        options = notification_options or NotificationOptions(tools_changed=True)
        return super().create_initialization_options(options, experimental_capabilities, extensions)


@opening
async def open_mcp(
    node: Node,
    *,
    actions: Names = (),
    services: Collection[str] = (),
    topics: Names = (),
    read_only: bool = False,
    confirm: bool = False,
    limits: Limits | None = None,
) -> AsyncIterator[McpServer]:
    """Offer a node's graph to language models for the length of a block.

    At the end of the block, calls under way are cancelled together with their goals. Goals that
    were sent as tasks go on.

    Args:
        node: The node that sends the goals.
        actions: The actions that clients may use, or "all".
        services: The services that clients may call.
        topics: The topics that clients may read, or "all".
        read_only: Whether clients may only read: they cannot send or cancel goals, or call
            services.
        confirm: Whether the user must confirm each goal and each service call. A client that cannot
            ask its user can then neither send goals nor call services.
        limits: Limits on the goals, calls and tasks of all clients together.

    Raises:
        InvalidName: if a name breaks ROS 2's rules for names.
    """
    offer = Offer(
        actions=resolved(actions),
        services=resolved(services) or frozenset(),
        topics=resolved(topics),
        is_read_only=read_only,
        asks=confirm,
        limits=limits or Limits(),
    )
    server = McpServer(node, offer)
    watching = Background(server.watch(), "watching the graph for mcp")
    try:
        yield server
    finally:
        await watching.aclose()
        await server.aclose()
