"""Makes and sends the messages and requests of ``topic pub``, ``service call`` and ``snapshot``.

Source: ros2cli ``ros2topic/verb/pub.py`` and ``ros2service/verb/call.py``; recordings of ROS 2
Jazzy for the wording of the output.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, cast

import anyio

from turtleact.commands.graph import chosen_class
from turtleact.commands.message_text import python_text
from turtleact.commands.output import note, say
from turtleact.errors import ServerUnavailable, ServiceTimeout, TurtleactError
from turtleact.interfaces import Message, Service, from_dict, from_text, stamp_of
from turtleact.interfaces.definition import nearest
from turtleact.interfaces.text import Document, tree_of
from turtleact.interfaces.types import fields, nested_classes
from turtleact.names import resolve_name
from turtleact.sim.world_services import TakeSnapshot
from turtleact.tasks.clock import within
from turtleact.transports.graph import types_by_name

if TYPE_CHECKING:
    from pathlib import Path

    from turtleact.commands.message_text import GoalText
    from turtleact.node import Node
    from turtleact.node.services import ServiceType
    from turtleact.node.topics import Publisher
    from turtleact.transports.base import EndpointKind

__all__ = ["MessageMaker", "call", "message_maker", "take", "wait_for_subscriptions"]

PATIENCE = 5.0
"""How long to wait until a subscription on the graph can be reached (s, by the graph's clock)."""


class MessageMaker(NamedTuple):
    """Makes the messages of a topic from a text, each with the time at which it is made.

    Attributes:
        node: The node whose clock tells the time.
        topic: The full name of the topic.
        message_type: The type of the messages.
        tree: The plain values in the text.
    """

    node: Node
    topic: str
    message_type: type[Message]
    tree: object

    def __call__(self) -> Message:
        """Make a message. In its headers, `now` and `auto` stand for the current time."""
        timed = _timed(self.tree, self.message_type, self.node.clock.now())
        return from_dict(self.message_type, timed, root="message")  # type: ignore[arg-type]  # it checks that


async def message_maker(
    node: Node, name: str, type_name: str | None, text: GoalText
) -> MessageMaker:
    """Read the text of a message for a topic. Print a note if the topic has another type.

    Raises:
        InvalidName: if the name breaks ROS 2's rules.
        TurtleactError: if the topic's type is unknown.
        InvalidMessage: if the message does not fit the type.
    """
    name = resolve_name(name)
    message_type = await chosen_class(node, "topic", Message, name, type_name)
    tree = tree_of(Document(text.text, "message", text.source, allow_nonfinite=True))
    make = MessageMaker(node, name, message_type, tree)
    make()  # an error is raised before waiting for subscriptions
    types = types_by_name(node.transport.endpoints(), "topic", hidden=True).get(name, ())
    if types and message_type.type_name not in types:
        others = " and ".join(types)
        note(f"topic '{name}' is of type {others}, so no node receives {message_type.type_name}")
    return make


async def wait_for_subscriptions(
    node: Node, publisher: Publisher[Message], message_type: type[Message], least: int
) -> None:
    """Wait until a topic has some subscriptions of this type, and until they can be reached."""
    type_name = message_type.type_name

    def count() -> int:
        wanted = ("subscription", publisher.topic, type_name)
        endpoints = node.transport.endpoints()
        return sum((each.kind, each.name, each.type_name) == wanted for each in endpoints)

    if count() < least:
        say(f"Waiting for at least {least} matching subscription(s)...\n")
        _suggest(node, "subscription", publisher.topic, type_name)
    while count() < least:
        await node.transport.wait_for_change()
    async with within(PATIENCE, node.clock):  # a known subscription is reached a little later
        while count() and not publisher.has_subscriptions:
            await node.transport.wait_for_change()


def _suggest(node: Node, kind: EndpointKind, name: str, type_name: str) -> None:
    """Suggest a similar name on the graph, because the user may have mistyped ``name``."""
    endpoints = node.transport.endpoints()
    known = {each.name for each in endpoints if (each.kind, each.type_name) == (kind, type_name)}
    if near := nearest(name, known):
        note(f"did you mean '{near}'?")


def _timed(tree: object, message_type: type[Message], now: int) -> object:
    """Return a message's plain values, with the current time filled in.

    The time replaces the text ``auto`` of a header and the text ``now`` of a stamp.
    """
    if not isinstance(tree, dict):
        return tree
    stamp = stamp_of(now)
    present = {"sec": stamp.sec, "nanosec": stamp.nanosec}
    timed = dict(tree)
    for field, nested in zip(fields(message_type), nested_classes(message_type), strict=True):
        said = (field.type.name, tree.get(field.name))
        if said == ("std_msgs/msg/Header", "auto"):
            timed[field.name] = {"stamp": present}
        elif said == ("builtin_interfaces/msg/Time", "now"):
            timed[field.name] = present
        elif nested is not None and field.name in tree and not field.type.is_sequence:
            timed[field.name] = _timed(tree[field.name], nested, now)
    return timed


async def call(
    node: Node, name: str, type_name: str | None, text: GoalText, *, rate: float | None
) -> int:
    """Call a service as soon as it exists, and return the exit status.

    Args:
        node: A node on the graph.
        name: The service's name.
        type_name: The name of the service's type; None to look it up on the graph.
        text: The text of the request.
        rate: How often to repeat the call (Hz, by the clock of the graph); None to call the service
            once.

    Raises:
        InvalidName: if the name breaks ROS 2's rules.
        TurtleactError: if the service's type is unknown.
        InvalidMessage: if the request does not fit the type.
        ServerUnavailable: if the service has another type, or its server goes away.
        ServiceError: if the service's handler fails.
    """
    full_name = resolve_name(name)
    service_type = await chosen_class(node, "service", Service, full_name, type_name)
    request = from_text(
        service_type.Request, text.text, root="request", source=text.source, allow_nonfinite=True
    )
    client = node.service_client(cast("ServiceType[Message, Message]", service_type), full_name)
    types = types_by_name(node.transport.endpoints(), "service", hidden=True).get(full_name, ())
    if types and service_type.type_name not in types:
        problem = f"it is served as {' and '.join(types)}, not as {service_type.type_name}"
        raise ServerUnavailable(full_name, problem, kind="service")
    if not types:
        say("waiting for service to become available...\n")
        _suggest(node, "service", full_name, service_type.type_name)
    await client.wait_for_service()
    while True:
        begun = node.clock.time()
        say(f"requester: making request: {python_text(request)}\n\n")
        response = await client.call(request)
        say(f"response:\n{python_text(response)}\n\n")
        if rate is None:
            return 0
        await node.clock.sleep_until(begun + 1 / rate)


PICTURE_PATIENCE = 10.0
"""How long to wait for a world's picture, which a thread draws (s, wall clock)."""


async def take(node: Node, path: Path) -> int:
    """Ask the world for a picture, and write the picture to a file.

    Args:
        node: A node on the graph.
        path: The file to write. Its suffix, ``.png`` or ``.svg``, selects the format of the
            picture.

    Raises:
        ServerUnavailable: if there is no world on the graph.
        ServiceTimeout: if the world does not answer.
        TurtleactError: if the world cannot make the picture, or the file cannot be written.
    """
    services = types_by_name(node.transport.endpoints(), "service")
    names = [name for name, types in services.items() if TakeSnapshot.type_name in types]
    if not names:
        problem = "there is no world on this graph: 'turtleact serve' starts one"
        raise ServerUnavailable("/world/snapshot", problem, kind="service")
    client = node.service_client(TakeSnapshot, names[0])
    answer = None
    with anyio.move_on_after(PICTURE_PATIENCE):
        await client.wait_for_service()
        answer = await client.call(TakeSnapshot.Request(path.suffix.lower().removeprefix(".")))
    if answer is None:
        raise ServiceTimeout(client.name, PICTURE_PATIENCE)
    if answer.problem:
        raise TurtleactError(answer.problem)
    try:
        path.write_bytes(answer.data)
    except OSError as error:
        problem = f"{path} cannot be written: {error.strerror or error}; name another file"
        raise TurtleactError(problem) from None
    say(f"{path}: {len(answer.data)} bytes\n")
    return 0
