"""Declares the group ``pkg`` for Typer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from turtleact.commands import completion
from turtleact.commands.verbs import Job, Verb, new_group
from turtleact.errors import TurtleactError

__all__ = ["app", "spread"]

NewName: TypeAlias = Annotated[
    str, typer.Argument(metavar="NAME", help="The name of the package.", show_default=False)
]
Dependencies: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--dependencies", metavar="PACKAGE...", help="Packages that it needs, separated by spaces."
    ),
]
BuildType: TypeAlias = Annotated[
    str,
    typer.Option(
        metavar="TYPE",
        help="ament_python, or ament_cmake for a package with interfaces only.",
        autocompletion=completion.words("ament_python", "ament_cmake"),
    ),
]
Destination: TypeAlias = Annotated[
    Path,
    typer.Option(
        "--destination-directory", metavar="DIR", help="Where the folder of the package is made."
    ),
]
Licence: TypeAlias = Annotated[
    str | None, typer.Option("--license", metavar="NAME", help="Its licence, such as Apache-2.0.")
]
Description: TypeAlias = Annotated[
    str | None, typer.Option("--description", metavar="TEXT", help="What it is for.")
]
NodeName: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--node-name", metavar="NAME", help="The name of its program. If left out, server."
    ),
]
Maintainer: TypeAlias = Annotated[
    str | None,
    typer.Option("--maintainer-name", metavar="NAME", help="Who maintains it. If left out, you."),
]
Email: TypeAlias = Annotated[
    str | None,
    typer.Option("--maintainer-email", metavar="ADDRESS", help="The address of the maintainer."),
]
Package: TypeAlias = Annotated[
    str | None,
    typer.Argument(
        metavar="PACKAGE",
        help="The package. If left out, all packages.",
        autocompletion=completion.runnable_packages,
        show_default=False,
    ),
]

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


@app.command("create", cls=Create, epilog=_EXAMPLES)
def create(
    name: NewName,
    *,
    dependencies: Dependencies = None,
    build_type: BuildType = "ament_python",
    destination_directory: Destination = Path(),
    license_: Licence = None,
    description: Description = None,
    node_name: NodeName = None,
    maintainer_name: Maintainer = None,
    maintainer_email: Email = None,
) -> Job:
    """Create a package with an action, a server and a test. The package needs no build."""
    from turtleact.commands.new_package import NewPackage, check
    from turtleact.commands.new_package import create as write

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
        **{key: value for key, value in given.items() if value is not None},
    )
    check(package, has_node_name=node_name is not None)

    def job() -> int:
        write(package)
        return 0

    return job


@app.command("list", cls=Verb)
def list_() -> Job:
    """List all packages: in the working directory, in a sourced workspace, and built in."""

    def job() -> int:
        from turtleact.commands.output import say_names
        from turtleact.commands.packages import runnable_here

        say_names("".join(f"{name}\n" for name in sorted(runnable_here())))
        return 0

    return job


@app.command("executables", cls=Verb)
def executables(package: Package = None) -> Job:
    """List the executables of packages, one package and executable per line."""

    def job() -> int:
        from turtleact.commands.output import say_names
        from turtleact.commands.packages import runnable_here
        from turtleact.interfaces.definition import did_you_mean

        known = runnable_here()
        if package is not None and package not in known:
            raise TurtleactError(f"unknown package '{package}'{did_you_mean(package, known)}")
        names = sorted(known) if package is None else [package]
        say_names("".join(f"{name} {each}\n" for name in names for each in known[name]))
        return 0

    return job
