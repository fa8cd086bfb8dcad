"""The command line's door: arguments in, exit status out.

What the verbs take is declared in `turtleact.commands.verbs`; here they are run, and whatever ends
them becomes a line on stderr and an exit status. Nothing is imported before it is wanted: Typer
alone takes five times as long as an empty Python program, so ``--help`` does without it; and until
`main` is entered, Ctrl-C is a traceback of Python's. From there on it waits until a handler takes
it: where it is raised in the middle of an import, it may be printed and lost.

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
any    somebody's code has called `sys.exit`
====== =================================================
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False  # as `typing` would say, which takes long to import
if TYPE_CHECKING:
    from collections.abc import Sequence

    from turtleact.commands.interrupts import Interrupts

__all__ = ["main", "run"]

OK, FAILED, USAGE, INTERRUPTED, BROKEN_PIPE = 0, 1, 2, 130, 141


def main() -> int:
    """Run the program and give its exit status; the entry point of ``turtleact``."""
    try:
        import _signal  # type: ignore[import-not-found]  # `signal` takes 6 ms more
        import os

        if shell := os.environ.get("_TURTLEACT_COMPLETE"):
            _signal.signal(_signal.SIGINT, _signal.SIG_DFL)  # silent, as all of it
            from turtleact.commands.completion import complete
            from turtleact.commands.interrupts import leave

            leave(complete(shell, sys.argv[1:]))

        before = _signal.pthread_sigmask(_signal.SIG_BLOCK, [_signal.SIGINT])
        from turtleact.commands.interrupts import Interrupts

        interrupts = Interrupts()
        interrupts.install()
        _signal.pthread_sigmask(_signal.SIG_SETMASK, before)
        if interrupts.received:
            raise KeyboardInterrupt
        status = run(sys.argv[1:], interrupts)
        interrupts.ignore()
        if interrupts.must_leave:
            from turtleact.commands.interrupts import leave

            leave(status)
    except KeyboardInterrupt:  # in the moment before the handler stood
        _note("interrupted")
        return INTERRUPTED
    return status


def run(arguments: Sequence[str], interrupts: Interrupts) -> int:
    """Run one command line and give its exit status. Never raises what a user might meet."""
    _make_printable()
    try:
        status = _run(arguments, interrupts)
        if sys.stdout is not None:
            sys.stdout.flush()
    except KeyboardInterrupt:
        _note("interrupted")
        return interrupts.status if interrupts.received else INTERRUPTED
    except BaseException as error:
        return _report(_leaf(error))
    return status


def _run(arguments: Sequence[str], interrupts: Interrupts) -> int:
    match arguments:
        case [] | ["-h" | "--help", *_]:
            print(_help())
        case ["--version", *_]:
            from turtleact import __version__

            print(f"turtleact {__version__}")
        case ["--show-completion" | "--install-completion" as option, *shells]:
            from turtleact.commands.shells import install, script

            act = script if option == "--show-completion" else install
            print(act(shells[0] if shells else None).removesuffix("\n"))
        case _:
            from turtleact.commands.verbs import parse

            return parse(arguments)(interrupts)
    return OK


def _help() -> str:
    from turtleact.commands import OPTIONS, VERBS

    option_lines, verb_lines = (
        "\n".join(f"  {name:{max(map(len, each))}}  {text}" for name, text in each.items())
        for each in (OPTIONS, VERBS)
    )
    return f"{_HELP}\n\nOptions:\n{option_lines}\n\nCommands:\n{verb_lines}"


_HELP = """Usage: turtleact [OPTIONS] COMMAND [ARGS]...

  ROS 2 actions, without ROS."""


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
    if error.errno in (errno.EPIPE, errno.EIO):
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
