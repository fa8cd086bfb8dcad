"""The command line's door: arguments in, exit status out.

What the verbs take is declared in `turtleact.commands.verbs`; here they are run, and whatever ends
them becomes a line on stderr and an exit status. Nothing heavy is imported before a verb wants it.

====== =================================================
status meaning
====== =================================================
0      SUCCEEDED, or nothing went wrong
1      an error: nobody serves the action, a broken world
2      usage, or a goal that does not fit its type
3      the goal was rejected
4      ABORTED
5      CANCELED by somebody else
124    timeout
130    SIGINT (Ctrl-C); 143 SIGTERM
141    whoever read the output has gone
====== =================================================
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts

__all__ = ["main", "run"]

OK, FAILED, USAGE, INTERRUPTED, BROKEN_PIPE = 0, 1, 2, 130, 141


def main() -> int:
    """Run the program and give its exit status; the entry point of ``turtleact``."""
    try:
        from turtleact.commands.interrupts import Interrupts

        interrupts = Interrupts()
        interrupts.install()
        return run(sys.argv[1:], interrupts)
    except KeyboardInterrupt:  # in the moment before the handler stood
        _complain("interrupted")
        return INTERRUPTED


def run(arguments: Sequence[str], interrupts: Interrupts) -> int:
    """Run one command line and give its exit status. Never raises what a user might meet."""
    _make_printable()
    try:
        from turtleact.commands.verbs import parse

        status = parse(arguments)(interrupts)
        if sys.stdout is not None:
            sys.stdout.flush()
    except KeyboardInterrupt:
        _complain("interrupted")
        return interrupts.status if interrupts.received else INTERRUPTED
    except BaseException as error:
        return _report(_leaf(error))
    return status


def _report(error: BaseException) -> int:
    """Say on stderr what went wrong, and give the exit status of it."""
    from turtleact.errors import InvalidMessage, InvalidName, TurtleactError, UsageError

    if isinstance(error, TurtleactError):
        _complain(str(error))
        return USAGE if isinstance(error, UsageError | InvalidName | InvalidMessage) else FAILED
    if isinstance(error, OSError) and error.errno in _gone():
        _forget_output()
        return BROKEN_PIPE
    if sys.flags.dev_mode or not isinstance(error, Exception):
        raise error
    name = type(error).__name__
    _complain(f"a bug in turtleact: {name}: {error}; 'python -X dev -m turtleact …' shows where")
    return FAILED


def _leaf(error: BaseException) -> BaseException:
    """The one error that a task group has wrapped."""
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error


def _gone() -> tuple[int, ...]:
    """What the system says of an output that nobody reads: a closed pipe, a closed terminal."""
    import errno

    return (errno.EPIPE, errno.EIO)


def _forget_output() -> None:
    """Let what is still buffered go nowhere, so that Python's own last flush does not fail."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


def _make_printable() -> None:
    """Let a character that the output cannot show be escaped, not raised."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="backslashreplace")


def _complain(text: str) -> None:
    if sys.stderr is not None:
        print(f"turtleact: {text}", file=sys.stderr, flush=True)
