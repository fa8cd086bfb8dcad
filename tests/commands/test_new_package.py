"""``pkg``: a new package can be tested and run at once; packages and executables are listed."""

from __future__ import annotations

import ast
import signal
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from turtleact.interfaces.types import REGISTRY

from .. import warm
from .test_serve import free_endpoint


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    with REGISTRY.isolated():
        yield tmp_path


def test_the_files_are_named_with_what_to_do_next(turtleact):
    ran = turtleact("pkg", "create", "lab")
    assert (ran.status, ran.err) == (0, "")
    files, steps = ran.out.split("\n\n")
    assert all(Path(file).is_file() for file in files.splitlines())
    assert steps.splitlines() == [
        "run it:   turtleact run lab server",
        "use it:   turtleact send-goal /countdown lab/action/Countdown 'start: 3'",
        "test it:  pytest lab",
    ]


@pytest.mark.parametrize(
    ("folder", "options"), [(".", []), ("lab", ["--node-name", "count", "--action-name", "go_up"])]
)
def test_its_tests_pass_with_plain_pytest(turtleact, here, folder, options):
    assert turtleact("pkg", "create", "lab", *options).status == 0
    program = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
    ran = subprocess.run(program, cwd=here / folder, capture_output=True, text=True, check=False)
    assert "1 passed" in ran.stdout, ran.stdout + ran.stderr


@pytest.mark.parametrize(
    ("program", "action"), [(["lab", "go"], "/go_up"), (["lab/lab/go.py"], "/countdown")]
)
def test_an_unbuilt_package_runs_from_beginning_to_end(turtleact, here, program, action):
    made = turtleact(
        *("pkg", "create", "lab", "--node-name", "go", "--action-name", action.removeprefix("/"))
    )
    type_name = {"/go_up": "GoUp", "/countdown": "Countdown"}[action]
    assert f"send-goal {action} lab/action/{type_name} 'start: 3'" in made.out
    options = ["--listen", free_endpoint()]
    command = [sys.executable, "-m", "turtleact", "run", *program, *options]
    with warm.start(command, cwd=here, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        try:
            assert server.stdout.readline().endswith(f": {action}\n")
        finally:
            server.send_signal(signal.SIGINT)
    assert server.returncode == 0


def test_what_the_options_say_is_in_the_files(turtleact, here):
    options = {
        "--description": "Turtles & 'more'",
        "--license": "MIT",
        "--maintainer-name": "Ada <A>",
        "--maintainer-email": "ada@example.com",
        "--destination-directory": "src",
    }
    turtleact(
        *("pkg", "create", "--dependencies", "rclpy", "std_msgs", "--build-type", "ament_python"),
        *(word for pair in options.items() for word in pair),
        "lab",
    )
    tree = ET.parse(here / "src" / "lab" / "package.xml")
    said = {each.tag: (each.text or "").strip() for each in tree.getroot()}
    assert said["description"] == "Turtles & 'more'"
    assert (said["maintainer"], said["license"]) == ("Ada <A>", "MIT")
    assert [each.text for each in tree.findall("depend")] == ["rclpy", "std_msgs"]
    setup = ast.unparse(ast.parse((here / "src" / "lab" / "setup.py").read_text()))
    assert """description="Turtles & 'more'", license='MIT'""" in setup


def test_the_steps_lead_to_another_folder(turtleact, here):
    (here / "other place").mkdir()
    ran = turtleact("pkg", "create", "lab", "--destination-directory", "other place")
    lines = ran.out.splitlines()[-3:]
    assert lines[0] == "run it:   cd 'other place' && turtleact run lab server"
    assert lines[2] == "test it:  cd 'other place' && pytest lab"


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["Lab"], "'Lab' is not the name of a ROS package: use lower case, digits and single"),
        (["random"], "'random' is the name of a Python module already"),
        (["lab", "--node-name", "my-node"], "--node-name must be a name that Python allows"),
        (["lab", "--action-name", "2nd"], "--action-name must be a name that Python allows"),
        (["lab", "--build-type", "ament_cmake"], "'ament_cmake' is not one of 'ament_python'"),
        (["--dependencies", "rclpy", "lab"], "Missing argument 'NAME'"),
        (["lab", "--dependencies"], "Option '--dependencies' requires an argument."),
    ],
)
def test_what_cannot_be_created_is_refused(turtleact, here, arguments, problem):
    ran = turtleact("pkg", "create", *arguments)
    assert ran.status == 2
    assert problem in ran.problem
    assert list(here.iterdir()) == []


def test_a_folder_that_exists_stays_as_it_is(turtleact, here):
    (here / "lab").mkdir()
    ran = turtleact("pkg", "create", "lab")
    assert ran == (1, "", "turtleact: lab exists already: choose another name, or remove it\n")
    assert list((here / "lab").iterdir()) == []


def test_a_place_that_cannot_be_written_is_named(turtleact, here):
    (here / "file").touch()
    ran = turtleact("pkg", "create", "lab", "--destination-directory", "file")
    assert ran.status == 1
    assert "turtleact: file/lab" in ran.err
    assert "cannot be written: Not a directory" in ran.err


# --- list and executables -------------------------------------------------------------------


def test_packages_and_executables_are_listed(turtleact):
    turtleact("pkg", "create", "lab")
    lines = turtleact("pkg", "list").out.splitlines()
    assert {"lab", "turtlesim"} <= {*lines}
    assert lines == sorted(lines)
    assert turtleact("pkg", "executables", "lab").out == "lab server\n"
    lines = turtleact("pkg", "executables").out.splitlines()
    assert {"lab server", "turtlesim turtlesim_node"} <= {*lines}


def test_the_help_of_run_lists_what_can_be_run(turtleact, here):
    turtleact("pkg", "create", "lab")
    out = turtleact("run", "--help").out
    assert "What can be run here" in out
    assert " lab server " in out
    assert " turtlesim turtlesim_node " in out


def test_the_help_of_run_does_not_list_hundreds(turtleact, here):
    scripts = "".join(f"go{number} = 'lab:main'\n" for number in range(100))
    (here / "lab").mkdir()
    (here / "lab" / "pyproject.toml").write_text(f"[project.scripts]\n{scripts}")
    out = turtleact("run", "--help").out
    assert out.count(" lab go") < 40
    assert "more: see 'turtleact pkg executables'" in out
