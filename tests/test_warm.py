"""Programs that are forked find what programs find that are started, and end as they do."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import partial

import pytest

from . import warm

REPORT = """
import os, signal, sys, threading, warnings
streams = [sys.stdin, sys.stdout, sys.stderr]
signals = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGCHLD, signal.SIGPIPE]
for found in (
    [(s.encoding, s.errors, s.line_buffering, s.write_through, s.isatty()) for s in streams],
    (sys.argv, sys.path, sys.executable, __name__, sys.modules["__main__"].__name__),
    (sys.warnoptions, [each for each in warnings.filters if each[0] == "error"]),
    (os.getcwd(), os.umask(0), sorted(os.environ.items())),
    (os.getpgid(0) == os.getpid(), os.getsid(0) == os.getpid()),
    [signal.getsignal(each) for each in signals],
    (signal.pthread_sigmask(signal.SIG_BLOCK, ()), threading.active_count()),
    (sorted(os.listdir("/proc/self/fd")), sys.stdin.read()),
):
    print(found)
"""
LAST_WORDS = """
import atexit, sys, threading, time
atexit.register(print, "atexit")
threading.Timer(0.05, print, ["thread"]).start()
print("main")
"""


@pytest.fixture(scope="module")
def forked():
    if not warm.is_warm():
        pytest.skip("programs are started anew")


@pytest.mark.usefixtures("forked")
@pytest.mark.parametrize(
    ("options", "arguments"),
    [
        ({}, ["-W", "error", "program.py"]),
        ({"start_new_session": True, "env": {"PYTHONUTF8": "1"}}, ["-m", "program", "-W", "x"]),
        ({"process_group": 0, "env": {"PYTHONUNBUFFERED": "1", "A": "1"}}, ["-c", REPORT, "a b"]),
    ],
    ids=["a script", "a module", "a text"],
)
def test_a_forked_program_finds_what_a_started_one_finds(tmp_path, options, arguments):
    (tmp_path / "program.py").write_text(REPORT)
    command = [sys.executable, *arguments]
    options = options | {"cwd": tmp_path, "env": os.environ | options.get("env", {})}
    seen = []
    for way in (warm.start, partial(subprocess.Popen, preexec_fn=warm.take_signals)):
        pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        with way(command, **pipes, **options, text=True) as process:
            seen.append((*process.communicate("typed\n", timeout=30), process.returncode))
        assert isinstance(process, warm.Program) == (len(seen) == 1)
    (forked, *_), (started, *_) = seen
    assert forked.splitlines() == started.splitlines()
    assert seen[0] == seen[1]
    assert "typed" in forked


@pytest.mark.parametrize(
    ("text", "status", "out", "last_of_err"),
    [
        (LAST_WORDS, 0, "main\nthread\natexit\n", ""),
        ("import sys; sys.exit(3)", 3, "", ""),
        ("import sys; sys.exit('sorry')", 1, "", "sorry"),
        ("1 / 0", 1, "", "ZeroDivisionError: division by zero"),
        ("import os; os.kill(os.getpid(), 9)", -9, "", ""),
        ("import os; os._exit(7)", 7, "", ""),
    ],
    ids=["the end", "a status", "a text", "an error", "a signal", "at once"],
)
def test_a_program_ends_as_python_does(text, status, out, last_of_err):
    ran = warm.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=30)
    assert (ran.returncode, ran.stdout) == (status, out)
    assert ran.stderr.splitlines()[-1:] == [last_of_err] * bool(last_of_err)


def test_a_program_takes_signals():
    text = "import time\nprint('ready', flush=True)\ntime.sleep(60)"
    with warm.start([sys.executable, "-c", text], stdout=-1, stderr=-1, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        assert process.poll() is None
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.01)
        process.send_signal(signal.SIGSTOP)
        warm.wait_until_stopped(process)
        process.send_signal(signal.SIGCONT)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
    assert err.endswith("\nKeyboardInterrupt\n")
    assert process.returncode == -signal.SIGINT


def test_a_program_that_fails_raises_if_so_asked():
    with pytest.raises(subprocess.CalledProcessError, match="exit status 4"):
        warm.run([sys.executable, "-c", "import sys; sys.exit(4)"], check=True)


def test_the_words_of_a_line_are_those_that_a_shell_makes_of_it():
    line = "turtleact send-goal /go_to \"{x: 1, name: 'a b'}\" --speed=2 '$HOME' tcp/127.0.0.1:1"
    shown = subprocess.run(["bash", "-c", f"printf '%s\\n' {line}"], stdout=-1, text=True)
    assert warm.words_of(line) == shown.stdout.splitlines()


@pytest.mark.parametrize(
    "more", ["| head", "> out", "& x", "; x", "$HOME", "*.py", "~", '"$A"', "`x`"]
)
def test_a_line_that_a_shell_changes_has_no_words(more):
    assert warm.words_of(f"turtleact goals {more}") is None


@pytest.mark.usefixtures("forked")
@pytest.mark.parametrize(
    ("command", "options"),
    [
        ([sys.executable, "-X", "dev", "-c", ""], {}),
        ([sys.executable, "-W", "error::UserWarning", "-c", ""], {}),
        ([sys.executable, "-c", ""], {"env": {"PYTHONHASHSEED": "0"}}),
        ([sys.executable, "-c", ""], {"pass_fds": (0,)}),
        (["true"], {}),
    ],
    ids=["an option", "a filter", "a variable", "a descriptor", "another program"],
)
def test_what_only_a_new_python_can_do_is_started(command, options):
    with warm.start(command, **options) as process:
        assert process.wait(30) == 0
    assert not isinstance(process, warm.Program)
