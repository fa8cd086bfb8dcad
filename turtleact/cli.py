"""The command line's door: arguments in, exit status out.

What the verbs take is declared in `turtleact.commands.verbs`; here they are run, and whatever ends
them becomes a line on stderr and an exit status. Nothing is imported before it is needed, because
a user waits for each import: Typer alone takes five times as long as an empty Python program.

====== =================================================
status meaning
====== =================================================
0      SUCCEEDED, or nothing went wrong; a signal ended ``serve``
1      an error: nobody serves the action, a broken world
2      usage, or a goal that does not fit its type
3      the goal was rejected
4      ABORTED
5      CANCELED by somebody else
124    timeout
130    SIGINT (Ctrl-C); 143 SIGTERM; 129 SIGHUP
141    whoever read the output has gone
any    the status that a user's code gave to `sys.exit`
====== =================================================
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False  # as `typing` would say, which takes long to import
if TYPE_CHECKING:
    from collections.abc import Sequence

    from turtleact.commands.interrupts import Interrupts

__all__ = ["main", "run"]

FAILED, USAGE, INTERRUPTED, BROKEN_PIPE = 1, 2, 130, 141

PATIENCE = 1.5
"""Seconds after which the Tab key offers nothing: nobody waits longer for a completion."""


def main() -> int:
    """Run the program and give its exit status; the entry point of ``turtleact``."""
    try:
        import os
        import signal

        # Until the handlers stand, Ctrl-C ends the program silently, as it ends any program in C.
        # As an exception in the middle of an import it could be swallowed, or print a traceback.
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, signal.SIG_DFL)

        from turtleact.commands.interrupts import Interrupts

        interrupts = Interrupts()
        if "_TURTLEACT_COMPLETE" in os.environ:
            _complete(interrupts)
        interrupts.install()
    except KeyboardInterrupt:  # in the few milliseconds before
        return INTERRUPTED
    status = run(sys.argv[1:], interrupts)
    interrupts.ignore()
    if interrupts.must_leave:
        from turtleact.commands.interrupts import leave

        leave(status)
    return status


def run(arguments: Sequence[str], interrupts: Interrupts) -> int:
    """Run one command line and give its exit status. Never raises what a user might meet."""
    _make_printable()
    try:
        from turtleact.commands.verbs import parse

        status = parse(arguments)(interrupts)
        if sys.stdout is not None:
            sys.stdout.flush()
    except KeyboardInterrupt:
        _note("interrupted")
        return interrupts.status if interrupts.received else INTERRUPTED
    except BaseException as error:
        return _report(_leaf(error))
    return status


def _complete(interrupts: Interrupts) -> None:
    """Let Typer tell the shell what may stand at the cursor, and end the process.

    The shell waits, and shows what is printed: so this takes `PATIENCE` at most, and is silent
    whatever goes wrong. It ends at once, because the threads of Zenoh would take their time.
    """
    import os
    import threading
    from contextlib import suppress

    from turtleact.commands.interrupts import leave

    watch = threading.Timer(PATIENCE, os._exit, (0,))
    watch.daemon = True
    watch.start()
    status = 0
    with suppress(Exception):
        from turtleact.commands.verbs import parse

        status = parse(())(interrupts)
    leave(status)


def _report(error: BaseException) -> int:
    """Say on stderr what went wrong, and give the exit status of it."""
    from turtleact.errors import InvalidMessage, InvalidName, TurtleactError, UsageError

    if isinstance(error, TurtleactError):
        _note(str(error))
        return USAGE if isinstance(error, UsageError | InvalidName | InvalidMessage) else FAILED
    if isinstance(error, OSError):
        return _report_broken_output(error)
    if isinstance(error, SystemExit):
        from turtleact.commands.output import tell_exit

        return tell_exit(error)
    if sys.flags.dev_mode or not isinstance(error, Exception):
        raise error
    name = type(error).__name__
    _note(f"a bug in turtleact: {name}: {error}; 'python -X dev -m turtleact …' shows where")
    return FAILED


def _leaf(error: BaseException) -> BaseException:
    """The one error that a task group has wrapped."""
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error


def _report_broken_output(error: OSError) -> int:
    """A pipe or terminal that was closed is nothing to speak of; a disk that is full is."""
    import errno

    from turtleact.commands.output import abandon

    if sys.stdout is not None:
        abandon(sys.stdout)
    closed = {errno.EPIPE, errno.EIO} | ({errno.EINVAL} if sys.platform == "win32" else set())
    if error.errno in closed:
        return BROKEN_PIPE
    _note(f"the output cannot be written: {error.strerror}")
    return FAILED


def _make_printable() -> None:
    """Let a character that the output cannot show be escaped, not raised."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="backslashreplace")


def _note(text: str) -> None:
    from turtleact.commands.output import note

    note(text)
