"""The bytes beside a message, against those that rclpy and rmw_zenoh_cpp were seen to send."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.errors import InvalidMessage
from turtleact.transports.rmw_zenoh.wire import (
    Attachment,
    read_attachment,
    write_attachment,
)

GID = bytes.fromhex("f53cfc0b31c2798f0d6b0b1826573f4a")
WRITTEN = bytes.fromhex("0100000000000000 15cd853dfe9c9717 10 f53cfc0b31c2798f0d6b0b1826573f4a")

# Recorded from a client of rclpy 9.1 on rmw_zenoh_cpp 0.6.7: the request for a goal.
RECORDED = bytes.fromhex("0100000000000000 b3b5d6bfbbe8e918 10 5c6fa3b1c189e35f4ecd0386e7f379b0")

MOST = 2**63 - 1


def test_it_is_written_as_rmw_zenoh_writes_it():
    assert write_attachment(1, 1_700_000_000_123_456_789, GID) == WRITTEN


def test_a_recorded_one_is_read():
    read = read_attachment(RECORDED)
    assert (read.sequence, read.stamp) == (1, 1_795_221_819_558_901_171)
    assert read.gid.hex() == "5c6fa3b1c189e35f4ecd0386e7f379b0"
    assert read.note == ""


@given(st.integers(0, MOST), st.integers(0, MOST), st.binary(min_size=16, max_size=16), st.text())
def test_what_is_written_is_read_as_it_was(sequence, stamp, gid, note):
    data = write_attachment(sequence, stamp, gid, note)
    assert read_attachment(data) == Attachment(sequence, stamp, gid, note)


def test_a_note_stands_behind_what_ros_reads():
    assert write_attachment(1, 1_700_000_000_123_456_789, GID, "too far") == WRITTEN + b"too far"


def test_a_long_note_is_cut_between_two_characters():
    data = write_attachment(1, 0, GID, "é" * 2047 + "x" + "é" * 9)
    assert len(data) == 33 + 4095
    assert read_attachment(data).note == "é" * 2047 + "x"


def test_half_a_character_does_not_keep_a_note_from_being_written():
    assert read_attachment(write_attachment(1, 0, GID, "a\ud800b")).note == r"a\ud800b"


def test_a_note_that_is_no_text_is_read_all_the_same():
    assert read_attachment(WRITTEN + b"\xff" + b"x" * 9000).note == "\ufffd" + "x" * 4095


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "attachment: expected 33 bytes, got 0"),
        (WRITTEN[:32], "attachment: expected 33 bytes, got 32"),
        (
            WRITTEN[:16] + b"\x11" + WRITTEN[17:],
            "attachment: expected a gid of 16 bytes, not of 17",
        ),
        (
            b"\xff" * 8 + WRITTEN[8:],
            "attachment: sequence number and time must not be negative: -1, 1700000000123456789",
        ),
        (
            WRITTEN[:8] + b"\xff" * 8 + WRITTEN[16:],
            "attachment: sequence number and time must not be negative: 1, -1",
        ),
    ],
    ids=["nothing", "short", "gid", "sequence", "stamp"],
)
def test_what_is_none_is_refused(data, said):
    with pytest.raises(InvalidMessage) as caught:
        read_attachment(data)
    assert str(caught.value) == said
