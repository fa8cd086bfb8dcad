"""Bytes of a keyboard in, keys out."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.commands.terminal import Keys


@pytest.mark.parametrize(
    ("data", "keys"),
    [
        (b"\x1b[A\x1b[B\x1b[C\x1b[D", ["up", "down", "right", "left"]),
        (b"\x1bOA\x1bOB\x1bOC\x1bOD", ["up", "down", "right", "left"]),
        (b"\x1b[1;2A", ["up"]),
        (b"gB", ["g", "b"]),
        (b"\x1b[5~\x1b[F\x1bOP", []),
        (b" 1\t\n\x00\xc3\xa4", []),
        (b"\x1bq", ["q"]),
        (b"\x1b\x1b[A", ["up"]),
    ],
)
def test_what_a_terminal_sends_for_a_key_is_that_key(data, keys):
    assert Keys().read(data) == keys


def test_an_arrow_is_no_letter():
    """turtle_teleop_key reads its last byte as the key C, D or B in capitals."""
    assert Keys().read(b"\x1b[C") == ["right"]


@given(st.binary(max_size=40), st.integers(0, 40))
def test_it_does_not_matter_where_what_is_typed_is_cut(data, at):
    whole, parts = Keys(), Keys()
    assert whole.read(data) == parts.read(data[:at]) + parts.read(data[at:])
