"""Stores which graph a program joins. The graph is chosen before rclpy is imported."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

__all__ = ["SETTINGS", "Place", "Settings"]


class Place(msgspec.Struct, frozen=True):
    """Describes the graph to join.

    Attributes:
        connect: The Zenoh endpoints to connect to. Without endpoints, the program joins the graph
            of this machine.
        config: Additional configuration of Zenoh: values by their paths in the configuration.
        is_embedded: Whether this process also runs a world of turtles, an "embedded world".
        is_alone: Whether the graph is inside this process, so that no other process sees it.
    """

    connect: tuple[str, ...] = ()
    config: Mapping[str, object] = msgspec.field(default_factory=dict)
    is_embedded: bool = False
    is_alone: bool = False


class Settings:
    """The settings of this process.

    Attributes:
        place: The graph to join.
    """

    def __init__(self) -> None:
        self.place = Place()


#: The only ones: ``rclpy.init()`` names no graph.
SETTINGS = Settings()
