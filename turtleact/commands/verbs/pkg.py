"""The verbs of ``pkg``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from turtleact.commands import completion
from turtleact.commands.verbs import Verb, new_group, verb
from turtleact.commands.verbs.options import argument, value
from turtleact.errors import TurtleactError

__all__ = ["app", "spread"]

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
    from turtleact.commands import new_package

    given = {
        "node_name": node_name,
        "description": description,
        "licence": license_,
        "maintainer": maintainer_name,
        "email": maintainer_email,
    }
    package = new_package.NewPackage(
        name,
        destination_directory,
        build_type,
        dependencies=tuple(dependencies or ()),
        **{key: each for key, each in given.items() if each is not None},
    )
    new_package.check(package, has_node_name=node_name is not None)
    new_package.create(package)


@verb(app, "list")
def list_() -> None:
    """List all packages: in the working directory, in a sourced workspace, and built in."""
    from turtleact.commands.output import say_names
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
    from turtleact.commands.output import say_names
    from turtleact.commands.packages import runnable_here
    from turtleact.interfaces.definition import did_you_mean

    known = runnable_here()
    if package is not None and package not in known:
        raise TurtleactError(f"unknown package '{package}'{did_you_mean(package, known)}")
    names = sorted(known) if package is None else [package]
    say_names("".join(f"{name} {each}\n" for name in names for each in known[name]))
