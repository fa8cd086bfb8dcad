"""Describes what users' code raised or gave, in one line of text."""

from __future__ import annotations

__all__ = [
    "CUT_OFF",
    "STOPPED",
    "STOPS",
    "encodable",
    "shortened",
    "summary",
    "syntax_hint",
    "text_of",
]

STOPS = (KeyboardInterrupt, SystemExit, GeneratorExit)
"""The exceptions that stop the program or close a coroutine.

If a callback raises any other exception, the callback has failed."""

STOPPED = "the program was stopped"
"""The reason given for goals and service calls that end because the program was stopped."""

CUT_OFF = "canceled from within"
"""The reason recorded for a goal if the user's own code cancelled the task of the goal's body."""

LONGEST = 10_000
"""The maximum length of an exception's text in logs and messages, in characters."""


_RETURN_IN_GENERATOR = "'return' with value in async generator"
"""Python's error message for a body that both yields feedback and returns a result."""


def summary(error: BaseException) -> str:
    """Describe an exception in one line.

    The descriptions of an exception group's members are joined with semicolons.
    """
    if isinstance(error, BaseExceptionGroup):
        return shortened("; ".join(summary(each) for each in error.exceptions))
    said = text_of(error)
    return f"{type(error).__name__}: {said}" if said else type(error).__name__


def text_of(value: object) -> str:
    """Return ``str(value)`` in one line, cut after `LONGEST` characters."""
    return " ".join(shortened(str(value)).split("\n"))


def syntax_hint(error: BaseException) -> str:
    """Advise what to write if a body returns its result after a ``yield``; otherwise return "".

    In rclpy, a body returns its result, so many users also write ``return`` in a generator. The
    error message of Python does not say what to write instead.
    """
    if isinstance(error, SyntaxError) and error.msg == _RETURN_IN_GENERATOR:
        return "a body that yields feedback yields its result, too: write 'yield' for 'return'"
    return ""


def shortened(text: str) -> str:
    """Cut a text after `LONGEST` characters, and add how many characters it had.

    >>> shortened("a" * 10_001)[-25:]
    'aaaa… (10,001 characters)'
    """
    if len(text) <= LONGEST:
        return text
    return f"{text[:LONGEST]}… ({len(text):,} characters)"


def encodable(text: str) -> str:
    r"""Escape lone surrogates, the characters that UTF-8 cannot encode.

    Python uses lone surrogates for file names that are not UTF-8 (PEP 383).

    >>> print(encodable("caf\udce9"))
    caf\udce9
    """
    return text if text.isascii() else text.encode(errors="backslashreplace").decode()
