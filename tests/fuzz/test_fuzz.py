"""The properties of this folder, for what a few seconds find; ``run`` looks for longer."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st

from .properties import PROPERTIES
from .seeds import seeds

SEEDS = {name: seeds(name) for name in PROPERTIES}
EXAMPLES = 150

#: What the fuzzers have found, mended or understood.
FOUND = {
    "name": [b"~\n/a\nno__", b"~\n\n__l"],
    "cdr": [b"\x00\x68" + bytes.fromhex("00010000 00000000 00000000 01000000 ffffbfff")],
    "interface": [b'\x00string a it\'s "so" \\'],
}


@pytest.mark.parametrize("name", PROPERTIES)
def test_what_is_right_is_read(name):
    for data in SEEDS[name]:
        PROPERTIES[name](data)


@pytest.mark.parametrize(("name", "data"), [(name, d) for name in FOUND for d in FOUND[name]])
def test_what_was_found_once_is_not_found_again(name, data):
    PROPERTIES[name](data)


@pytest.mark.parametrize("name", PROPERTIES)
def test_anything_is_read_or_refused(name):
    @seed(0)
    @settings(max_examples=EXAMPLES, database=None)
    @given(st.one_of(st.binary(max_size=200), changed(SEEDS[name])))
    def check(data: bytes) -> None:
        PROPERTIES[name](data)

    check()


def changed(right: list[bytes]) -> st.SearchStrategy[bytes]:
    """What is right, with some bytes changed, left out or put in."""

    def change(data: bytes, number: int) -> bytes:
        chance, result = random.Random(number), bytearray(data)
        for _ in range(chance.randint(1, 5)):
            place = chance.randint(0, len(result))
            piece = chance.choice([b"", b"\xff", b"\0", b"\xff" * 4, chance.randbytes(2), b"[]{}"])
            result[place : place + chance.randint(0, 4)] = piece
        return bytes(result)

    return st.builds(change, st.sampled_from(right), st.integers(0, 2**32))
