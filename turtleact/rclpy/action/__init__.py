"""Actions: their servers and clients, and lists of the actions on the graph."""

from __future__ import annotations

from turtleact.rclpy.action.client import ActionClient
from turtleact.rclpy.action.server import ActionServer, CancelResponse, GoalResponse
from turtleact.rclpy.graph import (
    get_action_client_names_and_types_by_node,
    get_action_names_and_types,
    get_action_server_names_and_types_by_node,
)

__all__ = [
    "ActionClient",
    "ActionServer",
    "CancelResponse",
    "GoalResponse",
    "get_action_client_names_and_types_by_node",
    "get_action_names_and_types",
    "get_action_server_names_and_types_by_node",
]
