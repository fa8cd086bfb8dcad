"""What docs/ shows in several terminals is typed here, in the same order.

The line above a block says what it is:

- ``<!-- save FILE -->``: a file to save. ``open_zenoh()`` in it joins the graph of the test,
  and it sleeps half as long.
- ``<!-- terminal N -->``: commands and what they print. ``...`` matches anything.
- ``<!-- terminal N, until Ctrl-C -->``: a server. It runs until the end of its section.
- ``<!-- terminal N, meanwhile -->``: a program that ends while the next block is typed.

Each section with such blocks has a folder and a graph of its own. A section of
docs/rclpy.md also has the files that were saved in earlier ones.
"""

from __future__ import annotations

import doctest
import os
import re
import shlex
import signal
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import NamedTuple

import pytest

import turtleact

from .. import warm
from ..lab import free_endpoint
from ..registry import isolated_registry

DOCS = Path(__file__).parents[2] / "docs"
BLOCK = re.compile(r"^<!-- (save|terminal) (.*?) -->\n```\w+\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SECTION = re.compile(r"^## (.*?)\n(.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL)


def sections_of(page, *, keeps_files):
    """The sections with such blocks."""
    saved: list[tuple[str, ...]] = []
    for title, text in SECTION.findall((DOCS / page).read_text("utf-8")):
        blocks = BLOCK.findall(text)
        if blocks:
            yield pytest.param([*saved, *blocks], id=title)
        if keeps_files:
            saved += [block for block in blocks if block[0] == "save"]


SECTIONS = [
    *sections_of("tutorial.md", keeps_files=False),
    *sections_of("rclpy.md", keeps_files=True),
]
OWN_SERVER = re.compile(r"^## 6\..*?^<!-- run -->\n```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ALIAS = "alias ros2=turtleact"
ON_A_GRAPH_OF_ITS_OWN = """
import sys
from turtleact import cli
from turtleact.commands import serving
from turtleact.transports.rmw_zenoh import config

serving.ROUTER = router = sys.argv.pop(1)
config.CONNECT = dict.fromkeys(("peer", "client"), (router,)) | {"router": ()}
sys.exit(cli.main())
"""
"""A command line whose router has another address than 7447."""

PATIENCE = 30.0
"""Seconds after which a program is taken to hang."""


class Running(NamedTuple):
    """A program in its terminal, and what it should print."""

    process: subprocess.Popen[str]
    first_line: str
    shown: str

    def check(self):
        assert self.process.stdout is not None
        with self.process.stdout as out:  # `communicate` would lose what `readline` has buffered
            check(self.first_line + out.read(), self.shown)
        self.process.wait(PATIENCE)


def check(printed, shown):
    """Compare what was printed; a last line ``...`` stands for nothing, too."""
    is_as_shown = doctest.OutputChecker().check_output
    want, got = f"{shown.rstrip()}\n", f"{printed.rstrip()}\n"
    assert any(is_as_shown(want, each, doctest.ELLIPSIS) for each in (got, f"{got}\n")), printed


def commands_of(text):
    """The commands of a block, each with the text below it."""
    return [part.partition("\n")[::2] for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]]


class Terminals:
    """Types commands on a graph of its own."""

    def __init__(self, folder, turtleact):
        self.folder = folder
        self.address = free_endpoint()
        self.turtleact = turtleact
        self.running = []
        self.serving = []

    def save(self, name, text):
        text = text.replace("open_zenoh()", f"open_zenoh([{self.address!r}])")
        text = text.replace("asyncio.sleep(0.5)", "asyncio.sleep(0.25)")  # a reader types slower
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")

    def type(self, where, text):
        for line, shown in commands_of(text):
            command, *arguments = shlex.split(line)
            if where.endswith("until Ctrl-C"):
                shown = shown.replace("tcp/127.0.0.1:7447", self.address)
                self.serving.append(self.start(self.program(*arguments), shown))
            elif where.endswith("meanwhile"):
                self.running.append(self.start(arguments, shown))
            elif command == "python":
                self.start(arguments, shown).check()
            elif arguments[0] == "run":
                self.start(self.program(*arguments), shown).check()
            elif command == "cat":
                check((self.folder / arguments[0]).read_text("utf-8"), shown)
            else:
                is_local = arguments[0] in {"interface", "pkg"}
                reach = () if is_local else ("--connect", self.address)
                with isolated_registry():  # each command knows only what it finds itself
                    ran = self.turtleact(*arguments, *reach)
                check(ran.err + ran.out, shown)
        if not where.endswith("meanwhile"):
            while self.running:
                self.running.pop().check()

    def program(self, verb, *arguments):
        """A command that is a process of its own: a server, or a program with rclpy."""
        if verb == "run" and arguments[0].endswith(".py"):
            return ["-m", "turtleact", "run", "--connect", self.address, *arguments]
        return ["-c", ON_A_GRAPH_OF_ITS_OWN, self.address, verb, *arguments]

    def start(self, program, shown):
        process = warm.start(
            [sys.executable, *program],
            cwd=self.folder,
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert process.stdout is not None
        first_line = ""
        if "topic" not in program:  # which says nothing before somebody publishes
            first_line = process.stdout.readline()
            check(first_line, shown.partition("\n")[0])
        return Running(process, first_line, shown)

    def close(self):
        while self.serving:
            server = self.serving.pop()
            server.process.send_signal(signal.SIGINT)
            server.check()


@pytest.fixture
def terminals(tmp_path, turtleact, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")
    terminals = Terminals(tmp_path, turtleact)
    terminals.save("lab.py", OWN_SERVER.search((DOCS / "tutorial.md").read_text("utf-8"))[1])  # type: ignore[index]
    yield terminals
    for each in (*terminals.running, *terminals.serving):
        each.process.kill()
        each.process.communicate()


@pytest.mark.timeout(300)  # a section may start some twenty processes, on whatever machine
@pytest.mark.parametrize("blocks", SECTIONS)
def test_the_terminals_of_a_section_show_what_the_page_shows(terminals, blocks):
    for kind, argument, text in blocks:
        if kind == "save":
            terminals.save(argument, text)
        else:
            terminals.type(argument, text)
    terminals.close()


def test_the_alias_of_the_page_runs_turtleact_in_a_shell():
    assert f"\n{ALIAS}\n" in (DOCS / "tutorial.md").read_text("utf-8")
    environment = os.environ | {"PATH": f"{sysconfig.get_path('scripts')}:{os.environ['PATH']}"}
    lines = f"shopt -s expand_aliases\n{ALIAS}\nros2 --version\n"
    ran = subprocess.run(["bash", "--norc", "-c", lines], env=environment, stdout=subprocess.PIPE)
    assert ran.stdout.decode() == f"turtleact {turtleact.__version__}\n"
