"""``snapshot``: a picture of the world on the graph, in a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import anyio

from turtleact.commands.kinds import types_by_name
from turtleact.commands.transcript import say
from turtleact.errors import ServerUnavailable, ServiceTimeout, TurtleactError
from turtleact.sim.world_services import TakeSnapshot

if TYPE_CHECKING:
    from pathlib import Path

    from turtleact.node import Node

__all__ = ["take"]

PATIENCE = 10.0
"""Wall seconds that a world has for a picture: it is drawn in a thread, whatever its clock says."""


async def take(node: Node, path: Path) -> int:
    """Ask the world for a picture, and write it.

    Args:
        node: A node on the graph.
        path: The file; its suffix says what the picture shall be.

    Raises:
        ServerUnavailable: if there is no world on the graph.
        ServiceTimeout: if it does not answer.
        TurtleactError: if there is no picture to be had, or the file cannot be written.
    """
    services = types_by_name(node.transport.endpoints(), "service")
    names = [name for name, types in services.items() if TakeSnapshot.type_name in types]
    if not names:
        problem = "there is no world on this graph: 'turtleact serve' has one"
        raise ServerUnavailable("/world/snapshot", problem, kind="service")
    client = node.service_client(TakeSnapshot, names[0])
    answer = None
    with anyio.move_on_after(PATIENCE):
        await client.wait_for_service()
        answer = await client.call(TakeSnapshot.Request(path.suffix.lower().removeprefix(".")))
    if answer is None:
        raise ServiceTimeout(client.name, PATIENCE)
    if answer.problem:
        raise TurtleactError(answer.problem)
    try:
        path.write_bytes(answer.data)
    except OSError as error:
        problem = f"{path} cannot be written: {error.strerror or error}; name another file"
        raise TurtleactError(problem) from None
    say(f"{path}: {len(answer.data)} bytes\n")
    return 0
