"""Users' programs, run as Python would."""

from __future__ import annotations

import sys

import pytest

from .. import warm


@pytest.fixture
def run(tmp_path):
    """Writes a program and runs it, as the file it is or by a function that its package names."""

    def run_(text, function=None, *arguments):
        (tmp_path / "go.py").write_text(text)
        script = f"[project.scripts]\ngo = 'go:{function}'\n"
        (tmp_path / "pyproject.toml").write_text(f"[project]\nname = 'lab'\n{script}")
        (tmp_path / "package.xml").write_text("<name>lab</name>")
        program = ["lab", "go"] if function else ["go.py"]
        line = [sys.executable, "-m", "turtleact", "run", *program, *arguments]
        ran = warm.run(line, cwd=tmp_path, capture_output=True, text=True, timeout=30)
        return ran.returncode, ran.stdout, ran.stderr

    return run_


def test_a_file_is_main_and_sees_its_arguments_and_its_neighbours(run, tmp_path):
    (tmp_path / "beside.py").write_text("WORD = 'found'\n")
    ran = run("import beside, sys\nprint(__name__, sys.argv[1:], beside.WORD)", None, "-x")
    assert ran == (0, "__main__ ['-x'] found\n", "")


@pytest.mark.parametrize(
    ("body", "status", "said"),
    [
        ("return 3", 3, ""),
        ("return True", 1, ""),
        ("sys.exit()", 0, ""),
        ("sys.exit('no turtle')", 1, "no turtle\n"),
        ("signal.raise_signal(signal.SIGINT)", 130, ""),
    ],
)
def test_the_exit_status_is_that_of_an_entry_point(run, body, status, said):
    text = f"import signal, sys\nclass App:\n    @staticmethod\n    def main():\n        {body}"
    assert run(text, "App.main") == (status, "", said)


@pytest.mark.parametrize("function", [None, "main"])
def test_a_traceback_begins_in_the_users_own_code(run, tmp_path, function):
    call = "" if function else "\nmain()"
    status, _, err = run(f"def main():\n    return 1 / 0{call}", function)
    first, place, *_, last = err.splitlines()
    assert (status, first) == (1, "Traceback (most recent call last):")
    assert "go.py" in place
    assert last == "ZeroDivisionError: division by zero"


def test_an_error_of_turtleact_is_named_with_its_line(run):
    status, _, err = run("import turtleact\n\nturtleact.get_action('lab/action/Gone')\n")
    assert status == 1
    assert err.startswith("turtleact: go.py:3: unknown interface 'lab/action/Gone'")
