"""What the server says, as frames."""

from __future__ import annotations

import base64
import json
import struct
import zlib

import pytest

from turtleact.web.message_conversion import png


def read_png(picture: bytes) -> tuple[int, int, bytes]:
    """Width, height and pixels of an RGB picture whose rows are not filtered."""
    assert picture.startswith(b"\x89PNG\r\n\x1a\n")
    at, found = 8, {}
    while at < len(picture):
        (length,) = struct.unpack_from(">I", picture, at)
        kind, data = picture[at + 4 : at + 8], picture[at + 8 : at + 8 + length]
        (checksum,) = struct.unpack_from(">I", picture, at + 8 + length)
        assert checksum == zlib.crc32(kind + data)
        found[kind] = data
        at += 12 + length
    width, height, depth, colour = struct.unpack_from(">IIBB", found[b"IHDR"])
    assert (depth, colour) == (8, 2)
    rows = zlib.decompress(found[b"IDAT"])
    step = width * 3 + 1
    assert len(rows) == height * step
    assert set(rows[::step]) == {0}
    return width, height, b"".join(rows[at + 1 : at + step] for at in range(0, len(rows), step))


@pytest.mark.parametrize(
    "text", ["{}", '{"a":"b"}', '{"word":"é€😀"}', '{"a":"' + "x" * 5000 + '"}']
)
def test_a_picture_holds_the_text(text):
    frame = json.loads(png(text))
    assert frame["op"] == "png"
    _, _, pixels = read_png(base64.b64decode(frame["data"]))
    assert json.loads(pixels.decode("latin-1")) == json.loads(text)


def test_a_picture_is_padded_with_line_breaks():
    width, height, pixels = read_png(base64.b64decode(json.loads(png('{"a":1}'))["data"]))
    assert pixels == b'{"a":1}\n\n'
    assert (width, height) == (1, 3)
