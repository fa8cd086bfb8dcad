"""New goal ids, and goal ids in their spellings."""

from __future__ import annotations

import uuid

import pytest

from turtleact.errors import InvalidGoalId
from turtleact.goals.server import goal_id_bytes, new_goal_id

SIXTEEN = bytes(range(16))


def test_new_ids_differ():
    assert len({new_goal_id() for _ in range(5_000)}) == 5_000


def test_each_new_id_is_a_uuid_of_version_4():
    ids = [uuid.UUID(bytes=new_goal_id()) for _ in range(1_000)]
    assert {(each.version, each.variant) for each in ids} == {(4, uuid.RFC_4122)}


@pytest.mark.parametrize(
    "spelling",
    [
        pytest.param(SIXTEEN, id="bytes"),
        pytest.param(uuid.UUID(bytes=SIXTEEN), id="uuid"),
        pytest.param(SIXTEEN.hex(), id="digits"),
        pytest.param(SIXTEEN.hex().upper(), id="capitals"),
        pytest.param(str(uuid.UUID(bytes=SIXTEEN)), id="hyphens"),
    ],
)
def test_an_id_is_read_in_any_of_its_spellings(spelling):
    assert goal_id_bytes(spelling) == SIXTEEN


@pytest.mark.parametrize(
    ("wrong", "problem"),
    [
        (b"", "a goal id has 16 bytes"),
        (b"1" * 15, "a goal id has 16 bytes"),
        (b"1" * 17, "a goal id has 16 bytes"),
        ("", "a goal id has 32 hexadecimal digits"),
        ("xyz", "a goal id has 32 hexadecimal digits"),
        ("0" * 31, "a goal id has 32 hexadecimal digits"),
        ("0" * 33, "a goal id has 32 hexadecimal digits"),
        (7, "a goal id has 16 bytes, or is a UUID"),
        (None, "a goal id has 16 bytes, or is a UUID"),
        ([1] * 16, "a goal id has 16 bytes, or is a UUID"),
        (bytes(16), "a goal id must not be all zeros"),
    ],
)
def test_what_is_no_id_is_refused(wrong, problem):
    with pytest.raises(InvalidGoalId, match=problem):
        goal_id_bytes(wrong)
