"""Users' programs, run as Python would."""

from __future__ import annotations

import subprocess
import sys
from functools import partial

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


def test_machine_code_takes_over_the_process(tmp_path):
    places = {
        "share/ament_index/resource_index/packages/lab": "",
        "lib/lab/node": "#!/bin/sh\necho $1 $$\nexit 7\n",
        "lib/lab/bad": "#!/nowhere/sh\n",
    }
    for name, text in places.items():
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        file.chmod(0o755)
    start = partial(
        subprocess.Popen,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={"AMENT_PREFIX_PATH": str(tmp_path)},
    )
    line = [sys.executable, "-m", "turtleact", "run", "lab"]
    with start([*line, "node", "-x"]) as program:
        assert program.communicate(timeout=30) == (f"-x {program.pid}\n", "")
    assert program.returncode == 7
    with start([*line, "bad"]) as program:
        _, err = program.communicate(timeout=30)
    assert (program.returncode, "lib/lab/bad cannot be run: No such file" in err) == (1, True)
