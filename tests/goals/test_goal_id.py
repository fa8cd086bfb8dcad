"""New goal ids, and goal ids in their spellings."""

from __future__ import annotations

import os
import uuid

import pytest

from turtleact.errors import InvalidGoalId
from turtleact.goals.server import goal_id_bytes, new_goal_id

SIXTEEN = bytes(range(16))


def test_a_new_id_has_sixteen_bytes():
    assert len(new_goal_id()) == 16


def test_new_ids_differ():
    assert len({new_goal_id() for _ in range(5_000)}) == 5_000


def test_each_new_id_is_a_uuid_of_version_4():
    ids = [uuid.UUID(bytes=new_goal_id()) for _ in range(1_000)]
    assert {(each.version, each.variant) for each in ids} == {(4, uuid.RFC_4122)}


def test_each_bit_of_a_new_id_that_may_vary_does():
    ids = [int.from_bytes(new_goal_id()) for _ in range(1_000)]
    ones = zeros = 0
    for each in ids:
        ones |= each
        zeros |= ~each
    assert (ones & zeros & (2**128 - 1)).bit_count() == 122


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")
def test_a_forked_child_draws_other_ids():
    new_goal_id()
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        os.write(writer, b"".join(new_goal_id() for _ in range(50)))
        os._exit(0)
    os.waitpid(child, 0)
    drawn = os.read(reader, 50 * 16)
    os.close(reader)
    os.close(writer)
    ours = {new_goal_id() for _ in range(300)}
    theirs = {drawn[at : at + 16] for at in range(0, len(drawn), 16)}
    assert (len(theirs), ours & theirs) == (50, set())


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
