"""Offers a node's actions to language models, as tools of the Model Context Protocol.

This package needs turtleact's extra ``mcp``. Other parts of turtleact import the package only when
they need it. The official SDK is slow to import. Therefore the SDK is imported only when one of
this package's public names is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from turtleact.mcp.http import Address, open_app, open_http
    from turtleact.mcp.offer import Limits
    from turtleact.mcp.server import McpServer, open_mcp

__all__ = ["Address", "Limits", "McpServer", "open_app", "open_http", "open_mcp"]

MODULES: Final = {
    "Address": "http",
    "Limits": "offer",
    "McpServer": "server",
    "open_app": "http",
    "open_http": "http",
    "open_mcp": "server",
}


def __getattr__(name: str) -> object:
    """Import a public name when it is first used."""
    if name not in MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{MODULES[name]}"), name)
