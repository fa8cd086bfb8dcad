"""What lies between the event loop and other threads."""

from __future__ import annotations

import threading
from functools import partial

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
    ReceiveQueue,
    SendQueue,
)
from turtleact.transports.rmw_zenoh.topics import CAPACITY, ENTRY, BoundedQueue

from ..lab import settle

# a queue


def test_what_is_put_in_comes_out_in_order():
    queue: BoundedQueue[str] = BoundedQueue()
    assert [queue.put(each, 1) for each in "abc"] == [True] * 3
    assert [queue.take() for _ in range(4)] == ["a", "b", "c", None]


def test_a_queue_weighs_what_waits_in_it():
    queue: BoundedQueue[str] = BoundedQueue()
    queue.put("a", 10)
    queue.put("b", 20)
    assert queue.weight == 30 + 2 * ENTRY
    queue.take()
    assert queue.weight == 20 + ENTRY


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


# an queue


async def test_what_another_thread_pushes_is_done_in_the_event_loop():
    queue, done = ReceiveQueue(current_tasks()), anyio.Event()
    seen: list[object] = []

    def work() -> None:
        seen.append(threading.get_ident())
        done.set()

    thread = threading.Thread(target=queue.push, args=(work,))
    thread.start()
    await done.wait()
    thread.join()
    assert seen == [threading.get_ident()]


async def test_many_things_are_done_in_order_and_in_more_than_one_turn():
    queue = ReceiveQueue(current_tasks())
    seen: list[int] = []
    for number in range(context.IN_A_ROW * 2 + 1):
        queue.push(partial(seen.append, number))
    while len(seen) <= context.IN_A_ROW * 2:
        await settle()
    assert seen == list(range(context.IN_A_ROW * 2 + 1))


async def test_what_fails_is_logged_and_the_rest_is_done(caplog):
    queue, seen = ReceiveQueue(current_tasks()), []
    queue.push(lambda: 1 / 0)
    queue.push(lambda: seen.append("done"))
    await settle()
    assert seen == ["done"]
    assert caplog.messages == ["the Zenoh transport failed to handle a message"]


async def test_a_closed_queue_does_nothing_more():
    queue, seen = ReceiveQueue(current_tasks()), []
    queue.push(queue.close)
    queue.push(lambda: seen.append("done"))
    await settle()
    queue.push(lambda: seen.append("done"))
    await settle()
    assert seen == []


# an queue


async def test_what_is_posted_is_done_in_order_in_a_thread_before_the_end():
    queue = SendQueue("a thread")
    seen: list[tuple[int, str]] = []

    def note(number: int) -> None:
        seen.append((number, threading.current_thread().name))

    for number in range(3):
        queue.post(partial(note, number))
    await queue.aclose()
    assert seen == [(number, "a thread") for number in range(3)]


async def test_a_job_that_fails_is_logged_and_the_next_is_done(caplog):
    queue, seen = SendQueue("a thread"), []
    queue.post(lambda: 1 / 0)
    queue.post(lambda: seen.append("done"))
    await queue.aclose()
    assert seen == ["done"]
    assert caplog.messages == ["the Zenoh transport failed to send"]


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


async def test_after_a_while_a_peer_is_complained_of_again(log, caplog):
    warnings = log()
    for round in range(2):
        for _ in range(LOGGED + 1):
            warnings.warn(f"round {round}", b"", ValueError("no CDR"))
        await until_counted(caplog, f"round {round}: 1 more such warnings in 0.01 s")
    assert caplog.text.count("round 1: no CDR") == LOGGED


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
