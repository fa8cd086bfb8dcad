"""Publishes the log of a node on ``/rosout``."""

from __future__ import annotations

from turtleact.rclpy.impl.connection import Sender
from turtleact.rclpy.impl.rcutils_logger import Record, Rosout
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages.classes import interface_class
from turtleact.rclpy.messages.codec import encode

__all__ = ["rosout_of"]


def rosout_of(sender: Sender) -> Rosout:
    """Return a function that publishes each record."""
    log: Anything = interface_class("rcl_interfaces/msg/Log")
    time: Anything = interface_class("builtin_interfaces/msg/Time")

    def publish(record: Record) -> None:
        seconds, rest = divmod(record.stamp, 1_000_000_000)
        message = log(
            stamp=time(sec=seconds, nanosec=rest),
            level=int(record.severity),
            name=record.name,
            msg=record.text,
            file=record.file,
            function=record.function,
            line=record.line,
        )
        sender.publish(encode(message, log))

    return publish
