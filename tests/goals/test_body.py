"""What can be the body of an action, and what a declaration makes of it."""

from __future__ import annotations

import functools
import re

import pytest

import turtleact
from turtleact.errors import InvalidBody, InvalidName
from turtleact.goals.body import ActionDeclaration, action, background

from ..lab import Count, count, feedback, goal, lab, result


async def plain(goal):
    return result()


async def with_handle(goal, handle):
    return result()


async def stream(goal):
    yield result()


async def stream_with_handle(goal, handle):
    yield result()


class Counter:
    """A body that is an object, with attributes of its own."""

    name = "the counter"

    def __init__(self) -> None:
        self.name = "a counter"
        self.options = "none"

    async def __call__(self, goal):
        return result(goal.upto)

    async def method(self, goal, handle):
        return result(goal.upto)

    @classmethod
    async def of_the_class(cls, goal):
        return result(goal.upto)

    @staticmethod
    async def of_nobody(goal):
        yield result(goal.upto)


class Streamer:
    async def __call__(self, goal, handle):
        yield result(goal.upto)


async def takes_four(goal, handle, speed, colour):
    return result()


async def takes_options(goal, handle, speed=1, *, colour="red", **more):
    return result()


async def takes_default_handle(goal, handle=None):
    return result()


async def takes_a_required_keyword(goal, *, speed):
    return result()


async def takes_nothing():
    return result()


async def takes_three(goal, handle, speed):
    return result()


async def takes_any(*goals):
    return result()


def not_async(goal):
    return result()


def gives_a_coroutine(goal):
    return plain(goal)


class NotCallable:
    pass


BODIES = [
    pytest.param(plain, id="coroutine"),
    pytest.param(with_handle, id="coroutine-with-handle"),
    pytest.param(stream, id="generator"),
    pytest.param(stream_with_handle, id="generator-with-handle"),
    pytest.param(Counter().method, id="bound-method"),
    pytest.param(Counter.of_the_class, id="class-method"),
    pytest.param(Counter.of_nobody, id="static-method"),
    pytest.param(Counter(), id="object"),
    pytest.param(Streamer(), id="object-that-streams"),
    pytest.param(functools.partial(with_handle), id="partial"),
    pytest.param(functools.partial(stream), id="partial-of-a-generator"),
    pytest.param(functools.partial(takes_four, speed=1, colour="red"), id="partial-by-keyword"),
    pytest.param(functools.partial(Counter().method, handle=None), id="partial-of-the-handle"),
    pytest.param(takes_options, id="defaults-behind-the-handle"),
    pytest.param(takes_default_handle, id="handle-with-a-default"),
    pytest.param(action(Count, "count")(stream), id="declaration"),
]

# What is wrong with each stands in the second column.
NO_BODIES = [
    pytest.param(not_async, "must be an 'async def', not a plain function", id="function"),
    pytest.param(gives_a_coroutine, "must be an 'async def', not a plain function", id="factory"),
    pytest.param(lambda goal: None, "must be an 'async def', not a plain function", id="lambda"),
    pytest.param(print, "must be an 'async def', not a plain function", id="built-in"),
    pytest.param(NotCallable(), "must be an 'async def', not a NotCallable", id="object"),
    pytest.param(Counter, "must be an 'async def', not a type", id="class"),
    pytest.param(functools.partial(not_async), "must be an 'async def', not a partial", id="part"),
    pytest.param(None, "must be an 'async def', not a NoneType", id="none"),
    pytest.param(takes_nothing, "must take the goal, or the goal and its handle, not 0", id="0"),
    pytest.param(takes_any, "must take the goal, or the goal and its handle, not 0", id="any"),
    pytest.param(takes_three, "must take the goal, or the goal and its handle, not 3", id="3"),
    pytest.param(
        takes_a_required_keyword, "must not require the keyword argument 'speed'", id="keyword"
    ),
]


@pytest.mark.parametrize("execute", BODIES)
async def test_a_body_of_any_kind_is_run(execute):
    async with lab(execute) as served:
        assert await served.client.send_goal(goal(7)) in (result(), result(7))


@pytest.mark.parametrize(("execute", "problem"), NO_BODIES)
def test_what_cannot_be_a_body_is_refused_where_it_is_declared(execute, problem):
    with pytest.raises(InvalidBody, match=f"^the body of action 'count' {problem}"):
        action(Count, "count")(execute)


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ((plain,), "missing 1 required positional argument: 'name'"),
        ((Count,), "missing 1 required positional argument: 'name'"),
        (
            ("Count", "count"),
            r"not 'Count': give the class, for example turtleact.get_action\(TYPE",
        ),
        ((Count.Goal, "count"), "not Count.Goal: give Count itself"),
        ((None, "count"), "expected a subclass of turtleact.Action, not None"),
    ],
)
def test_wrong_arguments_of_a_declaration_are_refused_at_once(arguments, problem):
    with pytest.raises(TypeError, match=problem):
        action(*arguments)


def test_a_wrong_name_in_a_declaration_is_refused_at_once():
    with pytest.raises(InvalidName):
        action(Count, "bad name")


async def test_what_cannot_be_a_body_is_refused_by_a_node():
    async with turtleact.open_node("lab") as node:
        with pytest.raises(InvalidBody, match="must be an 'async def'"):
            node.action_server(Count, "count", not_async)
        assert node.graph().actions == {}


async def test_a_body_that_takes_the_handle_gets_the_goals_own():
    async def body(request, handle):
        return result(handle.request.upto, request.upto)

    async with lab(body) as served:
        assert await served.client.send_goal(goal(7)) == result(7, 7)


async def test_a_body_that_takes_the_handle_sees_its_node():
    seen = []

    async def body(request, handle):
        seen.append(handle.node)
        return result()

    async with lab(body) as served:
        await served.client.send_goal(goal())
        assert seen == [served.node]


# --- declarations ---------------------------------------------------------------------------


@action(Count, "count_up", result_timeout=None)
async def declared(goal: Count.Goal):
    """Counts as declared."""
    async for item in count(goal):
        yield item


async def test_a_declared_generator_is_called_as_the_plain_function_that_it_is():
    items = [item async for item in declared(goal(2))]
    assert items == [feedback(0, 1), feedback(0, 1), result(0, 1)]  # one list, told twice


async def test_a_declared_coroutine_is_called_as_the_plain_function_that_it_is():
    assert await action(Count, "count")(plain)(goal()) == result()


def test_a_declaration_keeps_the_name_and_docstring_of_its_function():
    assert (vars(declared)["__name__"], declared.__doc__) == ("declared", "Counts as declared.")


def test_a_declaration_holds_what_was_declared():
    assert isinstance(declared, ActionDeclaration)
    assert (declared.action_type, declared.name, declared.options) == (
        Count,
        "count_up",
        {"result_timeout": None},
    )


def test_a_declaration_of_an_object_is_not_overwritten_by_the_objects_attributes():
    declaration = action(Count, "count_up")(Counter())
    assert (declaration.name, declaration.options) == ("count_up", {})


async def test_a_declaration_serves_nothing_by_itself():
    async with turtleact.open_node("lab") as node:
        action(Count, "count")(plain)
        assert node.graph().actions == {}


def no_coroutine(node):
    """Something that cannot run in the background."""


@pytest.mark.parametrize("function", [no_coroutine, stream, 3])
def test_what_cannot_run_in_the_background_is_refused(function):
    said = f"@turtleact.background needs an 'async def', not {function!r}"
    with pytest.raises(TypeError, match=f"^{re.escape(said)}$"):
        background(function)


async def test_a_background_function_can_be_called_like_the_function_itself():
    declared = background(plain)
    assert getattr(declared, "__name__", "") == "plain"
    assert await declared(object()) == result()
