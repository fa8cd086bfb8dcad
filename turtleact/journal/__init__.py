"""Journals keep goals on disk, so that the goals outlive their server's process.

Open a journal, and pass it to ``serve``::

    async with (
        turtleact.open_journal("goals.db") as journal,
        turtleact.open_node("robot") as node,
    ):
        node.serve(patrol, journal=journal, on_restart="resume")
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from turtleact.journal.database import JournalError, find_goals, prune, read_goals

if TYPE_CHECKING:
    from turtleact.journal.writer import Journal, open_journal

__all__ = ["Journal", "JournalError", "find_goals", "open_journal", "prune", "read_goals"]


def __getattr__(name: str) -> object:
    """Import the writer on first use, because programs that only read a journal do not need it."""
    if name not in ("Journal", "open_journal"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.writer"), name)
