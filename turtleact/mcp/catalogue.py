"""Lists the tools of an MCP server: one per offered action or service, and a few fixed ones.

Nothing is offered unless the program or the command line names it (`Offer`). The list follows the
graph: it contains the tool of an action or service only while a server offers that action or
service.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Final, Literal, NamedTuple, TypeAlias, TypeVar

import msgspec
from mcp.types import Tool, ToolAnnotations

from turtleact.interfaces import Action, Service
from turtleact.interfaces.loading import introduction
from turtleact.interfaces.types import REGISTRY
from turtleact.mcp.messages import (
    Schema,
    goal_schema,
    input_schema,
    object_schema,
    output_schema,
)
from turtleact.names import resolve_name
from turtleact.transports.graph import Kind, graph_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from turtleact.node import Node

__all__ = ["Catalogue", "Limits", "Names", "Offer", "ToolEntry", "resolved"]

T = TypeVar("T", bound="Action | Service")

ALL: Final = "all"

Names: TypeAlias = Collection[str] | Literal["all"]
"""Some names of the graph, or every name."""

READS: Final = ToolAnnotations(read_only_hint=True, open_world_hint=True)
STOPS: Final = ToolAnnotations(read_only_hint=False, destructive_hint=False, idempotent_hint=True)
ACTS: Final = ToolAnnotations(read_only_hint=False, destructive_hint=True, open_world_hint=True)


class Limits(msgspec.Struct, frozen=True):
    """Limits on the goals, calls and tasks of all clients together.

    Attributes:
        goals: The maximum number of goals and service calls under way.
        progress_rate: The maximum number of progress messages per second for each goal. Feedback
            beyond this rate is skipped.
        kept_tasks: The maximum number of tasks that are remembered after their goals have ended.
    """

    goals: int = 128
    progress_rate: float = 10.0
    kept_tasks: int = 1000


class Offer(msgspec.Struct, frozen=True):
    """What a server offers to clients.

    Attributes:
        actions: The actions that clients may use; None for every action.
        services: The services that clients may call.
        topics: The topics that clients may read; None for every topic.
        is_read_only: Whether clients may only read: they cannot send or cancel goals, or call
            services.
        asks: Whether the user must confirm each goal and each service call.
        limits: Limits on the goals, calls and tasks of all clients together.
    """

    actions: frozenset[str] | None
    services: frozenset[str]
    topics: frozenset[str] | None
    is_read_only: bool
    asks: bool
    limits: Limits

    def allows_action(self, name: str) -> bool:
        """Whether clients may see the goals of an action.

        If the offer is not read-only, clients may also send goals to the action.
        """
        return self.actions is None or name in self.actions

    def allows_topic(self, name: str) -> bool:
        """Whether clients may read a topic."""
        return self.topics is None or name in self.topics


class ToolEntry(NamedTuple):
    """A tool, and the action or service that it calls.

    Attributes:
        tool: The tool as clients see it.
        name: The name of the action or service; empty if the tool calls neither.
        interface: The class of the action or service; None if the tool calls neither.
    """

    tool: Tool
    name: str = ""
    interface: type[Action] | type[Service] | None = None


def _object(**properties: Schema) -> Schema:
    return object_schema(properties, properties)


GOAL_ID: Final[Schema] = {
    "type": "string",
    "description": "The id of a goal, 32 hexadecimal digits, as list_goals gives it.",
    "pattern": "^[0-9a-f]{32}$",
}
TOPIC: Final[Schema] = {
    "type": "string",
    "description": "The name of a topic, such as /turtle1/pose.",
}
STATUS: Final[Schema] = _object(goal_id={"type": "string"}, status={"type": "string"})
GOALS: Final[Schema] = _object(
    goals={
        "type": "array",
        "items": _object(
            goal_id={"type": "string"},
            action={"type": "string"},
            status={"type": "string"},
            accepted={"type": "string", "description": "When it was accepted, as in ISO 8601."},
        ),
    }
)


FIXED: Final = (
    Tool(
        name="list_goals",
        description="List the goals that servers hold.",
        input_schema=_object(),
        output_schema=GOALS,
        annotations=READS,
    ),
    Tool(
        name="read_topic",
        description="Read the newest message of a topic. Waits a few seconds for one if there is "
        "none yet.",
        input_schema=_object(topic=TOPIC),
        annotations=READS,
    ),
    Tool(
        name="take_picture",
        description="Take a picture of the world of turtles, with their trails, as PNG. It is "
        "11.1 m wide and high; x is to the right, y is up, and the origin is the lower left "
        "corner.",
        input_schema=_object(),
        annotations=READS,
    ),
    Tool(
        name="cancel_goal",
        description="Cancel a goal, whoever has sent it, and wait for its end.",
        input_schema=_object(goal_id=GOAL_ID),
        output_schema=STATUS,
        annotations=STOPS,
    ),
    Tool(
        name="cancel_all_goals",
        description="Cancel all goals of all offered actions, whoever has sent them, and wait for "
        "their ends.",
        input_schema=_object(),
        output_schema=GOALS,
        annotations=STOPS,
    ),
    Tool(
        name="pause_goal",
        description="Pause a goal, and wait until it stands still. Not every goal can be paused.",
        input_schema=_object(goal_id=GOAL_ID),
        output_schema=STATUS,
        annotations=STOPS,
    ),
    Tool(
        name="resume_goal",
        description="Let a paused goal go on.",
        input_schema=_object(goal_id=GOAL_ID),
        output_schema=STATUS,
        annotations=ACTS,
    ),
)
"""The tools that do not depend on the graph. An `Offer` may exclude some of these tools."""


class Catalogue:
    """Lists the tools for the actions and services that the graph contains and the offer allows.

    Args:
        node: The node whose graph is read.
        offer: The actions, services and topics that clients may use.
    """

    def __init__(self, node: Node, offer: Offer) -> None:
        self._node = node
        self._offer = offer
        self._changes = -1, 0
        self._entries: dict[str, ToolEntry] = {}

    def actions(self) -> dict[str, type[Action]]:
        """Return the class of each offered action that has a server now, by the action's name."""
        served = graph_of(self._node.transport).actions
        allowed = {name for name in served if self._offer.allows_action(name)}
        return self._known("action", allowed, Action)

    def _known(self, kind: Kind, names: Collection[str], base: type[T]) -> dict[str, type[T]]:
        """Return the classes of these actions or services that are known or learned, by name."""
        found = {name: self._node.learner.known(name, kind) for name in sorted(names)}
        return {
            name: each
            for name, each in found.items()
            if each is not None and issubclass(each, base)
        }

    async def learn(self) -> None:
        """Learn the types of offered actions and services that are not known here."""
        offer = self._offer

        def wants(kind: Kind, name: str) -> bool:
            is_offered = offer.allows_action if kind == "action" else offer.services.__contains__
            return kind != "topic" and is_offered(name)

        await self._node.learner.learn_all(wants)

    def entries(self) -> Mapping[str, ToolEntry]:
        """Return the tools for the current state of the graph, by name."""
        changes = self._node.transport.changes, len(REGISTRY.learned)
        if changes != self._changes:
            self._changes = changes
            self._entries = self._list()
        return self._entries

    def _list(self) -> dict[str, ToolEntry]:
        entries = [ToolEntry(tool) for tool in FIXED if self._has_use_for(tool)]
        if not self._offer.is_read_only:
            services = self._known("service", self._offer.services, Service)
            entries += [_service_tool(name, each) for name, each in services.items()]
            entries += [_action_tool(name, each) for name, each in self.actions().items()]
        return {entry.tool.name: entry for entry in entries}

    def _has_use_for(self, tool: Tool) -> bool:
        if tool.name == "read_topic":
            return self._offer.topics is None or bool(self._offer.topics)
        return tool.annotations is READS or not self._offer.is_read_only


def resolved(names: Names) -> frozenset[str] | None:
    """Return these names as absolute names; None for "all".

    Raises:
        InvalidName: if a name breaks ROS 2's rules for names.
    """
    return None if names == ALL else frozenset(resolve_name(each) for each in names)


def _action_tool(name: str, action_type: type[Action]) -> ToolEntry:
    about = f"Send a goal to the action {name} ({action_type.type_name}) and wait for its end."
    schemas = input_schema(action_type.Goal), goal_schema(action_type)
    return _entry(name, action_type, about, *schemas)


def _service_tool(name: str, service_type: type[Service]) -> ToolEntry:
    about = f"Call the service {name} ({service_type.type_name})."
    schemas = input_schema(service_type.Request), output_schema(service_type.Response)
    return _entry(name, service_type, about, *schemas)


def _entry(
    name: str, interface: type[Action] | type[Service], about: str, takes: Schema, gives: Schema
) -> ToolEntry:
    """Return the tool of an action or service. ``turtle1.spin`` is that of ``/turtle1/spin``."""
    tool = Tool(
        name=name.strip("/").replace("/", "."),
        title=name,
        description=" ".join(filter(None, (_said(interface), about))),
        input_schema=takes,
        output_schema=gives,
        annotations=ACTS,
    )
    return ToolEntry(tool, name, interface)


def _said(interface: type[Action] | type[Service]) -> str:
    """Return the description that the author of an interface has written.

    The result is empty for a generated description, which contains the interface's full name.
    """
    text = introduction(interface)
    return "" if interface.type_name in text else text.replace("``", "`")
