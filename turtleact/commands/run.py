"""The verb ``run``, and the verbs of ``pkg``: create, list and executables.

Packages near the working directory need no build. Their executables are the console scripts that
``setup.py`` or ``pyproject.toml`` declares, and the Python programs that ``CMakeLists.txt``
installs. ``setup.py`` is read, never executed. The executables of an installed package are the
files in ``lib/PACKAGE`` of its prefix, where ``ros2 run`` looks too. A file, or a function of a
module, runs as Python itself would run it.

A new package can be run and tested without a build. It follows the layout of ROS 2, so that colcon
can build it as well.

Source: ros2cli ``ros2pkg/api``; ros2pkg ``verb/create.py`` for the options and the names of files;
REP 149 for ``package.xml``; setuptools' documentation of entry points.
"""

from __future__ import annotations

import ast
import getpass
import keyword
import os
import re
import sys
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal, NamedTuple, NoReturn, TypeAlias
from xml.sax.saxutils import escape

import typer

from turtleact.commands import VERBS, completion
from turtleact.commands.app import SETTINGS, ManyVerb, new_group, verb
from turtleact.commands.options import Interfaces, argument, flag, value
from turtleact.commands.output import leave, say, say_names, write_file
from turtleact.commands.settings import ConnectOptions, Fleet, Service, WrongOptions, quoted
from turtleact.errors import TurtleactError, syntax_hint

if TYPE_CHECKING:
    from turtleact.rclpy.program import Options

__all__ = ["app", "nearby", "pkg", "place_of", "runnable_here"]

FAILED, INTERRUPTED = 1, 130

SHEBANG = 200
"""This many bytes at the beginning of a file are searched for ``python``."""

FIBONACCI = "turtleact.actions.fibonacci"

PROGRAMS: Final = (
    ("turtlesim", "turtlesim_node"),
    ("turtlesim", "turtle_teleop_key"),
    ("action_tutorials_py", "fibonacci_action_server"),
    ("action_tutorials_cpp", "fibonacci_action_server"),
    ("examples_rclpy_minimal_action_server", "server"),
    ("examples_rclcpp_minimal_action_server", "action_server_member_functions"),
)
"""The programs of ROS 2 that have a counterpart in turtleact.

All programs except those of the package turtlesim serve the Fibonacci action.
"""

_HELP = "'turtleact pkg executables' lists what can be run"

_MARKS: Final = ("package.xml", "setup.py", "pyproject.toml")
"""One of these files makes a folder a package."""

_INSTALLED: Final = re.compile(r"install\s*\(\s*PROGRAMS\s+(.*?)\sDESTINATION\s", re.DOTALL)
_ENTRY: Final = re.compile(r"\s*([^\s=]+)\s*=\s*([\w.]+\s*:\s*[\w.]+)\s*(?:\[.*\])?\s*")


class Program(NamedTuple):
    """Something that can be run: a file, or a function in a module.

    Attributes:
        name: The name that the program sees as its own, ``sys.argv[0]``.
        file: A Python file to run as ``__main__``, or another executable file. None if there is an
            entry point.
        entry: The entry point, such as ``lab.server:main``, if there is no file.
        folders: The folders that the program needs at the beginning of ``sys.path``.
    """

    name: str
    file: Path | None = None
    entry: str = ""
    folders: tuple[Path, ...] = ()


Programs: TypeAlias = dict[str, dict[str, Program | None]]
"""Programs by package name and then by executable name. A built-in program is None."""

app = typer.Typer(**SETTINGS)


@verb(
    app,
    help=VERBS["run"],
    epilog=f"{_HELP}.",
    # What follows the package belongs to the program, even if it looks like an option of ours.
    context_settings={"ignore_unknown_options": True, "allow_interspersed_args": False},
)
def run(
    reach: ConnectOptions,
    package: Annotated[
        str,
        argument(
            "PACKAGE",
            "The package, such as turtlesim, or a Python file such as lab.py.",
            completion.runnable_packages,
        ),
    ] = "",
    executable: Annotated[
        str,
        argument(
            "EXECUTABLE",
            "The program in the package, such as turtlesim_node.",
            completion.executables,
        ),
    ] = "",
    arguments: Annotated[
        list[str] | None, argument("ARGUMENTS", "The program's own arguments.")
    ] = None,
    *,
    face: Annotated[
        Literal["auto", "turtleact", "ros"],
        typer.Option(
            metavar="auto|turtleact|ros",
            help="Which rclpy the program imports: turtleact's, or that of a sourced ROS.",
        ),
    ] = "auto",
    embedded: Annotated[
        bool, flag("--embedded", text="Also start a world of turtles, for a rclpy program.")
    ] = False,
    interfaces: Interfaces = None,
) -> int:
    """``run``."""
    rest = list(arguments or ())
    if not package:
        raise WrongOptions(f"what to run is missing: {_HELP}")
    if package.endswith(".py"):
        program: Program | None = _file(package)
        rest = [executable, *rest] if executable else rest
    else:
        program = _chosen(runnable_here(), package, executable)
    if program is None:
        return _run_built_in(package, executable, rest, reach)
    from turtleact.commands.interface import make_found
    from turtleact.rclpy.face import JoinOptions
    from turtleact.rclpy.program import Options

    make_found(None if interfaces is None else str(interfaces))
    os.environ["ROS_DOMAIN_ID"] = str(reach.domain)  # the program reads it, as in ROS
    place = JoinOptions(reach.connect, reach.access().settings(), is_embedded=embedded)
    return _run_program(program, rest, Options(face, place))


# what can be run


def runnable_here() -> Programs:
    """Return the programs that can be run from the working directory.

    If several programs have the same package name and executable name, a program with sources wins,
    because it is the user's own. A built-in program wins over an installed one: ``turtlesim
    turtlesim_node`` runs turtleact's turtlesim, even if the real one is installed.
    """
    from turtleact.interfaces.workspace import folders_near, package_name

    found: Programs = {}
    for folder in folders_near(Path()):
        if any((folder / each).is_file() for each in _MARKS):
            name = package_name(folder) or folder.absolute().name
            found.setdefault(name, _programs_in(folder))
    for name, executable in PROGRAMS:
        found.setdefault(name, {}).setdefault(executable, None)
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        for place in Path(prefix, "share/ament_index/resource_index/packages").glob("*"):
            installed = _installed(Path(prefix), place.name)
            found[place.name] = {**installed, **found.get(place.name, {})}
    return found


def _programs_in(folder: Path) -> dict[str, Program | None]:
    """Return the programs of the package whose sources are in a folder."""
    # A module may be beside setup.py, or in a folder of its own: setuptools knows both layouts.
    folders = (folder, folder / "src")
    programs: dict[str, Program | None] = {
        file.name: Program(str(file), file, folders=folders) for file in _cmake_programs(folder)
    }
    for text in _console_scripts(folder):
        if found := _ENTRY.fullmatch(text):
            name, entry = found.groups()
            programs[name] = Program(str(folder / name), entry=entry, folders=folders)
    return dict(sorted(programs.items()))


def _console_scripts(folder: Path) -> Iterator[str]:
    """Yield the console scripts that a package declares, each as ``name = module:function``.

    A malformed file declares no scripts.
    """
    with suppress(OSError, ValueError, SyntaxError):
        yield from _of_setup_py((folder / "setup.py").read_text("utf-8"))
    with suppress(OSError, ValueError, AttributeError):
        project = tomllib.loads((folder / "pyproject.toml").read_text("utf-8")).get("project", {})
        for name, target in project.get("scripts", {}).items():
            yield f"{name} = {target}"


def _of_setup_py(text: str) -> Iterator[str]:
    """Yield the lines of all texts in the entry points of a ``setup.py``."""
    for given in ast.walk(ast.parse(text)):
        if isinstance(given, ast.keyword) and given.arg == "entry_points":
            for each in ast.walk(given.value):
                if isinstance(each, ast.Constant) and isinstance(each.value, str):
                    yield from each.value.splitlines()


def _cmake_programs(folder: Path) -> list[Path]:
    """Return the Python programs that a ``CMakeLists.txt`` installs. Others need a build."""
    try:
        text = (folder / "CMakeLists.txt").read_text("utf-8")
    except (OSError, UnicodeDecodeError):
        return []
    files = [folder / name for said in _INSTALLED.findall(text) for name in said.split()]
    return [file for file in files if _is_python(file)]


def _installed(prefix: Path, package: str) -> dict[str, Program | None]:
    """Return the executables of an installed package."""
    # Sourcing the workspace puts these folders on Python's path; so do we, if it was not sourced.
    folders = tuple(sorted((prefix / "lib").glob("python3*/*-packages")))
    return {
        file.name: Program(str(file), file, folders=folders)
        for file in sorted((prefix / "lib" / package).glob("*"))
        if file.is_file() and os.access(file, os.X_OK)
    }


def _is_python(file: Path) -> bool:
    """Whether a file is a Python program, judging by its ending and its first line."""
    if file.suffix == ".py":
        return True
    try:
        with file.open("rb") as opened:
            first = opened.readline(SHEBANG)
    except OSError:
        return False
    return first.startswith(b"#!") and b"python" in first


def _chosen(known: Programs, package: str, executable: str) -> Program | None:
    """Find the executable of a package; None if it is built in.

    Raises:
        WrongOptions: if there is no such package or executable. The error suggests the nearest
            name.
    """
    from turtleact.interfaces.definition import did_you_mean

    if package not in known:
        where = "in the working directory, in its src, or in a sourced workspace"
        hint = did_you_mean(package, known)
        raise WrongOptions(f"there is no package {quoted(package)} {where}{hint}; {_HELP}")
    programs = known[package]
    if executable in programs:
        return programs[executable]
    has = f"it has {', '.join(programs)}" if programs else "it has none in Python"
    if not executable:
        raise WrongOptions(f"say which executable of package {quoted(package)} to run: {has}")
    hint = did_you_mean(executable, programs) or f": {has}"
    raise WrongOptions(f"package {quoted(package)} has no executable {quoted(executable)}{hint}")


def _file(name: str) -> Program:
    if not Path(name).is_file():
        raise WrongOptions(f"there is no file {quoted(name)}")
    return Program(name, file=Path(name))


# how a program is run


def _run_built_in(
    package: str, executable: str, arguments: Sequence[str], reach: ConnectOptions
) -> int:
    """Run a built-in program, and return its exit status."""
    if executable == "turtle_teleop_key":
        from turtleact.commands.turtlesim import turtle_teleop_key

        return turtle_teleop_key(list(arguments), reach)
    if arguments:
        raise WrongOptions(
            f"{executable} is built in and takes no {quoted(arguments[0])}: options of 'run' stand "
            "before the package, and parameters are for 'turtleact param set', once it runs"
        )
    from turtleact.commands.interface import make_known
    from turtleact.commands.serving import run

    make_known(None)
    targets = () if package == "turtlesim" else (FIBONACCI,)
    service = Service(
        targets,
        (),
        reach,
        None if targets else Fleet(),
        None,
        reach.access().settings(),
        True,
        turtlesim_only=True,
        node_name=executable if targets else "turtleact",
    )
    return run(service)


def _run_program(program: Program, arguments: Sequence[str], options: Options) -> int:
    """Run a program of the user to its end in this process, and return its exit status.

    This function prepares the process first, because the program's first imports may need modules
    that turtleact provides. The program gets what ``python`` would give it: its arguments in
    ``sys.argv``, its folders in ``sys.path``, and Python's own signal handlers. An executable file
    that is not a Python program replaces this process.

    Returns:
        The exit status: that of `sys.exit`, 1 after an exception, 130 after Ctrl-C.

    Raises:
        TurtleactError: if the program raises one. The message begins with the file and the line.
    """
    if program.file is not None and not _is_python(program.file):
        _become(program.file, arguments)
    from turtleact.rclpy.program import end_threads, prepare

    prepare(options, *(program.folders if program.file is None else (program.file.parent,)))
    sys.argv = [program.name, *arguments]
    sys.path[:0] = [str(each) for each in program.folders]
    status = _status_of(program)
    if end_threads():
        leave(status)
    return status


def _status_of(program: Program) -> int:
    try:
        return _status(_run(program))
    except SystemExit as end:
        return _status(end.code)
    except KeyboardInterrupt:
        return INTERRUPTED
    except TurtleactError as error:
        place = place_of(error)
        if not place:
            raise
        raise TurtleactError(f"{place}: {error}") from error
    except BaseException as error:
        return _print_traceback(error)


def _run(program: Program) -> object:
    """Run a file as the module ``__main__``, or return what the function of the program returns."""
    from importlib.metadata import EntryPoint
    from runpy import run_path

    if program.file is None:
        return EntryPoint(program.name, program.entry, "console_scripts").load()()
    sys.path.insert(0, str(program.file.absolute().parent))
    run_path(str(program.file), run_name="__main__")
    return None


def _become(file: Path, arguments: Sequence[str]) -> NoReturn:
    """Replace this process by an executable file that is not a Python program."""
    try:
        os.execv(file, [str(file), *arguments])  # noqa: S606  # the program that the user typed
    except OSError as error:
        raise TurtleactError(f"{file} cannot be run: {error.strerror}") from None


def _status(code: object) -> int:
    """Return the exit status for the argument of `sys.exit`.

    As in Python, an argument that is neither None nor an integer is printed on stderr.
    """
    if code is None or isinstance(code, int):
        return (code or 0) & 0xFF
    print(code, file=sys.stderr)
    return FAILED


def _print_traceback(error: BaseException) -> int:
    """Print a traceback as Python does, but only of the user's code. Return the exit status."""
    import traceback

    trace = error.__traceback__
    while trace is not None and _is_library(trace.tb_frame.f_code.co_filename):
        trace = trace.tb_next
    if hint := syntax_hint(error):
        error.add_note(hint)
    traceback.print_exception(error.with_traceback(trace))
    return FAILED


def place_of(error: BaseException) -> str:
    """Return the file and line of the user's code that led to an error; empty if there is none."""
    import traceback

    if isinstance(error, SyntaxError) and error.filename:
        return f"{nearby(error.filename)}:{error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    own = [each for each in frames if not _is_library(each.filename)]
    return f"{nearby(own[-1].filename)}:{own[-1].lineno}" if own else ""


def nearby(file: str) -> str:
    """Return the path of a file, relative to the working directory if the file is inside."""
    path = Path(file)
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)


def _is_library(file: str) -> bool:
    """Whether a file belongs to turtleact, to Python or to an installed package."""
    import sysconfig

    is_installed = {"site-packages", "dist-packages"} & {*Path(file).parts}
    ours = str(Path(__file__).parents[1]) + os.sep
    return bool(is_installed) or file.startswith(("<", ours, sysconfig.get_path("stdlib")))


# packages

_NAME: Final = re.compile(r"[a-z](?:_?[a-z0-9])*")

_EXAMPLES = """\
[bold]Examples[/]
  turtleact pkg create my_robot
  turtleact pkg create my_patrol --action-name patrol --dependencies geometry_msgs turtlesim
"""

pkg = new_group("pkg", "Create and list packages, like 'ros2 pkg'. A package needs no build.")


@verb(pkg, cls=ManyVerb, epilog=_EXAMPLES)
def create(
    name: Annotated[str, argument("NAME", "The name of the package.")],
    *,
    dependencies: Annotated[
        list[str] | None,
        value("--dependencies", metavar="PACKAGE...", text="Packages that it needs."),
    ] = None,
    _build_type: Annotated[  # there is one
        Literal["ament_python"], value("--build-type", text="How colcon builds it.")
    ] = "ament_python",
    node_name: Annotated[
        str, value("--node-name", metavar="NAME", text="The name of its program.")
    ] = "server",
    action_name: Annotated[
        str, value("--action-name", metavar="NAME", text="The name of its action.")
    ] = "countdown",
    licence: Annotated[
        str, value("--license", metavar="NAME", text="Its licence, such as Apache-2.0.")
    ] = "TODO: License declaration",
) -> None:
    """Create a package with an action, a server and a test. The package needs no build."""
    from turtleact.interfaces.workspace import proper_name

    _check_package(name)
    _check_module("--node-name", node_name)
    _check_module("--action-name", action_name)
    words = {
        "name": name,
        "node": node_name,
        "action": action_name,
        "type": proper_name(action_name),
        "licence": licence,
        "maintainer": getpass.getuser(),
    }
    depends = "".join(f"  <depend>{each}</depend>\n" for each in dependencies or ())
    xml = {key: escape(each) for key, each in words.items()}
    files = {path.format(**words): text.format(**words) for path, text in _FILES.items()}
    files["package.xml"] = _PACKAGE_XML.format(**xml, depends=depends)
    if Path(name).exists():
        raise TurtleactError(f"{name} exists already: choose another name, or remove it")
    for path, text in files.items():
        write_file(Path(name, path), text)
        say(f"{Path(name, path)}\n")
    install = "" if find_spec("pytest") else "pip install pytest && "
    goal = f"/{action_name} {name}/action/{words['type']} 'start: 3'"
    say(f"\nrun it:   turtleact run {name} {node_name}\n")
    say(f"use it:   turtleact send-goal {goal}\ntest it:  {install}pytest {name}\n")


@verb(pkg, "list")
def list_() -> None:
    """List all packages: in the working directory, in a sourced workspace, and built in."""
    say_names("".join(f"{name}\n" for name in sorted(runnable_here())))


@verb(pkg)
def executables(
    package: Annotated[
        str | None,
        argument("PACKAGE", "The package. If left out, all.", completion.runnable_packages),
    ] = None,
) -> None:
    """List the executables of one package or of all packages."""
    from turtleact.interfaces.definition import did_you_mean

    known = runnable_here()
    if package is not None and package not in known:
        raise TurtleactError(f"unknown package '{package}'{did_you_mean(package, known)}")
    names = sorted(known) if package is None else [package]
    say_names("".join(f"{name} {each}\n" for name in names for each in known[name]))


def _check_package(name: str) -> None:
    if not _NAME.fullmatch(name):
        problem = "use lower case, digits and single underscores, beginning with a letter"
        raise WrongOptions(f"'{name}' is not the name of a ROS package: {problem}")
    spec = None if name in sys.modules else find_spec(name)
    is_module = name in sys.modules or (spec is not None and spec.origin is not None)
    if keyword.iskeyword(name) or is_module:
        raise WrongOptions(f"'{name}' is the name of a Python module already: choose another name")


def _check_module(option: str, name: str) -> None:
    if not name.isidentifier() or keyword.iskeyword(name) or name.startswith("_"):
        raise WrongOptions(f"{option} must be a name that Python allows, not '{name}'")


_FILES: Final = {
    "action/{type}.action": """\
# Counts down to zero, one step a second.
int32 start
---
string message
---
Step step
""",
    "msg/Step.msg": """\
# One step of a countdown.
int32 remaining
""",
    "package.xml": "",
    "setup.py": """\
from glob import glob

from setuptools import find_packages, setup

package_name = "{name}"

setup(
    name=package_name,
    version="0.0.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package_name]),
        ("share/" + package_name, ["package.xml"]),
        ("share/" + package_name + "/action", glob("action/*.action")),
        ("share/" + package_name + "/msg", glob("msg/*.msg")),
    ],
    install_requires=["setuptools", "turtleact"],
    zip_safe=True,
    maintainer={maintainer!r},
    maintainer_email="{maintainer}@todo.todo",
    description="TODO: Package description",
    license={licence!r},
    entry_points={{
        "console_scripts": [
            "{node} = {name}.{node}:main",
        ],
    }},
)
""",
    "setup.cfg": """\
[develop]
script_dir=$base/lib/{name}
[install]
install_scripts=$base/lib/{name}
""",
    "resource/{name}": "",
    "conftest.py": '"""Lets pytest find the modules of this package from any folder."""\n',
    "{name}/__init__.py": '"""The modules of {name}."""\n',
    "{name}/{node}.py": '''\
"""Serves the action /{action}."""

import asyncio
from pathlib import Path

import turtleact
from turtleact import cli
from turtleact.interfaces import load_interfaces

# The files in action and msg are read here. They need no build.
load_interfaces(Path(__file__).resolve().parents[1])
{type} = turtleact.get_action("{name}/action/{type}")
Step = turtleact.get_message("{name}/msg/Step")


@turtleact.action({type}, "{action}")
async def {action}(goal):
    """Count down to zero, one step a second."""
    for remaining in reversed(range(goal.start)):
        await asyncio.sleep(1.0)
        yield {type}.Feedback(step=Step(remaining=remaining))
    yield {type}.Result(message="Lift-off!")


def main():
    """Serve the actions of this module until Ctrl-C."""
    cli.serve(__file__, node="{node}")


if __name__ == "__main__":
    main()
''',
    "test/test_{name}.py": '''\
"""Tests of {name}. The time in them is virtual, so they take no time."""

from turtleact import testing

from {name}.{node} import {type}, {action}


def test_the_{action}_ends_with_lift_off():
    feedback, outcome = testing.run(testing.run_goal, {action}, {type}.Goal(start=3))
    assert [each.step.remaining for each in feedback] == [2, 1, 0]
    assert outcome.status.name == "SUCCEEDED"
    assert outcome.result.message == "Lift-off!"
''',
}

_PACKAGE_XML: Final = """\
<?xml version="1.0"?>
<package format="3">
  <name>{name}</name>
  <version>0.0.0</version>
  <description>TODO: Package description</description>
  <maintainer email="{maintainer}@todo.todo">{maintainer}</maintainer>
  <license>{licence}</license>

  <exec_depend>python3</exec_depend>
{depends}
  <export>
    <build_type>ament_python</build_type>
  </export>
</package>
"""
