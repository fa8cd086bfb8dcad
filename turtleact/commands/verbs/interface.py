"""The verbs of ``interface``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

from turtleact.commands import completion
from turtleact.commands.verbs import new_group, verb
from turtleact.commands.verbs.options import argument, flag, only_one, value

__all__ = ["app"]

Messages: TypeAlias = Annotated[bool, flag("--only-msgs", "-m", text="Messages only.")]
Services: TypeAlias = Annotated[bool, flag("--only-srvs", "-s", text="Services only.")]
Actions: TypeAlias = Annotated[bool, flag("--only-actions", "-a", text="Actions only.")]

app = new_group("interface")


@verb(app, "list", knows=True)
def list_(*, msgs: Messages = False, srvs: Services = False, actions: Actions = False) -> None:
    """List all interfaces."""
    from turtleact.commands.interfaces import print_list

    print_list(_kinds(msgs=msgs, srvs=srvs, actions=actions))


@verb(app, knows=True)
def package(
    name: Annotated[
        str, argument("PACKAGE", "The package, such as geometry_msgs.", completion.packages)
    ],
    *,
    msgs: Messages = False,
    srvs: Services = False,
    actions: Actions = False,
) -> None:
    """List the interfaces of a package."""
    from turtleact.commands.interfaces import print_package

    print_package(name, _kinds(msgs=msgs, srvs=srvs, actions=actions))


@verb(app, knows=True)
def packages(*, msgs: Messages = False, srvs: Services = False, actions: Actions = False) -> None:
    """List the packages that have interfaces."""
    from turtleact.commands.interfaces import print_packages

    print_packages(_kinds(msgs=msgs, srvs=srvs, actions=actions))


@verb(app, knows=True)
def proto(
    type_name: Annotated[
        str, argument("TYPE", "The interface, such as std_msgs/msg/String.", completion.interfaces)
    ],
    *,
    no_quotes: Annotated[
        bool, flag("--no-quotes", text="Print the message without quotes.")
    ] = False,
) -> None:
    """Print a message with its default values, as YAML."""
    from turtleact.commands.interfaces import print_prototype

    print_prototype(type_name, quotes=not no_quotes)


@verb(app, "python", knows=True)
def python_(
    names: Annotated[
        list[str], argument("PACKAGE", "The packages, such as nav2_msgs.", completion.packages)
    ],
    *,
    output: Annotated[
        Path, value("--output", "-o", metavar="DIR", text="Write DIR/PACKAGE/KIND.py.")
    ],
    check: Annotated[
        bool, flag("--check", text="Write nothing; exit with 1 if a file would change.")
    ] = False,
) -> int:
    """Write the interfaces of packages as typed Python classes."""
    from turtleact.commands.interfaces import write_python

    return write_python(names, output, is_check=check)


@verb(app, knows=True)
def show(
    type_name: Annotated[
        str,
        argument(
            "TYPE",
            "The interface, such as std_msgs/msg/String. A dash (-) reads it from stdin.",
            completion.interfaces,
        ),
    ],
    *,
    all_comments: Annotated[
        bool, flag("--all-comments", text="Print the comments of nested messages too.")
    ] = False,
    no_comments: Annotated[
        bool, flag("--no-comments", text="Leave out comments and empty lines.")
    ] = False,
) -> None:
    """Print the definition of an interface."""
    only_one("what to do with comments", all_comments=all_comments, no_comments=no_comments)
    from turtleact.commands import interfaces

    name = interfaces.read_type(type_name)
    interfaces.show(name, comments=not no_comments, nested_comments=all_comments)


def _kinds(*, msgs: bool, srvs: bool, actions: bool) -> list[str]:
    given = {"msg": msgs, "srv": srvs, "action": actions}
    return [kind for kind, is_wanted in given.items() if is_wanted]
