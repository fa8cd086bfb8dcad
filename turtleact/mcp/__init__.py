"""Offers a node's actions to language models, as tools of the Model Context Protocol.

This package needs turtleact's extra ``mcp``, whose SDK is slow to import. Other parts of turtleact
import the package only when they need it.
"""

from __future__ import annotations

from turtleact.mcp.catalogue import Limits
from turtleact.mcp.server import McpServer, open_mcp
from turtleact.mcp.serving import Address, open_app, open_http

__all__ = ["Address", "Limits", "McpServer", "open_app", "open_http", "open_mcp"]
