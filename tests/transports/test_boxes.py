"""What lies between the event loop and other threads."""

from __future__ import annotations

import threading
from functools import partial

import anyio
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.tasks import current_tasks
from turtleact.transports.rmw_zenoh import boxes
from turtleact.transports.rmw_zenoh.boxes import CAPACITY, ENTRY, Inbox, Lane, Outbox

from ..lab import settle

# a lane


def test_what_is_put_in_comes_out_in_order():
    lane: Lane[str] = Lane()
    assert [lane.put(each, 1) for each in "abc"] == [True] * 3
    assert [lane.take() for _ in range(4)] == ["a", "b", "c", None]


def test_a_lane_weighs_what_waits_in_it():
    lane: Lane[str] = Lane()
    lane.put("a", 10)
    lane.put("b", 20)
    assert lane.weight == 30 + 2 * ENTRY
    lane.take()
    assert lane.weight == 20 + ENTRY


def test_a_lane_of_a_length_keeps_the_newest():
    lane: Lane[int] = Lane(2)
    more = [lane.put(number, 1) for number in range(4)]
    assert (more, lane.dropped) == ([True, True, False, False], 2)
    assert [lane.take() for _ in range(3)] == [2, 3, None]
    assert lane.weight == 0


def test_a_lane_is_bounded_in_bytes():
    lane: Lane[int] = Lane()
    for number in range(5):
        lane.put(number, CAPACITY // 2 - ENTRY)
    assert (lane.weight, lane.dropped) == (CAPACITY, 3)
    assert [lane.take() for _ in range(3)] == [3, 4, None]


def test_something_too_heavy_for_a_lane_is_not_kept():
    lane: Lane[int] = Lane()
    assert not lane.put(1, CAPACITY)
    assert (lane.take(), lane.weight) == (None, 0)


@given(st.lists(st.one_of(st.none(), st.integers(0, 10_000))), st.integers(1, 5))
def test_a_lane_is_told_of_as_many_entries_as_can_be_taken(script, longest):
    lane: Lane[int] = Lane(longest)
    told = 0
    for step in script:
        if step is not None:
            told += lane.put(step, step)
        elif lane.take() is not None:
            told -= 1
    left = sum(1 for _ in iter(lane.take, None))
    assert (left, lane.weight) == (told, 0)


# an inbox


async def test_what_another_thread_pushes_is_done_in_the_event_loop():
    inbox, done = Inbox(current_tasks()), anyio.Event()
    seen: list[object] = []

    def work() -> None:
        seen.append(threading.get_ident())
        done.set()

    thread = threading.Thread(target=inbox.push, args=(work,))
    thread.start()
    await done.wait()
    thread.join()
    assert seen == [threading.get_ident()]


async def test_many_things_are_done_in_order_and_in_more_than_one_turn():
    inbox = Inbox(current_tasks())
    seen: list[int] = []
    for number in range(boxes.IN_A_ROW * 2 + 1):
        inbox.push(partial(seen.append, number))
    while len(seen) <= boxes.IN_A_ROW * 2:
        await settle()
    assert seen == list(range(boxes.IN_A_ROW * 2 + 1))


async def test_what_fails_is_logged_and_the_rest_is_done(caplog):
    inbox, seen = Inbox(current_tasks()), []
    inbox.push(lambda: 1 / 0)
    inbox.push(lambda: seen.append("done"))
    await settle()
    assert seen == ["done"]
    assert caplog.messages == ["the Zenoh transport failed on what has come"]


async def test_a_closed_inbox_does_nothing_more():
    inbox, seen = Inbox(current_tasks()), []
    inbox.push(inbox.close)
    inbox.push(lambda: seen.append("done"))
    await settle()
    inbox.push(lambda: seen.append("done"))
    await settle()
    assert seen == []


# an outbox


async def test_what_is_posted_is_done_in_order_in_a_thread_before_the_end():
    outbox = Outbox("a thread")
    seen: list[tuple[int, str]] = []

    def note(number: int) -> None:
        seen.append((number, threading.current_thread().name))

    for number in range(3):
        outbox.post(partial(note, number))
    await outbox.aclose()
    assert seen == [(number, "a thread") for number in range(3)]


async def test_a_job_that_fails_is_logged_and_the_next_is_done(caplog):
    outbox, seen = Outbox("a thread"), []
    outbox.post(lambda: 1 / 0)
    outbox.post(lambda: seen.append("done"))
    await outbox.aclose()
    assert seen == ["done"]
    assert caplog.messages == ["the Zenoh transport failed on what it was to send"]


@pytest.mark.parametrize("anyio_backend", ["asyncio"])
async def test_a_job_that_hangs_is_left_behind(caplog, monkeypatch):
    monkeypatch.setattr(boxes, "GRACE", 0.01)
    outbox, gate, seen = Outbox("a thread"), threading.Event(), []
    outbox.post(lambda: gate.wait() and 1 / 0)
    outbox.post(lambda: seen.append("done"))
    await outbox.aclose()
    gate.set()
    outbox._thread.join()
    assert seen == []
    assert caplog.messages == [
        "a peer takes nothing: the Zenoh transport leaves unsent what is left"
    ]
