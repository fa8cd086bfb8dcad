"""Keys that the user presses while a display is drawn.

Source: ECMA-48 for control sequences; xterm's control sequences for the arrows.
"""

from __future__ import annotations

import re
import sys
from collections.abc import AsyncGenerator
from typing import TYPE_CHECKING, Final

import anyio

from turtleact.commands.console import console

if TYPE_CHECKING:
    from turtleact.commands.terminal import Region

__all__ = ["Keys", "typed_keys"]

BACKGROUND: Final = 0.2
"""How often a process in the background looks whether it is in the foreground again (s)."""

ARROWS: Final = {b"A": "up", b"B": "down", b"C": "right", b"D": "left"}

TOKEN: Final = re.compile(
    rb"\x1b\[[0-?]*[ -/]*(?P<csi>[@-~])|\x1bO(?P<ss3>[@-~])"
    rb"|(?P<begun>\x1b(?:\[[0-?]*[ -/]*|O)?\Z)|(?P<key>[^\x1b])|\x1b"
)
"""A control sequence, the beginning of one at the very end, or a key; else an ESC on its own."""


class Keys:
    """Reads keys; a control sequence may come in parts."""

    def __init__(self) -> None:
        self._begun = b""

    def read(self, data: bytes) -> list[str]:
        r"""The keys: ``up``, ``down``, ``left``, ``right``, or a small letter; no others.

        >>> Keys().read(b"G\x1b[Aq")
        ['g', 'up', 'q']
        """
        data, self._begun = self._begun + data, b""
        keys = []
        for token in TOKEN.finditer(data):
            self._begun = token["begun"] or b""
            arrow = ARROWS.get(token["csi"] or token["ss3"] or b"")
            if arrow is not None:
                keys.append(arrow)
            elif token["key"] is not None and token["key"].isalpha():
                keys.append(token["key"].decode().lower())
        return keys


async def typed_keys(region: Region) -> AsyncGenerator[str, None]:
    """Give the keys as they are pressed, until the terminal is gone; see `Keys.read`.

    While this process is in the background, the keys are for another one, and none is read.

    Args:
        region: The display; its terminal must be held.
    """
    keys = Keys()
    while True:
        await console().wait_for_key(sys.stdin)
        if not region.is_in_foreground():
            await anyio.sleep(BACKGROUND)
            continue
        data = console().typed(sys.stdin)
        for key in keys.read(data):
            yield key
        if not data:
            return
