"""The lecture of docs/tutorial.md: a terminal for each program, one graph.

What stands in a block below ``<!-- not run: a terminal of its own -->`` goes on until the end; the
commands below ``<!-- not run: beside them -->`` run one after another, in the order of the page.
In the output ``...`` stands for anything.
"""

from __future__ import annotations

import doctest
import os
import re
import signal
import socket
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import NamedTuple

import pytest

import turtleact

from .. import warm

PAGE = Path(__file__).parents[2] / "docs" / "tutorial.md"
PROGRAM = Path(__file__).with_name("lecture.py")
BLOCK = re.compile(
    r"^<!-- not run: (?P<kind>a terminal of its own|beside them) -->\n"
    r"```console\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
OWN_SERVER = re.compile(r"^## 6\..*?^<!-- run -->\n```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ALIAS = "alias ros2=turtleact"
SECONDS = 30


class Step(NamedTuple):
    """A command of the page, and what it shall print."""

    goes_on: bool
    line: str
    output: str


STEPS = [
    Step(block["kind"] != "beside them", *part.split("\n", 1))
    for block in BLOCK.finditer(PAGE.read_text("utf-8"))
    for part in re.split(r"^\$ ", block["text"], flags=re.MULTILINE)[1:]
]


class Terminal:
    """A terminal in which one command runs."""

    def __init__(self, command, folder, environment):
        self.process = warm.start(
            command,
            cwd=folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        assert self.process.stdout is not None
        self.stdout = self.process.stdout
        self.printed = ""

    def wait_for(self, text):
        while text not in self.printed:
            line = self.stdout.readline()
            assert line, f"{self.printed!r} ended without {text!r}"
            self.printed += line

    def rest(self):
        """Wait for the end, and give all that was printed."""
        self.printed += self.process.communicate(timeout=SECONDS)[0]
        return self.printed

    def end(self):
        """End what still runs there, as Ctrl-C does, and give all that was printed."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGINT)
        return self.rest()


@pytest.fixture
def port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@pytest.fixture
def open_terminal(tmp_path, port):
    """Opens terminals, and closes all that are left."""
    (tmp_path / "lab.py").write_text(OWN_SERVER.search(PAGE.read_text("utf-8"))[1])  # type: ignore[index]
    environment = os.environ | {"ROS_DOMAIN_ID": "0"}
    terminals = []

    def open_(line):
        words = warm.words_of(line)
        assert words is not None, line
        assert words[0] in ("ros2", "turtleact")
        command = [sys.executable, PROGRAM, str(port), *words[1:]]
        terminals.append(Terminal(command, tmp_path, environment))
        return terminals[-1]

    yield open_
    for terminal in terminals:
        if terminal.process.poll() is None:
            os.killpg(terminal.process.pid, signal.SIGKILL)
        terminal.process.wait()
        terminal.stdout.close()


def is_as_shown(printed, step, port):
    """Whether that was printed; a last line ``...`` stands for nothing, too."""
    text = printed.replace(f":{port}", ":7447").rstrip() + "\n"
    shown = step.output.rstrip() + "\n"
    check = doctest.OutputChecker().check_output
    return any(check(shown, each, doctest.ELLIPSIS) for each in (text, f"{text}\n"))


def test_the_page_has_the_lecture():
    lines = [step.line for step in STEPS]
    assert lines[0] == "ros2 run turtlesim turtlesim_node"
    assert sum(line.startswith("ros2 ") for line in lines) >= 15
    assert any("/my_patrol" in line for line in lines)


def test_the_alias_of_the_page_runs_turtleact_in_a_shell():
    assert f"\n{ALIAS}\n" in PAGE.read_text("utf-8")
    environment = os.environ | {"PATH": f"{sysconfig.get_path('scripts')}:{os.environ['PATH']}"}
    lines = f"shopt -s expand_aliases\n{ALIAS}\nros2 --version\n"
    ran = subprocess.run(["bash", "--norc", "-c", lines], env=environment, stdout=subprocess.PIPE)
    assert ran.stdout.decode() == f"turtleact {turtleact.__version__}\n"


@pytest.mark.timeout(300)  # some twenty processes, on whatever machine
def test_the_commands_of_the_lecture_print_what_the_page_shows(open_terminal, port):
    beside = []
    for step in STEPS:
        terminal = open_terminal(step.line)
        if not step.goes_on:
            printed = terminal.rest()
            assert is_as_shown(printed, step, port), f"$ {step.line}\n{printed}"
            continue
        beside.append((step, terminal))
        if "ready" in step.output:
            terminal.wait_for("ready")
    for step, terminal in reversed(beside):
        printed = terminal.end()
        assert is_as_shown(printed, step, port), f"$ {step.line}\n{printed}"
