"""Pictures: what a reader of PNG and of SVG sees in them."""

from __future__ import annotations

import base64
import math
import re
import struct
import zlib
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest

from turtleact.sim import drawing as drawing_module
from turtleact.sim.drawing import Drawing
from turtleact.sim.pictures import (
    BACKGROUND,
    SIZE,
    Colour,
    Figure,
    Pen,
    Snapshot,
    shades_of,
    thumbnail,
    to_png,
    to_svg,
)

RED = Pen(Colour(255, 0, 0), 5)
MIDDLE = complex(250, 250) / 45.0
SKIN, SHELL, *_ = shades_of("turtle1")
SVG = "{http://www.w3.org/2000/svg}"


def picture(ours=None, turtles=(), background=BACKGROUND):
    ours = Drawing() if ours is None else ours
    return Snapshot(background, ours.pixels(), ours.base(), ours.polylines(), turtles)


def drawn(*points, pen=RED):
    ours = Drawing()
    for start, end in pairwise(points):
        ours.line(1, pen, start, end)
    return ours


def read_png(data):
    """The pixels of a PNG without filters, and its colour type; every checksum must be right."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    chunks, at = {}, 8
    while at < len(data):
        (length,) = struct.unpack_from(">I", data, at)
        body = data[at + 4 : at + 8 + length]
        assert struct.unpack_from(">I", data, at + 8 + length) == (zlib.crc32(body),)
        chunks[body[:4]] = body[4:]
        at += 12 + length
    assert list(chunks) == [b"IHDR", b"IDAT", b"IEND"]
    width, height, depth, colour_type, *rest = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    assert (width, height, depth, rest) == (SIZE, SIZE, 8, [0, 0, 0])
    channels = {2: 3, 6: 4}[colour_type]
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(SIZE, -1)
    assert not rows[:, 0].any()
    return rows[:, 1:].reshape(SIZE, SIZE, channels)


def pixels_of(snapshot):
    return read_png(to_png(snapshot))


def test_an_empty_picture_is_turtlesims_blue():
    assert (pixels_of(picture()) == [69, 86, 255]).all()


def test_the_drawing_is_shown_pixel_by_pixel():
    ours = drawn(1 + 1j, 5 + 3j, 2 + 9j)
    layers = np.frombuffer(ours.pixels(), np.uint8).reshape(SIZE, SIZE, 4)
    pixels = pixels_of(picture(ours))
    assert (pixels[layers[..., 3] == 255] == [255, 0, 0]).all()
    assert (pixels[layers[..., 3] == 0] == BACKGROUND).all()


def found(colour, pixels):
    """The pixels that wholly have a colour, as x + 1j * y of their centres."""
    y, x = (pixels == colour).all(axis=2).nonzero()
    return x + 0.5 + 1j * (y + 0.5)


@pytest.mark.parametrize("theta", [0.0, 1.0, math.pi / 2, -2.5])
def test_a_turtle_has_eyes_where_it_looks_and_legs_around_its_shell(theta):
    pixels = pixels_of(picture(turtles=[Figure(MIDDLE, theta, "turtle1")]))
    turn = complex(math.cos(theta), math.sin(theta))  # pixels count down
    shell, skin = (((found(colour, pixels) - 250 - 250j) * turn) for colour in (SHELL, SKIN))
    y, x = (pixels.max(axis=2) < 110).nonzero()  # nearly black
    eyes = (x + 0.5 + 1j * (y + 0.5) - 250 - 250j) * turn
    assert np.abs(eyes - 19.35).max() < 4.0
    assert np.abs(shell).max() < 14.0
    for leg in (8.5 + 10.4j, 8.5 - 10.4j, -9.0 + 9.5j, -9.0 - 9.5j):
        assert np.abs(skin - leg).min() < 3.0
    assert np.abs(np.concatenate([eyes, shell, skin])).max() < 23.0


def test_each_turtle_has_its_own_colours_in_every_picture():
    names = [f"turtle{number}" for number in range(1, 9)]
    shells = [shades_of(name).shell for name in names]
    assert len(set(shells)) == 8
    assert BACKGROUND not in shells
    assert shades_of("turtle9") == shades_of("turtle1")
    assert shades_of("Leonardo") == shades_of("Leonardo")
    turtles = [Figure(1 + number + 1j, 0.0, name) for number, name in enumerate(names)]
    pixels = pixels_of(picture(turtles=turtles))
    for turtle, shell in zip(turtles, shells, strict=True):
        assert np.abs(found(shell, pixels) - turtle.place * 45).max() < 14.0


@pytest.mark.parametrize(
    "place",
    [0j, 11.0888 + 0j, 11.0888j, 11.0888 + 11.0888j, 11.8 + 5j, 5 + 11.8j, -0.7j, 30 + 5j, -1e30j],
)
def test_a_turtle_at_the_edge_or_outside_is_cut_off(place):
    turtle = Figure(place, 0.5, "turtle1")
    assert len(found(SHELL, pixels_of(picture(turtles=[turtle])))) < 300


# SVG


def test_an_svg_is_as_large_as_turtlesims_window_and_as_blue():
    root = ElementTree.fromstring(to_svg(picture()))
    assert (root.get("viewBox"), root.get("width"), root.get("height")) == (
        "0 0 500 500",
        "500",
        "500",
    )
    rect = root.find(f"{SVG}rect")
    assert rect is not None
    assert rect.get("fill") == "#4556ff"


def test_an_svg_has_a_polyline_for_each_with_colour_width_and_points():
    root = ElementTree.fromstring(to_svg(picture(drawn(1 + 1j, 5 + 1j, 5 + 3j))))
    (line,) = root.iter(f"{SVG}polyline")
    assert (line.get("stroke"), line.get("stroke-width")) == ("#ff0000", "5")
    assert line.get("points") == "45,45 225,45 225,135"


def test_an_svg_has_a_shape_for_each_turtle():
    turtles = [Figure(MIDDLE, 0.0, "turtle1"), Figure(1 + 2j, math.pi / 2, "turtle2")]
    root = ElementTree.fromstring(to_svg(picture(turtles=turtles)))
    uses = [(each.get("transform"), each.get("fill")) for each in root.iter(f"{SVG}use")]
    skins = ["#" + bytes(shades_of(name).skin).hex() for name in ("turtle1", "turtle2")]
    assert uses == [
        ("translate(250,250) rotate(0)", skins[0]),
        ("translate(45,90) rotate(-90)", skins[1]),
    ]
    (shape,) = (each for each in root.iter(f"{SVG}g") if each.get("id") == "turtle")
    assert {use.get("href") for use in root.iter(f"{SVG}use")} == {"#turtle"}
    assert len(shape.findall(f"{SVG}polygon")) > 10


def test_an_svg_of_a_drawing_beyond_its_bound_has_the_rest_as_an_image(monkeypatch):
    monkeypatch.setattr(drawing_module, "MOST_POINTS", 4)
    ours = drawn(1 + 1j, 5 + 1j, 5 + 3j, 1 + 3j, 1 + 5j, 5 + 5j)
    root = ElementTree.fromstring(to_svg(picture(ours)))
    (image,) = root.iter(f"{SVG}image")
    found = re.fullmatch(r"data:image/png;base64,(.*)", image.get("href") or "")
    assert found is not None
    pixels = read_png(base64.b64decode(found[1]))
    assert pixels[45, 100].tolist() == [255, 0, 0, 255]
    assert pixels[9, 9].tolist() == [0, 0, 0, 0]
    assert len(list(root.iter(f"{SVG}polyline"))) == 1


# --- fewer pixels ---------------------------------------------------------------------------


def test_a_thumbnail_has_the_colours_that_were_drawn_in_their_places():
    drawing = Drawing()
    red, green = Pen(Colour(255, 0, 0)), Pen(Colour(0, 255, 0))
    drawing.line(1, red, 1.2 + 1.2j, 2.2 + 1.2j)
    drawing.line(2, green, 10.3 + 10.3j, 10.3 + 10.3j)
    small = thumbnail(drawing.pixels(), 11, 11)
    where = {(x, y): c for y, row in enumerate(small) for x, c in enumerate(row) if c is not None}
    assert where == {(1, 1): red.colour, (2, 1): red.colour, (10, 10): green.colour}


@pytest.mark.parametrize(("width", "height"), [(1, 1), (3, 7), (500, 500)])
def test_a_thumbnail_has_the_size_that_is_asked_for(width, height):
    small = thumbnail(Drawing().pixels(), width, height)
    assert [len(row) for row in small] == [width] * height
