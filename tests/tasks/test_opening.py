"""What is opened for an ``async with`` block, and the errors if ``async with`` is forgotten."""

from __future__ import annotations

import copy
import inspect
import pkgutil
import re
from collections.abc import AsyncIterator
from typing import Any

import pytest

import turtleact
from turtleact.tasks import opening

pytestmark = pytest.mark.loops("asyncio")


def open_door(events: list[str]) -> Any:
    @opening
    async def open_door(name: str) -> AsyncIterator[str]:
        """Open a door."""
        events.append("opened")
        try:
            yield name
        except ValueError:
            events.append("failed")
        events.append("closed")

    return open_door


async def test_a_block_gets_what_is_opened_and_closes_it():
    events: list[str] = []
    async with open_door(events)("oak") as door:
        assert (door, events) == ("oak", ["opened"])
    assert events == ["opened", "closed"]


async def test_an_error_of_the_block_reaches_what_was_opened():
    events: list[str] = []
    async with open_door(events)("oak"):
        raise ValueError
    assert events == ["opened", "failed", "closed"]


def test_the_function_keeps_its_name_and_docstring():
    function = open_door([])
    assert (function.__name__, function.__doc__) == ("open_door", "Open a door.")


OPENED = [
    "turtleact:open_node",
    "turtleact:open_world",
    "turtleact:open_zenoh",
    "turtleact:open_journal",
    "turtleact.recording:record",
    "turtleact.web:open_bridge",
    "turtleact.web:open_web",
    "turtleact.web.bag_view:open_bag_view",
    "turtleact.mcp:open_mcp",
    "turtleact.mcp:open_app",
    "turtleact.mcp:open_http",
]


@pytest.mark.parametrize("place", OPENED)
def test_an_error_says_that_async_is_missing(place):
    function: Any = pkgutil.resolve_name(place)
    parameters = inspect.signature(function).parameters.values()
    positional = [each for each in parameters if each.kind is each.POSITIONAL_OR_KEYWORD]
    arguments = [None for each in positional if each.default is each.empty]  # nobody reads them yet
    problem = rf"'async' is missing: write 'async with {function.__name__}\(…\) as …:'"
    with pytest.raises(TypeError, match=problem), function(*arguments):
        pass


async def test_an_error_says_that_what_is_opened_cannot_be_awaited():
    node: Any = turtleact.open_node("lab")
    said = "open_node(…) cannot be awaited: write 'async with open_node(…) as …:'"
    with pytest.raises(TypeError, match=f"^{re.escape(said)}$"):
        await node


def test_python_may_look_for_private_names_before_the_block():
    node: Any = turtleact.open_node("lab")
    assert type(copy.copy(node)) is type(node)
    with pytest.raises(AttributeError, match=r"object has no attribute '__len__'$"):
        node.__len__()


def test_an_error_says_that_async_with_is_missing():
    node: Any = turtleact.open_node("lab")
    said = "open_node(…) is not open yet and has no 'serve': write 'async with open_node(…) as …:'"
    with pytest.raises(AttributeError, match=f"^{re.escape(said)}$"):
        node.serve(None)
