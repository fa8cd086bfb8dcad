"""``service call``: a request of the user's own, and the response to it.

Source: ros2cli ``ros2service/verb/call.py``; recordings of Jazzy for the words.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from turtleact.commands.graph import chosen_class
from turtleact.commands.kinds import types_by_name
from turtleact.commands.python_text import python_text
from turtleact.commands.transcript import say
from turtleact.errors import ServerUnavailable
from turtleact.interfaces import Message, Service, from_text
from turtleact.names import resolve_name

if TYPE_CHECKING:
    from turtleact.commands.goal_text import GoalText
    from turtleact.node import Node
    from turtleact.services import ServiceType

__all__ = ["call"]


async def call(
    node: Node, name: str, type_name: str | None, text: GoalText, *, rate: float | None
) -> int:
    """Call a service, once it is there; again and again if a rate is given.

    Args:
        node: A node on the graph.
        name: The service.
        type_name: Its type, or None for what the graph says.
        text: The request.
        rate: Calls a second, by the clock of the graph; None for one call.

    Raises:
        InvalidName: if the name breaks ROS 2's rules.
        TurtleactError: if the service's type is not known.
        InvalidMessage: if the request does not fit it.
        ServerUnavailable: if the service is there under another type, or goes away.
        ServiceError: if it fails.
    """
    full_name = resolve_name(name)
    service_type = chosen_class(node, "service", Service, full_name, type_name)
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
    await client.wait_for_service()
    while True:
        begun = node.clock.time()
        say(f"requester: making request: {python_text(request)}\n\n")
        response = await client.call(request)
        say(f"response:\n{python_text(response)}\n\n")
        if rate is None:
            return 0
        await node.clock.sleep_until(begun + 1 / rate)
