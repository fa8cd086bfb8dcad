"""What lies between the event loop and other threads."""

from __future__ import annotations

import threading

import anyio
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.tasks import current_tasks
from turtleact.transports.rmw_zenoh import context
from turtleact.transports.rmw_zenoh.context import (
    LOGGED,
    MOST_PEERS,
    Crew,
    RateLimitedLog,
    SendQueue,
)
from turtleact.transports.rmw_zenoh.topics import CAPACITY, ENTRY, BoundedQueue

from ..lab import settle

# a queue


def test_a_queue_of_a_length_keeps_the_newest():
    queue: BoundedQueue[int] = BoundedQueue(2)
    more = [queue.put(number, 1) for number in range(4)]
    assert (more, queue.dropped) == ([True, True, False, False], 2)
    assert [queue.take() for _ in range(3)] == [2, 3, None]
    assert queue.weight == 0


def test_a_queue_is_bounded_in_bytes():
    queue: BoundedQueue[int] = BoundedQueue()
    for number in range(5):
        queue.put(number, CAPACITY // 2 - ENTRY)
    assert (queue.weight, queue.dropped) == (CAPACITY, 3)
    assert [queue.take() for _ in range(3)] == [3, 4, None]


@given(st.lists(st.one_of(st.none(), st.integers(0, 10_000))), st.integers(1, 5))
def test_a_queue_is_told_of_as_many_entries_as_can_be_taken(script, longest):
    queue: BoundedQueue[int] = BoundedQueue(longest)
    told = 0
    for step in script:
        if step is not None:
            told += queue.put(step, step)
        elif queue.take() is not None:
            told -= 1
    left = sum(1 for _ in iter(queue.take, None))
    assert (left, queue.weight) == (told, 0)


# a queue


@pytest.mark.parametrize("anyio_backend", ["asyncio"])
async def test_a_job_that_hangs_is_left_behind(caplog, monkeypatch):
    monkeypatch.setattr(context, "GRACE", 0.01)
    queue, gate, seen = SendQueue("a thread"), threading.Event(), []
    queue.post(lambda: gate.wait() and 1 / 0)
    queue.post(lambda: seen.append("done"))
    await queue.aclose()
    gate.set()
    queue.thread.join()
    assert seen == []
    assert caplog.messages == [
        "a peer reads nothing: the Zenoh transport closes with messages unsent"
    ]


# log


@pytest.fixture
def log(monkeypatch):
    monkeypatch.setattr(context, "PERIOD", 0.01)
    return lambda: RateLimitedLog(Crew(current_tasks()))


async def until_counted(caplog, text: str) -> None:
    while text not in caplog.text:
        await anyio.sleep(0.001)


async def test_a_peer_that_sends_nonsense_fills_no_log(log, caplog):
    warnings = log()
    for _ in range(2_880):
        warnings.warn("service /add: a request cannot be read", b"\x0a\x0b", ValueError("no CDR"))
    assert caplog.messages == ["service /add: a request cannot be read: no CDR"] * LOGGED
    await until_counted(caplog, "2,877 more")
    assert caplog.messages[LOGGED:] == [
        "service /add: a request cannot be read: 2,877 more such warnings in 0.01 s"
        " from the peer of gid 0a0b"
    ]


async def test_peers_without_number_fill_no_log(log, caplog):
    warnings = log()
    for number in range(10_000):
        warnings.warn("it", number.to_bytes(16), ValueError("no CDR"))
    assert len(caplog.messages) <= MOST_PEERS + LOGGED
    await until_counted(caplog, "more such warnings")


async def test_what_was_counted_is_logged_at_the_close(monkeypatch, caplog):
    monkeypatch.setattr(context, "PERIOD", 1000.0)
    crew = Crew(current_tasks())
    warnings = RateLimitedLog(crew)
    for _ in range(LOGGED + 2):
        warnings.warn("it", b"", ValueError("no CDR"))
    await settle()
    await crew.aclose()
    assert caplog.messages[-1] == "it: 2 more such warnings in 1000 s"


async def test_a_peer_that_sends_nonsense_hides_no_other(log, caplog):
    warnings = log()
    for peer in (b"a", b"a", b"a", b"a", b"a", b"b"):
        warnings.warn("it", peer, ValueError(peer))
    assert caplog.messages == ["it: b'a'"] * LOGGED + ["it: b'b'"]
    await until_counted(caplog, "2 more")
