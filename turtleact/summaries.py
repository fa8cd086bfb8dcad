"""Describes exceptions and values of users' code in one line."""

from __future__ import annotations

import ast
import linecache
import re
from types import TracebackType

__all__ = [
    "CUT_OFF",
    "STOPPED",
    "STOPS",
    "encodable",
    "field_hint",
    "loggable",
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

_UNKNOWN_FIELD = re.compile(r"Unexpected keyword argument '(\w+)'")
"""The error text of msgspec for a message that is created with an unknown field."""

_RETURN_IN_GENERATOR = "'return' with value in async generator"
"""Python's error message for a body that both yields feedback and returns a result."""


def summary(error: BaseException) -> str:
    """Describe an exception in one line.

    The descriptions of an exception group's members are joined with semicolons.
    """
    if isinstance(error, BaseExceptionGroup):
        return shortened("; ".join(summary(each) for each in error.exceptions))
    text, hint = text_of(error), field_hint(error)
    said = f"{text}: {hint}" if hint else text
    return f"{type(error).__name__}: {said}" if said else type(error).__name__


def text_of(value: object) -> str:
    """Return ``str(value)`` in one line, cut after `LONGEST` characters.

    If ``str`` fails, the text says so.
    """
    try:
        text = str(value)
    except Exception as failure:
        return f"({type(value).__name__}, whose text failed with {type(failure).__name__})"
    return " ".join(shortened(text).split("\n"))


def field_hint(error: BaseException) -> str:
    """If a message was created with an unknown field, suggest a known one; otherwise return "".

    The error does not name the message class, so this function finds the class in the source code
    of the failed call. The class itself does not check the fields in Python, because the check
    would double the time to create a message.
    """
    found = _UNKNOWN_FIELD.fullmatch(str(error)) if type(error) is TypeError else None
    called = _called(error.__traceback__) if found else None
    fields = getattr(called, "__struct_fields__", None)
    if found is None or called is None or fields is None:
        return ""
    import difflib  # only errors need it

    near = difflib.get_close_matches(found[1], fields, n=1)
    if near:
        return f"did you mean '{near[0]}'?"
    return f"{called.__qualname__} has {', '.join(map(repr, fields)) or 'no fields'}"


def syntax_hint(error: BaseException) -> str:
    """Advise what to write if a body returns its result after a ``yield``; otherwise return "".

    In rclpy, a body returns its result, so many users also write ``return`` in a generator. The
    error message of Python does not say what to write instead.
    """
    if isinstance(error, SyntaxError) and error.msg == _RETURN_IN_GENERATOR:
        return "a body that yields feedback yields its result, too: write 'yield' for 'return'"
    return ""


def _called(trace: TracebackType | None) -> type | None:
    """Return the class whose call has raised the error; None if the source does not show it."""
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if trace is None:
        return None
    frame = trace.tb_frame
    place = list(frame.f_code.co_positions())[trace.tb_lasti // 2]
    source = "".join(linecache.getlines(frame.f_code.co_filename, frame.f_globals))
    try:
        tree = ast.parse(source)
    except SyntaxError:  # the file has changed since
        return None
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and place == (
            *(node.lineno, node.end_lineno),
            *(node.col_offset, node.end_col_offset),
        ):
            found = _value_of(node.func, {**frame.f_globals, **frame.f_locals})
            return found if isinstance(found, type) else None
    return None


def _value_of(expression: ast.expr, names: dict[str, object]) -> object:
    """Return the value of a dotted name; for any other expression, return None.

    This runs none of the user's code.
    """
    if isinstance(expression, ast.Attribute):
        import inspect

        return inspect.getattr_static(_value_of(expression.value, names), expression.attr, None)
    return names.get(expression.id) if isinstance(expression, ast.Name) else None


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


def loggable(error: BaseException) -> BaseException:
    """Return an exception that can be logged with its traceback without printing a huge text.

    `logging` prints the whole text of an exception and of its causes. If the text of the exception
    or of a cause is longer than `LONGEST`, this function returns another exception, with the same
    traceback and a shortened text.
    """
    if not any(_is_huge(each) for each in _chain(error)):
        return error
    return RuntimeError(summary(error)).with_traceback(error.__traceback__)


def _chain(error: BaseException) -> list[BaseException]:
    """Collect an exception, its causes and contexts, and the members of exception groups."""
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
