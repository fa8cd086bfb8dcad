"""The verb ``run``, and the verbs of ``pkg``: create, list and executables.

`turtleact.commands.user_code` finds and runs programs. A new package can be run and tested without
a build. It follows the layout of ROS 2, so that colcon can build it as well.

Source: ros2pkg ``verb/create.py`` for the options and the names of files; REP 149 for
``package.xml``.
"""

from __future__ import annotations

import getpass
import keyword
import os
import re
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Final, Literal
from xml.sax.saxutils import escape

import typer

from turtleact.commands import VERBS, completion
from turtleact.commands.app import SETTINGS, ManyVerb, new_group, verb
from turtleact.commands.options import Interfaces, argument, flag, value
from turtleact.commands.output import say, say_lines, write_file
from turtleact.commands.settings import ConnectOptions, Fleet, Service, WrongOptions, quoted
from turtleact.commands.user_code import Program, Programs, run_program, runnable_here
from turtleact.errors import TurtleactError

__all__ = ["app", "pkg"]

FIBONACCI = "turtleact.actions.fibonacci"

_HELP = "'turtleact pkg executables' lists what can be run"

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
    from turtleact.commands.message_text import make_found
    from turtleact.rclpy.face import JoinOptions
    from turtleact.rclpy.program import Options

    make_found(None if interfaces is None else str(interfaces))
    os.environ["ROS_DOMAIN_ID"] = str(reach.domain)  # the program reads it, as in ROS
    place = JoinOptions(reach.connect, reach.access().settings(), is_embedded=embedded)
    return run_program(program, rest, Options(face, place))


# what can be run


def _chosen(known: Programs, package: str, executable: str) -> Program | None:
    """Find the executable of a package; None if it is built in.

    Raises:
        WrongOptions: if there is no such package or executable. The error suggests the nearest
            name.
    """
    from turtleact.interfaces.definition import did_you_mean

    programs = _programs_of(known, package)
    if executable in programs:
        return programs[executable]
    has = f"it has {', '.join(programs)}" if programs else "it has none in Python"
    if not executable:
        raise WrongOptions(f"say which executable of package {quoted(package)} to run: {has}")
    hint = did_you_mean(executable, programs) or f": {has}"
    raise WrongOptions(f"package {quoted(package)} has no executable {quoted(executable)}{hint}")


def _programs_of(known: Programs, package: str) -> dict[str, Program | None]:
    from turtleact.interfaces.definition import did_you_mean

    if package not in known:
        where = "in the working directory or in its src"
        hint = did_you_mean(package, known)
        raise WrongOptions(f"there is no package {quoted(package)} {where}{hint}; {_HELP}")
    return known[package]


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
    from turtleact.commands.message_text import make_known
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
    from turtleact.interfaces.finders import proper_name

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
    """List all packages: in the working directory, and built in."""
    say_lines(sorted(runnable_here()))


@verb(pkg)
def executables(
    package: Annotated[
        str | None,
        argument("PACKAGE", "The package. If left out, all.", completion.runnable_packages),
    ] = None,
) -> None:
    """List the executables of one package or of all packages."""
    known = runnable_here()
    names = sorted(known) if package is None else [package]
    say_lines(f"{name} {each}" for name in names for each in _programs_of(known, name))


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
