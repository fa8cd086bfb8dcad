"""Packages and their executables, found without being built."""

from __future__ import annotations

import os
import sys

import pytest

from .. import warm

SETUP = """\
from setuptools import setup
raise SystemExit('nobody runs this')
setup(name='lab', entry_points={})
"""


def write(folder, **files):
    """Write files into a folder that is made; ``setup_py`` is setup.py."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / ".".join(name.rsplit("_", 1))).write_text(text)


def status_of(folder, *program):
    """Run a program in a process of its own, and return its exit status."""
    line = [sys.executable, "-m", "turtleact", "run", *program]
    return warm.run(line, cwd=folder, env=dict(os.environ), timeout=30).returncode


@pytest.fixture
def executables(turtleact, tmp_path, monkeypatch):
    """The executables of a package that are found from an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)

    def find(package="lab"):
        lines = turtleact("pkg", "executables", package).out.splitlines()
        return [line.removeprefix(f"{package} ") for line in lines]

    return find


@pytest.mark.parametrize(
    ("entry_points", "expected"),
    [
        ("{'console_scripts': ['go = lab.go:main', 'back=lab:A.main']}", ["back", "go"]),
        ("'[console_scripts]\\ngo = lab.go:main [extra]\\n'", ["go"]),
        ("{'console_scripts': ['no entry']}", []),
        ("made()", []),
    ],
)
def test_entry_points_of_setup_py_are_read_not_executed(
    executables, tmp_path, entry_points, expected
):
    write(tmp_path / "lab", setup_py=SETUP.replace("{}", entry_points))
    assert executables() == expected


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("pyproject_toml", "[project.scripts]\ngo = 'lab.go:main'\n", ["go"]),
        ("setup_py", "setup(", []),
        ("pyproject_toml", "[project", []),
    ],
)
def test_entry_points_of_other_files_count_unless_malformed(
    executables, tmp_path, name, text, expected
):
    write(tmp_path / "lab", **{name: text})
    assert executables() == expected


def test_cmake_installs_python_programs(executables, tmp_path):
    text = "install(PROGRAMS\n  scripts/go.py\n  scripts/native\n  DESTINATION lib/${PROJECT_NAME})"
    write(tmp_path / "lab", CMakeLists_txt=text, package_xml="<name>arm</name>")
    assert executables("arm") == ["go.py"]


@pytest.mark.parametrize("place", [".", "lab", "src/lab", "src/repository/lab"])
def test_a_package_is_found_in_the_folder_and_in_src(executables, tmp_path, place):
    text = SETUP.replace("{}", "{'console_scripts': ['go = lab.go:main']}")
    write(tmp_path / place, package_xml="<package>\n <name> lab </name>", setup_py=text)
    assert executables() == ["go"]


def test_the_module_of_a_program_may_be_in_src_of_its_package(tmp_path):
    write(tmp_path / "lab", pyproject_toml="[project.scripts]\ngo = 'gone_lab:main'\n")
    write(tmp_path / "lab" / "src", gone_lab_py="def main():\n    return 3\n")
    assert status_of(tmp_path, "lab", "go") == 3


def test_sources_come_before_what_is_built_in(executables, tmp_path):
    assert executables("turtlesim") == ["turtlesim_node", "turtle_teleop_key"]
    text = SETUP.replace("{}", "{'console_scripts': ['turtlesim_node = gone_lab:main']}")
    package = "<name>turtlesim</name>"
    write(tmp_path / "src" / "lab", setup_py=text, package_xml=package)
    write(tmp_path / "src" / "lab", gone_lab_py="def main():\n    return 5\n")
    assert status_of(tmp_path, "turtlesim", "turtlesim_node") == 5
