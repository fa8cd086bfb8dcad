"""The built-in actions make way for a server of the user's, and come back when that has gone."""

from __future__ import annotations

import logging
from contextlib import AsyncExitStack

import anyio
import pytest

from turtleact import open_node
from turtleact.actions import serve_built_ins
from turtleact.interfaces.standard import Fibonacci
from turtleact.sim.kinematics import SIDE
from turtleact.transports import open_zenoh

MINE = [7]


async def mine(goal: Fibonacci.Goal) -> Fibonacci.Result:
    return Fibonacci.Result(sequence=MINE)


@pytest.mark.loops("asyncio")
async def test_a_built_in_action_makes_way_across_the_graph_and_comes_back(tmp_path, caplog):
    """Two sessions, as of two processes, that know each other by discovery only."""
    caplog.set_level(logging.WARNING, "turtleact")
    here = f"unixsock-stream/{tmp_path}/router"
    async with AsyncExitStack() as stack:
        enter = stack.enter_async_context
        first = await enter(open_zenoh(mode="router", listen=[here]))
        actions = await stack.enter_async_context(open_node("turtle_actions", transport=first))
        serve_built_ins(actions, side=SIDE)
        await first.flush()
        second = await enter(open_zenoh(mode="peer", connect=[here]))
        lab = await stack.enter_async_context(open_node("lab", transport=second))
        await second.explore()
        server = lab.action_server(Fibonacci, "/fibonacci", mine)
        client = lab.action_client(Fibonacci, "/fibonacci")

        async def logged(text):
            with anyio.fail_after(10.0):
                while not any(text in said for said in caplog.messages):
                    await anyio.sleep(0.01)

        await logged("/fibonacci is served by /lab now")
        assert (await client.send_goal(Fibonacci.Goal(order=2))).sequence == MINE
        await server.aclose()
        await logged("/fibonacci is free: the built-in action serves it again")
        assert (await client.send_goal(Fibonacci.Goal(order=2))).sequence == [0, 1, 1]
