"""What users' code raised or gave, in a line of text."""

from __future__ import annotations

__all__ = ["STOPPED", "STOPS", "encodable", "loggable", "shortened", "summary", "text_of"]

STOPS = (KeyboardInterrupt, SystemExit, GeneratorExit)
"""What stops the program or closes a coroutine; all else that a callback raises is its failure."""

STOPPED = "the program was stopped"
"""Why what was under way has ended then."""


LONGEST = 10_000
"""How many characters of an exception's text are logged or sent."""


def summary(error: BaseException) -> str:
    """An exception in one line: the type and the text, those of a group one after the other."""
    if isinstance(error, BaseExceptionGroup):
        return shortened("; ".join(summary(each) for each in error.exceptions))
    text = text_of(error)
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def text_of(value: object) -> str:
    """The text of a user's object, in a line of `LONGEST` characters, even if it has none."""
    try:
        text = str(value)
    except Exception as failure:
        return f"({type(value).__name__}, whose text cannot be had: {type(failure).__name__})"
    return " ".join(shortened(text).split("\n"))


def shortened(text: str) -> str:
    """The first `LONGEST` characters of a text, and how many it had if there are more.

    >>> shortened("a" * 10_001)[-25:]
    'aaaa… (10,001 characters)'
    """
    if len(text) <= LONGEST:
        return text
    return f"{text[:LONGEST]}… ({len(text):,} characters)"


def encodable(text: str) -> str:
    r"""A text that UTF-8 can encode: halves of surrogate pairs become escapes.

    Names of files that are not UTF-8 have such halves (PEP 383).

    >>> print(encodable("caf\udce9"))
    caf\udce9
    """
    return text if text.isascii() else text.encode(errors="backslashreplace").decode()


def loggable(error: BaseException) -> BaseException:
    """An exception that can be logged with its traceback: the same, unless its text is huge.

    `logging` prints the whole text, and those of the exceptions before it. Where one of them is
    longer than `LONGEST`, this is a stand-in with the same traceback and the shortened text.
    """
    if not any(_is_huge(each) for each in _chain(error)):
        return error
    return RuntimeError(summary(error)).with_traceback(error.__traceback__)


def _chain(error: BaseException) -> list[BaseException]:
    """An exception, its causes and contexts, and the members of groups."""
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
