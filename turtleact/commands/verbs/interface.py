"""Declares the group ``interface`` for Typer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from turtleact.commands import completion
from turtleact.commands.verbs import Job, Verb, new_group
from turtleact.commands.verbs.options import Interfaces, folder, only_one

__all__ = ["app"]

Type: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="TYPE",
        help="The interface, such as std_msgs/msg/String.",
        autocompletion=completion.interfaces,
    ),
]
ShownType: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="TYPE",
        help="The interface, such as std_msgs/msg/String. A dash (-) reads it from stdin.",
        autocompletion=completion.interfaces,
    ),
]
Package: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="PACKAGE",
        help="The package, such as geometry_msgs.",
        autocompletion=completion.packages,
    ),
]
Messages: TypeAlias = Annotated[bool, typer.Option("--only-msgs", "-m", help="Messages only.")]
Services: TypeAlias = Annotated[bool, typer.Option("--only-srvs", "-s", help="Services only.")]
Actions: TypeAlias = Annotated[bool, typer.Option("--only-actions", "-a", help="Actions only.")]
AllComments: TypeAlias = Annotated[
    bool, typer.Option("--all-comments", help="Print the comments of nested messages too.")
]
NoComments: TypeAlias = Annotated[
    bool, typer.Option("--no-comments", help="Leave out comments and empty lines.")
]
NoQuotes: TypeAlias = Annotated[
    bool, typer.Option("--no-quotes", help="Print the message without quotes.")
]
Packages: TypeAlias = Annotated[
    list[str],
    typer.Argument(
        metavar="PACKAGE",
        help="The packages, such as nav2_msgs.",
        autocompletion=completion.packages,
    ),
]
Folder: TypeAlias = Annotated[
    Path,
    typer.Option("--output", "-o", metavar="DIR", help="Write DIR/PACKAGE/KIND.py."),
]
Check: TypeAlias = Annotated[
    bool, typer.Option("--check", help="Write nothing; exit with 1 if a file would change.")
]

app = new_group("interface")


@app.command("list", cls=Verb)
def list_(
    *,
    msgs: Messages = False,
    srvs: Services = False,
    actions: Actions = False,
    interfaces: Interfaces = None,
) -> Job:
    """List all interfaces."""
    from turtleact.commands.interfaces import print_list

    kinds = _kinds(msgs=msgs, srvs=srvs, actions=actions)
    return _when_known(interfaces, lambda: print_list(kinds))


@app.command(cls=Verb)
def package(
    name: Package,
    *,
    msgs: Messages = False,
    srvs: Services = False,
    actions: Actions = False,
    interfaces: Interfaces = None,
) -> Job:
    """List the interfaces of a package."""
    from turtleact.commands.interfaces import print_package

    kinds = _kinds(msgs=msgs, srvs=srvs, actions=actions)
    return _when_known(interfaces, lambda: print_package(name, kinds))


@app.command(cls=Verb)
def packages(
    *,
    msgs: Messages = False,
    srvs: Services = False,
    actions: Actions = False,
    interfaces: Interfaces = None,
) -> Job:
    """List the packages that have interfaces."""
    from turtleact.commands.interfaces import print_packages

    kinds = _kinds(msgs=msgs, srvs=srvs, actions=actions)
    return _when_known(interfaces, lambda: print_packages(kinds))


@app.command(cls=Verb)
def proto(type_name: Type, *, no_quotes: NoQuotes = False, interfaces: Interfaces = None) -> Job:
    """Print a message with its default values, as YAML."""
    from turtleact.commands.interfaces import print_prototype

    return _when_known(interfaces, lambda: print_prototype(type_name, quotes=not no_quotes))


@app.command("python", cls=Verb)
def python_(
    names: Packages, *, output: Folder, check: Check = False, interfaces: Interfaces = None
) -> Job:
    """Write the interfaces of packages as typed Python classes."""

    def job() -> int:
        from turtleact.commands.interfaces import make_known, write_python

        make_known(folder(interfaces))
        return write_python(names, output, is_check=check)

    return job


@app.command(cls=Verb)
def show(
    type_name: ShownType,
    *,
    all_comments: AllComments = False,
    no_comments: NoComments = False,
    interfaces: Interfaces = None,
) -> Job:
    """Print the definition of an interface."""
    only_one("what to do with comments", all_comments=all_comments, no_comments=no_comments)

    def act() -> None:
        from turtleact.commands import interfaces

        name = interfaces.read_type(type_name)
        interfaces.show(name, comments=not no_comments, nested_comments=all_comments)

    return _when_known(interfaces, act)


def _kinds(*, msgs: bool, srvs: bool, actions: bool) -> list[str]:
    given = {"msg": msgs, "srv": srvs, "action": actions}
    return [kind for kind, is_wanted in given.items() if is_wanted]


def _when_known(interfaces: Path | None, act: Callable[[], None]) -> Job:
    """Make a job that loads the interfaces, then calls ``act``."""

    def job() -> int:
        from turtleact.commands.interfaces import make_known

        make_known(folder(interfaces))
        act()
        return 0

    return job
