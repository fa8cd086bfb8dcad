"""Quality of service, as the user asks for it; what is left open is the verb's to choose."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

if TYPE_CHECKING:
    from turtleact.transports import QoS

__all__ = ["Durability", "Policies", "Reliability"]

Durability: TypeAlias = Literal["volatile", "transient_local"]
Reliability: TypeAlias = Literal["reliable", "best_effort"]


class Policies(NamedTuple):
    """The policies that were asked for; None where none was.

    Attributes:
        reliability: As in `turtleact.QoS`.
        durability: As in `turtleact.QoS`.
        depth: As in `turtleact.QoS`, at least 1.
    """

    reliability: Reliability | None = None
    durability: Durability | None = None
    depth: int | None = None

    def qos(self, *, durability: Durability = "volatile", depth: int = 10) -> QoS:
        """The quality of service, where what was not asked for is as given here."""
        from turtleact.transports import QoS

        return QoS(
            depth=self.depth or depth,
            durability=self.durability or durability,
            reliability=self.reliability or "reliable",
        )
