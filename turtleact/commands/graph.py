"""The graph that a verb looks at: how it is reached, what is asked of it, how the looking ends.

A verb is a coroutine function that takes a `Node` and gives the exit status. Its node is hidden,
and nothing is opened on it but what the verb opens.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from typing import TYPE_CHECKING, TypeAlias, TypeVar

import anyio

from turtleact.commands import runner
from turtleact.commands.graph_names import Kind, names_like, types_by_name
from turtleact.commands.locks import mode_of
from turtleact.errors import InvalidInterface, TurtleactError, UnknownInterface, UsageError
from turtleact.interfaces import get_interface
from turtleact.node import Node, open_node

if TYPE_CHECKING:
    from contextlib import AbstractAsyncContextManager

    from turtleact.commands.interrupts import Interrupts
    from turtleact.commands.verbs.arguments import Reach
    from turtleact.interfaces import Action, Message, Service
    from turtleact.transports import Transport

__all__ = [
    "Look",
    "chosen_class",
    "enter_if_there",
    "interface_class",
    "open_graph",
    "open_transport",
    "run",
    "until_interrupted",
]

I = TypeVar("I", bound="Message | Service | Action")  # noqa: E741  # an interface
T = TypeVar("T")

Look: TypeAlias = Callable[[Node], Awaitable[int]]
"""Looks at the graph and gives the exit status."""


@asynccontextmanager
async def open_transport(reach: Reach) -> AsyncIterator[Transport]:
    """The graph that other processes are on; whoever enters it sees what is there.

    Raises:
        TurtleactError: if there is none in reach.
    """
    from turtleact.transports import open_zenoh

    locks = reach.locks()
    mode, config = mode_of(reach.connect, locks), locks.settings()
    opened = open_zenoh(reach.connect or None, mode=mode, domain=reach.domain, config=config)
    async with AsyncExitStack() as stack:
        try:
            transport = await stack.enter_async_context(opened)
        except TurtleactError as error:
            if reach.connect:
                raise
            raise TurtleactError(f"{error} 'turtleact serve' starts one") from None
        await transport.explore()
        yield transport


@asynccontextmanager
async def open_graph(reach: Reach) -> AsyncIterator[Node]:
    """A hidden node on that graph; raises as `open_transport` does."""
    async with (
        open_transport(reach) as transport,
        open_node(f"_turtleact_cli_{os.getpid()}", transport=transport) as node,
    ):
        yield node


async def enter_if_there(
    stack: AsyncExitStack, reach: Reach, opened: AbstractAsyncContextManager[T]
) -> T | None:
    """Enter a graph; None if there is none in reach and none was asked for.

    Args:
        stack: Closes it.
        reach: Which graph.
        opened: What opens it: `open_transport` or `open_graph`.

    Raises:
        UsageError: if the file with the locks is at fault.
        TurtleactError: if ``--connect`` says where it is, and it is not there.
    """
    try:
        return await stack.enter_async_context(opened)
    except UsageError:
        raise
    except TurtleactError:
        if reach.connect:
            raise
        return None


def run(reach: Reach, look: Look, interrupts: Interrupts) -> int:
    """Look at the graph until the verb or a signal ends it, and give the exit status.

    Args:
        reach: Which graph.
        look: The verb; a signal cancels it.
        interrupts: The signals.

    Raises:
        TurtleactError: if there is no graph in reach; what the verb raises.
    """
    return runner.run(until_interrupted(open_graph(reach), look, interrupts), interrupts)


async def until_interrupted(
    opened: AbstractAsyncContextManager[T],
    act: Callable[[T], Awaitable[int]],
    interrupts: Interrupts,
) -> int:
    """Open something and act on it, until that or a signal ends it, and give the exit status.

    Args:
        opened: What is opened, and closed at the end.
        act: Gives the exit status; a signal cancels it, and the opening and closing, too. An
            opening that does not heed that is not waited for, but ends with the process.
        interrupts: The signals.

    Raises:
        TurtleactError: if it cannot be opened; what the acting raises.
    """
    status: int | None = None
    with interrupts.listening(asyncio.get_running_loop()):
        async with anyio.create_task_group() as beside:
            beside.start_soon(_heed_interrupts, interrupts, beside.cancel_scope)
            async with AsyncExitStack() as stack:
                with interrupts.beginning():
                    it = await stack.enter_async_context(opened)
                status = await act(it)
            beside.cancel_scope.cancel()
    return interrupts.status if status is None else status


def interface_class(base: type[I], type_name: str, where: str = "") -> type[I]:
    """The class of a message, service or action whose name was typed, or is on the graph.

    Args:
        base: What it must be: `Message`, `Service` or `Action`.
        type_name: Its name.
        where: What it is the type of, if the graph says so.

    Raises:
        UnknownInterface: if it was typed and is not known.
        TurtleactError: if it is on the graph and not known here; the text says how to change that.
        InvalidInterface: if it is of another kind.
    """
    try:
        found = get_interface(type_name)
    except UnknownInterface:
        if not where:
            raise
        hint = "source the ROS workspace that has it, or give --interfaces DIR"
        raise TurtleactError(f"{where}: its type {type_name} is not known here: {hint}") from None
    if not issubclass(found, base):
        raise InvalidInterface(f"it is no {base.__name__.lower()}", source=found.type_name)
    return found


def chosen_class(
    node: Node, kind: Kind, base: type[I], name: str, type_name: str | None
) -> type[I]:
    """The class of what goes by a name: of the type that was typed, else as the graph says.

    Args:
        node: A node on the graph.
        kind: What goes by the name.
        base: As for `interface_class`.
        name: Its full name.
        type_name: The type, if it was typed; else the first of those on the graph is taken.

    Raises:
        TurtleactError: if neither says it, with the nearest name; as `interface_class`.
    """
    if type_name is not None:
        return interface_class(base, type_name)
    found = types_by_name(node.transport.endpoints(), kind, hidden=True)
    if name not in found:
        hint = names_like(name, [each for each in found if "/_" not in each])
        raise TurtleactError(f"{kind} '{name}' is not there{hint}; give its type to go ahead")
    return interface_class(base, found[name][0], f"{kind} '{name}'")


async def _heed_interrupts(interrupts: Interrupts, scope: anyio.CancelScope) -> None:
    await interrupts.wait(1)
    scope.cancel()
