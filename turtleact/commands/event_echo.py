"""Implements ``action echo`` and ``service echo``, which print requests and responses.

A client or server publishes its requests and responses only if service introspection is on
(`turtleact.goals.introspection`). ``action echo`` also prints the feedback and the status, which
every action server publishes.

Source: ros2cli ``ros2service/verb/echo.py`` and ``ros2action/verb/echo.py`` (Kilted).
"""

from __future__ import annotations

from contextlib import ExitStack, closing
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
    from turtleact.node.topics import Subscription
    from turtleact.transports.base import Closeable

__all__ = ["PARTS", "Order", "echo_action", "echo_service"]

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


class Order(NamedTuple):
    """The user's choice of what to print.

    Attributes:
        name: The name of the action or service.
        type_name: The type of the action or service; None for the type on the graph.
        style: How messages are printed.
        parts: The parts of the action to print, by the names in `PARTS`.
    """

    name: str
    type_name: str | None
    style: Style
    parts: Collection[str] = PARTS


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


async def echo_service(node: Node, order: Order) -> int:
    """Print the requests and responses of a service until the node is closed.

    Raises:
        InvalidName: if the name breaks ROS 2's rules for names.
        TurtleactError: if the type of the service is unknown.
    """
    name = resolve_name(order.name)
    service = await chosen_class(node, "service", Service, name, order.type_name)
    events = Source(event_topic(name), event_message(service))
    return await _print_all(node, [events], order.style)


async def echo_action(node: Node, order: Order) -> int:
    """Print the requests, responses, feedback and status of an action until the node is closed.

    Raises:
        InvalidName: if the name breaks ROS 2's rules for names.
        TurtleactError: if the type of the action is unknown.
    """
    name = resolve_name(order.name)
    action = await chosen_class(node, "action", Action, name, order.type_name)
    names, kinds = action_names(name), implied(action)
    sources = (
        Source(event_topic(names.send_goal), event_message(kinds.send_goal), "GOAL_SERVICE"),
        Source(event_topic(names.cancel_goal), event_message(CancelGoal), "CANCEL_SERVICE"),
        Source(event_topic(names.get_result), event_message(kinds.get_result), "RESULT_SERVICE"),
        Source(names.feedback, kinds.feedback_message, "FEEDBACK_TOPIC"),
        Source(names.status, GoalStatusArray, "STATUS_TOPIC", STATUS_QOS),
    )
    wanted = [each for each in sources if each.heading in order.parts]
    return await _print_all(node, wanted, order.style)


async def _print_all(node: Node, sources: Sequence[Source], style: Style) -> int:
    """Print the messages of several topics in the order of their arrival."""
    send, receive = anyio.create_memory_object_stream[str](float("inf"))

    def show(source: Source, message: Any) -> bool:  # noqa: ANN401  # of any type
        send.send_nowait(_text(source, message, style))
        return True

    async with anyio.create_task_group() as beside, send, receive:
        opened_all: list[Subscription[Any]] = []
        with ExitStack() as stack:
            for source in sources:
                opened = node.subscription(source.message_type, source.topic, source.qos)
                opened.taker = lambda message, source=source: show(source, message)
                for early in opened.drain():  # latched, so they came before the line above
                    show(source, early)
                opened_all.append(stack.enter_context(closing(opened)))
            topics = [each.topic for each in sources if each.topic.endswith(EVENT_SUFFIX)]
            if topics:
                beside.start_soon(_note_silence, node, topics)
            beside.start_soon(_close_with, opened_all[0], send)
            async for text in receive:
                say_message(text)
        beside.cancel_scope.cancel()
    return DONE


async def _close_with(subscription: Subscription[Any], stream: Closeable) -> None:
    """Close ``stream`` when ``subscription`` is closed.

    The subscription yields no messages here, because it passes all messages to its ``taker``.
    """
    async for _ in subscription:
        pass
    stream.close()


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
