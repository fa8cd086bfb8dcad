"""Publishers and subscriptions: what is kept, what is missed, who reads, and what closing does."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, NamedTuple

import pytest

import turtleact
from turtleact import QoS
from turtleact.errors import InvalidMessage, TurtleactError
from turtleact.interfaces import Message, int32
from turtleact.node.topics import Publisher, Subscription
from turtleact.tasks import current_tasks

from ..lab import running

LATCHED = QoS(depth=2, durability="transient_local")


class Word(Message, type_name="lab_interfaces/msg/Word"):
    number: int32 = 0
    letters: list[int32] = []


class Other(Message, type_name="lab_interfaces/msg/Other"):
    number: int32 = 0


class Line(NamedTuple):
    """What a test works with."""

    node: turtleact.Node
    sending: Publisher[Word]
    receiving: Subscription[Word]


@asynccontextmanager
async def line(depth: int = 10) -> AsyncIterator[Line]:
    """A topic with one publisher, and one subscription of some depth."""
    async with turtleact.open_node("lab") as node:
        receiving = node.subscription(Word, "words", QoS(depth=depth))
        yield Line(node, node.publisher(Word, "words"), receiving)


def say(sending: Publisher[Word], *numbers: int) -> None:
    for number in numbers:
        sending.publish(Word(number=number))


async def read(receiving: Subscription[Word], count: int) -> list[int]:
    return [(await anext(receiving)).number for _ in range(count)]


async def read_to_the_end(receiving: Subscription[Word]) -> list[int]:
    return [message.number async for message in receiving]


# --- publishing and reading -----------------------------------------------------------------


async def test_a_message_is_waited_for():
    async with line() as words, running(lambda: read(words.receiving, 1)) as reading:
        assert not reading.done.is_set()
        say(words.sending, 7)
        await reading.done.wait()
        assert reading.value == [7]


async def test_what_was_published_is_what_is_read():
    async with line() as words:
        message = Word(letters=[1])
        words.sending.publish(message)
        message.letters.append(2)
        assert (await anext(words.receiving)).letters == [1]


async def test_a_publisher_is_told_when_the_first_reader_comes_and_the_last_one_goes():
    async with turtleact.open_node("lab") as node:
        told: list[bool] = []
        sending = node.publisher(
            Word, "words", on_matched=lambda: told.append(sending.has_subscriptions)
        )
        first, second = node.subscription(Word, "words"), node.subscription(Word, "words")
        assert told == [True]
        await first.aclose()
        assert told == [True]
        await second.aclose()
        assert told == [True, False]


async def test_a_publisher_is_told_of_a_reader_that_was_there_first():
    async with turtleact.open_node("lab") as node:
        node.subscription(Word, "words")
        told: list[str] = []
        node.publisher(Word, "words", on_matched=lambda: told.append("matched"))
        assert told == ["matched"]


@pytest.mark.parametrize("is_heard", [False, True])
async def test_a_message_of_another_type_is_refused_whether_anybody_listens_or_not(is_heard):
    async with turtleact.open_node("lab") as node:
        sending: Publisher[Any] = node.publisher(Word, "words")
        receiving = node.subscription(Word, "words") if is_heard else None
        with pytest.raises(InvalidMessage, match="Other"):
            sending.publish(Other(number=1))
        assert receiving is None or receiving.drain() == []


@pytest.mark.parametrize("is_heard", [False, True])
async def test_a_value_that_does_not_fit_is_refused_with_its_path(is_heard):
    async with turtleact.open_node("lab") as node:
        sending = node.publisher(Word, "words")
        receiving = node.subscription(Word, "words") if is_heard else None
        message = Word()
        message.letters.append(2**40)
        with pytest.raises(InvalidMessage, match=r"letters\[0\]"):
            sending.publish(message)
        assert receiving is None or receiving.drain() == []


# --- keep last ------------------------------------------------------------------------------


async def test_the_newest_messages_are_kept_and_the_others_counted():
    async with line(depth=3) as words:
        say(words.sending, *range(10))
        assert await read(words.receiving, 3) == [7, 8, 9]
        assert words.receiving.missed == 7


async def test_the_latest_is_the_newest_read_or_not():
    async with line(depth=1) as words:
        assert words.receiving.latest is None
        say(words.sending, 1, 2)
        assert words.receiving.latest == Word(number=2)
        await read(words.receiving, 1)
        assert words.receiving.latest == Word(number=2)


async def test_draining_takes_what_is_there_and_no_more():
    async with line() as words:
        assert words.receiving.drain() == []
        say(words.sending, 1, 2)
        assert words.receiving.drain() == [Word(number=1), Word(number=2)]
        assert words.receiving.drain() == []
        say(words.sending, 3)
        assert await read(words.receiving, 1) == [3]


# --- latched --------------------------------------------------------------------------------


async def test_a_late_subscription_keeps_no_more_latched_messages_than_its_depth():
    async with turtleact.open_node("lab") as node:
        say(node.publisher(Word, "words", LATCHED), 1, 2)
        late = node.subscription(Word, "words", QoS(depth=1, durability="transient_local"))
        assert (await read(late, 1), late.missed) == ([2], 1)


# --- several readers ------------------------------------------------------------------------


# --- canceled -------------------------------------------------------------------------------


async def test_a_canceled_reader_loses_no_message():
    async with line() as words:
        for turns in range(6):
            async with running(lambda: read(words.receiving, 1)) as reading:
                say(words.sending, turns)
                for _ in range(turns):
                    await current_tasks().checkpoint()
                reading.scope.cancel()
            taken = reading.value or []
            left = [message.number for message in words.receiving.drain()]
            assert taken + left == [turns], f"after {turns} turns"


# --- closing --------------------------------------------------------------------------------


async def test_what_has_come_before_the_closing_can_be_read():
    async with line() as words:
        say(words.sending, 1, 2)
        await words.receiving.aclose()
        say(words.sending, 3)
        assert await read_to_the_end(words.receiving) == [1, 2]


async def test_publishing_on_a_closed_publisher_raises():
    async with line() as words:
        await words.sending.aclose()
        with pytest.raises(
            TurtleactError, match="the publisher of topic '/words' is closed: open another"
        ):
            say(words.sending, 1)
        assert words.receiving.drain() == []


async def test_a_depth_in_place_of_a_qos_is_refused_with_the_way_to_write_it():
    async with turtleact.open_node("lab") as node:
        opens: list[Any] = [node.publisher, node.subscription]
        for open_it in opens:
            with pytest.raises(TypeError, match=r"expected a QoS, such as QoS\(depth=10\), not 10"):
                open_it(Word, "words", 10)
