"""Journals: goals on disk, so that they outlive their server's process.

Open a journal, and name it when you serve an action::

    async with (
        turtleact.open_journal("goals.db") as journal,
        turtleact.open_node("robot") as node,
    ):
        node.serve(patrol, journal=journal, on_restart="resume")
"""

from turtleact.journal.database import JournalError, find_goals, prune, read_goals
from turtleact.journal.writer import Journal, open_journal

__all__ = ["Journal", "JournalError", "find_goals", "open_journal", "prune", "read_goals"]
