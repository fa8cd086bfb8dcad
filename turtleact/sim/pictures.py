"""Pictures of a world for other processes: the service ``~/snapshot``.

Knows what to ask and answer; the pictures are made in `snapshot`, in a thread.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import anyio.to_thread

from turtleact.interfaces import Message, Service, string
from turtleact.sim.snapshot import Snapshot, to_png, to_svg

if TYPE_CHECKING:
    from collections.abc import Callable

    from turtleact.node import Node

__all__ = ["FORMATS", "Pictures", "TakeSnapshot"]

FORMATS: Final[dict[str, Callable[[Snapshot], bytes]]] = {
    "png": to_png,
    "svg": lambda snapshot: to_svg(snapshot).encode(),
}
"""What a picture can be."""


class TakeSnapshot(Service, type_name="turtleact_interfaces/srv/TakeSnapshot"):
    """Makes a picture of the world as it looks now."""

    class Request(Message):
        """What it shall be.

        Attributes:
            format: ``png`` or ``svg``.
        """

        format: string = "png"

    class Response(Message):
        """The picture.

        Attributes:
            data: What is in the file; empty if there is none.
            problem: Why there is none; empty if there is one.
        """

        data: bytes = b""
        problem: string = ""


class Pictures:
    """The service; open as long as the node.

    Args:
        node: Where it is opened.
        look: How the world looks now.
    """

    def __init__(self, node: Node, look: Callable[[], Snapshot]) -> None:
        self._look = look
        node.service(TakeSnapshot, "~/snapshot", self._take)

    async def _take(self, request: TakeSnapshot.Request) -> TakeSnapshot.Response:
        make = FORMATS.get(request.format)
        if make is None:
            problem = f"there is no picture as '{request.format}': ask for {' or '.join(FORMATS)}"
            return TakeSnapshot.Response(problem=problem)
        return TakeSnapshot.Response(await anyio.to_thread.run_sync(make, self._look()))
