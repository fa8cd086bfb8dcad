"""The two services with which other nodes read and set the log levels of a process."""

from __future__ import annotations

from turtleact.rclpy.impl.logging_severity import LoggingSeverity
from turtleact.rclpy.impl.rcutils_logger import logger_named
from turtleact.rclpy.impl.typing import Anything, ServiceHost
from turtleact.rclpy.messages.classes import interface_class

__all__ = ["LoggingService"]


class LoggingService:
    """Creates a node's services for log levels. Destroying the node destroys the services.

    Args:
        node: The node that offers the services.
    """

    def __init__(self, node: ServiceHost) -> None:
        name = node.get_name()
        for kind, callback in (("Get", self._get), ("Set", self._set)):
            node.create_service(
                interface_class(f"rcl_interfaces/srv/{kind}LoggerLevels"),
                f"{name}/{kind.lower()}_logger_levels",
                callback,
            )

    def _get(self, request: Anything, response: Anything) -> Anything:
        made: Anything = interface_class("rcl_interfaces/msg/LoggerLevel")
        for name in request.names:
            response.levels.append(made(name=name, level=logger_named(name).level))
        return response

    def _set(self, request: Anything, response: Anything) -> Anything:
        made: Anything = interface_class("rcl_interfaces/msg/SetLoggerLevelsResult")
        for wanted in request.levels:
            try:
                logger_named(wanted.name).setLevel(LoggingSeverity(wanted.level))
            except ValueError:
                result = made(successful=False, reason="Failed reason: Invalid logger level.")
            else:
                result = made(successful=True)
            response.results.append(result)
        return response
