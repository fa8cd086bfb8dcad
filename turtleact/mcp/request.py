"""The names of the SDK's types that several modules here use."""

from __future__ import annotations

from typing import Any, TypeAlias

from mcp.server.context import ServerRequestContext

__all__ = ["Request"]

Request: TypeAlias = ServerRequestContext[Any, Any]
"""A request of a client, and the way back to the client."""
