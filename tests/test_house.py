"""The rules of the tree itself: its layers, its start-up, its words, its lock and its CI."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "turtleact"

# One planted import for each kind of contract in .importlinter, and how lint-imports shows it.
VIOLATIONS = {
    "upwards": ("Layers", "goals.state", "turtleact.node"),
    "sibling": ("Layers", "doctor.checks", "turtleact.recording.bag"),
    "front-door": ("Root", "node.resources", "turtleact"),
    "clock-in-goal": ("Pure", "goals.state", "time"),
    "task-in-names": ("Pure", "names", "asyncio"),
    "chance-in-interfaces": ("Pure", "interfaces.cdr", "random"),
    "file-in-parse": ("Files", "interfaces.parse", "pathlib"),
    "goal": ("Transports", "transports.base", "turtleact.goals.state"),
    "message": ("Transports", "transports.memory", "turtleact.interfaces"),
    "sim-in-an-action": ("Acts", "actions.patrol", "turtleact.sim.world"),
    "names-in-world": ("World", "sim.world", "turtleact.names"),
    "clock-in-kinematics": ("World", "sim.kinematics", "time"),
    "rich-outside-commands": ("Doors", "app", "rich"),
    "numpy-outside-sim": ("Doors", "node.node", "numpy"),
    "yaml-outside-text": ("Doors", "cli", "yaml"),
    "zenoh-in-memory": ("Doors", "transports.memory", "zenoh"),
}


# Put together here, so that this file passes its own test.
MACHINE_PATHS = [f"/{folder}/" for folder in ("work", "root", "home")]
REGISTRY_HOSTS = [".".join(host) for host in (("pypi", "org"), ("pythonhosted", "org"))]

SKIPPED_FOLDERS = {".git", ".venv", "__pycache__", "build", "dist"}
LONGEST_MODULE = 700
LONGEST_FUNCTION = 60


def lint_imports(folder: Path) -> subprocess.CompletedProcess[str]:
    tool = Path(sysconfig.get_path("scripts"), "lint-imports")
    return subprocess.run(
        [tool, "--no-cache"],
        cwd=folder,
        env=os.environ | {"COLUMNS": "200", "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        check=False,
    )


def files() -> list[Path]:
    """Every text file of the checkout that is not made by a tool."""
    found = []
    for folder, folders, names in os.walk(ROOT):
        folders[:] = [
            name for name in folders if name not in SKIPPED_FOLDERS and not is_cache(name)
        ]
        found += [
            Path(folder, name)
            for name in names
            # a worktree's .git is a file
            if name not in {".git", "uv.lock"} and not name.startswith(".coverage")
        ]
    return sorted(found)


def is_cache(folder: str) -> bool:
    return folder.endswith(("_cache", ".egg-info")) or folder == ".hypothesis"


def lines_that_hold(words: list[str]) -> list[str]:
    pattern = re.compile("|".join(map(re.escape, words)))
    return [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in files()
        for number, line in enumerate(path.read_text("utf-8", "replace").splitlines(), start=1)
        if pattern.search(line)
    ]


def body_length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of a function from its def to its end, its docstring left out."""
    length = (function.end_lineno or 0) - function.lineno + 1
    if ast.get_docstring(function, clean=False) is None:
        return length
    docstring = function.body[0]
    return length - ((docstring.end_lineno or 0) - docstring.lineno + 1)


# --- layers ---------------------------------------------------------------------------------


def test_the_tree_keeps_every_import_contract():
    outcome = lint_imports(ROOT)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr


@pytest.fixture(scope="module")
def broken_contracts(tmp_path_factory):
    """What lint-imports says of each broken contract of a tree with all violations."""
    folder = tmp_path_factory.mktemp("violations")
    shutil.copytree(PACKAGE, folder / "turtleact", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / ".importlinter", folder)
    for _, module, imported in VIOLATIONS.values():
        path = folder.joinpath("turtleact", *module.split(".")).with_suffix(".py")
        with path.open("a", encoding="utf-8") as file:
            file.write(f"\nimport {imported}\n")
    (folder / "turtleact" / "utils.py").touch()
    outcome = lint_imports(folder)
    assert outcome.returncode == 1, outcome.stdout + outcome.stderr
    _, _, details = outcome.stdout.partition("Broken contracts\n")
    contracts = re.split(r"^(\w+): .*\n-+$", details, flags=re.MULTILINE)[1:]
    return dict(zip(contracts[::2], contracts[1::2], strict=True))


@pytest.mark.parametrize("violation", VIOLATIONS)
def test_a_planted_violation_breaks_its_import_contract(broken_contracts, violation):
    contract, module, imported = VIOLATIONS[violation]
    line = rf"^-? *turtleact\.{re.escape(module)} -> {re.escape(imported)} \(l\.\d+\)$"
    assert re.search(line, broken_contracts[contract], re.MULTILINE)


def test_a_module_in_no_row_breaks_the_contract_of_the_layers(broken_contracts):
    assert "utils" in broken_contracts["Layers"]


# --- size -----------------------------------------------------------------------------------


def test_no_module_is_over_700_lines():
    sizes = {path: len(path.read_text("utf-8").splitlines()) for path in PACKAGE.rglob("*.py")}
    long = {str(path.relative_to(ROOT)): n for path, n in sizes.items() if n > LONGEST_MODULE}
    assert not long


def test_no_function_is_over_60_lines():
    long = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {node.name}"
        for path in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and body_length(node) > LONGEST_FUNCTION
    ]
    assert not long


# --- words ----------------------------------------------------------------------------------


def test_no_file_names_a_path_of_a_machine():
    assert lines_that_hold(MACHINE_PATHS) == []


def test_no_file_names_the_host_of_a_package_registry():
    assert lines_that_hold(REGISTRY_HOSTS) == []


# --- event loops ----------------------------------------------------------------------------

NAMED = """
import pytest
async def test_default(): ...
@pytest.mark.loops("uvloop", "trio")
async def test_named(): ...
@pytest.mark.parametrize("anyio_backend", ["trio"])
async def test_of_its_own(): ...
def test_plain(): ...
"""


CASES = """
import pytest
NUMBERS = pytest.mark.parametrize("number", range(4))
@NUMBERS
async def test_shared(number): ...
@NUMBERS
@pytest.mark.loops("uvloop")
async def test_named(number): ...
"""


# --- watchdog -------------------------------------------------------------------------------

HANG = """
import anyio, conftest
conftest.SECONDS = 0.1
async def test_waits():
    await anyio.sleep_forever()
"""


def test_an_async_test_that_hangs_fails_on_every_loop(tmp_path):
    shutil.copy(ROOT / "tests" / "conftest.py", tmp_path)
    (tmp_path / "test_hang.py").write_text(HANG, "utf-8")
    outcome = subprocess.run(
        [sys.executable, "-m", "pytest", "-o", "anyio_mode=auto", tmp_path],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=50,
    )
    assert re.search(r"=+ 3 failed in", outcome.stdout), outcome.stdout + outcome.stderr


# --- packaging ------------------------------------------------------------------------------


def test_the_package_says_the_version_of_its_metadata():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    found = re.search(r'^__version__ = "(.+)"$', (PACKAGE / "__init__.py").read_text("utf-8"), re.M)
    assert found is not None
    assert found[1] == project["version"]


def test_the_package_is_marked_as_typed():
    assert (PACKAGE / "py.typed").read_text("utf-8") == ""


# --- continuous integration -----------------------------------------------------------------


@pytest.fixture
def checkout(tmp_path: Path):
    """Makes a git checkout of .ci/run and the README that it is given."""

    def make(readme: str) -> Path:
        (tmp_path / ".ci").mkdir()
        shutil.copy(ROOT / ".ci" / "run", tmp_path / ".ci")
        (tmp_path / "README.md").write_text(readme, "utf-8")
        subprocess.run(["git", "init", "--quiet", tmp_path], check=True)
        return tmp_path

    return make


COMMANDS = [
    *("awk", "bash", "cat", "dirname", "env", "git", "grep", "ls"),
    *("mkdir", "mktemp", "rm", "tar", "timeout", "touch"),
]


@pytest.fixture
def commands(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all commands that .ci/run may find; there is a browser, so it installs none."""
    folder = tmp_path_factory.mktemp("commands")
    for command in COMMANDS:
        (folder / command).symlink_to(shutil.which(command) or "/bin/false")
    (folder / "chromium").symlink_to(folder / "bash")
    return folder


@pytest.fixture
def run_ci(commands: Path):
    """Runs a checkout's .ci/run."""

    def run(checkout: Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [checkout / ".ci" / "run"],
            env={**os.environ, "PATH": str(commands)},
            capture_output=True,
            text=True,
            check=False,
            timeout=30,
        )

    return run


def readme_with(command: str) -> str:
    return f"# t\n\n```sh\nfalse\n```\n\n<!-- test command -->\n```sh\n{command}\n```\n\nEnd.\n"


needs_git = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")


@needs_git
def test_ci_runs_the_test_command_of_the_readme(checkout, run_ci):
    outcome = run_ci(checkout(readme_with("echo first && echo last")))
    assert outcome.stdout == "$ echo first && echo last\nfirst\nlast\n"


@needs_git
def test_ci_passes_the_exit_status_on(checkout, run_ci):
    assert run_ci(checkout(readme_with("exit 7"))).returncode == 7


@needs_git
def test_ci_runs_in_a_copy_of_the_checkout(checkout, run_ci):
    folder = checkout(readme_with("ls -A && touch left-behind"))
    outcome = run_ci(folder)
    assert outcome.stdout.splitlines()[1:] == [".ci", "README.md"]
    assert not (folder / "left-behind").exists()
