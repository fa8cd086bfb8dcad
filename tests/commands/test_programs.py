"""Users' programs, run in this process as Python would."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from turtleact.commands import programs
from turtleact.commands.programs import Program, run_program
from turtleact.errors import TurtleactError, UnknownInterface, UsageError


@pytest.fixture
def python(monkeypatch):
    """Python's own state, which a program may change."""
    monkeypatch.setattr(sys, "argv", [*sys.argv])
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(sys, "meta_path", [*sys.meta_path])
    before = {*sys.modules}
    yield
    for name in {*sys.modules} - before:
        del sys.modules[name]


@pytest.fixture
def run(python, tmp_path):
    """Writes a program and runs it, as the file it is or by a function in it."""

    def run_(text, function=None, *arguments):
        file = tmp_path / "go.py"
        file.write_text(text)
        by_function = Program("go", module="go", function=function or "", folders=(tmp_path,))
        program = by_function if function else Program(str(file), file=file)
        return run_program(program, arguments)

    return run_


def test_a_file_is_main_and_sees_its_arguments_and_its_neighbours(run, tmp_path, capsys):
    (tmp_path / "beside.py").write_text("WORD = 'found'\n")
    assert run("import beside, sys\nprint(__name__, sys.argv[1:], beside.WORD)", None, "-x") == 0
    assert capsys.readouterr().out == "__main__ ['-x'] found\n"


@pytest.mark.parametrize(
    ("body", "status"),
    [
        ("pass", 0),
        ("return 3", 3),
        ("return True", 1),
        ("sys.exit()", 0),
        ("sys.exit(258)", 2),
        ("raise KeyboardInterrupt", 130),
    ],
)
def test_the_exit_status_is_that_of_an_entry_point(run, capsys, body, status):
    assert run(f"import sys\ndef main():\n    {body}", "main") == status
    assert capsys.readouterr() == ("", "")


def test_a_text_given_to_exit_is_printed(run, capsys):
    assert run("def main():\n    raise SystemExit('no turtle')", "main") == 1
    assert capsys.readouterr().err == "no turtle\n"


def test_a_method_is_found_by_its_dotted_name(run):
    assert run("class App:\n    @staticmethod\n    def main(): return 4", "App.main") == 4


@pytest.mark.parametrize("function", [None, "main"])
def test_a_traceback_begins_in_the_users_own_code(run, tmp_path, capsys, function):
    call = "" if function else "\nmain()"
    assert run(f"def main():\n    return 1 / 0{call}", function) == 1
    first, place, *_, last = capsys.readouterr().err.splitlines()
    assert first == "Traceback (most recent call last):"
    assert str(tmp_path / "go.py") in place
    assert last == "ZeroDivisionError: division by zero"


def test_the_traceback_of_a_failed_import_begins_in_the_users_own_code(run, tmp_path, capsys):
    assert run("import nowhere_at_all", "main") == 1
    _, place, *_ = capsys.readouterr().err.splitlines()
    assert place == f'  File "{tmp_path / "go.py"}", line 1, in <module>'


def test_an_error_of_turtleact_is_left_to_the_command_line_with_its_line(run, tmp_path):
    text = "import turtleact\n\nturtleact.get_action('lab/action/Gone')\n"
    with pytest.raises(TurtleactError) as raised:
        run(text)
    assert str(raised.value).startswith(f"{tmp_path}/go.py:3: unknown interface 'lab/action")
    assert isinstance(raised.value.__cause__, UnknownInterface)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "go is go:main, but there is no 'main'"),
        ("main = 1", "go is go:main, not a function"),
    ],
)
def test_a_missing_function_is_named(run, text, problem):
    with pytest.raises(UsageError, match=problem):
        run(text, "main")


def test_the_program_gets_pythons_own_signal_handlers(run):
    assert (
        run("def main():\n    import signal\n    signal.raise_signal(signal.SIGINT)", "main") == 130
    )
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_machine_code_takes_over_the_process(monkeypatch, tmp_path):
    started = []
    monkeypatch.setattr(os, "execv", lambda file, command: started.append((file, command)))
    monkeypatch.setattr(subprocess, "call", lambda command: len(command))
    file = tmp_path / "node"
    file.write_bytes(b"\x7fELF")
    assert run_program(Program("node", file=file), ["-x"]) == 2
    assert started == [(str(file), [str(file), "-x"])]


def test_machine_code_that_cannot_be_run_is_an_error(tmp_path):
    with pytest.raises(TurtleactError, match=r"node cannot be run: No such file"):
        run_program(Program("node", file=tmp_path / "node"), ())


@pytest.mark.parametrize(
    ("name", "first", "expected"),
    [
        ("node.py", "", True),
        ("node", "#!/usr/bin/env python3\n", True),
        ("node", "#!/bin/sh\n", False),
        ("node", "python", False),
    ],
)
def test_python_is_told_by_ending_or_first_line(tmp_path, name, first, expected):
    file: Path = tmp_path / name
    file.write_text(first)
    assert programs.is_python(file) is expected


LAB = """
import turtleact
from turtleact.interfaces.standard import Fibonacci

@turtleact.action(Fibonacci, "mine")
async def mine(goal):
    yield Fibonacci.Result(sequence=[goal.order])
"""


@pytest.mark.parametrize(
    "more",
    [
        "",
        "NUMBER = 3\n",
        "if NUMBER := 3:\n    import sys\n",
        "from turtleact.interfaces import load_interfaces\nload_interfaces('.')\ndef main(): ...\n",
    ],
)
def test_a_file_that_only_declares_actions_is_told_how_to_serve_them(run, tmp_path, capsys, more):
    assert run(f"{LAB}{more}") == 0
    file = tmp_path / "go.py"
    assert capsys.readouterr().err == (
        f"turtleact: {file} declares action mine, but runs nothing: use 'turtleact serve {file}'\n"
    )


@pytest.mark.parametrize(
    "more", ["", "def again():\n    return main()\n", "later = lambda: main()\n"]
)
def test_a_file_that_does_not_call_its_main_is_told_how_to(run, tmp_path, capsys, more):
    assert run(f"import signal\n\ndef main():\n    signal.pause()\n{more}") == 0
    assert capsys.readouterr().err == (
        f"turtleact: {tmp_path / 'go.py'} defines main, but runs nothing: "
        "add 'if __name__ == \"__main__\": main()' at its end\n"
    )


@pytest.mark.parametrize(
    ("first", "lines"),
    [
        ("", "'import asyncio' at its beginning and 'if __name__"),
        ("import asyncio\n", "'if __name__"),
    ],
)
def test_a_file_that_does_not_run_its_async_main_is_told_how_to(
    run, tmp_path, capsys, first, lines
):
    assert run(f"{first}async def main(): ...\n") == 0
    assert capsys.readouterr().err == (
        f"turtleact: {tmp_path / 'go.py'} defines main, but runs nothing: "
        f'add {lines} == "__main__": asyncio.run(main())\' at its end\n'
    )


def test_a_file_with_only_background_functions_is_told_how_to_serve_them(run, tmp_path, capsys):
    functions = "".join(
        f"@turtleact.background\nasync def {name}(node): ...\n" for name in ("beat", "log")
    )
    assert run(f"import turtleact\n{functions}") == 0
    file = tmp_path / "go.py"
    assert capsys.readouterr().err == (
        f"turtleact: {file} declares background functions beat, log, but runs nothing: "
        f"use 'turtleact serve {file}'\n"
    )


@pytest.mark.parametrize(
    "text",
    [
        f"{LAB}print(mine)\n",
        "def main(): ...\nmain()\n",
        "def main(): ...\ncode = main()\n",
        "def main(): ...\nif __name__ == '__main__':\n    status = main()\n",
        "import asyncio\nasync def main(): ...\ncode = asyncio.run(main())\n",
        "import anyio\nasync def main(): ...\ncode: object = anyio.run(main)\n",
        f"{LAB}def main(): ...\ncode = main()\n",
        f"{LAB}if __name__ == '__main__':\n    print(mine)\n",
        "from turtleact.actions.fibonacci import fibonacci\n",
        "NUMBER = 3\n",
    ],
)
def test_another_program_is_told_nothing(run, capsys, text):
    assert run(text) == 0
    assert capsys.readouterr().err == ""
