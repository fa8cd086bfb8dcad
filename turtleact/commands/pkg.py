"""Implements ``pkg create``, which writes a package that can be run and tested without a build.

The package follows the layout of ROS 2, so that colcon can build it as well. ROS 2 generates
interfaces only in packages of the build type ``ament_cmake``. turtleact reads interfaces in any
package.

Source: ros2pkg ``verb/create.py`` for the options and the names of files; REP 149 for
``package.xml``.
"""

from __future__ import annotations

import getpass
import keyword
import re
import shlex
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Final, NamedTuple, TypeAlias
from xml.sax.saxutils import escape, quoteattr

import typer

from turtleact.commands import completion
from turtleact.commands.app import Verb, new_group, verb
from turtleact.commands.options import argument, value
from turtleact.commands.output import say, say_names
from turtleact.commands.settings import WrongOptions
from turtleact.errors import TurtleactError

__all__ = ["app"]

BUILD_TYPES: Final = ("ament_python", "ament_cmake")

_NAME: Final = re.compile(r"[a-z](?:_?[a-z0-9])*")
_INTERFACES: Final = re.compile(r".*(_msgs|_interfaces|_srvs|_actions)")


_EXAMPLES = """\
[bold]Examples[/]
  turtleact pkg create my_robot
  turtleact pkg create my_patrol --node-name patrol --dependencies geometry_msgs turtlesim
"""

app = new_group("pkg", "Create and list packages, like 'ros2 pkg'. A package needs no build.")


class Create(Verb):
    """The command ``create``. As in ``ros2``, ``--dependencies`` takes several values."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # as in `Verb`
        """Parse the arguments, after repeating ``--dependencies`` before each of its values.

        This is needed because an option of click takes one value at a time.
        """
        return super().parse_args(ctx, spread(args, "--dependencies"))


def spread(args: list[str], option: str) -> list[str]:
    """Insert an option before each of its values. The values end at the next option or ``--``.

    >>> spread(["lab", "--dependencies", "rclpy", "std_msgs", "--license", "MIT"], "--dependencies")
    ['lab', '--dependencies', 'rclpy', '--dependencies', 'std_msgs', '--license', 'MIT']
    """
    spread_out: list[str] = []
    is_inside = is_first = False
    for arg in args:
        if arg.startswith("-"):
            is_ending, is_inside = is_inside and arg == "--", arg == option
            if not is_ending:
                spread_out.append(arg)
            is_first = is_inside
        else:
            spread_out += [option, arg] if is_inside and not is_first else [arg]
            is_first = False
    return spread_out


Dependencies: TypeAlias = Annotated[
    list[str] | None,
    value(
        "--dependencies",
        metavar="PACKAGE...",
        text="Packages that it needs, separated by spaces.",
    ),
]


@verb(app, cls=Create, epilog=_EXAMPLES)
def create(
    name: Annotated[str, argument("NAME", "The name of the package.", show_default=False)],
    *,
    dependencies: Dependencies = None,
    build_type: Annotated[
        str,
        value(
            metavar="TYPE",
            text="ament_python, or ament_cmake for a package with interfaces only.",
            autocompletion=completion.words("ament_python", "ament_cmake"),
        ),
    ] = "ament_python",
    destination_directory: Annotated[
        Path,
        value(
            "--destination-directory",
            metavar="DIR",
            text="Where the folder of the package is made.",
        ),
    ] = Path(),
    license_: Annotated[
        str | None, value("--license", metavar="NAME", text="Its licence, such as Apache-2.0.")
    ] = None,
    description: Annotated[
        str | None, value("--description", metavar="TEXT", text="What it is for.")
    ] = None,
    node_name: Annotated[
        str | None,
        value("--node-name", metavar="NAME", text="The name of its program. If left out, server."),
    ] = None,
    maintainer_name: Annotated[
        str | None,
        value("--maintainer-name", metavar="NAME", text="Who maintains it. If left out, you."),
    ] = None,
    maintainer_email: Annotated[
        str | None,
        value("--maintainer-email", metavar="ADDRESS", text="The address of the maintainer."),
    ] = None,
) -> None:
    """Create a package with an action, a server and a test. The package needs no build."""
    given = {
        "node_name": node_name,
        "description": description,
        "licence": license_,
        "maintainer": maintainer_name,
        "email": maintainer_email,
    }
    package = NewPackage(
        name,
        destination_directory,
        build_type,
        dependencies=tuple(dependencies or ()),
        **{key: each for key, each in given.items() if each is not None},
    )
    check(package, has_node_name=node_name is not None)
    write(package)


@verb(app, "list")
def list_() -> None:
    """List all packages: in the working directory, in a sourced workspace, and built in."""
    from turtleact.commands.packages import runnable_here

    say_names("".join(f"{name}\n" for name in sorted(runnable_here())))


@verb(app)
def executables(
    package: Annotated[
        str | None,
        argument(
            "PACKAGE",
            "The package. If left out, all packages.",
            completion.runnable_packages,
            show_default=False,
        ),
    ] = None,
) -> None:
    """List the executables of packages, one package and executable per line."""
    from turtleact.commands.packages import runnable_here
    from turtleact.interfaces.definition import did_you_mean

    known = runnable_here()
    if package is not None and package not in known:
        raise TurtleactError(f"unknown package '{package}'{did_you_mean(package, known)}")
    names = sorted(known) if package is None else [package]
    say_names("".join(f"{name} {each}\n" for name in names for each in known[name]))


class NewPackage(NamedTuple):
    """The package to create.

    Attributes:
        name: The name of the package.
        folder: The folder in which the package's folder is created.
        build_type: One of `BUILD_TYPES`. A package of the type ``ament_cmake`` has only interfaces.
        node_name: The name of the package's executable, and of the module with its code.
        dependencies: Other packages that this package needs.
        description: What the package is for.
        licence: The licence of the package.
        maintainer: The maintainer's name; None for the user's login name.
        email: The maintainer's e-mail address; None for a placeholder.
    """

    name: str
    folder: Path
    build_type: str = BUILD_TYPES[0]
    node_name: str = "server"
    dependencies: tuple[str, ...] = ()
    description: str = "TODO: Package description"
    licence: str = "TODO: License declaration"
    maintainer: str | None = None
    email: str | None = None


def write(package: NewPackage) -> None:
    """Write the files of a package, print their names, and print how to run and test the package.

    Args:
        package: A package that has passed `check`.

    Raises:
        TurtleactError: if the package's folder exists already, or a file cannot be written.
    """
    root = package.folder / package.name
    if root.exists():
        raise TurtleactError(f"{root} exists already: choose another name, or remove it")
    python = package.build_type == "ament_python"
    files = _python_files(package) if python else _cmake_files(package)
    for name, text in files.items():
        path = root / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, "utf-8")
        except OSError as error:
            raise TurtleactError(f"{path} cannot be written: {error.strerror}") from None
    say("".join(f"{root / name}\n" for name in files))
    say("".join(f"{line}\n" for line in ("", *_next_steps(package, python=python))))


def check(package: NewPackage, *, has_node_name: bool) -> None:
    """Check the names and the build type of a package.

    Args:
        package: The package to create.
        has_node_name: Whether the user named an executable.

    Raises:
        WrongOptions: if a name or the build type is not allowed, or if the user named an executable
            for a package that has only interfaces.
    """
    if package.build_type not in BUILD_TYPES:
        raise WrongOptions(
            f"--build-type is {' or '.join(BUILD_TYPES)}: turtleact compiles nothing"
        )
    if has_node_name and package.build_type == "ament_cmake":
        problem = "has interfaces only: leave out --node-name, or give --build-type ament_python"
        raise WrongOptions(f"a package of the build type ament_cmake {problem}")
    name, node = package.name, package.node_name
    if not _NAME.fullmatch(name):
        problem = "use lower case, digits and single underscores, beginning with a letter"
        raise WrongOptions(f"'{name}' is not the name of a ROS package: {problem}")
    if keyword.iskeyword(name) or _is_module(name):
        raise WrongOptions(f"'{name}' is the name of a Python module already: choose another name")
    if not node.isidentifier() or keyword.iskeyword(node) or node.startswith("__"):
        raise WrongOptions(f"--node-name must be a valid name of a Python module, not '{node}'")
    for each in package.dependencies:
        if not _NAME.fullmatch(each):
            raise WrongOptions(f"--dependencies must be names of packages, not '{each}'")


def _is_module(name: str) -> bool:
    """Whether Python has a module of that name. A folder without ``__init__.py`` does not count."""
    spec = None if name in sys.modules else find_spec(name)
    return name in sys.modules or (spec is not None and spec.origin is not None)


def _next_steps(package: NewPackage, *, python: bool) -> list[str]:
    """Return lines with the commands that the user can type next."""
    here = Path()
    is_near = package.folder.resolve() in (here.resolve(), (here / "src").resolve())
    cd = "" if is_near else f"cd {shlex.quote(str(package.folder))} && "
    folder = (package.folder if is_near else Path()) / package.name
    if not python:
        return [f"look at it:  {cd}turtleact interface show {package.name}/action/Countdown"]
    install = "" if find_spec("pytest") else "pip install pytest && "
    return [
        f"run it:   {cd}turtleact run {package.name} {package.node_name}",
        f"use it:   {cd}turtleact send-goal /countdown {package.name}/action/Countdown 'start: 3'",
        f"test it:  {cd}{install}pytest {shlex.quote(str(folder))}",
    ]


def _python_files(package: NewPackage) -> dict[str, str]:
    """Return the files of a package that contains a program, as a dict from path to text."""
    name, node = package.name, package.node_name
    texts = {
        "package.xml": _package_xml(package, ("<exec_depend>python3</exec_depend>",), ()),
        "setup.py": _SETUP_PY.format(
            name=name,
            node=node,
            description=repr(package.description),
            licence=repr(package.licence),
            maintainer=repr(_maintainer(package)),
            email=repr(_email(package)),
        ),
        "setup.cfg": _SETUP_CFG.format(name=name),
        f"resource/{name}": "",
        "conftest.py": '"""Lets pytest find the modules of this package from any folder."""\n',
        f"{name}/__init__.py": f'"""The modules of {name}."""\n',
        f"{name}/{node}.py": _MODULE.replace("NAME", name).replace("NODE", node),
        f"test/test_{name}.py": _TEST.replace("NAME", name).replace("NODE", node),
    }
    return _INTERFACE_FILES | texts


def _cmake_files(package: NewPackage) -> dict[str, str]:
    """Return the files of a package that contains only interfaces, as a dict from path to text."""
    needed = [each for each in package.dependencies if _INTERFACES.fullmatch(each)]
    uses = f"  DEPENDENCIES {' '.join(needed)}\n" if needed else ""
    found = "".join(f"find_package({each} REQUIRED)\n" for each in package.dependencies)
    texts = {
        "package.xml": _package_xml(package, _GENERATORS, _GENERATED),
        "CMakeLists.txt": _CMAKE.format(name=package.name, found=found, uses=uses),
    }
    return _INTERFACE_FILES | texts


def _package_xml(package: NewPackage, tools: tuple[str, ...], more: tuple[str, ...]) -> str:
    depends = (f"<depend>{each}</depend>" for each in package.dependencies)
    lines = [*tools, *depends, *more]
    return _PACKAGE_XML.format(
        name=package.name,
        description=escape(package.description),
        email=quoteattr(_email(package)),
        maintainer=escape(_maintainer(package)),
        licence=escape(package.licence),
        depends="".join(f"  {line}\n" for line in lines),
        build_type=package.build_type,
    )


def _maintainer(package: NewPackage) -> str:
    if package.maintainer is not None:
        return package.maintainer
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # the system does not know the user
        return "user"


def _email(package: NewPackage) -> str:
    return package.email if package.email is not None else f"{_maintainer(package)}@todo.todo"


_INTERFACE_FILES: Final = {
    "action/Countdown.action": """\
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
}

_MODULE: Final = '''\
"""Serves the action /countdown."""

import asyncio
from pathlib import Path

import turtleact
from turtleact import cli
from turtleact.interfaces import load_interfaces

# The files in action and msg are read here. They need no build.
load_interfaces(Path(__file__).resolve().parents[1])
Countdown = turtleact.get_action("NAME/action/Countdown")
Step = turtleact.get_message("NAME/msg/Step")


@turtleact.action(Countdown, "countdown")
async def countdown(goal):
    """Count down to zero, one step a second."""
    for remaining in reversed(range(goal.start)):
        await asyncio.sleep(1.0)
        yield Countdown.Feedback(step=Step(remaining=remaining))
    yield Countdown.Result(message="Lift-off!")


def main():
    """Serve the actions of this module until Ctrl-C."""
    cli.serve(__file__, node="NODE")


if __name__ == "__main__":
    main()
'''

_TEST: Final = '''\
"""Tests of NAME. The time in them is virtual, so they take no time."""

from turtleact import testing

from NAME.NODE import Countdown, countdown


def test_the_countdown_ends_with_lift_off():
    feedback, outcome = testing.run(testing.run_goal, countdown, Countdown.Goal(start=3))
    assert [each.step.remaining for each in feedback] == [2, 1, 0]
    assert outcome.status.name == "SUCCEEDED"
    assert outcome.result.message == "Lift-off!"
'''

_SETUP_PY: Final = """\
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
    maintainer={maintainer},
    maintainer_email={email},
    description={description},
    license={licence},
    entry_points={{
        "console_scripts": [
            "{node} = {name}.{node}:main",
        ],
    }},
)
"""

_SETUP_CFG: Final = """\
[develop]
script_dir=$base/lib/{name}
[install]
install_scripts=$base/lib/{name}
"""

_PACKAGE_XML: Final = """\
<?xml version="1.0"?>
<package format="3">
  <name>{name}</name>
  <version>0.0.0</version>
  <description>{description}</description>
  <maintainer email={email}>{maintainer}</maintainer>
  <license>{licence}</license>

{depends}
  <export>
    <build_type>{build_type}</build_type>
  </export>
</package>
"""

_GENERATORS: Final = (
    "<buildtool_depend>ament_cmake</buildtool_depend>",
    "<buildtool_depend>rosidl_default_generators</buildtool_depend>",
    "<depend>action_msgs</depend>",
)
_GENERATED: Final = (
    "<exec_depend>rosidl_default_runtime</exec_depend>",
    "<member_of_group>rosidl_interface_packages</member_of_group>",
)

_CMAKE: Final = """\
cmake_minimum_required(VERSION 3.8)
project({name})

find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{found}
rosidl_generate_interfaces(${{PROJECT_NAME}}
  "action/Countdown.action"
  "msg/Step.msg"
{uses})

ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""
