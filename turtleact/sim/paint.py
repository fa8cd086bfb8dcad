"""The sizes and colours of pictures of a world.

A turtle's colours depend only on its name, so they are the same in every picture, on a terminal and
on a web page. This module imports no numpy, because commands need it at their start.
"""

from __future__ import annotations

import re
import zlib
from colorsys import hls_to_rgb
from typing import Final, NamedTuple

__all__ = ["BACKGROUND", "METER", "SIZE", "Colour", "Pen", "Shades", "hue_of", "shades_of"]

SIZE: Final = 500
"""Width and height (pixels)."""

METER: Final = 45.0
"""Pixels per metre. In turtlesim, one metre is the height of the picture of a turtle."""


class Colour(NamedTuple):
    """Red, green and blue, 0 to 255 each."""

    red: int
    green: int
    blue: int


class Pen(NamedTuple):
    """A turtle's pen: a colour, and a width in pixels (1 to 255)."""

    colour: Colour = Colour(179, 184, 255)
    width: int = 3


BACKGROUND: Final = Colour(69, 86, 255)
"""The default background colour of turtlesim. turtlesim's parameters can change the colour."""

HUES: Final = (145, 38, 340, 175, 15, 80, 295, 55)
"""The hues of turtles (degrees); none is the blue of the background."""


class Shades(NamedTuple):
    """The colours of a turtle. ``mark`` is legible on dark and on light terminals."""

    skin: Colour
    shell: Colour
    mark: Colour
    eye: Colour = Colour(17, 17, 17)


def hue_of(name: str) -> int:
    """The hue of a turtle (degrees): ``turtle1`` is green, ``turtle2`` orange, and so on.

    If a name does not end in a number, the whole name decides which hue the turtle gets. So a
    turtle keeps its hue when others come and go, and every program shows it in the same hue.
    """
    number = re.search(r"[0-9]+$", name)
    index = int(number[0]) - 1 if number else zlib.crc32(name.encode())
    return HUES[index % len(HUES)]


def shades_of(name: str) -> Shades:
    """Return the colours of a turtle. Skin, shell and mark have the hue that `hue_of` returns."""
    hue = hue_of(name) / 360
    return Shades(_colour(hue, 0.64, 0.65), _colour(hue, 0.3, 0.6), _colour(hue, 0.5, 0.65))


def _colour(hue: float, lightness: float, saturation: float) -> Colour:
    red, green, blue = (round(255 * each) for each in hls_to_rgb(hue, lightness, saturation))
    return Colour(red, green, blue)
