"""Makes functions that open a resource for an ``async with`` block, such as `open_node`.

`opening` works like `contextlib.asynccontextmanager`. In addition, if the user writes ``with``,
``await`` or no keyword at all in place of ``async with``, the error says what to write. Without
`opening`, Python's error would name an internal class of `contextlib`. Type checkers see an
`AbstractAsyncContextManager`, so they find these mistakes themselves.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from functools import wraps
from types import TracebackType
from typing import NoReturn, ParamSpec, TypeVar

__all__ = ["opening"]

P = ParamSpec("P")
T = TypeVar("T")


def opening(function: Callable[P, AsyncIterator[T]]) -> Callable[P, AbstractAsyncContextManager[T]]:
    """Make a function that opens a resource for an ``async with`` block.

    Args:
        function: An async generator function that yields the resource once.
    """
    manager = asynccontextmanager(function)

    @wraps(function)
    def open_it(*args: P.args, **kwargs: P.kwargs) -> AbstractAsyncContextManager[T]:
        return _Opening(manager(*args, **kwargs), f"{function.__name__}(…)")

    return open_it


class _Opening(AbstractAsyncContextManager[T]):
    """Opens a resource at the start of an ``async with`` block, and closes the resource at the end.

    Args:
        manager: The context manager that opens and closes the resource.
        call: The call that made this object, for error messages.
    """

    def __init__(self, manager: AbstractAsyncContextManager[T, bool | None], call: str) -> None:
        self._manager = manager
        self._call = call
        self._is_entered = False
        self._advice = f"write 'async with {call} as …:'"

    async def __aenter__(self) -> T:
        if self._is_entered:
            again = f"call {self._call} again for another 'async with'"
            raise RuntimeError(f"this result of {self._call} was used before: {again}")
        self._is_entered = True
        return await self._manager.__aenter__()

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> bool | None:
        return await self._manager.__aexit__(kind, error, trace)

    def __enter__(self) -> NoReturn:
        raise TypeError(f"'async' is missing: {self._advice}")

    def __exit__(self, *_: object) -> None:
        """Do nothing.

        A ``with`` statement needs ``__exit__``. Without this method, the statement would fail
        before it calls ``__enter__``, which raises the error that helps the user.
        """

    def __await__(self) -> NoReturn:
        raise TypeError(f"{self._call} cannot be awaited: {self._advice}")

    def __getattr__(self, name: str) -> NoReturn:
        # Private names belong to Python. `copy.copy`, for example, asks for ``__setstate__`` before
        # the copy has any attribute that this method could read.
        if name.startswith("_"):
            raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")
        raise AttributeError(f"{self._call} is not open yet and has no '{name}': {self._advice}")
