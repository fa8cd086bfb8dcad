"""Actions as tools for language models: a node as a server of the Model Context Protocol.

This package needs the extra ``mcp``. It serves an ordinary `turtleact.Node` and knows nothing below
that. The rest of turtleact imports it only when it is used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from turtleact.mcp.offer import Limits
from turtleact.mcp.server import McpServer, open_mcp

if TYPE_CHECKING:
    from turtleact.mcp.http import Address, open_app, open_http

__all__ = ["Address", "Limits", "McpServer", "open_app", "open_http", "open_mcp"]


def __getattr__(name: str) -> object:
    """Import what serves HTTP when it is first used."""
    if name in ("Address", "open_app", "open_http"):
        from turtleact.mcp import http

        return getattr(http, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
