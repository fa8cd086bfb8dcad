"""Makes the interfaces known that a verb may need, in the order in which they are looked for."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from turtleact.commands.output import note
from turtleact.interfaces import (
    Action,
    Service,
    load_interfaces,
    load_workspace,
    offer_interfaces,
)
from turtleact.interfaces.loading import find_interface
from turtleact.interfaces.workspace import find_interfaces

if TYPE_CHECKING:
    from turtleact.interfaces import Message

__all__ = ["first_message", "make_found", "make_known"]


def make_known(folder: str | None, *, is_silent: bool = False) -> None:
    """Register turtleact's own interfaces, and those that `make_found` registers.

    Args:
        folder: A folder with interface files, or None.
        is_silent: Whether to leave out the note on stderr.

    Raises:
        InvalidInterface: if the folder does not exist.
    """
    for module in ("actions", "sim.world_services"):  # they declare interfaces
        import_module(f"turtleact.{module}")
    make_found(folder, is_silent=is_silent)


def make_found(folder: str | None, *, is_silent: bool = False) -> None:
    """Find and register interfaces in ``folder``, in the workspace and near the working directory.

    If an interface has several definitions, the search order decides: first ``folder``, then the
    sourced workspace, the folders near the working directory, and turtleact itself. When the first
    interface near the working directory is used, a note on stderr says where that interface was
    found.

    Args:
        folder: The folder to search, or None; see `turtleact.interfaces.load_interfaces`.
        is_silent: Whether to leave out the note on stderr.

    Raises:
        InvalidInterface: if the folder does not exist.
    """
    load_workspace(*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    found = find_interfaces(Path())
    if found:
        offer_interfaces(found, None if is_silent else _OneNote())
    if folder is not None:
        load_interfaces(folder)


class _OneNote:
    """Prints a note that says where an interface was found, but only for the first interface."""

    def __init__(self) -> None:
        self._is_told = False

    def __call__(self, type_name: str, file: str) -> None:
        if not self._is_told:
            self._is_told = True
            note(f"found {type_name} in {Path(file).absolute().parents[1]}")


def first_message(type_name: str) -> Message:
    """Return an action's goal, a service's request or a message, with default values.

    Raises:
        UnknownInterface: if the name is unknown. The error suggests the nearest name.
    """
    interface = find_interface(type_name)
    if issubclass(interface, Action):
        return interface.Goal()
    return interface.Request() if issubclass(interface, Service) else interface()
