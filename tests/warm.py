"""Starts Python programs that need not import turtleact, because they are forked from one that has.

Most commands in these tests take longer to start Python and to import turtleact than to run. So
`start` and `run` take what `subprocess.Popen` and `subprocess.run` take, but pass the command to a
server, which has imported everything and waits. It forks a process for each command. Nothing else
differs: the process has its own standard streams, signals, process group, environment, working
directory and exit status, and Python ends in it as it always does.

Some programs are started by `subprocess` all the same: those whose command, environment or other
options only a new Python can obey, and all programs if coverage is measured, if ``COLD`` is set in
the environment, or if the system is not Linux. Tests of imports and of the first milliseconds of a
program use `subprocess` themselves.

As a program, this file is the server. It ends when the other end of its socket is closed.
"""

from __future__ import annotations

import atexit
import ctypes
import functools
import gc
import importlib
import json
import os
import re
import runpy
import shlex
import signal
import socket
import subprocess
import sys
import threading
import types
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

if TYPE_CHECKING:
    from collections.abc import Sequence

PRELOADED = (
    *("asyncio", "numpy", "rich.live", "typer.rich_utils", "yaml", "zenoh"),
    *("turtleact.actions.go_to", "turtleact.actions.patrol", "turtleact.actions.fibonacci"),
    *(
        "turtleact.sim.world_node",
        "turtleact.cli",
        "turtleact.commands.graph",
        "turtleact.commands.live",
    ),
    *("turtleact.commands.send_goal", "turtleact.commands.serving", "turtleact.sim.turtlesim"),
    *("turtleact.commands.goals", "turtleact.commands.serve"),
    *("turtleact.interfaces.text", "turtleact.transports.rmw_zenoh.transport"),
)
"""What most commands import. None of these opens a file or starts a thread."""

STREAMS = ("stdin", "stdout", "stderr")
KNOWN = {"cwd", "env", "text", "process_group", "start_new_session", *STREAMS}
"""The options of `subprocess.Popen` that the server can obey."""

OBEYED = {"PYTHONUNBUFFERED", "PYTHONUTF8", "PYTHONWARNINGS", "PYTHONDONTWRITEBYTECODE"}
"""What Python reads from the environment at its start and the server can obey."""

BEFORE = dict(os.environ)
"""The environment of the server."""

LARGEST = 1 << 20
"""A request has fewer bytes."""

PR_SET_CHILD_SUBREAPER = 36
"""Of prctl(2): makes orphans below this process its children."""

ASKING = threading.Lock()
"""Held while the server is asked for a program."""


class Request(NamedTuple):
    """A program to run, as JSON on the way to the server.

    Attributes:
        way: ``-m`` if the program is a module, ``-c`` if it is the text of one, else nothing.
        program: That, or the path of a file.
        arguments: Its arguments.
        environment: All of its environment.
        folder: Its working directory.
        warnings: The options ``-W``.
        group: Its process group: ``same``, ``own``, or ``session`` for a session of its own.
    """

    way: str
    program: str
    arguments: list[str]
    environment: dict[str, str]
    folder: str
    warnings: list[str]
    group: str


def start(command: Sequence[Any], **options: Any) -> subprocess.Popen[Any]:
    """Start a program, as `subprocess.Popen` does."""
    request = read(command, options) if is_warm() else None
    if request is None:
        return subprocess.Popen(command, preexec_fn=take_signals, **options)
    with Path(os.devnull).open("r+b", 0) as nothing:
        nowhere = {each: nothing for each in STREAMS if options.get(each) == subprocess.DEVNULL}
        return Program(command, request, **options | nowhere)


def run(
    command: Sequence[Any],
    *,
    capture_output: bool = False,
    check: bool = False,
    timeout: float | None = None,
    **options: Any,
) -> subprocess.CompletedProcess[Any]:
    """Run a program to its end, as `subprocess.run` does."""
    if capture_output:
        options |= {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with start(command, **options) as process:
        try:
            out, err = process.communicate(timeout=timeout)
        except BaseException:
            process.kill()
            raise
    if check and process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command, out, err)
    return subprocess.CompletedProcess(command, process.returncode, out, err)


def words_of(line: str) -> list[str] | None:
    """The words of a line, or None if a shell would do more than split it into words."""
    unquoted = re.sub(r"""\"[^"$`\\]*"|'[^']*'""", "", line)
    return shlex.split(line) if re.fullmatch(r"[\w\s./,:=+-]*", unquoted) else None


def is_warm() -> bool:
    """Whether programs are forked."""
    is_new = "COLD" in os.environ or "coverage" in sys.modules
    return sys.platform == "linux" and not is_new


def read(command: Sequence[Any], options: dict[str, Any]) -> Request | None:
    """What the server shall do, or None if only a new Python can do it."""
    python, *words = map(str, command)
    asked = []
    while words[:1] == ["-W"]:
        asked.append(words[1])
        words = words[2:]
    way = words.pop(0) if words[:1] in (["-m"], ["-c"]) else ""
    environment = dict(os.environ if options.get("env") is None else options["env"])
    read_at_start = {name for name in {*environment, *BEFORE} if name.startswith("PYTHON")} - OBEYED
    is_obeyed = options.keys() <= KNOWN and all(
        environment.get(name) == BEFORE.get(name) for name in read_at_start
    )
    is_program = bool(way) or (bool(words) and words[0].endswith(".py"))
    if python != sys.executable or not is_obeyed or not is_program:
        return None
    asked[:0] = [each for each in environment.get("PYTHONWARNINGS", "").split(",") if each]
    if any(each not in ("default", "error", "ignore") for each in asked):
        return None
    is_own = options.get("process_group") == 0
    group = "session" if options.get("start_new_session") else "own" if is_own else "same"
    folder = str(Path(options.get("cwd") or ".").absolute())
    return Request(way, words[0], words[1:], environment, folder, asked, group)


def take_signals() -> None:
    """Let signals end this process, even if the one that started the tests ignores them."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


class Program(subprocess.Popen[Any]):
    """A program that the server has forked, and that is a child of this process all the same."""

    def __init__(self, command: Sequence[Any], request: Request, **options: Any) -> None:
        self._request = request
        super().__init__(command, **options)

    def _execute_child(self, *arguments: Any) -> None:
        """Starts the program; `subprocess.Popen` has made the pipes."""
        # Ten options, then both ends of each pipe, or -1 for a stream that is no pipe.
        to_read, to_write, out_read, out_write, err_read, err_write = arguments[10:16]
        theirs = [to_read, out_write, err_write]
        given = [number if each == -1 else each for number, each in enumerate(theirs)]
        data = json.dumps(self._request).encode("utf-8", "surrogateescape")
        with ASKING:
            socket.send_fds(server(), [data], given)
            self.pid = int.from_bytes(server().recv(4), "big")
        self._child_created = True
        for ours, its in zip((to_write, out_read, err_read), theirs, strict=True):
            if ours != -1:
                os.close(its)
        if not self.pid:
            raise RuntimeError(f"{self.args!r} was not started")


@functools.cache
def server() -> socket.socket:
    """The socket of the server; the first call starts it."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)
    with theirs:
        process = subprocess.Popen(
            [sys.executable, __file__, str(theirs.fileno())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
        )
    atexit.register(process.wait)
    atexit.register(ours.close)
    return ours


# --- the server itself ------------------------------------------------------------------------


def serve(control: socket.socket) -> tuple[Request, list[int]] | None:
    """Fork a process for each request.

    The process between the server and a program ends at once. So the program becomes a child of
    the process that asked for it, which can wait for its end.

    Returns:
        In a program, what it was forked for, its standard streams, and where to tell that it has
        them; in the server None, at the end.
    """
    while True:
        data, descriptors, *_ = socket.recv_fds(control, LARGEST, len(STREAMS))
        if not data:
            return None
        told, telling = os.pipe()
        if os.fork() == 0:
            if os.fork():
                os._exit(0)
            control.detach()
            request = Request(*json.loads(data.decode("utf-8", "surrogateescape")))
            return request, [*descriptors, telling]
        os.wait()
        for each in (*descriptors, telling):
            os.close(each)
        control.send(os.read(told, 4) or bytes(4))
        os.close(told)


def become(request: Request, descriptors: list[int]) -> NoReturn:
    """Run a program in this process, which has just been forked."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    take_signals()
    if request.group == "session":
        os.setsid()
    elif request.group == "own":
        os.setpgid(0, 0)
    *streams, telling = descriptors
    for number, each in enumerate(streams):
        os.dup2(each, number)
    os.write(telling, os.getpid().to_bytes(4, "big"))
    os.closerange(len(streams), os.sysconf("SC_OPEN_MAX"))
    os.environ.clear()
    os.environ.update(request.environment)
    os.chdir(request.folder)
    open_streams()
    sys.dont_write_bytecode = bool(os.environ.get("PYTHONDONTWRITEBYTECODE"))
    for action in request.warnings:
        sys.warnoptions.append(action)
        warnings.simplefilter(action)  # type: ignore[arg-type]  # it is one of three
    gc.enable()
    sys.argv[:] = [request.way or request.program, *request.arguments]
    if request.way == "-m":
        sys.path[0] = request.folder
        runpy.run_module(request.program, run_name="__main__", alter_sys=True)
    elif request.way == "-c":
        sys.path[0] = ""
        module = sys.modules["__main__"] = types.ModuleType("__main__")
        exec(compile(request.program, "<string>", "exec"), module.__dict__)
    else:
        sys.path[0] = str(Path(request.program).absolute().parent)
        runpy.run_path(request.program, run_name="__main__")
    sys.exit()


def open_streams() -> None:
    """Open the standard streams as Python does at its start."""
    is_unbuffered = bool(os.environ.get("PYTHONUNBUFFERED"))
    is_utf8 = os.environ.get("PYTHONUTF8") == "1"
    for number, name in enumerate(STREAMS):
        before = getattr(sys, name)
        stream = open(  # noqa: SIM115  # it has a number, and is never closed
            number,
            "w" if number else "r",
            encoding="utf-8" if is_utf8 else before.encoding,
            errors="surrogateescape" if is_utf8 and name != "stderr" else before.errors,
            closefd=False,
        )
        stream.reconfigure(line_buffering=is_unbuffered or name == "stderr" or stream.isatty())
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)


def main() -> None:
    """Import what programs import, then serve; in a new process, run the program."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the programs and for pytest
    for name in PRELOADED:
        importlib.import_module(name)
    from turtleact.commands.app import load

    # Typer imports pydantic when it reads an option.
    load("action").commands["list"].make_context("list", [])
    gc.collect()
    gc.disable()
    gc.freeze()
    task = serve(socket.socket(fileno=int(sys.argv[1])))
    if task is not None:
        become(*task)


if __name__ == "__main__":
    main()
