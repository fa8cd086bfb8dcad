"""A client's values as messages, without keeping others waiting: large ones are read in a thread.

To check a million numbers takes seconds, and nobody else would be served meanwhile.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Final, TypeVar

from anyio import to_thread

from turtleact.interfaces import Message
from turtleact.web.values import message_from

__all__ = ["is_large", "read_message"]

M = TypeVar("M", bound=Message)

LARGE: Final = 2000
"""So many values are checked in a few milliseconds."""


async def read_message(cls: type[M], values: object, *, root: str) -> M:
    """As `turtleact.web.values.message_from`; others go on while it reads.

    Raises:
        InvalidMessage: with the path of the first value or name that does not fit.
    """
    if is_large(values):
        return await to_thread.run_sync(partial(message_from, cls, values, root=root))
    return message_from(cls, values, root=root)


def is_large(values: object) -> bool:
    """Whether there are more than `LARGE` values in objects and lists.

    >>> is_large({"x": [1] * 100}), is_large({"x": {"y": [1] * 3000}})
    (False, True)
    """
    count, waiting = 0, [values]
    while waiting:
        each: Any = waiting.pop()
        inner = each.values() if isinstance(each, dict) else each if isinstance(each, list) else ()
        count += len(inner)
        if count > LARGE:
            return True
        waiting.extend(inner)
    return False
