"""What waits for one client: what is kept, what is dropped, and when it may go."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.interfaces.standard import Point
from turtleact.web.mailbox import (
    MOST_DROPPABLE,
    MOST_KEPT,
    MOST_KEPT_BYTES,
    MOST_OF_ONE,
    Budget,
    Mailbox,
    Throttle,
)
from turtleact.web.message_conversion import Rendering


def taken(mailbox: Mailbox) -> list[Any]:
    return list(iter(mailbox.take, None))


def test_frames_go_in_the_order_of_their_coming():
    mailbox = Mailbox()
    mailbox.put("a", "1")
    mailbox.keep("2")
    mailbox.put("b", "3")
    mailbox.put("a", "4")
    mailbox.keep("5")
    assert len(mailbox) == 5
    assert taken(mailbox) == ["1", "2", "3", "4", "5"]
    assert len(mailbox) == 0


def test_of_a_source_the_newest_are_kept():
    mailbox = Mailbox()
    for number in range(MOST_OF_ONE + 3):
        mailbox.put("a", f"{number}")
    assert mailbox.dropped == 3
    assert taken(mailbox) == [f"{number}" for number in range(3, MOST_OF_ONE + 3)]


def test_a_busy_source_pushes_out_no_other():
    mailbox = Mailbox()
    mailbox.put("rare", "rare")
    for number in range(1000):
        mailbox.put("busy", f"{number}")
    assert mailbox.take() == "rare"


def test_what_must_arrive_is_never_pushed_out():
    mailbox = Mailbox()
    mailbox.keep("a result")
    for number in range(1000):
        mailbox.put("a", f"{number}")
    assert mailbox.take() == "a result"


def test_large_frames_push_out_the_oldest():
    mailbox = Mailbox()
    large = "x" * (MOST_DROPPABLE // 2)
    for source in "abc":
        mailbox.put(source, large)
    assert mailbox.dropped == 1
    assert taken(mailbox) == [large, large]


def test_one_frame_waits_whatever_its_size():
    mailbox = Mailbox()
    mailbox.put("a", "small")
    mailbox.put("b", "x" * (MOST_DROPPABLE + 1))
    assert [len(frame) for frame in taken(mailbox)] == [MOST_DROPPABLE + 1]


@pytest.mark.parametrize(
    ("frames", "is_overfull"),
    [
        (["x"] * MOST_KEPT, False),
        (["x"] * (MOST_KEPT + 1), True),
        (["x" * MOST_KEPT_BYTES], False),
        (["x" * MOST_KEPT_BYTES, "x"], True),
    ],
    ids=["as-many", "too-many", "as-long", "too-long"],
)
def test_a_mailbox_that_nobody_empties_is_overfull(frames, is_overfull):
    mailbox = Mailbox()
    for frame in frames:
        mailbox.keep(frame)
    assert mailbox.is_overfull is is_overfull


def test_what_was_taken_is_not_counted_any_more():
    mailbox = Mailbox()
    for _ in range(3 * MOST_KEPT):
        mailbox.keep("x" * 100_000)
        assert mailbox.take() is not None
    assert not mailbox.is_overfull


def test_a_source_can_be_forgotten():
    mailbox = Mailbox()
    mailbox.put("a", "1")
    mailbox.put("b", "2")
    mailbox.forget("a")
    mailbox.forget("never there")
    assert taken(mailbox) == ["2"]
    assert mailbox.dropped == 0


def test_only_what_must_arrive_can_be_left():
    mailbox = Mailbox()
    mailbox.put("a", "1")
    mailbox.keep("2")
    mailbox.drop_all()
    assert taken(mailbox) == ["2"]


@given(
    st.lists(st.tuples(st.sampled_from(["keep", "a", "b", "take", "forget a"]), st.integers(0, 40)))
)
def test_a_mailbox_counts_right_whatever_happens(events):
    mailbox, numbers, last = Mailbox(), itertools.count(), -1
    kept: list[str] = []
    for event, times in events:
        for _ in range(times):
            if event == "take":
                frame = mailbox.take()
                if frame is not None:
                    assert int(frame) > last
                    last = int(frame)
                    if frame in kept:
                        assert frame == kept.pop(0)
            elif event == "forget a":
                mailbox.forget("a")
            elif event == "keep":
                frame = f"{next(numbers)}"
                kept.append(frame)
                mailbox.keep(frame)
            else:
                mailbox.put(event, f"{next(numbers)}")
    left = taken(mailbox)
    assert [frame for frame in left if frame in kept] == kept
    assert left == sorted(left, key=lambda frame: int(str(frame)))
    assert len(mailbox) == mailbox.size == 0


# throttles


def messages(count: int) -> list[Rendering]:
    return [Rendering(Point(x=float(number)), number) for number in range(count)]


def throttle(interval: float, queue_length: int) -> Throttle:
    made = Throttle("/topic")
    made.adjust(interval, queue_length, "none")
    return made


def test_without_a_rate_every_message_goes_at_once():
    unhurried = throttle(0.0, 0)
    assert all(unhurried.offer(message, 1.0) is message for message in messages(3))


def test_what_comes_too_early_is_dropped():
    first, early, late = messages(3)
    slow = throttle(0.1, 0)
    assert slow.offer(first, 1.0) is first
    assert slow.offer(early, 1.09) is None
    assert slow.due is None
    assert slow.offer(late, 1.1) is late


def test_with_a_queue_what_comes_too_early_waits_for_its_time():
    first, second, third = messages(3)
    slow = throttle(0.1, 2)
    assert slow.offer(first, 1.0) is first
    assert slow.offer(second, 1.01) is None
    assert slow.offer(third, 1.02) is None
    assert slow.due == pytest.approx(1.1)
    assert slow.release(1.05) is None
    assert slow.release(1.1) is second
    assert slow.due == pytest.approx(1.2)
    assert slow.release(1.3) is third
    assert slow.due is None
    assert slow.release(2.0) is None


def test_a_full_queue_keeps_the_newest():
    first, second, third = messages(3)
    slow = throttle(0.1, 1)
    slow.offer(first, 1.0)
    slow.offer(second, 1.0)
    slow.offer(third, 1.0)
    assert slow.release(1.1) is third


def test_a_message_does_not_overtake_those_that_wait():
    first, second, third = messages(3)
    slow = throttle(0.1, 2)
    slow.offer(first, 1.0)
    slow.offer(second, 1.0)
    assert slow.offer(third, 5.0) is None
    assert slow.release(5.0) is second


def test_other_wishes_hold_for_what_waits():
    first, second, third = messages(3)
    slow = throttle(10.0, 2)
    for message in (first, second, third):
        slow.offer(message, 1.0)
    slow.adjust(0.5, 1, "png")
    assert slow.due == pytest.approx(1.5)
    assert slow.release(1.5) is third
    assert slow.compression == "png"


# the memory of all clients


class Client:
    """Holds memory, and gives back as much as it is told to."""

    def __init__(self, left: int = 0) -> None:
        self.left = left
        self.asked = 0

    def shrink(self) -> int:
        self.asked += 1
        return self.left


def test_a_budget_counts_what_each_holder_holds_now():
    budget, one, other = Budget(100), Client(), Client()
    for holder, size in ((one, 30), (other, 50), (one, 20), (other, 0)):
        budget.hold(holder, size)
    assert budget.held == 20


def test_beyond_a_budget_the_holder_of_the_most_shrinks():
    budget, small, large = Budget(100), Client(), Client(left=40)
    budget.hold(large, 80)
    budget.hold(small, 30)
    assert (small.asked, large.asked, budget.held) == (0, 1, 70)


def test_holders_shrink_until_the_budget_is_kept():
    budget = Budget(100)
    clients = [Client(left=45) for _ in range(3)]
    for client in clients:
        budget.hold(client, 50)
    assert budget.held <= 100


def test_a_mailbox_sheds_what_may_be_dropped_and_counts_it():
    mailbox = Mailbox()
    mailbox.keep("must arrive")
    for frame in ("a", "b"):
        mailbox.put("topic", frame)
    assert mailbox.shed()
    assert (mailbox.dropped, taken(mailbox)) == (2, ["must arrive"])
    assert not mailbox.shed()
