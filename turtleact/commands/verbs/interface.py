"""``interface``, as Typer sees it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from turtleact.commands.verbs import completing
from turtleact.commands.verbs.arguments import Interfaces, Job, Verb, new_group, only_one

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts

__all__ = ["app"]

_Type = Annotated[
    str,
    typer.Argument(
        metavar="TYPE",
        help="The interface, such as std_msgs/msg/String.",
        autocompletion=completing.interfaces,
    ),
]
_ShownType = Annotated[
    str,
    typer.Argument(
        metavar="TYPE",
        help="The interface, such as std_msgs/msg/String; - reads it from stdin.",
        autocompletion=completing.interfaces,
    ),
]
_Package = Annotated[
    str,
    typer.Argument(
        metavar="PACKAGE",
        help="The package, such as geometry_msgs.",
        autocompletion=completing.packages,
    ),
]
_Messages = Annotated[bool, typer.Option("--only-msgs", "-m", help="Messages only.")]
_Services = Annotated[bool, typer.Option("--only-srvs", "-s", help="Services only.")]
_Actions = Annotated[bool, typer.Option("--only-actions", "-a", help="Actions only.")]
_AllComments = Annotated[
    bool, typer.Option("--all-comments", help="Also the comments of the messages in it.")
]
_NoComments = Annotated[
    bool, typer.Option("--no-comments", help="Neither comments nor empty lines.")
]
_NoQuotes = Annotated[bool, typer.Option("--no-quotes", help="No quotes around it.")]

app = new_group("interface")


@app.command("list", cls=Verb, help="List the interfaces that there are.")
def list_(
    *,
    msgs: _Messages = False,
    srvs: _Services = False,
    actions: _Actions = False,
    interfaces: Interfaces = None,
) -> Job:
    """``interface list``."""

    def job(_: Interrupts) -> int:
        from turtleact.commands.interfaces import make_known, print_list

        make_known(interfaces)
        print_list(_kinds(msgs=msgs, srvs=srvs, actions=actions))
        return 0

    return job


@app.command("package", cls=Verb, help="List the interfaces of a package.")
def package(
    name: _Package,
    *,
    msgs: _Messages = False,
    srvs: _Services = False,
    actions: _Actions = False,
    interfaces: Interfaces = None,
) -> Job:
    """``interface package``."""

    def job(_: Interrupts) -> int:
        from turtleact.commands.interfaces import make_known, print_package

        make_known(interfaces)
        print_package(name, _kinds(msgs=msgs, srvs=srvs, actions=actions))
        return 0

    return job


@app.command("packages", cls=Verb, help="List the packages that have interfaces.")
def packages(
    *,
    msgs: _Messages = False,
    srvs: _Services = False,
    actions: _Actions = False,
    interfaces: Interfaces = None,
) -> Job:
    """``interface packages``."""

    def job(_: Interrupts) -> int:
        from turtleact.commands.interfaces import make_known, print_packages

        make_known(interfaces)
        print_packages(_kinds(msgs=msgs, srvs=srvs, actions=actions))
        return 0

    return job


@app.command("proto", cls=Verb, help="Print a message to begin with, as YAML.")
def proto(type_name: _Type, *, no_quotes: _NoQuotes = False, interfaces: Interfaces = None) -> Job:
    """``interface proto``."""

    def job(_: Interrupts) -> int:
        from turtleact.commands.interfaces import make_known, print_prototype

        make_known(interfaces)
        print_prototype(type_name, quotes=not no_quotes)
        return 0

    return job


@app.command("show", cls=Verb, help="Print the definition of an interface.")
def show(
    type_name: _ShownType,
    *,
    all_comments: _AllComments = False,
    no_comments: _NoComments = False,
    interfaces: Interfaces = None,
) -> Job:
    """``interface show``."""
    only_one("what to do with comments", all_comments=all_comments, no_comments=no_comments)

    def job(interrupts: Interrupts) -> int:
        from turtleact.commands import interfaces as verbs

        verbs.make_known(interfaces)
        name = verbs.read_type(type_name, interrupts)
        verbs.show(name, comments=not no_comments, nested_comments=all_comments)
        return 0

    return job


def _kinds(*, msgs: bool, srvs: bool, actions: bool) -> list[str]:
    given = {"msg": msgs, "srv": srvs, "action": actions}
    return [kind for kind, is_wanted in given.items() if is_wanted]
