"""Verbs that look at a graph, and the options that say at which one.

What such a verb takes is its own and these options; its function gives back a look, and need not
know at what.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, TypeAlias

from turtleact.commands.interrupts import Interrupts
from turtleact.commands.verbs.arguments import Interfaces, Job, Reach, reach
from turtleact.commands.verbs.grouping import grouped, then

if TYPE_CHECKING:
    from turtleact.node import Node

__all__ = ["Look", "Plan", "on_graph", "on_known_graph", "planned_on_known_graph"]

Look: TypeAlias = Callable[["Node"], Awaitable[int]]
"""Looks at the graph that a node is on, and gives the exit status."""

Plan: TypeAlias = Callable[[Interrupts], Look]
"""Does what comes before the graph, such as reading stdin, and gives the look."""


@grouped(where=reach)
def _graph(*, where: Reach) -> Callable[[Look], Job]:
    def job_of(look: Look) -> Job:
        def job(interrupts: Interrupts) -> int:
            from turtleact.commands import graph

            return graph.run(where, look, interrupts)

        return job

    return job_of


@grouped(where=reach)
def _planned(*, where: Reach, interfaces: Interfaces = None) -> Callable[[Plan], Job]:
    def job_of(plan: Plan) -> Job:
        def job(interrupts: Interrupts) -> int:
            from turtleact.commands import graph
            from turtleact.commands.interfaces import make_known

            make_known(interfaces)
            return graph.run(where, plan(interrupts), interrupts)

        return job

    return job_of


@grouped(job_of=_planned)
def _known_graph(*, job_of: Callable[[Plan], Job]) -> Callable[[Look], Job]:
    return lambda look: job_of(lambda _: look)


on_graph = then(_graph)
"""A verb that looks at a graph: Typer sees the options that say at which one, it does not."""

on_known_graph = then(_known_graph)
"""The same with ``--interfaces``, which are known before the verb looks."""

planned_on_known_graph = then(_planned)
"""The same of a verb that has something to do before it looks."""
