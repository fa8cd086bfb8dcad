"""Decides which rclpy a program gets: the genuine one, or turtleact's.

A program uses modules of only one rclpy. The genuine rclpy is used if Python can import it and load
the type support of a message, unless the user asks for turtleact's rclpy. A separate process tries
the import and the loading, because an import that fails halfway cannot be undone.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from typing import Final, Literal, TypeAlias, get_args

import msgspec

from turtleact.errors import UsageError

__all__ = ["FACES", "SETTINGS", "Face", "JoinOptions", "Settings", "chosen_face"]


class JoinOptions(msgspec.Struct, frozen=True):
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
        self.place = JoinOptions()


#: The only ones: ``rclpy.init()`` names no graph.
SETTINGS = Settings()


Face: TypeAlias = Literal["auto", "turtleact", "ros"]

FACES: Final = get_args(Face)

PATIENCE = 20.0
"""How long the trial import of the genuine rclpy may take (s)."""

ATTEMPT: Final = (
    "import rclpy\n"
    "from builtin_interfaces.msg import Time\n"
    "type(Time).__import_type_support__()\n"
    "print(rclpy.get_rmw_implementation_identifier())\n"
)


def chosen_face(asked: str) -> tuple[Literal["turtleact", "ros"], str]:
    """Return the name of the rclpy to use, and the name of its middleware.

    For turtleact's rclpy, the name of the middleware is an empty string.

    Args:
        asked: The rclpy that the user has asked for: one of `FACES`.

    Raises:
        UsageError: if ``asked`` is not one of `FACES`, or if ``asked`` is "ros" and the genuine
            rclpy cannot be imported.
    """
    if asked not in FACES:
        raise UsageError(f"--face is one of {', '.join(FACES)}, not '{asked}'")
    if asked == "turtleact":
        return "turtleact", ""
    middleware = _genuine()
    if middleware:
        return "ros", middleware
    if asked == "ros":
        raise UsageError("--face ros: the genuine rclpy cannot be imported; source a ROS workspace")
    return "turtleact", ""


def _genuine() -> str:
    """Return the name of the genuine rclpy's middleware.

    Return an empty string if the genuine rclpy cannot be imported.
    """
    from importlib.machinery import PathFinder

    if PathFinder.find_spec("rclpy") is None:  # saves starting a process
        return ""
    try:
        tried = subprocess.run(  # noqa: S603  # this Python, with the text above
            [sys.executable, "-c", ATTEMPT],
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return "" if tried.returncode else tried.stdout.strip()
