"""Makes pictures of a world as SVG and PNG: the drawing, and the turtles on it.

A picture has 500×500 pixels, like turtlesim's window. A picture shows the turtles from above, each
facing in the direction of its heading. The turtles are as large as turtlesim's pictures of turtles
(45 pixels). A turtle's colours depend only on its name, so they are the same in every picture, on a
terminal and on a web page. All functions are pure.

This module imports numpy only when it makes a picture, because commands need the colours at their
start.

Source: W3C, Scalable Vector Graphics 2; W3C, Portable Network Graphics, third edition.
"""

from __future__ import annotations

import base64
import cmath
import math
import re
import struct
import zlib
from colorsys import hls_to_rgb
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    import numpy.typing as npt

__all__ = [
    "BACKGROUND",
    "METER",
    "SIZE",
    "SVG_TURTLE",
    "Colour",
    "Figure",
    "Pen",
    "Polyline",
    "Shades",
    "Snapshot",
    "encode_png",
    "hue_of",
    "shades_of",
    "svg_shades",
    "thumbnail",
    "to_png",
    "to_svg",
]

FINE: Final = 4
"""The number of samples per pixel, in x and again in y, for smoothing the edges of turtles."""


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


class Polyline(NamedTuple):
    """A line with bends. Its points are in pixels, ``x + 1j * y``, from the upper left corner."""

    pen: Pen
    points: tuple[complex, ...]


class Figure(NamedTuple):
    """A turtle in a picture: its place ``x + 1j * depth`` (m), heading (rad) and name."""

    place: complex
    theta: float
    name: str = ""


class Snapshot(NamedTuple):
    """The contents of a picture.

    Attributes:
        background: The colour where nothing was drawn.
        pixels: The whole drawing, as `Drawing.pixels` gives it.
        base: An image of the lines that were drawn before those in ``polylines``, in the same form
            as ``pixels``; None if there are no earlier lines.
        polylines: The lines that were drawn after those in ``base``.
        turtles: The turtles, in the order in which they are painted.
    """

    background: Colour
    pixels: bytes
    base: bytes | None
    polylines: Sequence[Polyline]
    turtles: Sequence[Figure]


def to_svg(snapshot: Snapshot) -> str:
    """Draw a scalable picture: the polylines as vectors, over an image of ``base``.

    The polylines are drawn in the order in which they began. Later lines cover earlier lines.
    """
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{SIZE}" height="{SIZE}"'
        f' viewBox="0 0 {SIZE} {SIZE}">',
        f'<rect width="{SIZE}" height="{SIZE}" fill="{_css(snapshot.background)}"/>',
    ]
    if snapshot.base is not None:
        image = base64.b64encode(encode_png(snapshot.base, channels=4)).decode()
        href = f"data:image/png;base64,{image}"
        lines.append(f'<image width="{SIZE}" height="{SIZE}" href="{href}"/>')
    lines.append('<g fill="none" stroke-linecap="square" stroke-linejoin="round">')
    for pen, points in snapshot.polylines:
        stroke = f'stroke="{_css(pen.colour)}" stroke-width="{pen.width}"'
        lines.append(f'<polyline {stroke} points="{_svg_points(points)}"/>')
    lines.append("</g>")
    if snapshot.turtles:
        lines += ["<defs>", f'<g id="turtle">\n{SVG_TURTLE}\n</g>', "</defs>"]
    for turtle in snapshot.turtles:
        place = turtle.place * METER
        turn = _short(0.0 - math.degrees(turtle.theta))  # y counts down
        moved = f"translate({_short(place.real)},{_short(place.imag)}) rotate({turn})"
        lines.append(f'<use href="#turtle" {svg_shades(turtle.name)} transform="{moved}"/>')
    return "\n".join([*lines, "</svg>", ""])


def to_png(snapshot: Snapshot) -> bytes:
    """Draw a PNG picture. Its lines match the lines in turtlesim's window, pixel for pixel."""
    import numpy as np

    layers = np.frombuffer(snapshot.pixels, np.uint8).reshape(SIZE, SIZE, 4)
    is_drawn = layers[..., 3:] != 0
    picture = np.where(is_drawn, layers[..., :3], np.array(snapshot.background, np.uint8))
    for turtle in snapshot.turtles:
        shades, turned = shades_of(turtle.name), cmath.exp(-1j * turtle.theta)
        for shade, outline in _PARTS:
            corners = np.array(outline) * turned + turtle.place * METER
            _paint(picture, corners, getattr(shades, shade))
    return encode_png(picture.tobytes(), channels=3)


def thumbnail(pixels: bytes, width: int, height: int) -> list[list[Colour | None]]:
    """Scale a drawing down to rows of colours, top row first; None where nothing was drawn.

    Each pixel of the result represents an area of the drawing, and gets a colour from this area. If
    the area has several colours, the pixel gets the colour with the highest blue value.

    Args:
        pixels: The drawing, as `Drawing.pixels` gives it.
        width: Columns, 1 to 500.
        height: Rows, 1 to 500.
    """
    import numpy as np

    packed = np.frombuffer(pixels, "<u4").reshape(SIZE, SIZE)
    rows, columns = (np.arange(count) * SIZE // count for count in (height, width))
    small = np.maximum.reduceat(np.maximum.reduceat(packed, rows, 0), columns, 1)
    return [[_unpacked(pixel) for pixel in row] for row in small.tolist()]


def _colour(hue: float, lightness: float, saturation: float) -> Colour:
    red, green, blue = (round(255 * each) for each in hls_to_rgb(hue, lightness, saturation))
    return Colour(red, green, blue)


def _unpacked(pixel: int) -> Colour | None:
    return Colour(pixel & 255, pixel >> 8 & 255, pixel >> 16 & 255) if pixel else None


def svg_shades(name: str) -> str:
    """The SVG attributes that give `SVG_TURTLE` the colours of a turtle."""
    shades = shades_of(name)
    return f'fill="{_css(shades.skin)}" color="{_css(shades.shell)}"'


class _Part(NamedTuple):
    """A part of a turtle at the origin that faces right: its shade and its outline (pixels)."""

    shade: str
    outline: tuple[complex, ...]


def _ellipse(centre: complex, across: float, up: float, turn: float = 0.0) -> tuple[complex, ...]:
    """The outline of an ellipse (pixels). ``turn`` is in rad; the other arguments are in metres."""
    angles = (math.tau * i / 32 for i in range(32))
    points = (complex(across * math.cos(each), up * math.sin(each)) for each in angles)
    return tuple((centre + point * cmath.rect(1.0, turn)) * METER for point in points)


def _seam(angle: float) -> tuple[complex, ...]:
    """The corners (pixels) of a thin line on a turtle's shell, from its middle to its edge."""
    start, end = (complex(a * math.cos(angle), b * math.sin(angle)) for a, b in _SEAM)
    aside = 1j * (end - start) / abs(end - start) * _LINE / 2
    return tuple(each * METER for each in (start + aside, end + aside, end - aside, start - aside))


_LINE: Final = 0.022
_SEAM: Final = (0.14, 0.12), (0.28, 0.23)
_PARTS: Final = (
    _Part("skin", _ellipse(0.37, 0.14, 0.11)),
    *(_Part("skin", _ellipse(0.19 + 0.23j * side, 0.12, 0.07, 0.7 * side)) for side in (1, -1)),
    *(_Part("skin", _ellipse(-0.2 + 0.21j * side, 0.11, 0.065, -0.6 * side)) for side in (1, -1)),
    _Part("skin", _ellipse(-0.34, 0.09, 0.03)),
    *(_Part("eye", _ellipse(0.43 + 0.045j * side, 0.02, 0.02)) for side in (1, -1)),
    _Part("shell", _ellipse(0.0, 0.29, 0.24)),
    *(_Part("skin", _seam(angle)) for angle in (0.6, 2.5, 3.8, 5.7)),
    _Part("skin", _ellipse(0.0, 0.14 + _LINE / 2, 0.12 + _LINE / 2)),
    _Part("shell", _ellipse(0.0, 0.14 - _LINE / 2, 0.12 - _LINE / 2)),
)
"""The parts of a turtle, from the lowest to the topmost: head, legs, tail, eyes, and the shell."""

_SVG_FILLS: Final = {"skin": "", "shell": ' fill="currentColor"', "eye": ' fill="#111"'}


def _svg_points(points: Sequence[complex]) -> str:
    return " ".join(f"{_short(point.real)},{_short(point.imag)}" for point in points)


def _short(number: float) -> str:
    """Format a number with at most two decimals, because a hundredth of a pixel is exact enough."""
    return f"{number:.2f}".rstrip("0").rstrip(".")


SVG_TURTLE: Final = "\n".join(
    f'<polygon{_SVG_FILLS[part.shade]} points="{_svg_points(part.outline)}"/>' for part in _PARTS
)
"""The SVG shape of a turtle at the origin that faces right (theta 0).

Put the shape into an element that has the attributes from `svg_shades`.
"""


def _paint(
    picture: npt.NDArray[np.uint8], corners: npt.NDArray[np.complex128], colour: Colour
) -> None:
    """Fill a polygon by the even-odd rule, with smooth edges."""
    import numpy as np

    left, top = (int(part.min()) - 1 for part in (corners.real, corners.imag))
    width, height = (int(np.ptp(part)) + 4 for part in (corners.real, corners.imag))
    x = left + (np.arange(width * FINE) + 0.5) / FINE
    y = (top + (np.arange(height * FINE) + 0.5) / FINE)[:, None]
    is_inside = np.zeros((len(y), len(x)), np.bool_)
    for a, b in zip(corners, np.roll(corners, -1), strict=True):
        slope = (b.real - a.real) / ((b.imag - a.imag) or 1.0)  # a level edge crosses no row
        crosses = (a.imag > y) != (b.imag > y)
        is_inside ^= crosses & (x < a.real + (y - a.imag) * slope)
    cover = is_inside.reshape(height, FINE, width, FINE).mean(axis=(1, 3))
    rows, columns = _shown(top, height), _shown(left, width)
    share = cover[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
    under = picture[rows, columns]
    painted = under + (np.array(colour) - under) * share[..., None]
    picture[rows, columns] = np.rint(painted).astype(np.uint8)


def _shown(start: int, length: int) -> slice:
    """The part of a range of rows or columns that lies in the picture."""
    return slice(*(min(max(end, 0), SIZE) for end in (start, start + length)))


def encode_png(pixels: bytes, *, channels: int, width: int = SIZE) -> bytes:
    """Encode rows of pixels as PNG. With four channels, alpha follows red, green and blue."""
    stride = width * channels
    rows = [b"\0" + pixels[at : at + stride] for at in range(0, len(pixels), stride)]  # no filter
    colour_type = {3: 2, 4: 6}[channels]
    header = struct.pack(">IIBBBBB", width, len(rows), 8, colour_type, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(b"".join(rows))), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(*chunk) for chunk in chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    body = kind + data
    return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))


def _css(colour: Colour) -> str:
    return "#" + bytes(colour).hex()
