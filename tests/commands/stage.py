"""A world for tests: actions that do each one thing. As a program: the command line in that world.

``/now`` succeeds, ``/fail`` aborts, ``/reject`` rejects, ``/hold`` ends when it is canceled and
``/stubborn`` not even then, ``/refuse`` refuses to be canceled, ``/deaf`` never answers that,
``/quit`` cancels itself, ``/consider`` takes for ever to accept, ``/crash`` raises, ``/strange``
says strange things.
"""

from __future__ import annotations

import sys
from contextlib import asynccontextmanager, suppress

import anyio

from turtleact import Abort, Action, CancelResponse, Message, Reject, cli, open_node
from turtleact.commands import graph, send_goal
from turtleact.interfaces import float64, string
from turtleact.interfaces.standard import ExampleFibonacci as Fibonacci


class Strange(Action, type_name="stage_interfaces/action/Strange"):
    class Goal(Message):
        text: string = ""

    class Result(Message):
        pass

    class Feedback(Message):
        text: string = "two\nlines\x1b[2J"
        numbers: list[float64] = []
        remaining: float64 = 0.0


async def now(goal):
    yield Fibonacci.Result(sequence=[0, 1])


async def fail(goal):
    sequence = [0, 1]
    for i in range(1, goal.order):
        sequence.append(sequence[i] + sequence[i - 1])
        yield Fibonacci.Feedback(sequence=sequence)
    if goal.order:
        raise Abort("out of paper", Fibonacci.Result(sequence=sequence))
    raise Abort


async def hold(goal):
    yield Fibonacci.Feedback(sequence=[0])
    await anyio.sleep_forever()


async def stubborn(goal):
    yield Fibonacci.Feedback(sequence=[0])
    while True:
        with suppress(anyio.get_cancelled_exc_class()):
            await anyio.sleep_forever()


async def crash(goal):
    raise ZeroDivisionError("by hand")
    yield


async def strange(goal):
    for remaining in (-4.0, 1.0):
        yield Strange.Feedback(numbers=[0.5] * 20, remaining=remaining)
        await anyio.sleep(0.1)
    yield Strange.Result()


REASON = "not today"


async def reject(goal):
    raise Reject(REASON)


async def consider(goal):
    await anyio.sleep_forever()


async def ponder(handle):
    await anyio.sleep_forever()


async def quit_(goal, handle):
    yield Fibonacci.Feedback(sequence=[0])
    await handle.node.action_client(Fibonacci, "/quit").cancel_all()
    await anyio.sleep_forever()


@asynccontextmanager
async def world(speed=1.0, seed=0):
    async with open_node("stage") as node:
        for body in (now, fail, hold, stubborn, crash):
            node.action_server(Fibonacci, f"/{body.__name__}", body)
        node.action_server(Fibonacci, "/quit", quit_)
        node.action_server(Strange, "/strange", strange)
        node.action_server(Fibonacci, "/reject", now, goal_callback=reject)
        node.action_server(Fibonacci, "/consider", now, goal_callback=consider)
        node.action_server(Fibonacci, "/deaf", hold, cancel_callback=ponder)
        node.action_server(
            Fibonacci, "/refuse", hold, cancel_callback=lambda handle: CancelResponse.REJECT
        )
        yield node


if __name__ == "__main__":
    graph.embedded_world = world
    send_goal.PATIENCE = 0.1
    send_goal.CANCEL_TIMEOUT = 2.0
    sys.exit(cli.main())
