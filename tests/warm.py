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
import functools
import gc
import importlib
import io
import json
import os
import re
import runpy
import select
import shlex
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import types
import warnings
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple, NoReturn

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

STATUS = struct.Struct("=ci")
"""What a server says of a process: ``p`` and its process ID, or ``s`` and its wait status."""


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
    return Program(command, request, options)


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
    """A program that the server has forked."""

    def __init__(self, command: Sequence[Any], request: Request, options: dict[str, Any]) -> None:
        # Not super().__init__, which would start a process.
        self.args = command
        self.returncode = None
        self._readers: dict[str, Reader] = {}
        self._status, status = os.pipe()
        pipes: dict[str, int] = {}
        passed: list[int] = []
        opened = [status]
        for number, name in enumerate(STREAMS):
            theirs = options.get(name)
            if theirs == subprocess.STDOUT:
                passed.append(passed[1])
                continue
            if theirs == subprocess.PIPE:
                ends = os.pipe()
                pipes[name], theirs = (ends[1], ends[0]) if name == "stdin" else ends
                opened.append(theirs)
            elif theirs == subprocess.DEVNULL:
                theirs = os.open(os.devnull, os.O_RDWR)
                opened.append(theirs)
            elif theirs is None:
                theirs = number
            passed.append(theirs if isinstance(theirs, int) else theirs.fileno())
        for name in STREAMS:
            setattr(self, name, opened_pipe(name, pipes.get(name), bool(options.get("text"))))
        server().start(request, [status, *passed])
        for each in opened:
            os.close(each)
        self.pid = self._read(b"p")

    def _read(self, kind: bytes) -> int:
        said = os.read(self._status, STATUS.size)
        if not said.startswith(kind):
            raise RuntimeError(f"{self.args!r} was not started")
        return int(STATUS.unpack(said)[1])

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end, and return the exit status."""
        if self.returncode is None:
            end = select.poll()
            end.register(self._status, select.POLLIN)
            if not end.poll(None if timeout is None else timeout * 1000):
                raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
            self.returncode = os.waitstatus_to_exitcode(self._read(b"s"))
            os.close(self._status)
        return self.returncode

    def poll(self) -> int | None:
        """The exit status, or None if the program runs."""
        try:
            return self.wait(0)
        except subprocess.TimeoutExpired:
            return None

    def send_signal(self, sig: int) -> None:
        """Send a signal, unless the program has ended."""
        if self.poll() is None:
            with suppress(ProcessLookupError):  # ended since, but its status has not come yet
                os.kill(self.pid, sig)

    def terminate(self) -> None:
        """Send SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)

    def communicate(
        self, input: Any = None, timeout: float | None = None
    ) -> tuple[Any, Any]:  # as in subprocess
        """Read all output and wait for the end."""
        end = None if timeout is None else time.monotonic() + timeout
        for name in ("stdout", "stderr"):
            stream = getattr(self, name)
            if name not in self._readers and stream is not None and not stream.closed:
                self._readers[name] = Reader(stream)
        if self.stdin is not None and not self.stdin.closed:
            with suppress(BrokenPipeError):
                if input:
                    self.stdin.write(input)
                self.stdin.close()
        for reader in self._readers.values():
            reader.join(None if end is None else max(0.0, end - time.monotonic()))
            if reader.is_alive():
                raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
        self.wait(None if end is None else max(0.0, end - time.monotonic()))
        out, err = (self._readers.get(name) for name in ("stdout", "stderr"))
        return out and out.text, err and err.text

    def __exit__(self, *_: object) -> None:
        for stream in (self.stdin, self.stdout, self.stderr):
            if stream is not None:
                stream.close()
        self.wait()


def wait_until_stopped(process: subprocess.Popen[Any]) -> None:
    """Wait until a signal has stopped a program."""
    if not isinstance(process, Program):
        assert os.WIFSTOPPED(os.waitpid(process.pid, os.WUNTRACED)[1])
        return
    while process.poll() is None:
        state = Path(f"/proc/{process.pid}/stat").read_text("utf-8").rpartition(") ")[2][0]
        if state == "T":
            return
        time.sleep(0.002)
    raise AssertionError(f"{process.args!r} has ended")


class Reader(threading.Thread):
    """Reads a stream to its end and closes it."""

    def __init__(self, stream: IO[Any]) -> None:
        super().__init__(daemon=True)
        self.text: Any = None
        self._stream = stream
        self.start()

    def run(self) -> None:
        """Read."""
        with self._stream:
            self.text = self._stream.read()


def opened_pipe(name: str, descriptor: int | None, is_text: bool) -> IO[Any] | None:
    if descriptor is None:
        return None
    return os.fdopen(descriptor, ("w" if name == "stdin" else "r") + ("" if is_text else "b"))


class Server:
    """The server of this process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._socket, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, __file__, str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
            )
        atexit.register(self.close)

    def start(self, request: Request, descriptors: list[int]) -> None:
        """Ask for a program with these: where its status goes, and its standard streams."""
        data = json.dumps(request).encode("utf-8", "surrogateescape")
        with self._lock:
            socket.send_fds(self._socket, [struct.pack("=I", len(data))], descriptors)
            self._socket.sendall(data)

    def close(self) -> None:
        """End the server; the programs go on."""
        self._socket.close()
        self._process.wait()


@functools.cache
def server() -> Server:
    """The server; the first call starts it."""
    return Server()


# --- the server itself ------------------------------------------------------------------------


def serve(control: socket.socket) -> tuple[Request, list[int]] | None:
    """Fork a process for each request, and tell how they end.

    Returns:
        In a new process, what it was forked for, and its descriptors; in the server None, at the
        end.
    """
    running: dict[int, tuple[int, int]] = {}
    events = select.poll()
    events.register(control, select.POLLIN)
    while True:
        for descriptor, _ in events.poll():
            if descriptor in running:
                pid, status = running.pop(descriptor)
                events.unregister(descriptor)
                tell(status, b"s", os.waitpid(pid, 0)[1])
                os.close(status)
                os.close(descriptor)
                continue
            size, descriptors, *_ = socket.recv_fds(control, 4, 4)
            if not size:
                return None
            data = control.recv(struct.unpack("=I", size)[0], socket.MSG_WAITALL)
            pid = os.fork()
            if pid == 0:
                control.detach()
                request = Request(*json.loads(data.decode("utf-8", "surrogateescape")))
                return request, descriptors
            for each in descriptors[1:]:
                os.close(each)
            end = os.pidfd_open(pid)
            running[end] = pid, descriptors[0]
            events.register(end, select.POLLIN)


def tell(status: int, kind: bytes, number: int) -> None:
    """Tell the one who asked for a program; it may be gone."""
    with suppress(BrokenPipeError):
        os.write(status, STATUS.pack(kind, number))


def become(request: Request, descriptors: list[int]) -> NoReturn:
    """Run a program in this process, which has just been forked."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    take_signals()
    if request.group == "session":
        os.setsid()
    elif request.group == "own":
        os.setpgid(0, 0)
    status, *streams = descriptors
    for number, each in enumerate(streams):
        os.dup2(each, number)
    tell(status, b"p", os.getpid())
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
        before = getattr(sys, f"__{name}__")
        size = 0 if is_unbuffered and name != "stdin" else -1
        data = os.fdopen(number, "wb" if number else "rb", size, closefd=False)
        stream = io.TextIOWrapper(
            data,
            encoding="utf-8" if is_utf8 else before.encoding,
            errors="surrogateescape" if is_utf8 and name != "stderr" else before.errors,
            line_buffering=not is_unbuffered and (name == "stderr" or data.isatty()),
            write_through=is_unbuffered,
        )
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
