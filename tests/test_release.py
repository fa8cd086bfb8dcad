"""What makes a release: the wheel and the sdist, the workflow, the image.

The scripts of the workflow run as they stand. The wheel is built and installed once; its
dependencies are borrowed from this environment, so that no test here needs a network.
"""

from __future__ import annotations

import json
import os
import re
import runpy
import shutil
import socket
import subprocess
import sys
import tomllib
import urllib.request
import venv
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
WORKFLOW = yaml.safe_load((ROOT / ".github" / "workflows" / "release.yml").read_text("utf-8"))
JOBS = WORKFLOW["jobs"]
CHECK_DIST = runpy.run_path(str(ROOT / "scripts" / "check_dist.py"))
DOCKERFILE = (ROOT / "Dockerfile").read_text("utf-8")


def run(*command: object, folder: Path = ROOT) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(each) for each in command], cwd=folder, capture_output=True, text=True, check=False
    )


# --- the workflow -------------------------------------------------------------------------------


def test_it_tests_every_system_with_every_python():
    matrix = JOBS["test"]["strategy"]["matrix"]
    assert matrix["os"] == ["ubuntu-latest", "macos-latest", "windows-latest"]
    assert matrix["python"] == ["3.11", "3.12", "3.13", "3.14"]


def test_the_classifiers_are_the_systems_and_pythons_of_the_workflow():
    named = re.findall(
        r"Python :: (3\.\d+)|System :: (?:\w+ :: )?(\w+)", str(PROJECT["classifiers"])
    )
    assert [python for python, _ in named if python] == JOBS["test"]["strategy"]["matrix"]["python"]
    assert {system for _, system in named if system} == {"Linux", "MacOS", "Windows"}


def test_only_a_tag_that_was_tested_is_published():
    publish = JOBS["publish"]
    assert publish["if"] == "startsWith(github.ref, 'refs/tags/v')"
    assert publish["needs"] == ["build", "test"]


def test_only_publishing_may_ask_for_the_token_of_trusted_publishing():
    assert WORKFLOW["permissions"] == {"contents": "read"}
    granted = {name for name, job in JOBS.items() if "id-token" in job.get("permissions", {})}
    assert granted == {"publish"}
    assert JOBS["publish"]["environment"]
    action = JOBS["publish"]["steps"][-1]
    assert action == {"uses": "pypa/gh-action-pypi-publish@release/v1"}  # no password


# --- the wheel ----------------------------------------------------------------------------------


@pytest.mark.timeout(150)
def test_the_scripts_build_check_and_try_a_wheel(tmp_path):
    given = {
        "build": [],
        "check": [],
        "test": ["--borrow", "--tests", "-q", "-n", "0", "tests/test_geometry.py"],
    }
    for script, arguments in given.items():
        path = ROOT / "scripts" / f"{script}_dist.py"
        outcome = run(sys.executable, path, tmp_path / "dist", *arguments)
        assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    tag = f"v{PROJECT['version']}"
    tags = CHECK_DIST["problems_of"](tmp_path / "dist", f"{tag}rc")
    assert f"the tag is '{tag}rc', but the version is" in next(iter(tags))


def test_a_folder_without_a_wheel_is_no_release(tmp_path):
    outcome = run(sys.executable, ROOT / "scripts" / "check_dist.py", tmp_path)
    assert outcome.returncode == 1
    assert "holds 0 wheels and 0 sdists" in outcome.stderr


def test_a_version_without_changes_is_no_release():
    (problem,) = CHECK_DIST["problems_of_tag"]("v99.0", "99.0")
    assert problem == "CHANGELOG.md has no section [99.0]"


# --- the image ----------------------------------------------------------------------------------


def instructions(text: str) -> list[tuple[str, str]]:
    """The instructions of a Dockerfile without line continuations."""
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    return [(word, rest) for word, _, rest in (line.partition(" ") for line in lines)]


def test_the_image_serves_as_an_ordinary_user():
    words = dict(instructions(DOCKERFILE))
    assert words["USER"] not in {"0", "root"}


@pytest.fixture
def image(tmp_path):
    """The environment that the commands of the Dockerfile make, in place of an image."""
    ignored = (ROOT / ".dockerignore").read_text("utf-8").split()
    names = [each.removeprefix("**/") for each in ignored]
    shutil.copytree(ROOT, tmp_path / "source", ignore=shutil.ignore_patterns(*names))
    venv.create(tmp_path / "venv")
    pip = tmp_path / "venv" / "bin" / "pip"
    pip.write_text(f'#!/bin/sh\nexec {pip.with_name("python")} -m pip "$@"\n')
    pip.chmod(0o755)
    library = next((tmp_path / "venv" / "lib").glob("python*")) / "site-packages"
    others = [each for each in sys.path if Path(each).name == "site-packages"]
    (library / "borrowed.pth").write_text("\n".join(others), "utf-8")
    for word, rest in instructions(DOCKERFILE):
        if word == "RUN":
            command = re.sub(r"/(?=source|dist)", f"{tmp_path}/", rest)
            offline = {"PIP_NO_INDEX": "1", "PIP_NO_BUILD_ISOLATION": "0"}
            if "install" in command:
                offline |= {"PIP_NO_DEPS": "1", "PIP_IGNORE_INSTALLED": "1"}
            path = f"{tmp_path}/venv/bin:{os.environ['PATH']}"
            subprocess.run(
                ["bash", "-c", command], env=os.environ | offline | {"PATH": path}, check=True
            )
    return tmp_path / "venv" / "bin"


@pytest.mark.timeout(150)
def test_what_the_image_runs_serves_the_page(image):
    words = dict(instructions(DOCKERFILE))
    program, *arguments = json.loads(words["ENTRYPOINT"]) + json.loads(words["CMD"])
    assert arguments[-1] == f"0.0.0.0:{words['EXPOSE']}"
    arguments[-1] = "0.0.0.0:0"
    with socket.create_server(("127.0.0.1", 0)) as free:
        listen = ["--listen", f"tcp/127.0.0.1:{free.getsockname()[1]}"]
    with subprocess.Popen([image / program, *arguments, *listen], stdout=-1, text=True) as server:
        assert server.stdout is not None
        try:
            url = server.stdout.readline().split()[-1]
            with urllib.request.urlopen(url, timeout=30) as page:
                assert b"</html>" in page.read()
        finally:
            server.terminate()
        assert server.wait(30) == 0
