"""``pkg``: a new package can be tested and run at once; packages and executables are listed."""

from __future__ import annotations

import signal
import subprocess
import sys
import xml.etree.ElementTree as ET

import pytest

from .. import warm
from ..lab import free_endpoint
from ..registry import isolated_registry


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    with isolated_registry():
        yield tmp_path


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


def test_run_hands_the_graph_that_it_was_given_to_the_package(turtleact, here):
    assert turtleact("pkg", "create", "lab", "--node-name", "go").status == 0
    nowhere = free_endpoint()
    command = [sys.executable, "-m", "turtleact", "run", "--connect", nowhere, "lab", "go"]
    ran = subprocess.run(command, cwd=here, capture_output=True, text=True, check=False, timeout=30)
    assert (ran.returncode, f"no router answers at {nowhere}" in ran.stderr) == (1, True)


def test_what_the_options_say_is_in_the_files(turtleact, here):
    options = ("--build-type", "ament_python", "--license", "MIT & 'more'")
    turtleact("pkg", "create", "--dependencies", "rclpy", "std_msgs", *options, "lab")
    tree = ET.parse(here / "lab" / "package.xml")
    assert tree.findtext("license") == "MIT & 'more'"
    assert [each.text for each in tree.findall("depend")] == ["rclpy", "std_msgs"]
    assert """license="MIT & 'more'",""" in (here / "lab" / "setup.py").read_text()


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


# --- list and executables -------------------------------------------------------------------


def test_packages_and_executables_are_listed(turtleact):
    turtleact("pkg", "create", "lab")
    lines = turtleact("pkg", "list").out.splitlines()
    assert {"lab", "turtlesim"} <= {*lines}
    assert lines == sorted(lines)
    assert turtleact("pkg", "executables", "lab").out == "lab server\n"
    lines = turtleact("pkg", "executables").out.splitlines()
    assert {"lab server", "turtlesim turtlesim_node"} <= {*lines}
