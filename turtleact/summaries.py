"""What users' code raised or gave, in a line of text."""

from __future__ import annotations

__all__ = ["STOPPED", "STOPS", "summary", "text_of"]

STOPS = (KeyboardInterrupt, SystemExit, GeneratorExit)
"""What stops the program or closes a coroutine; all else that a callback raises is its failure."""

STOPPED = "the program was stopped"
"""Why what was under way has ended then."""


def summary(error: BaseException) -> str:
    """An exception in one line: the type and the text, those of a group one after the other."""
    if isinstance(error, BaseExceptionGroup):
        return "; ".join(summary(each) for each in error.exceptions)
    text = text_of(error)
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def text_of(value: object) -> str:
    """The text of a user's object, in a line, even if it fails to give one."""
    try:
        text = str(value)
    except Exception as failure:
        return f"({type(value).__name__}, whose text cannot be had: {type(failure).__name__})"
    return " ".join(text.split("\n"))
