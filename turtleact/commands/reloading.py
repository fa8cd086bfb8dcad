"""Implements ``serve --reload``, which starts the program again when a file of the user changes.

Before, running goals end as at any stop of the server. The new process imports everything anew, so
no old code stays behind.

Source: uvicorn ``supervisors/basereload.py``, which also restarts the process.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn, TypeAlias

import anyio

from turtleact.interfaces.types import REGISTRY

if TYPE_CHECKING:
    from turtleact.commands.targets import Modules

__all__ = ["Stamps", "restart", "stamps_of", "wait_for_change"]

INTERVAL = 0.15
"""How often the files are checked (s, event loop time)."""

Stamps: TypeAlias = dict[Path, tuple[int, int, int] | None]
"""The time of change, size and identity of each file; None for a missing file."""


async def wait_for_change(modules: Modules, before: Stamps) -> list[Path]:
    """Wait until a file of the user's modules or interfaces has changed, and return those files.

    An editor may write a file in parts, remove it and rename another, or save several files in a
    row. So a change counts once two checks in a row have found all files in the same state.

    Args:
        modules: The user's modules.
        before: What `stamps_of` returned after the modules were imported.
    """
    last = before
    while True:
        await anyio.sleep(INTERVAL)
        stamps = stamps_of(modules)
        before = stamps | before  # an interface may have been loaded since
        changed = [file for file, stamp in stamps.items() if stamp != before[file]]
        if changed and stamps == last:
            return changed
        last = stamps


def restart() -> NoReturn:
    """Replace this process by a new one with the same command line."""
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])  # noqa: S606  # no shell needed


def stamps_of(modules: Modules) -> Stamps:
    """Return the stamps of all files of the user's modules and interfaces."""
    finders = REGISTRY.finders
    interfaces = (*finders.loaded.files.values(), *finders.nearby.files.values())
    own = {each for each in interfaces if modules.has(each)}
    return {file: _stamp(file) for file in sorted(modules.files | own)}


def _stamp(file: Path) -> tuple[int, int, int] | None:
    try:
        status = file.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size, status.st_ino
