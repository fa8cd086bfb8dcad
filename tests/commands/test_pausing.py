"""``pause`` and ``resume``, and ``goals`` with paused goals."""

from __future__ import annotations

import re
from contextlib import asynccontextmanager

import anyio

from turtleact import open_node
from turtleact.goals.wire import SetPaused
from turtleact.interfaces.standard import ExampleFibonacci as Fibonacci

IDS = [bytes([number]) * 16 for number in (1, 2, 3)]
WALK, WAIT, BLIND = (each.hex() for each in IDS)


class Walk:
    """A graph with three goals: one of them walks, one waits for its turn, one cannot be paused.

    Attributes:
        paused: Which of them are paused, in the end.
        log: When ``/walk`` was paused and resumed.
        paused_before: Which of them are paused before the verb begins.
        count: How many of them there are.
    """

    def __init__(self, *paused_before: int, count: int = 3) -> None:
        self.count = count
        self.paused: list[bool] = []
        self.log: list[str] = []
        self.paused_before = paused_before
        self.switched = anyio.Event()

    async def walk(self, goal, handle):
        for _ in range(20):
            yield Fibonacci.Feedback()
            await handle.node.clock.sleep(1.0)
        yield Fibonacci.Result()

    async def blind(self, goal):
        await anyio.sleep_forever()
        return Fibonacci.Result()

    async def on_pause(self, handle):
        self.log.append("pause")
        self.switched.set()

    async def on_resume(self, handle):
        self.log.append("resume")

    @asynccontextmanager
    async def __call__(self, transport):
        async with (
            open_node("server", transport=transport) as server,
            open_node("boss", transport=transport) as boss,
        ):
            server.action_server(
                Fibonacci,
                "walk",
                self.walk,
                policy="queue",
                on_pause=self.on_pause,
                on_resume=self.on_resume,
            )
            server.action_server(Fibonacci, "blind", self.blind)
            handles = []
            for goal_id, name in zip(IDS[: self.count], ("walk", "walk", "blind"), strict=False):
                client = boss.action_client(Fibonacci, name)
                goal = Fibonacci.Goal(order=1)
                async with client.send_goal(goal, goal_id=goal_id) as handle:
                    handle.detach()
                    handles.append(handle)
                await transport.clock.sleep(1.0)
            for number in self.paused_before:
                await handles[number].pause()
            yield
            self.paused = [each.is_paused for each in handles]


def test_goals_are_paused_by_the_beginnings_of_their_ids(on_graph):
    walk = Walk()
    ran = on_graph(walk, "pause", WALK[:6], WAIT)
    assert ran == (0, f"{WALK} of /walk: paused\n{WAIT} of /walk: paused\n", "")
    assert (walk.paused, walk.log) == ([True, True, False], ["pause"])


def test_goals_are_resumed_by_the_beginnings_of_their_ids(on_graph):
    walk = Walk(0, 1)
    assert on_graph(walk, "resume", WALK[:6]) == (0, f"{WALK} of /walk: resumed\n", "")
    assert (walk.paused, walk.log) == ([False, True, False], ["pause", "resume"])


def test_why_a_goal_is_not_paused_is_printed(on_graph):
    ran = on_graph(Walk(), "pause", BLIND, "beef")
    assert ran.status == 1
    assert ran.out.splitlines() == [
        f"{BLIND} of /blind: not paused: its body cannot be paused: declare it with pausable=True "
        "and let it await handle.checkpoint(), or give the action an on_pause",
        "beef: not paused: no server in reach holds it",
    ]


def test_all_goals_of_an_action_are_paused(on_graph):
    walk = Walk()
    ran = on_graph(walk, "pause", "--all", "walk")
    assert (ran.status, len(ran.out.splitlines())) == (0, 2)
    assert walk.paused == [True, True, False]


def test_all_goals_that_are_paused_are_resumed(on_graph):
    walk = Walk(1)
    assert on_graph(walk, "resume", "--all") == (0, f"{WAIT} of /walk: resumed\n", "")
    assert on_graph(Walk(), "resume", "--all") == (
        0,
        "",
        "turtleact: there is no goal to resume\n",
    )


def test_an_ended_goal_is_not_paused(on_graph, graphs):
    ran = on_graph(graphs.goals, "pause", "3c87")
    assert (ran.status, ran.out) == (
        1,
        f"{graphs.IDS['done']} of /count: not paused: it has ended SUCCEEDED\n",
    )


def test_a_server_that_cannot_pause_says_so(on_graph):
    @asynccontextmanager
    async def without(transport):
        """A server that offers no service for it, as those of ROS 2."""
        serve = transport.serve

        def only_others(endpoint, *rest):
            if endpoint.type_name == SetPaused.type_name:
                return Gone()
            return serve(endpoint, *rest)

        transport.serve = only_others
        async with Walk()(transport):
            yield

    class Gone:
        def close(self):
            pass

    ran = on_graph(without, "pause", WALK)
    problem = "its server does not offer that; is it a server of turtleact?"
    assert (ran.status, ran.out) == (1, f"{WALK} of /walk: not paused: {problem}\n")


def test_paused_goals_are_listed_as_such(on_graph):
    lines = on_graph(Walk(0, 1), "goals").out.splitlines()
    states = [re.split("  +", line)[2] for line in lines[1:]]
    assert states == ["EXECUTING (paused)", "ACCEPTED (paused)", "EXECUTING"]
