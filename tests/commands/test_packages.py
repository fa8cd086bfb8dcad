"""Packages and their executables, found without being built."""

from __future__ import annotations

import pytest

from turtleact.commands.packages import find_installed, find_sources, runnable

SETUP = """\
from setuptools import setup
package_name = 'lab'
raise SystemExit('nobody runs this')
setup(name=package_name, entry_points={})
"""


def write(folder, **files):
    """Write files into a folder that is made; ``setup_py`` is setup.py."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / ".".join(name.rsplit("_", 1))).write_text(text)


def targets(root, package="lab"):
    programs = find_sources(root)[package].programs
    return {name: f"{each.module}:{each.function}" for name, each in programs.items()}


@pytest.mark.parametrize(
    ("entry_points", "expected"),
    [
        ("{'console_scripts': ['go = lab.go:main']}", {"go": "lab.go:main"}),
        ("dict(console_scripts=['go=lab.go:main'])", {}),
        ("{'console_scripts': [f'go = {package_name}.go:main']}", {"go": "lab.go:main"}),
        ("{'console_scripts': ['go = ' + package_name + '.go:A.main']}", {"go": "lab.go:A.main"}),
        ("{'console_scripts': ['a = lab:a'] + ['b = lab:b']}", {"a": "lab:a", "b": "lab:b"}),
        ("{'console_scripts': [f'a = {unknown}:a', 'b = lab:b']}", {"b": "lab:b"}),
        ("{'console_scripts': 'go = lab.go:main'}", {"go": "lab.go:main"}),
        ("'[console_scripts]\\ngo = lab.go:main\\n[other]\\nx = y:z'", {"go": "lab.go:main"}),
        ("{'console_scripts': ['go = lab.go:main [extra]', 'no entry']}", {"go": "lab.go:main"}),
        ("made()", {}),
    ],
)
def test_entry_points_of_setup_py_are_read_not_executed(tmp_path, entry_points, expected):
    text = SETUP.replace("{}", entry_points)
    write(tmp_path / "lab", setup_py=text)
    assert targets(tmp_path) == expected


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("setup_cfg", "[options.entry_points]\nconsole_scripts =\n    go = lab.go:main\n"),
        ("pyproject_toml", "[project.scripts]\ngo = 'lab.go:main'\n"),
        ("pyproject_toml", "[tool.poetry.scripts]\ngo = 'lab.go:main'\n"),
    ],
)
def test_entry_points_of_other_files_count_too(tmp_path, name, text):
    write(tmp_path / "lab", **{name: text})
    assert targets(tmp_path) == {"go": "lab.go:main"}


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("setup_py", "setup("),
        ("setup_py", "\0"),
        ("setup_cfg", "console_scripts"),
        ("pyproject_toml", "[project"),
        ("pyproject_toml", "project = 1"),
        ("pyproject_toml", "[project]\nscripts = 1"),
    ],
)
def test_a_malformed_file_declares_nothing(tmp_path, name, text):
    write(tmp_path / "lab", **{name: text})
    assert targets(tmp_path) == {}


def test_cmake_installs_python_programs(tmp_path):
    text = "install(PROGRAMS\n  scripts/go.py\n  scripts/native\n  DESTINATION lib/${PROJECT_NAME})"
    write(tmp_path / "lab", CMakeLists_txt=text, package_xml="<name>arm</name>")
    assert list(find_sources(tmp_path)["arm"].programs) == ["go.py"]


@pytest.mark.parametrize("place", [".", "lab", "src/lab", "src/repository/lab"])
def test_a_package_is_found_in_the_folder_and_in_src(tmp_path, place):
    write(tmp_path / place, package_xml="<package>\n <name> lab </name>", setup_py=SETUP)
    assert find_sources(tmp_path)["lab"].folder == tmp_path / place


def test_the_module_of_a_program_may_be_in_src_of_its_package(tmp_path):
    text = "[project.scripts]\ngo = 'lab.go:main'\n"
    write(tmp_path / "lab" / "src" / "lab")
    write(tmp_path / "lab", pyproject_toml=text)
    program = find_sources(tmp_path)["lab"].programs["go"]
    assert program.folders == (tmp_path / "lab", tmp_path / "lab" / "src")


@pytest.fixture
def prefix(tmp_path, monkeypatch):
    """A sourced workspace with the packages lab and turtlesim."""
    prefix = tmp_path / "install"
    for package in ("lab", "turtlesim"):
        write(prefix / "share/ament_index/resource_index/packages")
        (prefix / "share/ament_index/resource_index/packages" / package).touch()
        write(prefix / "lib" / package, go_py="", notes_txt="")
        (prefix / "lib" / package / "go.py").chmod(0o755)
    write(prefix / "lib/python3.12/site-packages")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{prefix}:/nowhere")
    return prefix


def test_an_installed_package_has_the_programs_in_its_lib(prefix):
    program = find_installed()["lab"].programs["go.py"]
    assert program.file == prefix / "lib/lab/go.py"
    assert program.folders == (prefix / "lib/python3.12/site-packages",)
    assert list(find_installed()["lab"].programs) == ["go.py"]


def test_sources_come_first_then_what_is_built_in_then_what_is_installed(prefix, tmp_path):
    here = tmp_path / "here"
    write(here / "lab", setup_py=SETUP.replace("{}", "{'console_scripts': ['go.py = lab:main']}"))
    known = runnable(here, [("turtlesim", "go.py"), ("lab", "other")])
    assert known["turtlesim"] == {"go.py": None}
    assert list(known["lab"]) == ["go.py", "other"]
    assert known["lab"]["go.py"].module == "lab"  # type: ignore[union-attr]
