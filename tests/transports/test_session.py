"""The door to Zenoh: which threads stay attached to Python, and a graph that is asked once."""

from __future__ import annotations

import threading

import anyio.to_thread

from turtleact import open_node
from turtleact.interfaces.standard import Twist
from turtleact.transports import open_zenoh
from turtleact.transports.rmw_zenoh import session
from turtleact.transports.rmw_zenoh.session import census, stay_attached


def stay(calls: int) -> None:
    for _ in range(calls):
        stay_attached()


def in_a_thread(calls: int) -> int:
    """Have a new thread stay attached, so many times over; the id of that thread."""
    thread = threading.Thread(target=stay, args=[calls])
    thread.start()
    thread.join()
    assert thread.ident is not None
    return thread.ident


def test_each_thread_asks_once_to_keep_its_state(monkeypatch):
    asked: list[int] = []
    monkeypatch.setattr(session, "ENSURE_STATE", lambda: asked.append(threading.get_ident()))
    assert asked == [in_a_thread(2), in_a_thread(3)]


async def test_all_that_is_there_is_told_and_nobody_sees_who_asks(address):
    async with (
        open_zenoh([], listen=[address], domain=7) as here,
        open_node("robot", transport=here) as node,
    ):
        node.publisher(Twist, "/at")
        await here.flush()
        graph = await anyio.to_thread.run_sync(census, [address], 7)
        assert graph.nodes() == ("/robot",)
        assert [(each.kind, each.name) for each in graph.endpoints()] == [("publisher", "/at")]
        assert here.nodes() == ("/robot",)
        other = await anyio.to_thread.run_sync(census, [address], 8)
        assert other.nodes() == ()


async def test_a_graph_of_hundreds_of_endpoints_is_told(address):
    async with (
        open_zenoh([], listen=[address], domain=7) as here,
        open_node("robot", transport=here) as node,
    ):
        for number in range(300):
            node.publisher(Twist, f"/topic{number}")
        await here.flush()
        with anyio.fail_after(15):
            graph = await anyio.to_thread.run_sync(census, [address], 7, abandon_on_cancel=True)
        assert len(graph.endpoints()) == 300
