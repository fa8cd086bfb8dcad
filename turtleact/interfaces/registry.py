"""The interfaces that this process knows, by name.

Classes enter as they are made, from Python or from text. The first of equal ones stays, so that
``get_interface`` gives the same class every time; one that says something else under the same
name replaces it for later look-ups. Opens no file: ``classes`` looks for what is not here yet.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable
    from pathlib import Path

    from turtleact.interfaces.definition import Definition
    from turtleact.interfaces.types import Action, Message, Service

    Interface = type[Message] | type[Service] | type[Action]

__all__ = ["REGISTRY", "Registry"]


class Registry:
    """Interface classes by type name."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[Interface, Definition]] = {}
        #: Files that hold interfaces nobody has asked for yet.
        self.files: dict[str, Traversable] = {}
        #: Where ROS packages are installed, the first one before the others.
        self.prefixes: tuple[Path, ...] = ()

    def add(self, interface: Interface, definition: Definition) -> Interface:
        """Makes a class known, and gives the one that goes by its name from now on."""
        name = definition.type_name
        held = self._known.get(name)
        if held is not None:
            if held[1] == definition:
                return held[0]
            self.forget(name)
        self._known[name] = (interface, definition)
        return interface

    def get(self, type_name: str) -> Interface | None:
        """The class of that name, or None."""
        held = self._known.get(type_name)
        return None if held is None else held[0]

    def forget(self, type_name: str) -> None:
        """Drops an interface and the types it implies (``NAME_Goal``, ``NAME_SendGoal`` …)."""
        for name in [n for n in self._known if n == type_name or n.startswith(f"{type_name}_")]:
            del self._known[name]

    def names(self) -> list[str]:
        """The names known so far."""
        return list(self._known)


#: The one registry of the process: a class statement has no other place to announce itself.
REGISTRY = Registry()
