"""The entry point of the command line: takes arguments, returns an exit status.

`turtleact.commands.app` runs the verb. This module calls it and turns every exception
into a line on stderr and an exit status. Modules are imported only when needed, because users wait
for every import. Importing Typer alone takes five times as long as running an empty Python program.

====== =================================================
status meaning
====== =================================================
0      SUCCEEDED, or nothing went wrong; also if a signal ended ``serve``
1      an error, for example nobody serves the action
2      wrong usage, or a goal that does not fit its type
3      the goal was rejected
4      ABORTED
5      somebody else canceled the goal
124    timeout
130    SIGINT (Ctrl-C); 143 SIGTERM; 129 SIGHUP
141    the reader of the output is gone
any    the status that users' code passed to `sys.exit`
====== =================================================
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False  # as in `typing`, which is slow to import
if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import NoReturn

__all__ = ["main", "run", "serve"]

FAILED, USAGE, INTERRUPTED, BROKEN_PIPE = 1, 2, 130, 141

PATIENCE = 1.5
"""The Tab key offers nothing after this many seconds, because users do not wait longer."""


def main() -> int:
    """Run the program and return its exit status."""
    try:
        import os
        import signal

        if "_TURTLEACT_COMPLETE" in os.environ:
            _complete()
        status = run(sys.argv[1:])
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # no traceback while Python shuts down
    except KeyboardInterrupt:
        return INTERRUPTED
    return status


def serve(*targets: str, node: str) -> NoReturn:
    """Do what ``turtleact serve TARGET... --no-sim --node-name NODE`` does, then end the program.

    Call this in the ``main`` of a package. The arguments of the program are added to those of
    ``turtleact serve``.

    Args:
        *targets: The modules with the actions, such as ``lab.server``, or their files, such as
            ``__file__``, or single actions, such as ``lab.server:countdown``.
        node: The name of the node that serves the actions.
    """
    from turtleact.rclpy.face import SETTINGS

    # The graph that 'turtleact run --connect ENDPOINT PACKAGE EXECUTABLE' has named.
    place = SETTINGS.place.connect
    graph = ["--connect", ",".join(place)] if place else []
    sys.argv[1:] = ["serve", *targets, "--no-sim", "--node-name", node, *graph, *sys.argv[1:]]
    sys.exit(main())


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit status. An error is printed to stderr."""
    _make_printable()
    try:
        from turtleact.commands import app

        status = app.run(arguments)
        print(end="", flush=True)
    except KeyboardInterrupt:
        _note("interrupted")
        return INTERRUPTED
    except Exception as error:
        return _report(_leaf(error))
    return status


def _complete() -> None:
    """Let Typer print completions for the shell, then end the process.

    The shell waits for the process, and shows whatever the process prints. Completion therefore
    takes at most `PATIENCE` seconds, and prints no error, whatever goes wrong. The process ends at
    once, because Zenoh's threads would take a while to stop.
    """
    import os
    import threading
    from contextlib import suppress

    from turtleact.commands.output import leave

    watch = threading.Timer(PATIENCE, os._exit, (0,))
    watch.daemon = True
    watch.start()
    status = 0
    with suppress(Exception):
        from turtleact.commands import app

        status = app.run(())
    leave(status)


def _report(error: BaseException) -> int:
    """Print an error to stderr, and return its exit status."""
    from turtleact.errors import InvalidMessage, InvalidName, TurtleactError, UsageError

    if isinstance(error, TurtleactError):
        _note(f"{error}{_advice(error)}")
        return USAGE if isinstance(error, UsageError | InvalidName | InvalidMessage) else FAILED
    if isinstance(error, OSError):
        return _report_broken_output(error)
    if sys.flags.dev_mode or not isinstance(error, Exception):
        raise error
    name = type(error).__name__
    _note(f"a bug in turtleact: {name}: {error}; 'PYTHONDEVMODE=1 turtleact …' shows where")
    return FAILED


def _advice(error: BaseException) -> str:
    """Return advice on an unknown interface, or an empty text for any other error."""
    from turtleact.commands.output import ELSEWHERE
    from turtleact.errors import UnknownInterface

    if isinstance(error, UnknownInterface):
        return f"{' If not,' if error.suggestion else ':'} {ELSEWHERE}"
    if isinstance(error.__cause__, UnknownInterface):  # a file uses it
        return f"\nto make it known, {ELSEWHERE}"
    return ""


def _leaf(error: BaseException) -> BaseException:
    """Return the first error inside nested exception groups."""
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error


def _report_broken_output(error: OSError) -> int:
    """Report an error of writing output, unless the reader is gone. Return the exit status."""
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
    """Make stdout and stderr escape what they cannot show, so that printing never raises."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="backslashreplace")


def _note(text: str) -> None:
    from turtleact.commands.output import note

    note(text)
