"""Notes beside ROS 2's messages, and the bytes of the status topic."""

from __future__ import annotations

import pytest

from turtleact.goals.wire import (
    LARGEST,
    LONGEST_REASON,
    GoalMetadata,
    read_states,
    write_states,
)
from turtleact.interfaces import SECOND, encode
from turtleact.interfaces.standard import (
    UUID,
    GoalInfo,
    GoalStatusArray,
    GoalStatusMessage,
    Time,
)

STATES = {bytes([number]) * 16: (number, 999_999_999 - number, number % 7) for number in range(5)}


def message(count: int) -> bytes:
    """The first goals as CDR writes them."""
    return encode(
        GoalStatusArray(
            [
                GoalStatusMessage(GoalInfo(UUID(goal_id), Time(seconds, rest)), number)
                for goal_id, (seconds, rest, number) in list(STATES.items())[:count]
            ]
        )
    )


@pytest.mark.parametrize("count", range(5))
def test_goals_are_written_as_cdr_writes_them(count):
    told = [(id, seconds * SECOND + rest, state) for id, (seconds, rest, state) in STATES.items()]
    assert write_states(told[:count]) == message(count)


@pytest.mark.parametrize("behind", [b"", b"garbage"])
@pytest.mark.parametrize("count", range(5))
def test_goals_are_read_whatever_stands_behind_them(count, behind):
    assert read_states(message(count) + behind) == dict(list(STATES.items())[:count])


def test_garbage_in_the_padding_changes_nothing():
    data = bytearray(message(2))
    begin = 8 + 25 + 16  # the header, the first goal, the id of the second
    data[begin : begin + 3] = b"xyz"
    assert read_states(bytes(data)) == read_states(message(2))


@pytest.mark.parametrize("length", [0, 3, 7, 8, 32, 33, 60])
def test_what_is_cut_off_is_not_read(length):
    assert read_states(message(2)[:length]) is None


def test_a_count_that_cannot_be_is_not_read():
    assert read_states(b"\0\1\0\0\xff\xff\xff\xff" + message(2)[8:]) is None


def test_big_endian_bytes_are_left_to_the_general_reader():
    assert read_states(b"\0\0\0\0" + message(1)[4:]) is None


@pytest.mark.parametrize(
    "note", [GoalMetadata(), GoalMetadata("no such place"), GoalMetadata("🐢", 3)]
)
def test_a_note_is_read_as_it_was_written(note):
    assert GoalMetadata.read(note.write()) == note


@pytest.mark.parametrize("text", ["", "no JSON", '{"reason": 3}', "[]"])
def test_what_is_no_note_is_an_empty_one(text):
    assert GoalMetadata.read(text) == GoalMetadata()


def test_a_long_reason_is_cut():
    assert GoalMetadata.read(GoalMetadata("a" * 5_000).write()).reason == "a" * LONGEST_REASON


def test_a_reason_that_utf_8_cannot_encode_is_escaped():
    assert GoalMetadata.read(GoalMetadata("caf\udce9", 3).write()) == GoalMetadata(r"caf\udce9", 3)


@pytest.mark.parametrize("character", ["\0", "\udce9", "🐢"])
def test_a_note_is_never_longer_than_what_travels(character):
    text = GoalMetadata(character * 2_000, 7).write()
    assert len(text.encode()) <= LARGEST
    assert GoalMetadata.read(text).feedback == 7
