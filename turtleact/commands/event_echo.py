"""Implements ``action echo`` and ``service echo``, which print requests and responses.

A client or server publishes its requests and responses only if service introspection is on
(`turtleact.goals.service_server`). ``action echo`` also prints the feedback and the status, which
every action server publishes.

Source: ros2cli ``ros2service/verb/echo.py`` and ``ros2action/verb/echo.py`` (Kilted).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import anyio

from turtleact.commands.graph import chosen_class
from turtleact.commands.output import note, say_message
from turtleact.interfaces import Action, Message, Service, implied
from turtleact.interfaces.classes import event_message
from turtleact.interfaces.standard import CancelGoal, GoalStatusArray, ServiceEventInfo
from turtleact.names import EVENT_SUFFIX, action_names, event_topic, resolve_name
from turtleact.tasks.clock import within
from turtleact.transports import QoS
from turtleact.transports.base import STATUS_QOS

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from turtleact.commands.message_text import Style
    from turtleact.node import Node

__all__ = ["PARTS", "echo_action", "echo_service"]

PARTS: Final = (
    "GOAL_SERVICE",
    "CANCEL_SERVICE",
    "RESULT_SERVICE",
    "FEEDBACK_TOPIC",
    "STATUS_TOPIC",
)
"""The names that ``ros2 action echo`` prints for the parts of an action."""

READ_QOS: Final = QoS(depth=1000)
"""The QoS for reading. Up to 1000 messages are kept while the output is blocked."""

UNHEARD: Final = 1.0
"""How long to wait for a publisher of events before a note is printed (s, graph clock)."""

EVENTS: Final = {
    ServiceEventInfo.REQUEST_SENT: "REQUEST_SENT",
    ServiceEventInfo.REQUEST_RECEIVED: "REQUEST_RECEIVED",
    ServiceEventInfo.RESPONSE_SENT: "RESPONSE_SENT",
    ServiceEventInfo.RESPONSE_RECEIVED: "RESPONSE_RECEIVED",
}

DONE: Final = 0


class Source(NamedTuple):
    """A topic to print.

    Attributes:
        topic: The name of the topic.
        message_type: The type of the topic's messages.
        heading: A name to print above each message; empty for none.
        qos: The quality of service of the subscription.
    """

    topic: str
    message_type: type[Message]
    heading: str = ""
    qos: QoS = READ_QOS


async def echo_service(node: Node, name: str, type_name: str | None, style: Style) -> int:
    """Print the requests and responses of a service until the node is closed.

    Raises:
        InvalidName: if the name breaks ROS 2's rules for names.
        TurtleactError: if the type of the service is unknown.
    """
    name = resolve_name(name)
    service = await chosen_class(node, "service", Service, name, type_name)
    events = Source(event_topic(name), event_message(service))
    return await _print_all(node, [events], style)


async def echo_action(
    node: Node, name: str, type_name: str | None, style: Style, parts: Collection[str] = PARTS
) -> int:
    """Print the requests, responses, feedback and status of an action until the node is closed.

    ``parts`` are the parts of the action to print, by their names in `PARTS`.

    Raises:
        InvalidName: if the name breaks ROS 2's rules for names.
        TurtleactError: if the type of the action is unknown.
    """
    name = resolve_name(name)
    action = await chosen_class(node, "action", Action, name, type_name)
    names, kinds = action_names(name), implied(action)
    sources = (
        Source(event_topic(names.send_goal), event_message(kinds.send_goal), "GOAL_SERVICE"),
        Source(event_topic(names.cancel_goal), event_message(CancelGoal), "CANCEL_SERVICE"),
        Source(event_topic(names.get_result), event_message(kinds.get_result), "RESULT_SERVICE"),
        Source(names.feedback, kinds.feedback_message, "FEEDBACK_TOPIC"),
        Source(names.status, GoalStatusArray, "STATUS_TOPIC", STATUS_QOS),
    )
    wanted = [each for each in sources if each.heading in parts]
    return await _print_all(node, wanted, style)


async def _print_all(node: Node, sources: Sequence[Source], style: Style) -> int:
    """Print the messages of several topics as they arrive."""

    async def show(source: Source) -> None:
        async for message in node.subscription(source.message_type, source.topic, source.qos):
            say_message(_text(source, message, style))

    topics = [each.topic for each in sources if each.topic.endswith(EVENT_SUFFIX)]
    async with anyio.create_task_group() as beside:
        for source in sources:
            beside.start_soon(show, source)
        if topics:
            beside.start_soon(_note_silence, node, topics)
    return DONE


async def _note_silence(node: Node, topics: Sequence[str]) -> None:
    """Print a note if none of the event topics has a publisher."""
    async with within(UNHEARD, node.clock):
        while not any(node.count_publishers(each) for each in topics):
            await node.transport.wait_for_change()
        return
    note(
        f"nobody publishes {', '.join(topics)}: turn on introspection at the server or client, for "
        "example with 'turtleact serve --introspection contents'"
    )


def _text(source: Source, message: Message, style: Style) -> str:
    values: Any = style.values(message)
    if not style.csv and "info" in values:
        kind = values["info"]["event_type"]
        values["info"]["event_type"] = EVENTS.get(kind, kind)
    heading = f"interface: {source.heading}\n" if source.heading else ""
    return f"{heading}{style.text(values)}"
