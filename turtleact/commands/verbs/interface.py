"""``interface``, as Typer sees it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, TypeAlias

import typer

from turtleact.commands.interrupts import Interrupts
from turtleact.commands.verbs import completing
from turtleact.commands.verbs.arguments import Interfaces, Job, only_one
from turtleact.commands.verbs.grouping import grouped, then
from turtleact.commands.verbs.reading import Verb, new_group

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

Act: TypeAlias = Callable[[Interrupts], None]
"""Prints what the verb is for."""

app = new_group("interface")


def _kinds(
    *, msgs: _Messages = False, srvs: _Services = False, actions: _Actions = False
) -> list[str]:
    given = {"msg": msgs, "srv": srvs, "action": actions}
    return [kind for kind, is_wanted in given.items() if is_wanted]


def _known(*, interfaces: Interfaces = None) -> Callable[[Act], Job]:
    """What makes a job of what is printed once the interfaces are known."""

    def job_of(act: Act) -> Job:
        def job(interrupts: Interrupts) -> int:
            from turtleact.commands.interfaces import make_known

            make_known(interfaces)
            act(interrupts)
            return 0

        return job

    return job_of


@app.command("list", cls=Verb, help="List the interfaces that there are.")
@then(_known)
@grouped(kinds=_kinds)
def list_(*, kinds: list[str]) -> Act:
    """``interface list``."""
    from turtleact.commands import interfaces

    return lambda _: interfaces.print_list(kinds)


@app.command("package", cls=Verb, help="List the interfaces of a package.")
@then(_known)
@grouped(kinds=_kinds)
def package(name: _Package, *, kinds: list[str]) -> Act:
    """``interface package``."""
    from turtleact.commands import interfaces

    return lambda _: interfaces.print_package(name, kinds)


@app.command("packages", cls=Verb, help="List the packages that have interfaces.")
@then(_known)
@grouped(kinds=_kinds)
def packages(*, kinds: list[str]) -> Act:
    """``interface packages``."""
    from turtleact.commands import interfaces

    return lambda _: interfaces.print_packages(kinds)


@app.command("proto", cls=Verb, help="Print a message to begin with, as YAML.")
@then(_known)
def proto(type_name: _Type, *, no_quotes: _NoQuotes = False) -> Act:
    """``interface proto``."""
    from turtleact.commands import interfaces

    return lambda _: interfaces.print_prototype(type_name, quotes=not no_quotes)


@app.command("show", cls=Verb, help="Print the definition of an interface.")
@then(_known)
def show(
    type_name: _ShownType, *, all_comments: _AllComments = False, no_comments: _NoComments = False
) -> Act:
    """``interface show``."""
    only_one("what to do with comments", all_comments=all_comments, no_comments=no_comments)

    def act(interrupts: Interrupts) -> None:
        from turtleact.commands import interfaces

        name = interfaces.read_type(type_name, interrupts)
        interfaces.show(name, comments=not no_comments, nested_comments=all_comments)

    return act
