"""Opens the graph that a verb uses, prints what is on it, and explains what is missing.

A verb is a coroutine function that takes a `Node` and returns the exit status. The node is hidden,
and has no endpoints until the verb opens some.

A command may find no router, an empty domain, or an action that nobody serves. To the command, a
server that is off looks the same as a server in another domain. Error messages therefore name the
actions or domains that are in reach.

``list``, ``type``, ``find`` and ``info`` print what exists, as ``ros2`` does. The same functions
list actions, services and topics; `Kind` says which. A name is hidden if a part between its slashes
begins with an underscore. Hidden names are listed only on request. If you name a hidden action,
service or topic, it is always found.

Source: ros2cli ``ros2{action,node,service,topic}/verb/*.py`` for the order of the output;
recordings of Jazzy for the words.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator, Mapping
from contextlib import AsyncExitStack, aclosing, asynccontextmanager
from typing import TYPE_CHECKING, TypeAlias, TypeVar

from turtleact.commands.access_config import mode_of
from turtleact.commands.interrupts import Interrupts
from turtleact.commands.output import ELSEWHERE, note, say_lines, say_names
from turtleact.errors import (
    InvalidInterface,
    ServerUnavailable,
    TurtleactError,
    UnknownInterface,
    UsageError,
)
from turtleact.interfaces import get_interface, type_hash
from turtleact.interfaces.definition import did_you_mean, names_like
from turtleact.names import action_names, resolve_name
from turtleact.node import Node, open_node
from turtleact.transports.graph import Kind, is_hidden_node, types_by_name

if TYPE_CHECKING:
    from contextlib import AbstractAsyncContextManager

    from turtleact.commands.settings import ConnectOptions
    from turtleact.interfaces import Action, Message, Service
    from turtleact.interfaces.types import Interface
    from turtleact.transports import Transport
    from turtleact.transports.base import Endpoint, EndpointKind
    from turtleact.transports.rmw_zenoh.config import Mode

__all__ = [
    "Look",
    "chosen_class",
    "embedded_world",
    "enter_graph",
    "interface_class",
    "no_router",
    "none_in_domain",
    "not_served",
    "note_differing",
    "note_empty",
    "note_pause",
    "open_graph",
    "open_or_embed",
    "open_transport",
    "print_action_info",
    "print_list",
    "print_node_info",
    "print_nodes",
    "print_service_info",
    "print_topic_info",
    "print_topics_in_full",
    "print_type",
    "run",
    "suggest",
    "use",
]

I = TypeVar("I", bound="Message | Service | Action")  # noqa: E741  # an interface

T = TypeVar("T")

Look: TypeAlias = Callable[[Node], Awaitable[int]]
"""A verb: a function that looks at the graph and returns the exit status."""

Enter: TypeAlias = "Callable[[AsyncExitStack, ConnectOptions], Awaitable[Node | None]]"

ROUTER = "tcp/localhost:7447"
"""The endpoint of the router to which commands connect without ``--connect``."""

HIDDEN = "_turtleact_cli_{}"
"""The name of the node of most verbs, with the number of the process in place of the braces."""

WORLD_STATE = "/world/get_simulation_state"
RESUMES = """'turtleact service call /world/set_simulation_state "state: {state: 1}"'"""

PATIENCE = 5.0
"""How long to wait for the world's answer (s, by the clock of the graph)."""


@asynccontextmanager
async def open_transport(
    reach: ConnectOptions, mode: Mode | None = None
) -> AsyncIterator[Transport]:
    """Open a transport to the graph of other processes.

    When the block begins, the transport knows the nodes and endpoints on the graph.

    Args:
        reach: The graph to open.
        mode: Whether to join the graph as a peer or as a client. By default, `mode_of` decides.

    Raises:
        TurtleactError: if no graph can be reached.
    """
    from turtleact.transports import open_zenoh

    access = reach.access()
    mode, config = mode or mode_of(reach.connect, access), access.settings()
    opened = open_zenoh(reach.connect or None, mode=mode, domain=reach.domain, config=config)
    async with AsyncExitStack() as stack:
        transport = await stack.enter_async_context(opened)
        await transport.explore()
        yield transport


@asynccontextmanager
async def open_graph(
    reach: ConnectOptions, mode: Mode | None = None, name: str = HIDDEN
) -> AsyncIterator[Node]:
    """Open a node on a graph, by default a hidden one. The errors are those of `open_transport`.

    In the name of the node, ``{}`` becomes the number of this process.
    """
    async with (
        open_transport(reach, mode) as transport,
        open_node(name.format(os.getpid()), transport=transport) as node,
    ):
        node.learner.is_on = reach.learns
        node.learner.note = note
        yield node


async def enter_graph(
    stack: AsyncExitStack, reach: ConnectOptions, name: str = HIDDEN
) -> Node | None:
    """Open a node on a graph. Return None if no graph is in reach and ``--connect`` was not given.

    Args:
        stack: The stack that closes the node.
        reach: The graph.
        name: The name of the node, as for `open_graph`.

    Raises:
        UsageError: if the ``--config`` file cannot be read, or has an invalid value.
        TurtleactError: if the graph that ``--connect`` names is not in reach.
    """
    try:
        return await stack.enter_async_context(open_graph(reach, name=name))
    except UsageError:
        raise
    except TurtleactError:
        if reach.connect:
            raise
        return None


@asynccontextmanager
async def embedded_world(speed: float | str = 1.0, seed: int = 0) -> AsyncIterator[Node]:
    """Open a world in this process. Only this function imports modules that load slowly."""
    from turtleact.sim.world_node import open_world

    async with open_world(speed=speed, seed=seed) as node:
        yield node


@asynccontextmanager
async def open_or_embed(
    reach: ConnectOptions | None,
    what: str,
    is_enough: Callable[[Node], Awaitable[bool]],
    world: Callable[[str], AbstractAsyncContextManager[Node]],
    enter: Enter = enter_graph,
) -> AsyncIterator[Node]:
    """Open a node on a graph or, if the graph lacks what the user needs, in an embedded world.

    A graph that ``--connect`` names is used in any case, because the user means no other.

    Args:
        reach: The graph; None to use only an embedded world.
        what: What the user needs, such as ``"turtles"``.
        is_enough: Returns whether a node sees what the user needs.
        world: Opens the embedded world. It is told why the graph is of no use, and raises an error
            if a world is no substitute.
        enter: Opens a node on the graph, or returns None if there is no graph.
    """
    why = ""
    async with AsyncExitStack() as stack:
        if reach is not None:
            there = await enter(stack, reach)
            why = no_router(reach)
            if there is not None:
                if reach.connect or await is_enough(there):
                    yield there
                    return
                why = await none_in_domain(there.transport, reach, what)
                # The world has a transport and a clock of its own, so nothing of this graph stays.
                await stack.aclose()
        node = await stack.enter_async_context(world(why))
        reason = f", because {why}" if why else ""
        note(f"started an embedded world, which ends with this command{reason}")
        yield node


def run(reach: ConnectOptions, look: Look, interrupts: Interrupts | None = None) -> int:
    """Run a verb on a graph until it ends or a signal cancels it, and return the exit status.

    Most verbs print nothing if the domain has no nodes, so a note is printed first in that case.

    Raises:
        TurtleactError: if no graph can be reached. The verb's exceptions are also raised.
    """

    async def tell_and_look(node: Node) -> int:
        await note_empty(node.transport, reach)
        return await look(node)

    return (interrupts or Interrupts()).run(use(open_graph(reach), tell_and_look))


async def use(opened: AbstractAsyncContextManager[T], act: Callable[[T], Awaitable[int]]) -> int:
    """Enter a context manager, and return what ``act`` returns for the result."""
    async with opened as it:
        return await act(it)


def interface_class(base: type[I], type_name: str, where: str = "") -> type[I]:
    """Return the class of a message, service or action that the user or the graph names.

    Args:
        base: The expected kind of interface: `Message`, `Service` or `Action`.
        type_name: The name of the interface.
        where: The topic, service or action that has this type on the graph, for the error message.
            If the user typed the type, ``where`` is empty.

    Raises:
        UnknownInterface: if the user typed an unknown name.
        TurtleactError: if the graph has the type, but this process does not know it. The error says
            how to make the type known.
        InvalidInterface: if the interface is not of the expected kind.
    """
    try:
        found = get_interface(type_name)
    except UnknownInterface:
        if not where:
            raise
        problem = f"{where}: its type {type_name} is not known here: {ELSEWHERE}"
        raise TurtleactError(problem) from None
    return _of_kind(base, found)


def _of_kind(base: type[I], found: Interface) -> type[I]:
    if not issubclass(found, base):
        kind = base.__name__.lower()
        problem = f"it is not the type of {'an' if kind == 'action' else 'a'} {kind}"
        raise InvalidInterface(problem, source=found.type_name)
    return found


async def chosen_class(
    node: Node,
    kind: Kind,
    base: type[I],
    name: str,
    type_name: str | None,
    timeout: float | None = None,
) -> type[I]:
    """Return the class of the interface type that the user typed, or that the graph uses.

    A type that is not known here, or that the graph defines in another way, is learned from the
    nodes that use it.

    Args:
        node: A node on the graph.
        kind: Whether ``name`` belongs to an action, a service or a topic.
        base: The expected kind of interface: `Message`, `Service` or `Action`.
        name: The full name of the action, service or topic.
        type_name: The type that the user typed; None for the first type that ``name`` has on the
            graph.
        timeout: How long to ask again nodes that do not answer (s); None to ask them once.

    Raises:
        TurtleactError: if the user typed no type and the name is not on the graph. The error
            suggests similar names. Other errors are those of `interface_class` and
            `turtleact.learn_interface`.
    """
    found = types_by_name(node.transport.endpoints(), kind, hidden=True)
    where = "" if type_name else f"{kind} '{name}'"
    if type_name is None:
        if name not in found:
            hint = names_like(name, [each for each in found if "/_" not in each])
            raise TurtleactError(f"{where} is not there{hint}; give its type to go ahead")
        type_name = found[name][0]
    if not node.learner.is_on:
        return interface_class(base, type_name, where)
    learned = await node.learner.learn_used(name, kind, type_name, timeout)
    return interface_class(base, type_name, where) if learned is None else _of_kind(base, learned)


def note_differing(node: Node, endpoints: Iterable[Endpoint], known: Mapping[str, str]) -> None:
    """Print a note on nodes that cannot communicate because they define a type differently.

    Args:
        node: The node of this command. The node's own endpoints are not compared.
        endpoints: The endpoints to compare.
        known: The type hashes that this process has, by type name. Each type of the endpoints is
            also compared with the definition in this process.
    """
    from turtleact.doctor.checks import EndpointSeen, Snapshot, differing_definitions

    own = node.fully_qualified_name
    seen = tuple(EndpointSeen(each) for each in endpoints if each.node != own)
    for fault in differing_definitions(Snapshot(endpoints=seen, known=known)):
        note(f"{fault.problem}; {fault.advice}")


async def note_pause(node: Node) -> None:
    """Tell the user if the world is paused: its clock then stands still, and goals wait."""
    from turtleact.interfaces.standard.simulation_interfaces.msg import SimulationState
    from turtleact.interfaces.standard.simulation_interfaces.srv import GetSimulationState

    if WORLD_STATE not in {each.name for each in node.transport.endpoints()}:
        return
    async with aclosing(node.service_client(GetSimulationState, WORLD_STATE)) as client:
        try:
            response = await client.call(GetSimulationState.Request(), PATIENCE)
        except TurtleactError:
            return  # the world is silent or gone; the user's own server tells what matters
    if response.state.state in (SimulationState.STATE_PAUSED, SimulationState.STATE_STOPPED):
        note(f"the world is paused; {RESUMES} resumes it")


def suggest(node: Node, kind: EndpointKind, name: str, type_name: str) -> None:
    """Suggest a similar name on the graph, because the user may have mistyped ``name``."""
    endpoints = node.transport.endpoints()
    known = {each.name for each in endpoints if (each.kind, each.type_name) == (kind, type_name)}
    if hint := did_you_mean(name, known):
        note(f"nobody has '{name}' yet{hint}")


def no_router(reach: ConnectOptions) -> str:
    """Return the error message for the case that no router answers at `ROUTER`."""
    rest = "answers" if reach.config is None else "answers, or lets in this --config,"
    return f"no router {rest} at {ROUTER} ('turtleact serve' starts one)"


async def note_empty(transport: Transport, reach: ConnectOptions) -> None:
    """Print a note if a domain has no nodes, because most verbs then print nothing."""
    from turtleact.transports import ZenohTransport  # an embedded world does without Zenoh

    if isinstance(transport, ZenohTransport) and all(map(is_hidden_node, transport.nodes())):
        note(await none_in_domain(transport, reach))


async def none_in_domain(transport: Transport, reach: ConnectOptions, what: str = "nodes") -> str:
    """Return a message such as "domain 5 has no nodes" that also names other domains with nodes.

    Args:
        transport: The transport to the graph.
        reach: The graph's settings, including its domain.
        what: What the domain lacks, such as ``"nodes"``.
    """
    from turtleact.transports import ZenohTransport

    lack = f"domain {reach.domain} has no {what}"
    known = await transport.domains() if isinstance(transport, ZenohTransport) else ()
    others = [str(each) for each in known if each != reach.domain]
    if not others:
        return f"{lack}; is your server running?"
    there = f"domain {others[0]} has" if len(others) == 1 else f"domains {', '.join(others)} have"
    return f"{lack} ({there} nodes: try --domain {others[0]})"


def not_served(
    name: str,
    served: Iterable[str],
    problem: str = "nobody serves it",
    hint: str = "is your server running?",
) -> ServerUnavailable:
    """Return the error for an action that nobody serves. The error suggests other actions.

    Args:
        name: The full name of the action.
        served: The names of the actions that are served.
        problem: What is wrong, without those names.
        hint: What to check next.
    """
    return ServerUnavailable(name, f"{problem}{names_like(name, served)}", hint=hint)


def is_served(node: Node, name: str, type_name: str) -> bool:
    """Whether a node on the graph serves the action of this full name with this type now."""
    return type_name in types_by_name(node.transport.endpoints(), "action", hidden=True).get(
        name, ()
    )


# what exists

SIDES: dict[str, EndpointKind] = {"Publish": "publisher", "Subscrib": "subscription"}


# all kinds


def print_list(
    node: Node,
    kind: Kind,
    *,
    type_name: str | None = None,
    types: bool = False,
    count: bool,
    hidden: bool,
) -> None:
    """Print the names of all actions, services or topics, or only how many there are.

    Args:
        node: A node on the graph.
        kind: What to list.
        type_name: The type of what to list; None for all.
        types: Whether to print the types too.
        count: Whether to print only how many there are.
        hidden: Whether to include hidden names.
    """
    found = types_by_name(node.transport.endpoints(), kind, hidden=hidden)
    names = [name for name, own in found.items() if type_name is None or type_name in own]
    lines = (_with_types(name, found[name] if types else ()) for name in names)
    say_lines([str(len(names))] if count else lines)


def print_type(node: Node, kind: Kind, name: str) -> int:
    """Print the types of an action, service or topic.

    If the name is not on the graph, print nothing and return the exit status 1.
    """
    types = types_by_name(node.transport.endpoints(), kind, hidden=True).get(name, ())
    say_lines(types)
    return int(not types)


# actions


def print_action_info(node: Node, name: str, *, types: bool, count: bool) -> None:
    """Print the nodes that are clients of an action, and the nodes that serve it.

    Raises:
        InvalidName: if the name breaks ROS 2's rules.
    """
    full_name = resolve_name(name)
    say_names(f"Action: {name}\n")
    sides: dict[str, EndpointKind] = {"clients": "client", "servers": "service"}
    for side, kind in sides.items():
        nodes = list(_nodes_of_action(node, full_name, kind))
        say_names(f"Action {side}: {len(nodes)}\n")
        if not count:
            say_lines(f"    {_with_types(who, known if types else ())}" for who, known in nodes)
    served = types_by_name(node.transport.endpoints(), "action", "service", hidden=True)
    if full_name not in served and (hint := did_you_mean(full_name, served)):
        note(f"nobody serves '{full_name}'{hint}")


def _nodes_of_action(
    node: Node, name: str, kind: EndpointKind
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the names of an action's client nodes or server nodes, each with the action's types.

    If several nodes share a name, the name is yielded several times.
    """
    service = action_names(name).send_goal
    for who in sorted(set(node.transport.nodes())):
        own = _endpoints_of(node, who)
        types = types_by_name(own, "action", kind, hidden=True).get(name, ())
        ends = Counter(e.type_name for e in own if e.kind == kind and e.name == service)
        yield from ((who, types) for _ in range(max(ends.values(), default=0)))


# services


def print_service_info(node: Node, name: str) -> None:
    """Print the type of a service, and how many clients and servers it has.

    Raises:
        TurtleactError: if there is no such service. The error suggests the nearest name.
    """
    endpoints = node.transport.endpoints()
    name = _full(name)
    types = _needed_types(endpoints, "service", name)
    counts = Counter(endpoint.kind for endpoint in endpoints if endpoint.name == name)
    say_names(f"Type: {_as_said(types)}\n")
    say_names(f"Clients count: {counts['client']}\nServices count: {counts['service']}\n")


# topics


def print_topics_in_full(node: Node, *, hidden: bool) -> None:
    """Print the topics that have publishers, and then the topics that have subscriptions.

    Each line says how many publishers or subscriptions the topic has.
    """
    endpoints = node.transport.endpoints()
    topics = types_by_name(endpoints, "topic", hidden=hidden)
    for word, kind in SIDES.items():
        counts = Counter(endpoint.name for endpoint in endpoints if endpoint.kind == kind)
        say_names(f"{word}ed topics:\n")
        for name, types in topics.items():
            if number := counts[name]:
                plural = "s" if number > 1 else ""
                say_names(f" * {_with_types(name, types)} {number} {word.lower()}er{plural}\n")
        say_names("\n")


def print_topic_info(node: Node, name: str, *, verbose: bool) -> None:
    """Print the type of a topic, and how many publishers and subscriptions it has.

    With ``verbose``, also describe each publisher and subscription in full.

    Raises:
        TurtleactError: if there is no such topic. The error suggests the nearest name.
    """
    endpoints = node.transport.endpoints()
    name = _full(name)
    types = _needed_types(endpoints, "topic", name)
    end = "\n\n" if verbose else "\n"
    say_names(f"Type: {_as_said(types)}{end}")
    for word, kind in {"Publisher": "publisher", "Subscription": "subscription"}.items():
        there = [each for each in endpoints if each.name == name and each.kind == kind]
        say_names(f"{word} count: {len(there)}{end}")
        if verbose:
            say_lines(f"{_in_full(endpoint)}\n" for endpoint in there)


def _in_full(endpoint: Endpoint) -> str:
    """Describe an endpoint in full, as ``ros2 topic info -v`` prints it."""
    namespace, _, name = endpoint.node.rpartition("/")
    gid = f"GID: {endpoint.gid.hex('.')}\n" if endpoint.gid else ""
    qos, times = endpoint.qos, endpoint.times
    return (
        f"Node name: {name}\n"
        f"Node namespace: {namespace or '/'}\n"
        f"Topic type: {endpoint.type_name}\n"
        f"Topic type hash: {endpoint.type_hash or _hash_of(endpoint.type_name)}\n"
        f"Endpoint type: {endpoint.kind.upper()}\n"
        f"{gid}"
        "QoS profile:\n"
        f"  Reliability: {qos.reliability.upper()}\n"
        f"  History (Depth): KEEP_LAST ({qos.depth})\n"
        f"  Durability: {qos.durability.upper()}\n"
        f"  Lifespan: {_duration(times.lifespan)}\n"
        f"  Deadline: {_duration(times.deadline)}\n"
        f"  Liveliness: {times.liveliness.upper()}\n"
        f"  Liveliness lease duration: {_duration(times.lease)}"
    )


def _duration(nanoseconds: int | None) -> str:
    """Return a duration as rclpy prints it."""
    return "Infinite" if nanoseconds is None else f"{nanoseconds} nanoseconds"


def _hash_of(type_name: str) -> str:
    try:
        return type_hash(get_interface(type_name))
    except UnknownInterface:
        return "INVALID"


# nodes


def print_nodes(node: Node, *, count: bool, hidden: bool) -> None:
    """Print the names of all nodes, or their number. If nodes share a name, also print a note."""
    names = sorted(name for name in node.transport.nodes() if hidden or not is_hidden_node(name))
    shared = [name for name, number in Counter(names).items() if number > 1]
    if shared:
        note(f"several nodes have the same name: {', '.join(shared)}")
    say_lines([str(len(names))] if count else names)


def print_node_info(node: Node, name: str, *, hidden: bool) -> None:
    """Print the topics, services and actions of a node, with their types.

    Raises:
        TurtleactError: if there is no such node. The error suggests the nearest name.
    """
    names = [each for each in node.transport.nodes() if hidden or not is_hidden_node(each)]
    name = _full(name)
    if name not in names:
        raise TurtleactError(f"there is no node '{name}'{names_like(name, names)}")
    if names.count(name) > 1:
        note(f"{names.count(name)} nodes have the name '{name}'; this list is for all of them")
    own = _endpoints_of(node, name)
    say_names(f"{name}\n")
    sections: tuple[tuple[str, Kind, EndpointKind], ...] = (
        ("Subscribers", "topic", "subscription"),
        ("Publishers", "topic", "publisher"),
        ("Service Servers", "service", "service"),
        ("Service Clients", "service", "client"),
        ("Action Servers", "action", "service"),
        ("Action Clients", "action", "client"),
    )
    for title, kind, end in sections:
        say_names(f"  {title}:\n")
        found = types_by_name(own, kind, end, hidden=hidden)
        say_lines([f"    {each}: {', '.join(types)}" for each, types in found.items()] or [""])
    names_here = {each.name for each in own}
    note_differing(node, [e for e in node.transport.endpoints() if e.name in names_here], {})


# what they share


def _full(name: str) -> str:
    """Return a name with a slash at its beginning."""
    return name if name.startswith("/") else f"/{name}"


def _endpoints_of(node: Node, name: str) -> list[Endpoint]:
    return [endpoint for endpoint in node.transport.endpoints() if endpoint.node == name]


def _needed_types(endpoints: Iterable[Endpoint], kind: Kind, name: str) -> tuple[str, ...]:
    found = types_by_name(endpoints, kind, hidden=True)
    if name not in found:
        visible = [each for each in found if "/_" not in each]
        raise TurtleactError(f"unknown {kind} '{name}'{names_like(name, visible)}")
    return found[name]


def _as_said(types: tuple[str, ...]) -> str:
    """Return types as text: a single type unchanged, several types as a Python list."""
    return types[0] if len(types) == 1 else str(list(types))


def _with_types(name: str, types: Iterable[str]) -> str:
    said = ", ".join(types)
    return f"{name} [{said}]" if said else name
