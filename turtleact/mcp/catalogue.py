"""Lists the tools of an MCP server: one per offered action or service, and a few fixed ones.

The list follows the graph: it contains the tool of an action or service only while a server offers
that action or service.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple, TypeVar

from mcp.types import Tool, ToolAnnotations

from turtleact.interfaces import Action, Service
from turtleact.interfaces.comments import introduction
from turtleact.interfaces.types import REGISTRY
from turtleact.mcp.offer import Offer, tool_name
from turtleact.mcp.replies import goal_schema
from turtleact.mcp.schema import Schema, input_schema, output_schema
from turtleact.transports.graph import Kind, graph_of

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from turtleact.node import Node

__all__ = ["FIXED", "Catalogue", "ToolEntry"]

T = TypeVar("T", bound="Action | Service")

READS: Final = ToolAnnotations(read_only_hint=True, open_world_hint=True)
STOPS: Final = ToolAnnotations(read_only_hint=False, destructive_hint=False, idempotent_hint=True)
ACTS: Final = ToolAnnotations(read_only_hint=False, destructive_hint=True, open_world_hint=True)


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
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


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


def _fixed(
    name: str, description: str, takes: Schema, gives: Schema | None, hints: ToolAnnotations
) -> Tool:
    return Tool(
        name=name,
        description=description,
        input_schema=takes,
        output_schema=gives,
        annotations=hints,
    )


FIXED: Final = (
    _fixed("list_goals", "List the goals that servers hold.", _object(), GOALS, READS),
    _fixed(
        "read_topic",
        "Read the newest message of a topic. Waits a few seconds for one if there is none yet.",
        _object(topic=TOPIC),
        None,
        READS,
    ),
    _fixed(
        "take_picture",
        "Take a picture of the world of turtles, with their trails, as PNG. It is 11.1 m wide and "
        "high; x is to the right, y is up, and the origin is the lower left corner.",
        _object(),
        None,
        READS,
    ),
    _fixed(
        "cancel_goal",
        "Cancel a goal, whoever has sent it, and wait for its end.",
        _object(goal_id=GOAL_ID),
        STATUS,
        STOPS,
    ),
    _fixed(
        "cancel_all_goals",
        "Cancel all goals of all offered actions, whoever has sent them, and wait for their ends.",
        _object(),
        GOALS,
        STOPS,
    ),
    _fixed(
        "pause_goal",
        "Pause a goal, and wait until it stands still. Not every goal can be paused.",
        _object(goal_id=GOAL_ID),
        STATUS,
        STOPS,
    ),
    _fixed("resume_goal", "Let a paused goal go on.", _object(goal_id=GOAL_ID), STATUS, ACTS),
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
        self._made: dict[tuple[str, str], ToolEntry] = {}

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
        found = {tool.name: ToolEntry(tool) for tool in FIXED if self._has_use_for(tool)}
        if self._offer.is_read_only:
            return found
        for name, action_type in self.actions().items():
            self._add(found, self._entry(name, action_type), "action")
        for name, service_type in self._known("service", self._offer.services, Service).items():
            self._add(found, self._entry(name, service_type), "service")
        return found

    def _has_use_for(self, tool: Tool) -> bool:
        if tool.name == "read_topic":
            return self._offer.topics is None or bool(self._offer.topics)
        return tool.annotations is READS or not self._offer.is_read_only

    @staticmethod
    def _add(found: dict[str, ToolEntry], entry: ToolEntry, kind: str) -> None:
        """Add a tool. If another tool has the same name, append the kind to the new tool's name."""
        name = entry.tool.name
        if name in found:
            name = f"{name}.{kind}"
            entry = entry._replace(tool=entry.tool.model_copy(update={"name": name}))
        found[name] = entry

    def _entry(self, name: str, interface: type[Action] | type[Service]) -> ToolEntry:
        """Return the tool of an action or service.

        A tool is made only once, because its schemas do not change.
        """
        key = name, interface.type_name
        if key not in self._made:
            if issubclass(interface, Action):
                tool = _action_tool(name, interface)
            else:
                tool = _service_tool(name, interface)
            self._made[key] = ToolEntry(tool, name, interface)
        return self._made[key]


def _action_tool(name: str, action_type: type[Action]) -> Tool:
    about = f"Send a goal to the action {name} ({action_type.type_name}) and wait for its end."
    return Tool(
        name=tool_name(name),
        title=name,
        description=" ".join(filter(None, (_said(action_type), about))),
        input_schema=input_schema(action_type.Goal),
        output_schema=goal_schema(action_type),
        annotations=ACTS,
    )


def _service_tool(name: str, service_type: type[Service]) -> Tool:
    about = f"Call the service {name} ({service_type.type_name})."
    return Tool(
        name=tool_name(name),
        title=name,
        description=" ".join(filter(None, (_said(service_type), about))),
        input_schema=input_schema(service_type.Request),
        output_schema=output_schema(service_type.Response),
        annotations=ACTS,
    )


def _said(interface: type[Action] | type[Service]) -> str:
    """Return the description that the author of an interface has written.

    The result is empty for a generated description, which contains the interface's full name.
    """
    text = introduction(interface)
    return "" if interface.type_name in text else text.replace("``", "`")
