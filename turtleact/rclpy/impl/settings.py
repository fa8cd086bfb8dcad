"""The choice of the graph that a program joins. It is made before rclpy is imported."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

__all__ = ["SETTINGS", "Place", "Settings"]


class Place(msgspec.Struct, frozen=True):
    """Where a graph is.

    Attributes:
        connect: The endpoints of the graph. An empty list means the graph of this machine.
        config: Paths and values of a configuration of Zenoh.
        is_embedded: Whether this process has a world of turtles, too.
        is_alone: Whether the graph is inside this process, so that no other process sees it.
    """

    connect: tuple[str, ...] = ()
    config: Mapping[str, object] = msgspec.field(default_factory=dict)
    is_embedded: bool = False
    is_alone: bool = False


class Settings:
    """The settings of this process.

    Attributes:
        place: Where its graph is.
    """

    def __init__(self) -> None:
        self.place = Place()


#: The only ones: ``rclpy.init()`` names no graph.
SETTINGS = Settings()
