"""What Zenoh complains of, in words for people. Pure.

Source: the texts of eclipse-zenoh 1.10.
"""

from __future__ import annotations

import re

from turtleact.transports.rmw_zenoh.config import SessionConfig

__all__ = ["why_not_open", "words"]

SOURCE_LINE = re.compile(r" at /\S+:[0-9]+\.?")

#: In brackets stands what happened, behind the address; before them what was tried, with it, too.
INNER = re.compile(r".*\[(?:\S+: )?(.*)\]")


def words(text: str) -> str:
    """What Zenoh says, without the lines of its source that it names, in brackets or behind.

    >>> words("Unicast not supported for foo protocol at /zenoh-link/src/lib.rs:183.")
    'Unicast not supported for foo protocol'
    """
    return SOURCE_LINE.sub("", text).rstrip(".!")


def why_not_open(config: SessionConfig, said: str) -> str:
    """Why a session cannot be opened: where that was, and what to do.

    Args:
        config: What it was to be opened with.
        said: The `words` of Zenoh.
    """
    if "listener" in said or (config.listen and not config.connect):
        at = ", ".join(config.listen) or "the configured endpoints"
        hint = "; is another router there already? connect to it" if "in use" in said else ""
        inner = INNER.fullmatch(said)
        return f"cannot listen at {at}: {inner[1] if inner else said}{hint}"
    to = ", ".join(config.connect) or "the configured endpoints"
    says_nothing_more = said.startswith("Unable to connect") or "Connection refused" in said
    more = "" if says_nothing_more else f" ({said})"
    return f"no ROS 2 graph in reach: nobody at {to} lets us in{more}; is a router running there?"
