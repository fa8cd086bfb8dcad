"""What may stand where the cursor is: words of a command line in, lines for the shell out.

The verbs and their options are Typer's to know, the values of arguments `candidates`'. Whatever
goes wrong is silence: a line that is typed is no place for errors; and it is not waited for long.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Final

from turtleact.commands import OPTIONS, VERBS

__all__ = ["candidates", "complete", "lines"]

PATIENCE: Final = 1.5
"""Wall seconds after which there is nothing to be said."""

BREAKS: Final = (":", "=")
"""Where bash parts words: each of these is a word of its own to it."""

_NEEDS_QUOTES: Final = frozenset(" \t\"'\\$`&|;<>(){}[]*?!#~")
_ESCAPED: Final = str.maketrans({each: f"\\{each}" for each in '"\\$`'})


def complete(shell: str, words: Sequence[str]) -> int:
    """Print what may stand in the place of the last word; always a success.

    Args:
        shell: As in `turtleact.commands.shells`.
        words: The command line up to the cursor, the program first.
    """
    watch = threading.Timer(PATIENCE, os._exit, (0,))
    watch.daemon = True
    watch.start()
    text = ""
    with suppress(Exception, SystemExit):
        text = "".join(f"{line}\n" for line in lines(shell, words))
    watch.cancel()
    with suppress(OSError, ValueError):  # nobody reads, or not these letters
        print(text, end="", flush=True)
    return 0


def lines(shell: str, words: Sequence[str]) -> Iterator[str]:
    """What is printed; see `complete`."""
    if shell == "fish":
        typed, kept = list(words), ""
    else:
        typed, kept = _joined(words) if shell == "bash" else (list(words), "")
    *before, last = typed
    begun = last if shell == "fish" else _unquoted(last)
    for value, about in candidates([_unquoted(word) for word in before][1:], begun):
        if shell == "bash":
            yield _for_bash(value.removeprefix(kept), last[:1])
        else:
            yield f"{value}\t{about}" if about else value


def candidates(before: Sequence[str], begun: str) -> Iterator[tuple[str, str]]:
    """What may stand behind some words, and a few words on each.

    Args:
        before: The words before it, without the program.
        begun: What stands there already.
    """
    if not before:
        for name, text in (OPTIONS if begun.startswith("-") else VERBS).items():
            long_name = name.rpartition(" ")[2]
            if long_name.startswith(begun):
                yield long_name, text
        return
    from typer._completion_classes import BashComplete
    from typer.main import get_command

    from turtleact.commands.verbs import assemble

    verb = before[0]
    command = get_command(assemble([verb] if verb in VERBS else VERBS))
    for item in BashComplete(command, {}, "turtleact", "").get_completions(list(before), begun):
        yield str(item.value), item.help or ""


def _joined(words: Sequence[str]) -> tuple[list[str], str]:
    """The words of bash as they were typed, and what of the last one bash keeps."""
    typed: list[str] = []
    kept, is_open = "", False
    for word in words:
        is_break = word in BREAKS
        if typed and (is_open or is_break):
            kept = typed[-1] + (word if is_break else "")
            typed[-1] += word
        else:
            kept = ""
            typed.append(word)
        is_open = is_break
    return typed, kept


def _unquoted(word: str) -> str:
    """What a word says, its quotes closed or not."""
    result, quote, is_escaped = "", "", False
    for character in word:
        if is_escaped:
            result, is_escaped = result + character, False
        elif character == "\\" and quote != "'":
            is_escaped = True
        elif character in "'\"" and quote in ("", character):
            quote = "" if quote else character
        else:
            result += character
    return result


def _for_bash(value: str, first: str) -> str:
    """A value as bash is to type it, behind what the word begins with: it types it as it is."""
    if first == "'":
        return value.replace("'", r"'\''")
    escaped = value.translate(_ESCAPED)
    if first == '"':
        return escaped
    return f'"{escaped}"' if _NEEDS_QUOTES.intersection(value) else value
