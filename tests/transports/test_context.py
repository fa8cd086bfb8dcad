"""What lies between the event loop and other threads."""

from __future__ import annotations

import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.transports.rmw_zenoh import context
from turtleact.transports.rmw_zenoh.context import (
    RateLimitedLog,
    SendQueue,
)
from turtleact.transports.rmw_zenoh.topics import CAPACITY, ENTRY, BoundedQueue

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


def test_a_peer_that_sends_nonsense_fills_no_log_and_hides_no_other_kind(caplog, monkeypatch):
    log = RateLimitedLog()
    for _ in range(2_880):
        log.warn("service /add: a request cannot be read", ValueError("no CDR"))
    log.warn("topic /chatter: a message cannot be read", ValueError("cut off"))
    monkeypatch.setattr(context, "PERIOD", 0.0)
    log.warn("service /add: a request cannot be read", ValueError("no CDR"))
    assert caplog.messages == [
        "service /add: a request cannot be read: no CDR",
        "topic /chatter: a message cannot be read: cut off",
        "service /add: a request cannot be read: no CDR (2,879 more such warnings before)",
    ]
