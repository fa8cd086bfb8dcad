"""Options that belong together: declared once, by the function that makes one thing of them.

Typer reads what a verb takes from the signature of a function. Here that is put together of the
signatures of several: `grouped` gives a function such a thing for one of its parameters, `then`
hands what a function gives on to it.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from itertools import chain
from typing import TypeVar

__all__ = ["grouped", "then"]

T = TypeVar("T")
U = TypeVar("U")


def grouped(**groups: Callable[..., object]) -> Callable[[Callable[..., T]], Callable[..., T]]:
    """Let a function take, in place of some of its parameters, those of other functions.

    Args:
        **groups: By the name of the parameter, the function that gives its value.
    """

    def decorate(function: Callable[..., T]) -> Callable[..., T]:
        own = inspect.signature(function, eval_str=True)
        options = {
            name: [
                each.replace(kind=inspect.Parameter.KEYWORD_ONLY)
                for each in inspect.signature(make, eval_str=True).parameters.values()
            ]
            for name, make in groups.items()
        }
        parameters = [options.get(name, [each]) for name, each in own.parameters.items()]
        signature = own.replace(parameters=list(chain.from_iterable(parameters)))

        @wraps(function)
        def command(*args: object, **given: object) -> T:
            bound = signature.bind(*args, **given)
            bound.apply_defaults()
            values = bound.arguments
            for name, make in groups.items():
                values[name] = make(**{each.name: values.pop(each.name) for each in options[name]})
            return function(**values)

        return _signed(command, signature)

    return decorate


def then(
    options: Callable[..., Callable[[T], U]],
) -> Callable[[Callable[..., T]], Callable[..., U]]:
    """Let a function take the options of another behind its own, and hand on what it gives.

    The result of both is what ``options`` gives, called with what the function gives.

    Args:
        options: Takes options, and gives a function of one argument.
    """

    def decorate(function: Callable[..., T]) -> Callable[..., U]:
        @wraps(function)
        def command(*, hand_on: Callable[[T], U], **given: object) -> U:
            return hand_on(function(**given))

        own = inspect.signature(function, eval_str=True)
        last = inspect.Parameter("hand_on", inspect.Parameter.KEYWORD_ONLY)
        _signed(command, own.replace(parameters=[*own.parameters.values(), last]))
        return grouped(hand_on=options)(command)

    return decorate


def _signed(command: Callable[..., U], signature: inspect.Signature) -> Callable[..., U]:
    command.__signature__ = signature  # type: ignore[attr-defined]  # Typer looks there
    command.__annotations__ = {}  # and would look up there what only type checkers import
    return command
