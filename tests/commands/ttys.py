"""Terminals for tests: both ends of one, and programs that run on one of their own."""

from __future__ import annotations

import errno
import fcntl
import os
import pty
import re
import struct
import sys
import termios
from pathlib import Path

from .. import warm

STAGE = (Path(__file__).with_name("stage.py"),)
TURTLEACT = ("-m", "turtleact")
ESCAPE = re.compile(r"\x1b(\[[0-9;?]*[A-Za-z]|[78])")
SHOW, HIDE = b"\x1b[?25h", b"\x1b[?25l"


def open_terminal(columns=80, rows=24):
    """Both ends of a terminal of that size."""
    main, other = pty.openpty()
    fcntl.ioctl(other, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
    return main, other


def read(main):
    """What has been written, or nothing if the other end is closed."""
    try:
        return os.read(main, 65536)
    except OSError as error:  # what Linux says then
        if error.errno != errno.EIO:
            raise
        return b""


class Terminal:
    """A command line on a terminal of its own, in a process group of its own.

    Args:
        *arguments: The command line.
        program: What Python runs.
        columns: The width of the terminal.
        rows: Its height.
        **environment: More variables.
    """

    def __init__(self, *arguments, program=TURTLEACT, columns=80, rows=24, **environment):
        hidden = ("NO_COLOR", "COLUMNS", "LINES")
        base = {name: each for name, each in os.environ.items() if name not in hidden}
        settings = {"TERM": "xterm-256color", "PYTHONUTF8": "1"} | environment
        self.main, other = open_terminal(columns, rows)
        self.before = termios.tcgetattr(self.main)
        self.process = warm.start(
            [sys.executable, *program, *arguments],
            stdin=other,
            stdout=other,
            stderr=other,
            process_group=0,
            env=base | settings,
        )
        self.name = os.ttyname(other)
        os.close(other)
        self.written = b""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        os.close(self.main)

    @property
    def shown(self):
        """What has been written so far, without styles."""
        return ESCAPE.sub("", self.written.decode(errors="ignore").replace("\r\n", "\n"))

    @property
    def echoes(self):
        return bool(termios.tcgetattr(self.main)[3] & termios.ECHO)

    def wait_for(self, pattern):
        """Read until what is shown has a match."""
        while not re.search(pattern, self.shown):
            chunk = read(self.main)
            assert chunk, self.shown
            self.written += chunk

    def end(self):
        """Read to the end. Give the exit status, and whether the terminal is as it was."""
        while chunk := read(self.main):
            self.written += chunk
        return self.process.wait(30), termios.tcgetattr(self.main) == self.before
