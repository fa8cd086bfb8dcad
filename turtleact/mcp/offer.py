"""Defines which actions, services and topics a model may use, and within which limits.

Nothing is offered unless the program or the command line names it.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection
from typing import Final, Literal, TypeAlias

import msgspec

from turtleact.errors import InvalidOption
from turtleact.names import resolve_name

__all__ = ["ALL", "Limits", "Names", "Offer", "tool_name"]

ALL: Final = "all"

Names: TypeAlias = Collection[str] | Literal["all"]
"""Some names of the graph, or every name."""

LONGEST_NAME: Final = 128
DIGEST: Final = 8
"""The number of hexadecimal digits of the hash at the end of a shortened tool name."""

not_allowed = re.compile(r"[^A-Za-z0-9_.-]")


class Limits(msgspec.Struct, frozen=True):
    """Limits on the goals, calls and tasks of all clients together.

    Attributes:
        goals: The maximum number of goals and service calls under way.
        progress_rate: The maximum number of progress messages per second for each goal. Feedback
            beyond this rate is skipped.
        kept_tasks: The maximum number of tasks that are remembered after their goals have ended.
    """

    goals: int = 128
    progress_rate: float = 10.0
    kept_tasks: int = 1000

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            if not getattr(self, name) > 0:
                raise InvalidOption(name, f"must be above zero, not {getattr(self, name)!r}")


class Offer(msgspec.Struct, frozen=True):
    """What a server offers to clients.

    Attributes:
        actions: The actions that clients may use; None for every action.
        services: The services that clients may call.
        topics: The topics that clients may read; None for every topic.
        is_read_only: Whether clients may only read: they cannot send or cancel goals, or call
            services.
        asks: Whether the user must confirm each goal and each service call.
        limits: Limits on the goals, calls and tasks of all clients together.
    """

    actions: frozenset[str] | None
    services: frozenset[str]
    topics: frozenset[str] | None
    is_read_only: bool
    asks: bool
    limits: Limits

    @classmethod
    def of(
        cls,
        actions: Names,
        services: Collection[str],
        topics: Names,
        limits: Limits,
        *,
        is_read_only: bool,
        asks: bool,
    ) -> Offer:
        """Check the names, make them absolute, and return the offer.

        Raises:
            InvalidName: if a name breaks ROS 2's rules for names.
        """
        return cls(
            _resolved(actions),
            _resolved(services) or frozenset(),
            _resolved(topics),
            is_read_only,
            asks,
            limits,
        )

    def allows_action(self, name: str) -> bool:
        """Whether clients may see the goals of an action.

        If the offer is not read-only, clients may also send goals to the action.
        """
        return self.actions is None or name in self.actions

    def allows_topic(self, name: str) -> bool:
        """Whether clients may read a topic."""
        return self.topics is None or name in self.topics


def tool_name(name: str) -> str:
    """Return the name of the tool for an action or service with this name.

    >>> tool_name("/turtle1/rotate_absolute")
    'turtle1.rotate_absolute'
    """
    whole = not_allowed.sub("_", name.strip("/").replace("/", "."))
    if len(whole) <= LONGEST_NAME:
        return whole
    digest = hashlib.sha256(name.encode()).hexdigest()[:DIGEST]
    return f"{whole[: LONGEST_NAME - DIGEST - 1]}-{digest}"


def _resolved(names: Names) -> frozenset[str] | None:
    return None if names == ALL else frozenset(resolve_name(each) for each in names)
