"""Runs turtleact without what Windows lacks: POSIX modules, signals and functions of ``os``.

``python on_windows.py ARGUMENT…`` runs a command line in the world of ``stage.py``; without any it
imports every module of turtleact. This only shows that nothing depends on what is hidden here.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
import runpy
import signal
import sys
from contextlib import suppress
from pathlib import Path

MODULES = ("fcntl", "grp", "pty", "pwd", "readline", "resource", "syslog", "termios", "tty")
KEPT = {"SIGABRT", "SIGFPE", "SIGILL", "SIGINT", "SIGSEGV", "SIGTERM"}
FUNCTIONS = (
    *("fork", "getpgid", "getpgrp", "getuid", "killpg", "mkfifo", "register_at_fork", "setsid"),
    *("set_blocking", "tcgetpgrp", "ttyname", "O_NOCTTY", "O_NONBLOCK"),
)


def hide() -> None:
    import asyncio  # noqa: F401  # is made for the system that it runs on

    for name in MODULES:
        sys.modules[name] = None  # type: ignore[assignment]  # makes an import fail
    for name in ("alarm", "getitimer", "pause", "setitimer", "sigwait", "ITIMER_REAL"):
        delattr(signal, name)
    for each in signal.Signals:
        if each.name not in KEPT:
            delattr(signal, each.name)
    for name in FUNCTIONS:
        delattr(os, name)


def import_all() -> None:
    import turtleact

    for module in pkgutil.walk_packages(turtleact.__path__, "turtleact."):
        if not module.name.endswith(".__main__"):  # it would run
            importlib.import_module(module.name)
            print(module.name)


if __name__ == "__main__":
    if len(sys.argv) == 1:
        with suppress(ImportError):  # is made for the system that it runs on, if it is installed
            import mcp.server.stdio  # noqa: F401
        hide()
        import_all()
    else:
        hide()
        runpy.run_path(str(Path(__file__).with_name("stage.py")), run_name="__main__")
