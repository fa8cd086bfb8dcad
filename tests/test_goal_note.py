"""What peers tell each other of a goal beside ROS 2's messages."""

from __future__ import annotations

import pytest

from turtleact.goal_note import LARGEST, LONGEST_REASON, GoalNote


@pytest.mark.parametrize("note", [GoalNote(), GoalNote("no such place"), GoalNote("🐢", 3)])
def test_a_note_is_read_as_it_was_written(note):
    assert GoalNote.read(note.write()) == note


@pytest.mark.parametrize("text", ["", "no JSON", '{"reason": 3}', "[]"])
def test_what_is_no_note_is_an_empty_one(text):
    assert GoalNote.read(text) == GoalNote()


def test_a_long_reason_is_cut():
    assert GoalNote.read(GoalNote("a" * 5_000).write()).reason == "a" * LONGEST_REASON


def test_a_reason_that_utf_8_cannot_encode_is_escaped():
    assert GoalNote.read(GoalNote("caf\udce9", 3).write()) == GoalNote(r"caf\udce9", 3)


@pytest.mark.parametrize("character", ["\0", "\udce9", "🐢"])
def test_a_note_is_never_longer_than_what_travels(character):
    text = GoalNote(character * 2_000, 7).write()
    assert len(text.encode()) <= LARGEST
    assert GoalNote.read(text).feedback == 7
