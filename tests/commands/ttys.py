"""Terminals for tests: both ends of one, and programs that run on one of their own."""

from __future__ import annotations

import errno
import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios
from pathlib import Path

from .. import warm

STAGE = Path(__file__).with_name("stage.py")


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


class Screen:
    """A goal on the stage, sent from a terminal.

    It has a process group of its own in our session, or the system would not let it stop.
    """

    def __init__(self, *arguments, program=(STAGE,)):
        self.main, self.other = open_terminal()
        self.process = warm.start(
            [sys.executable, *program, "send-goal", *arguments],
            stdin=self.other,
            stdout=self.other,
            stderr=subprocess.DEVNULL,
            process_group=0,
            env=os.environ | {"TERM": "xterm-256color", "PYTHONUTF8": "1"},
        )
        self.written = b""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        os.close(self.main)
        os.close(self.other)

    def wait_for(self, text):
        """Read until something has been written."""
        while text not in self.written:
            self.written += read(self.main)

    def rest(self):
        """All that has been written; whoever writes must have ended or stopped."""
        os.set_blocking(self.main, False)
        try:
            while chunk := read(self.main):
                self.written += chunk
        except BlockingIOError:
            pass
        finally:
            os.set_blocking(self.main, True)
        return self.written
