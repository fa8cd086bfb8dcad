"""What a keyboard sends, as keys: bytes in, names out.

Source: ECMA-48 for the form of control sequences; xterm's "Control Sequences" for the arrow keys,
which are ``ESC [ A`` to ``ESC [ D``, or ``ESC O A`` and so on, with modifiers before the letter.
"""

from __future__ import annotations

import re
from typing import Final

__all__ = ["Keys"]

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
