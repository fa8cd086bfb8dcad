"""``service``, as Typer sees it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from turtleact.commands.verbs import completing
from turtleact.commands.verbs.arguments import message_of, number, only_one, type_and_text, type_of
from turtleact.commands.verbs.looking import Look, Plan, on_graph, planned_on_known_graph
from turtleact.commands.verbs.reading import Verb, new_group

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts

__all__ = ["app"]

_Name = Annotated[
    str,
    typer.Argument(
        metavar="NAME", help="The service, such as /spawn.", autocompletion=completing.services
    ),
]
_Type = Annotated[str, type_of("service")]
_CalledType = Annotated[str | None, type_of("service", is_asked=True)]
_Values = Annotated[str | None, message_of("request")]
_Stdin = Annotated[bool, typer.Option("--stdin", help="Read the request from stdin.")]
_Rate = Annotated[
    str | None,
    typer.Option("--rate", "-r", metavar="HZ", help="Call again, so many times a second."),
]
_ShowTypes = Annotated[bool, typer.Option("--show-types", "-t", help="Show the types, too.")]
_Count = Annotated[
    bool, typer.Option("--count-services", "-c", help="Only print how many there are.")
]
_Hidden = Annotated[bool, typer.Option("--include-hidden-services", help="Hidden services, too.")]

app = new_group("service")


@app.command("list", cls=Verb, help="List the services that there are.")
@on_graph
def list_(*, types: _ShowTypes = False, count: _Count = False, hidden: _Hidden = False) -> Look:
    """``service list``."""
    from turtleact.commands import listing

    return lambda node: listing.print_list(node, "service", types=types, count=count, hidden=hidden)


@app.command("info", cls=Verb, help="Print the type of a service, and how many use it.")
@on_graph
def info(name: _Name) -> Look:
    """``service info``."""
    from turtleact.commands import listing

    return lambda node: listing.print_service_info(node, name)


@app.command("type", cls=Verb, help="Print the type of a service.")
@on_graph
def type_(name: _Name) -> Look:
    """``service type``."""
    from turtleact.commands import listing

    return lambda node: listing.print_type(node, "service", name)


@app.command("find", cls=Verb, help="List the services of a type.")
@on_graph
def find(type_name: _Type, *, count: _Count = False, hidden: _Hidden = False) -> Look:
    """``service find``."""
    from turtleact.commands import listing

    return lambda node: listing.print_found(node, "service", type_name, count=count, hidden=hidden)


@app.command("call", cls=Verb, help="Call a service, and print its response.")
@planned_on_known_graph
def call(
    name: _Name,
    type_name: _CalledType = None,
    values: _Values = None,
    *,
    stdin: _Stdin = False,
    rate: _Rate = None,
) -> Plan:
    """``service call``."""
    type_name, values = type_and_text(type_name, values, "request")
    only_one("the request", VALUES=values is not None, stdin=stdin)
    hertz = (
        None if rate is None else number("--rate", rate, unit="calls a second", is_positive=True)
    )

    def plan(interrupts: Interrupts) -> Look:
        from turtleact.commands import user_messages
        from turtleact.commands.message_text import GoalText

        text = GoalText.read(values, stdin=stdin, path=None, interrupts=interrupts, what="request")
        return lambda node: user_messages.call(node, name, type_name, text, rate=hertz)

    return plan
