"""Verbs that look at a graph, and the options that say at which one.

Typer reads what a verb takes from the signature of a function. That of a verb that looks is its own
and these options; the function gives back a look, and need not know at what.
"""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable
from functools import partial, wraps
from typing import TYPE_CHECKING, TypeAlias

from turtleact.commands.interrupts import Interrupts
from turtleact.commands.verbs.arguments import Config, Connect, Domain, Interfaces, Job, reach

if TYPE_CHECKING:
    from turtleact.node import Node

__all__ = ["Look", "on_graph", "on_known_graph"]

Look: TypeAlias = Callable[["Node"], Awaitable[int]]
"""Looks at the graph that a node is on, and gives the exit status."""

Runner: TypeAlias = Callable[[Look, Interrupts], int]
"""Runs a look at some graph."""


def on_graph(function: Callable[..., Look]) -> Callable[..., Job]:
    """A verb that looks at a graph: Typer sees the options that say at which one, it does not."""
    return _looking(function, _graph)


def on_known_graph(function: Callable[..., Look]) -> Callable[..., Job]:
    """The same with ``--interfaces``, which are known before the verb looks."""
    return _looking(function, _known_graph)


def _graph(*, connect: Connect = None, domain: Domain = None, config: Config = None) -> Runner:
    """What runs a look at the graph that these options mean."""
    where = reach(connect, domain, config)

    def run(look: Look, interrupts: Interrupts) -> int:
        from turtleact.commands import graph

        return graph.run(where, look, interrupts)

    return run


def _known_graph(
    *,
    connect: Connect = None,
    domain: Domain = None,
    config: Config = None,
    interfaces: Interfaces = None,
) -> Runner:
    """The same, after what it takes to know the interfaces."""
    run_there = _graph(connect=connect, domain=domain, config=config)

    def run(look: Look, interrupts: Interrupts) -> int:
        from turtleact.commands.interfaces import make_known

        make_known(interfaces)
        return run_there(look, interrupts)

    return run


def _looking(function: Callable[..., Look], options: Callable[..., Runner]) -> Callable[..., Job]:
    """A function with the options of both, as far as Typer, which reads signatures, can see."""
    own, more = (inspect.signature(each, eval_str=True) for each in (function, options))

    @wraps(function)
    def command(**given: object) -> Job:
        run = options(**{name: given.pop(name) for name in more.parameters})
        return partial(run, function(**given))

    parameters = [*own.parameters.values(), *more.parameters.values()]
    command.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]  # Typer looks there
    command.__annotations__ = {}  # and would look up there what only type checkers import
    return command
