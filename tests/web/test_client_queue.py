"""What waits for one client: what is kept, and what is dropped."""

from __future__ import annotations

import itertools
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from turtleact.web.connection import ClientQueue

MOST = 1000


def taken(queue: ClientQueue) -> list[Any]:
    return list(iter(queue.take, None))


def test_one_frame_waits_whatever_its_size():
    queue = ClientQueue(MOST)
    queue.put("a", "small")
    queue.put("b", "x" * (MOST + 1))
    assert [len(frame) for frame in taken(queue)] == [MOST + 1]
    assert not queue.is_overfull


@given(st.lists(st.sampled_from(["take", "forget", "keep", "a", "b"])))
def test_a_queue_gives_each_frame_once_and_in_order(events):
    queue, numbers, seen = ClientQueue(20), itertools.count(), []
    for event in events:
        if event == "take":
            seen += [frame for frame in [queue.take()] if frame is not None]
        elif event == "forget":
            queue.forget("a")
        elif event == "keep":
            queue.keep(f"{next(numbers)}")
        else:
            queue.put(event, f"{next(numbers)}")
    seen += taken(queue)
    assert seen == sorted(set(seen), key=int)
    assert len(queue) == 0
