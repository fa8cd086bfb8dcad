"""What is asked of an action server, once of rclpy's and once of turtleact's.

Each scenario drives a `Peer` and leaves a transcript: a line for each thing that a client can see.
Knows neither of the two, so that both Pythons can import it.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Protocol

REJECTED = -1
"""The order of a goal that the server's goal callback rejects."""

STUBBORN = 13
"""The order of a goal that the server's cancel callback does not let go."""

UNKNOWN = "nobody"
"""A label that no goal has."""

RESULT_TIMEOUT = 1
"""How long the servers keep a result (s)."""

STATUS = ("UNKNOWN", "ACCEPTED", "EXECUTING", "CANCELING", "SUCCEEDED", "CANCELED", "ABORTED")


class Peer(Protocol):
    """An action server whose goals end as they are told, and a client that uses its endpoints.

    Goals go by labels. What a client sees is noted in ``transcript``.
    """

    transcript: list[str]

    async def send(self, label: str, order: int = 3) -> None:
        """Send a goal, and wait until it has been answered."""

    async def tell(self, label: str, word: str, *numbers: int) -> None:
        """Let the body of a goal go on: feedback, succeed, abort, canceled, raise, or return.

        ``nothing`` returns without a word on how the goal has ended, ``none`` without a result too.
        """

    async def cancel(self, label: str | None = None, before: str | None = None) -> None:
        """Send a cancel request: of a goal, of all accepted a moment before another, or of all."""

    async def status(self, **goals: str) -> None:
        """Wait until the status topic shows these goals so, and note the whole array."""

    async def result(self, label: str) -> None:
        """Ask for a result and wait for it."""

    async def ask(self, label: str) -> None:
        """Ask for a result."""

    async def answers(self) -> None:
        """Wait for all results that were asked for."""

    async def feedback(self, count: int) -> None:
        """Wait for so many feedback messages."""

    async def pause(self, seconds: float) -> None:
        """Let time pass."""


Scenario = Callable[[Peer], Awaitable[None]]


def goal_id(label: str) -> bytes:
    """The 16 bytes that a goal of this label has for its id."""
    return label.encode().ljust(16, b"-")


def label_of(uuid: bytes) -> str:
    return bytes(uuid).rstrip(b"-").decode()


def status_line(goals: list[tuple[str, int]]) -> str:
    """What a status array says."""
    return "status: " + ", ".join(f"{label} {STATUS[status]}" for label, status in goals)


def shows(goals: list[tuple[str, int]], expected: dict[str, str]) -> bool:
    """Whether a status array shows these goals so; what else it shows is left open."""
    return expected.items() <= {label: STATUS[status] for label, status in goals}.items()


def cancel_line(label: str | None, before: str | None, code: int, goals: list[str]) -> str:
    """What the answer to a cancel request says; the order of its goals says nothing."""
    words = [label or ("all" if before is None else ""), f"before {before}" if before else ""]
    return f"cancel {' '.join(filter(None, words))}: {code} {' '.join(sorted(goals))}".rstrip()


def result_line(label: str, status: int, numbers: list[int]) -> str:
    return f"result of {label}: {STATUS[status]} {numbers}"


async def a_goal_succeeds(peer: Peer) -> None:
    await peer.send("a")
    await peer.status(a="EXECUTING")
    await peer.tell("a", "feedback", 0, 1)
    await peer.tell("a", "feedback", 0, 1, 1)
    await peer.feedback(2)
    await peer.tell("a", "succeed", 0, 1, 1, 2)
    await peer.status(a="SUCCEEDED")
    await peer.result("a")


async def a_goal_is_aborted(peer: Peer) -> None:
    await peer.send("a")
    await peer.tell("a", "abort", 7)
    await peer.status(a="ABORTED")
    await peer.result("a")


async def a_body_says_nothing_of_the_end(peer: Peer) -> None:
    await peer.send("a")
    await peer.tell("a", "nothing")
    await peer.status(a="ABORTED")
    await peer.result("a")


async def a_body_returns_none(peer: Peer) -> None:
    await peer.send("a")
    await peer.tell("a", "none")
    await peer.status(a="ABORTED")
    await peer.result("a")


async def a_body_raises(peer: Peer) -> None:
    await peer.send("a")
    await peer.tell("a", "raise")
    await peer.status(a="ABORTED")
    await peer.result("a")


async def a_goal_is_rejected(peer: Peer) -> None:
    await peer.send("a", REJECTED)
    await peer.result("a")
    await peer.cancel("a")


async def an_id_twice(peer: Peer) -> None:
    await peer.send("a")
    await peer.send("a")
    await peer.tell("a", "succeed", 1)
    await peer.status(a="SUCCEEDED")
    await peer.send("a")
    await peer.result("a")


async def a_result_is_asked_for_early_and_by_many(peer: Peer) -> None:
    await peer.send("a")
    await peer.ask("a")
    await peer.ask("a")
    await peer.tell("a", "succeed", 5)
    await peer.answers()
    await peer.result("a")


async def a_goal_nobody_knows(peer: Peer) -> None:
    await peer.result(UNKNOWN)
    await peer.cancel(UNKNOWN)


async def a_result_expires(peer: Peer) -> None:
    await peer.send("a")
    await peer.tell("a", "succeed", 5)
    await peer.status(a="SUCCEEDED")
    await peer.result("a")
    await peer.pause(RESULT_TIMEOUT + 0.5)
    await peer.result("a")
    await peer.cancel("a")
    await peer.send("a")
    await peer.status(a="EXECUTING")
    await peer.tell("a", "succeed", 6)
    await peer.result("a")


async def a_long_goal_keeps_its_result(peer: Peer) -> None:
    await peer.send("a")
    await peer.pause(RESULT_TIMEOUT + 0.5)
    await peer.tell("a", "succeed", 5)
    await peer.status(a="SUCCEEDED")
    await peer.result("a")


async def a_cancel_ends_canceled(peer: Peer) -> None:
    await peer.send("a")
    await peer.status(a="EXECUTING")
    await peer.cancel("a")
    await peer.status(a="CANCELING")
    await peer.tell("a", "feedback", 8)
    await peer.feedback(1)
    await peer.tell("a", "canceled", 9)
    await peer.status(a="CANCELED")
    await peer.result("a")
    await peer.cancel("a")


async def a_cancel_ends_otherwise(peer: Peer) -> None:
    await peer.send("a")
    await peer.send("b")
    await peer.status(a="EXECUTING", b="EXECUTING")
    await peer.cancel()
    await peer.status(a="CANCELING", b="CANCELING")
    await peer.tell("a", "succeed", 1)
    await peer.status(a="SUCCEEDED")
    await peer.tell("b", "abort", 2)
    await peer.status(b="ABORTED")
    await peer.result("a")
    await peer.result("b")


async def a_cancel_of_all(peer: Peer) -> None:
    await peer.cancel()
    await peer.send("a")
    await peer.send("b")
    await peer.send("c")
    await peer.tell("a", "succeed")
    await peer.status(a="SUCCEEDED", b="EXECUTING", c="EXECUTING")
    await peer.cancel()
    await peer.status(b="CANCELING", c="CANCELING")
    await peer.tell("b", "canceled")
    await peer.tell("c", "canceled")
    await peer.status(b="CANCELED", c="CANCELED")
    await peer.cancel()


async def a_cancel_before_a_time(peer: Peer) -> None:
    for label in ("a", "b", "c"):
        await peer.send(label)
        await peer.pause(0.01)
    await peer.status(a="EXECUTING", b="EXECUTING", c="EXECUTING")
    await peer.cancel(before="a")
    await peer.cancel(before="c")
    await peer.status(a="CANCELING", b="CANCELING")
    for label in ("a", "b"):
        await peer.tell(label, "canceled")
        await peer.status(**{label: "CANCELED"})
    await peer.tell("c", "succeed")
    await peer.status(c="SUCCEEDED")


async def a_cancel_by_id_and_time(peer: Peer) -> None:
    for label in ("a", "b", "c"):
        await peer.send(label)
        await peer.pause(0.01)
    await peer.status(a="EXECUTING", b="EXECUTING", c="EXECUTING")
    await peer.cancel(UNKNOWN, before="a")
    await peer.cancel("c", before="b")
    await peer.status(a="CANCELING", c="CANCELING")
    for label in ("a", "c"):
        await peer.tell(label, "canceled")
        await peer.status(**{label: "CANCELED"})
    await peer.tell("b", "succeed")
    await peer.status(b="SUCCEEDED")


async def a_second_cancel(peer: Peer) -> None:
    await peer.send("a")
    await peer.status(a="EXECUTING")
    await peer.cancel("a")
    await peer.status(a="CANCELING")
    await peer.cancel("a")
    await peer.cancel()
    await peer.tell("a", "canceled")
    await peer.status(a="CANCELED")


async def a_goal_that_is_not_let_go(peer: Peer) -> None:
    await peer.send("a", STUBBORN)
    await peer.status(a="EXECUTING")
    await peer.cancel("a")
    await peer.tell("a", "succeed", 4)
    await peer.status(a="SUCCEEDED")
    await peer.result("a")


async def some_goals_are_not_let_go(peer: Peer) -> None:
    await peer.send("a", STUBBORN)
    await peer.send("b", STUBBORN)
    await peer.send("c")
    await peer.status(a="EXECUTING", b="EXECUTING", c="EXECUTING")
    await peer.cancel()
    await peer.status(c="CANCELING")
    await peer.tell("c", "canceled")
    await peer.status(c="CANCELED")
    for label in ("a", "b"):
        await peer.tell(label, "succeed")
    await peer.status(a="SUCCEEDED", b="SUCCEEDED")


async def two_goals_side_by_side(peer: Peer) -> None:
    await peer.send("a")
    await peer.send("b")
    await peer.status(a="EXECUTING", b="EXECUTING")
    await peer.tell("b", "feedback", 2)
    await peer.feedback(1)
    await peer.tell("a", "feedback", 1)
    await peer.feedback(1)
    await peer.tell("b", "succeed", 2)
    await peer.status(b="SUCCEEDED")
    await peer.tell("a", "succeed", 1)
    await peer.status(a="SUCCEEDED")
    await peer.result("a")
    await peer.result("b")


SCENARIOS: dict[str, Scenario] = {
    scenario.__name__: scenario
    for scenario in (
        a_goal_succeeds,
        a_goal_is_aborted,
        a_body_says_nothing_of_the_end,
        a_body_returns_none,
        a_body_raises,
        a_goal_is_rejected,
        an_id_twice,
        a_result_is_asked_for_early_and_by_many,
        a_goal_nobody_knows,
        a_result_expires,
        a_long_goal_keeps_its_result,
        a_cancel_ends_canceled,
        a_cancel_ends_otherwise,
        a_cancel_of_all,
        a_cancel_before_a_time,
        a_cancel_by_id_and_time,
        a_second_cancel,
        a_goal_that_is_not_let_go,
        some_goals_are_not_let_go,
        two_goals_side_by_side,
    )
}
