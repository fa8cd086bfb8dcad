"""A picture of a world: the drawing and the turtles on it, as SVG and as PNG.

500×500 pixels, like turtlesim's window. A turtle is an arrowhead that points along its heading; it
has the size of turtlesim's pictures of turtles, 45 pixels. All functions are pure.

Source: W3C, Scalable Vector Graphics 1.1; W3C, Portable Network Graphics, third edition.
"""

from __future__ import annotations

import base64
import cmath
import struct
import zlib
from typing import TYPE_CHECKING, Final, NamedTuple

from turtleact.sim.canvas import METER, SIZE, Colour
from turtleact.sim.drawing import Polyline

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    import numpy.typing as npt

__all__ = ["BACKGROUND", "Snapshot", "thumbnail", "to_png", "to_svg"]

BACKGROUND: Final = Colour(69, 86, 255)
"""turtlesim's background, unless its parameters change it."""

SHELL: Final = Colour(46, 125, 50)
"""The colour of a turtle."""

ARROW: Final = (22.0 + 0.0j, -18.0 + 15.0j, -10.0 + 0.0j, -18.0 - 15.0j)
"""A turtle that looks to the right, around its own place (pixels)."""

FINE: Final = 4
"""The number of samples per pixel, in each direction, that smooth a turtle's edges."""


class Figure(NamedTuple):
    """A turtle in a picture: its place ``x + 1j * depth`` (m) and heading (rad)."""

    place: complex
    theta: float


class Snapshot(NamedTuple):
    """All that is in a picture.

    Attributes:
        background: The colour where nothing was drawn.
        pixels: The drawing, as `Drawing.pixels` gives it.
        base: The part of the drawing that the polylines leave out, in the same form, or None.
        polylines: The rest of the drawing.
        turtles: The turtles, in the order in which they are painted.
    """

    background: Colour
    pixels: bytes
    base: bytes | None
    polylines: Sequence[Polyline]
    turtles: Sequence[Figure]


def to_svg(snapshot: Snapshot) -> str:
    """A picture that scales: polylines, and an image of everything kept only as pixels.

    Polylines lie over each other in the order of their beginning.
    """
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{SIZE}" height="{SIZE}"'
        f' viewBox="0 0 {SIZE} {SIZE}">',
        f'<rect width="{SIZE}" height="{SIZE}" fill="{_css(snapshot.background)}"/>',
    ]
    if snapshot.base is not None:
        image = base64.b64encode(_png(snapshot.base, channels=4)).decode()
        href = f"data:image/png;base64,{image}"
        lines.append(f'<image width="{SIZE}" height="{SIZE}" href="{href}"/>')
    lines.append('<g fill="none" stroke-linecap="square" stroke-linejoin="round">')
    for pen, points in snapshot.polylines:
        stroke = f'stroke="{_css(pen.colour)}" stroke-width="{pen.width}"'
        lines.append(f'<polyline {stroke} points="{_svg_points(points)}"/>')
    lines.append("</g>")
    for turtle in snapshot.turtles:
        lines.append(f'<polygon fill="{_css(SHELL)}" points="{_svg_points(_outline(turtle))}"/>')
    return "\n".join([*lines, "</svg>", ""])


def to_png(snapshot: Snapshot) -> bytes:
    """A picture pixel by pixel, as in turtlesim's window, except for the turtles."""
    import numpy as np

    layers = np.frombuffer(snapshot.pixels, np.uint8).reshape(SIZE, SIZE, 4)
    is_drawn = layers[..., 3:] != 0
    picture = np.where(is_drawn, layers[..., :3], np.array(snapshot.background, np.uint8))
    for turtle in snapshot.turtles:
        _paint(picture, _outline(turtle))
    return _png(picture.tobytes(), channels=3)


def thumbnail(pixels: bytes, width: int, height: int) -> list[list[Colour | None]]:
    """A drawing in fewer pixels, row by row from the top; None where nothing was drawn.

    A pixel has a colour that was drawn in its place: of several the one with most blue.

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


def _unpacked(pixel: int) -> Colour | None:
    return Colour(pixel & 255, pixel >> 8 & 255, pixel >> 16 & 255) if pixel else None


def _outline(turtle: Figure) -> list[complex]:
    """The corners of a turtle (pixels); y counts down, so angles turn the other way."""
    turned = cmath.exp(-1j * turtle.theta)
    return [turtle.place * METER + corner * turned for corner in ARROW]


def _paint(picture: npt.NDArray[np.uint8], outline: Sequence[complex]) -> None:
    """Fill a polygon by the even-odd rule, with smooth edges."""
    import numpy as np

    corners = np.array(outline)
    left, top = (int(part.min()) - 1 for part in (corners.real, corners.imag))
    width, height = (int(np.ptp(part)) + 4 for part in (corners.real, corners.imag))
    x = left + (np.arange(width * FINE) + 0.5) / FINE
    y = (top + (np.arange(height * FINE) + 0.5) / FINE)[:, None]
    is_inside = np.zeros((len(y), len(x)), np.bool_)
    for a, b in zip(corners, np.roll(corners, -1), strict=True):
        slope = (b.real - a.real) / ((b.imag - a.imag) or 1.0)  # what is level crosses no row
        crosses = (a.imag > y) != (b.imag > y)
        is_inside ^= crosses & (x < a.real + (y - a.imag) * slope)
    cover = is_inside.reshape(height, FINE, width, FINE).mean(axis=(1, 3))
    rows, columns = _shown(top, height), _shown(left, width)
    share = cover[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
    under = picture[rows, columns]
    painted = under + (np.array(SHELL) - under) * share[..., None]
    picture[rows, columns] = np.rint(painted).astype(np.uint8)


def _shown(start: int, length: int) -> slice:
    """What of some rows or columns is in the picture; they may lie outside of it."""
    return slice(*(min(max(end, 0), SIZE) for end in (start, start + length)))


def _png(pixels: bytes, *, channels: int) -> bytes:
    """A PNG of rows of red, green, blue and, of four channels, alpha."""
    stride = SIZE * channels
    rows = (b"\0" + pixels[at : at + stride] for at in range(0, len(pixels), stride))  # no filter
    colour_type = {3: 2, 4: 6}[channels]
    header = struct.pack(">IIBBBBB", SIZE, SIZE, 8, colour_type, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(b"".join(rows), 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(*chunk) for chunk in chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    body = kind + data
    return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))


def _css(colour: Colour) -> str:
    return "#" + bytes(colour).hex()


def _svg_points(points: Sequence[complex]) -> str:
    return " ".join(f"{_short(point.real)},{_short(point.imag)}" for point in points)


def _short(number: float) -> str:
    """A hundredth of a pixel is more than enough."""
    return f"{number:.2f}".rstrip("0").rstrip(".")
