"""Runs command lines: in this process, or in one of their own that signals can be sent to."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import ExitStack
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import NamedTuple

import pytest

from turtleact import cli
from turtleact.commands import graph

from .. import warm

STAGE = Path(__file__).with_name("stage.py")
GRAPHS = Path(__file__).with_name("graphs.py")


class Ran(NamedTuple):
    """How a command line went."""

    status: int
    out: str
    err: str

    @property
    def problem(self):
        """What is in Typer's box around a mistake in the command line, on one line."""
        box = [line for line in self.err.splitlines() if line.startswith("│")]
        return " ".join(line.strip("│ ") for line in box)


class Program:
    """A command line in a process of its own, on the stage unless something else is given."""

    def __init__(self, *arguments, module=False, script=STAGE, warnings="error"):
        program = ["-m", "turtleact"] if module else [script]
        self.process = warm.start(
            [sys.executable, "-W", warnings, *program, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONUNBUFFERED": ""},
        )
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        self.stdout, self.stderr = self.process.stdout, self.process.stderr
        self.out = ""

    def wait_for(self, text):
        """Read stdout up to a line that holds the text."""
        while text not in self.out:
            line = self.stdout.readline()
            assert line, f"{self.out!r} ended without {text!r}: {self.stderr.read()}"
            self.out += line

    def send(self, number):
        self.process.send_signal(number)

    def end(self):
        out, err = self.process.communicate(timeout=30)
        return Ran(self.process.returncode, self.out + out, err)


@pytest.fixture(scope="session")
def stage():
    return loaded(STAGE)


@pytest.fixture(scope="session")
def graphs():
    return loaded(GRAPHS)


def loaded(path):
    spec = spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[path.stem] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def turtleact(capsys):
    """Runs a command line in this process, in the embedded world."""

    def run(*arguments):
        status = cli.run(arguments)
        return Ran(status, *capsys.readouterr())

    return run


@pytest.fixture
def on_stage(turtleact, stage, monkeypatch):
    """The same in the world of ``stage.py``."""
    monkeypatch.setattr(graph, "embedded_world", stage.world)
    return turtleact


@pytest.fixture
def on_graph(turtleact, graphs, monkeypatch):
    """Runs a command line in this process, on a graph of ``graphs.py``."""

    def run(nodes, *arguments):
        monkeypatch.setattr(graph, "open_transport", graphs.open_graph(nodes))
        return turtleact(*arguments)

    return run


@pytest.fixture
def stdin_of(monkeypatch, tmp_path):
    with ExitStack() as stack:

        def put(data):
            path = tmp_path / "stdin"
            path.write_bytes(data)
            monkeypatch.setattr(sys, "stdin", stack.enter_context(path.open()))

        yield put


@pytest.fixture
def start():
    """Starts programs, and leaves none behind."""
    programs = []

    def begin(*arguments, **options):
        programs.append(Program(*arguments, **options))
        return programs[-1]

    yield begin
    for program in programs:
        program.process.kill()
        program.process.wait()
        program.stdout.close()
        program.stderr.close()
