"""One-line texts for what users' code raised or returned."""

from __future__ import annotations

__all__ = ["STOPPED", "STOPS", "encodable", "loggable", "shortened", "summary", "text_of"]

STOPS = (KeyboardInterrupt, SystemExit, GeneratorExit)
"""These exceptions stop the program or close a coroutine; a callback fails with any other."""

STOPPED = "the program was stopped"
"""The reason given for everything that ends because of it."""


LONGEST = 10_000
"""The maximum length of an exception's text in logs and messages, in characters."""


def summary(error: BaseException) -> str:
    """Describe an exception in one line; the members of a group are joined with semicolons."""
    if isinstance(error, BaseExceptionGroup):
        return shortened("; ".join(summary(each) for each in error.exceptions))
    text = text_of(error)
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def text_of(value: object) -> str:
    """Return ``str(value)`` in one line, at most `LONGEST` characters, even if ``str`` fails."""
    try:
        text = str(value)
    except Exception as failure:
        return f"({type(value).__name__}, whose text failed with {type(failure).__name__})"
    return " ".join(shortened(text).split("\n"))


def shortened(text: str) -> str:
    """Cut a text after `LONGEST` characters and add how many it had.

    >>> shortened("a" * 10_001)[-25:]
    'aaaa… (10,001 characters)'
    """
    if len(text) <= LONGEST:
        return text
    return f"{text[:LONGEST]}… ({len(text):,} characters)"


def encodable(text: str) -> str:
    r"""Escape what UTF-8 cannot encode: lone halves of surrogate pairs.

    Python uses such halves for file names that are not UTF-8 (PEP 383).

    >>> print(encodable("caf\udce9"))
    caf\udce9
    """
    return text if text.isascii() else text.encode(errors="backslashreplace").decode()


def loggable(error: BaseException) -> BaseException:
    """Return an exception that can be logged with its traceback without printing a huge text.

    `logging` prints the whole text of an exception and of those that caused it. If one of them is
    longer than `LONGEST`, the result is a stand-in with the same traceback and the shortened text.
    """
    if not any(_is_huge(each) for each in _chain(error)):
        return error
    return RuntimeError(summary(error)).with_traceback(error.__traceback__)


def _chain(error: BaseException) -> list[BaseException]:
    """Collect an exception, its causes and contexts, and the members of groups."""
    found: list[BaseException] = []
    waiting = [error]
    while waiting:
        each = waiting.pop()
        if any(each is known for known in found):
            continue
        found.append(each)
        waiting += [other for other in (each.__cause__, each.__context__) if other is not None]
        if isinstance(each, BaseExceptionGroup):
            waiting += each.exceptions
    return found


def _is_huge(error: BaseException) -> bool:
    try:
        return len(str(error)) > LONGEST
    except Exception:  # `logging` copes with that
        return False
