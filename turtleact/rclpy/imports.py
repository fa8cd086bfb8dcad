"""Learns the interfaces that a program imports and that no installed package has.

``from nav2_msgs.action import NavigateToPose`` names a type, not a topic. The user's cache is
looked at first. If it has no version of the type, or several, the graph is asked once, in a session
of its own, because the program has not called ``rclpy.init`` yet.

A thread runs that session, because the importing one may have an event loop. Python holds its
import lock while it looks for a module, so no thread could import anything then. These functions
must therefore be called while a module is executed or asked for a name, never by `find_spec`.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import cache
from typing import Final

import anyio

from turtleact.errors import NotLearned, TurtleactError
from turtleact.interfaces import type_hash
from turtleact.interfaces.learned import cached, cached_names, remember
from turtleact.interfaces.loading import learned_classes
from turtleact.node import open_node
from turtleact.node.learning import Learner
from turtleact.rclpy.face import SETTINGS
from turtleact.transports import open_zenoh
from turtleact.transports.graph import Kind

__all__ = ["PROBLEMS", "learn_import", "learn_package"]

LONGEST: Final = 3.0
"""How long an import may wait for the graph (s)."""


PROBLEMS: Final[dict[str, TurtleactError]] = {}
"""Why types could not be learned. Python looks twice for a name, and nobody is asked twice."""


def learn_import(type_name: str) -> None:
    """Learn a type, so that `turtleact.interfaces.loading.find_interface` finds it.

    Raises:
        TurtleactError: if neither the cache nor a node on the graph describes the type, or if there
            are several versions of it. The error lists them.
    """
    if type_name in PROBLEMS:
        raise PROBLEMS[type_name]
    if len({type_hash(each) for each in learned_classes(type_name)}) == 1:
        return
    try:
        _on_graph(lambda learner: learner.learn_type(type_name), type_name)
    except TurtleactError as error:
        PROBLEMS[type_name] = error
        raise


@cache
def learn_package(package: str) -> bool:
    """Learn the types of a package, and return whether there are any.

    A type of which the cache has several versions is left to `learn_import`, which asks the graph.
    """

    async def learn(learner: Learner) -> None:
        def wants(kind: Kind, name: str) -> bool:
            uses = learner.uses(name, kind)
            return any(use.type_name.startswith(f"{package}/") for use in uses)

        await learner.learn_all(wants)

    if not _cached(package):
        with suppress(TurtleactError):
            _on_graph(learn, package)
    for name in _cached(package):
        versions = list(cached(name))
        if len(versions) == 1:
            remember(versions[0])
    return bool(_cached(package))


def _cached(package: str) -> list[str]:
    return [name for name in cached_names() if name.startswith(f"{package}/")]


def _on_graph(learn: Callable[[Learner], Awaitable[object]], what: str) -> None:
    """Open a session, and learn from the graph in it.

    Raises:
        TurtleactError: if no graph is in reach, or the types cannot be learned in time.
    """
    place, domain = SETTINGS.place, int(os.environ.get("ROS_DOMAIN_ID", "0"))
    problems: list[TurtleactError] = [NotLearned(what, f"no answer within {LONGEST:g} s")]

    async def ask() -> None:
        with anyio.move_on_after(LONGEST):
            try:
                graph = open_zenoh(place.connect or None, domain=domain, config=place.config)
                async with graph as transport, open_node("_import", transport=transport) as node:
                    await transport.explore()
                    await learn(node.learner)
                problems.clear()
            except TurtleactError as error:
                problems[:] = [error]

    asking = threading.Thread(target=anyio.run, args=(ask,))
    asking.start()  # a thread of its own, because this one may run an event loop
    asking.join()
    if problems:
        raise problems[0]
