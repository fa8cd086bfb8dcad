"""Implements ``serve``, which serves a world, the built-in actions and the user's own actions.

By default, the server is the router that the nodes of this machine look for. If this machine
already has a router, the server joins that router's graph as a peer. The server prints a line on
stdout once goals can be sent, and then a line for each change of a goal's state. On a terminal, it
shows a dashboard instead of lines. The server runs until a signal comes.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, aclosing, asynccontextmanager
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, TypeAlias, TypedDict, Unpack, cast

import anyio

from turtleact.commands.interrupts import Interrupts
from turtleact.commands.node_parameters import of_node, unheard
from turtleact.commands.observing import json_line, observing, set_up_logging
from turtleact.commands.output import abandon, note, printable
from turtleact.commands.screen import can_move
from turtleact.commands.user_modules import Found, Modules
from turtleact.errors import ActionConflict, InvalidOption, TurtleactError, UsageError
from turtleact.goals.body import ActionDeclaration, BackgroundDeclaration
from turtleact.goals.state import GoalStatus
from turtleact.interfaces.types import REGISTRY
from turtleact.node import Node, close_withdrawn, open_node, resources_of
from turtleact.tasks import GRACE, Background
from turtleact.transports import open_zenoh
from turtleact.transports.graph import types_by_name

if TYPE_CHECKING:
    from contextlib import AbstractAsyncContextManager

    from turtleact.commands.live import Dashboard
    from turtleact.commands.settings import Page, Service
    from turtleact.goals.records import OnRestart
    from turtleact.journal import Journal
    from turtleact.node import ActionServer, ServerGoalHandle
    from turtleact.node.conflicts import OnConflict
    from turtleact.tasks.clock import Clock
    from turtleact.transports import Transport, ZenohTransport

__all__ = ["ServerLog", "listed", "run", "serve_declared"]

logger = logging.getLogger("turtleact.serve")

ROUTER = "tcp/127.0.0.1:7447"
"""The endpoint at which the nodes of a machine look for a router."""

LEASE = 15.0
"""How long the graph may still show the node of a killed process (s, event loop time).

The time is longer than Zenoh's own lease of 10 s.
"""

STANDBY = 0.2
"""The interval at which a standby tries to open the journal of another process (s)."""

RELOAD = -1
"""In place of an exit status: start the program again."""

MOST_LISTED = 12
"""The ready line names at most this many actions."""


def run(service: Service) -> int:
    """Serve until a signal comes, then end the running goals, and return the exit status.

    Raises:
        UsageError: if a target has no action, or a token is missing.
        TurtleactError: if the graph cannot be opened.
    """
    if logging.lastResort is not None:  # it serves modules that configure no logging
        logging.lastResort.setFormatter(_Escaping())
    set_up_logging(service.watched.log_format)
    modules = Modules(service.targets)
    log = ServerLog(_dashboard(service), is_json=service.watched.log_format == "json")
    found = _find(modules, service, log)
    work = Work(modules, found, _stamps_of(modules))
    interrupts = Interrupts()
    interrupts.forced = 0
    if log.board is not None:
        interrupts.restore = log.board.close
    try:
        status = interrupts.run(_serve(service, work, log, interrupts))
    finally:
        interrupts.restore()
    if interrupts.received:
        return 0
    return _restart() if status == RELOAD else status


def _dashboard(service: Service) -> Dashboard | None:
    """Return a dashboard, if the user wants one and the terminal can show it; otherwise None."""
    is_live = service.is_live and service.watched.log_format != "json"
    if not (is_live and can_move(sys.stdout)):
        return None
    from turtleact.commands.live import Dashboard

    return Dashboard()


def _find(modules: Modules, service: Service, log: ServerLog) -> Found:
    """Import the user's modules, and return what they declare.

    With ``--reload``, an error in a module is only printed, and nothing from the user's modules is
    served until a file changes.
    """
    if not service.reload:
        return modules.find()
    sys.dont_write_bytecode = True  # a change within the same second could be taken for no change
    try:
        return modules.find()
    except UsageError:
        raise
    except TurtleactError as error:
        log.note(f"{error}; nothing of it is served until the next change")
        return Found([], [])


class Kept(TypedDict, total=False):
    """The options that make a server keep its goals in a journal. Empty without a journal."""

    journal: Journal
    on_restart: OnRestart


class Running:
    """The user's actions and background tasks while they run.

    Args:
        node: The node that serves the actions.
    """

    def __init__(self, node: Node) -> None:
        self.node = node
        self._servers: list[ActionServer[Any, Any, Any]] = []
        self._tasks: list[Background] = []

    def start(self, found: Found, servers: list[ActionServer[Any, Any, Any]]) -> None:
        """Take charge of the actions that the node serves, and start the background tasks."""
        self._servers = servers
        self._tasks = [
            Background(_run(each, self.node), f"the background task {each.run.__name__}")
            for each in found.tasks
        ]

    async def aclose(self, others: list[ActionServer[Any, Any, Any]]) -> None:
        """End the background tasks and the goals of all servers at the same time.

        Tasks that ignore their cancellation are waited for together, for `GRACE` seconds in all.
        """
        async with anyio.create_task_group() as closing:
            # The tasks come first: one that waits for a goal is cancelled before the goal ends.
            for task in self._tasks:
                closing.start_soon(task.aclose, GRACE)
            for server in [*self._servers, *others]:
                closing.start_soon(server.aclose)


async def _run(declared: BackgroundDeclaration[Any], node: Node) -> None:
    await declared.run(node)


class Work(NamedTuple):
    """The part of a server that comes from the user's modules.

    Attributes:
        modules: The modules that the targets name.
        found: The actions, parameters and background tasks in these modules.
        stamps: The state of the files of these modules.
    """

    modules: Modules
    found: Found
    stamps: Stamps


async def _serve(service: Service, work: Work, log: ServerLog, interrupts: Interrupts) -> int:
    opened: list[tuple[ZenohTransport, str]] = []
    # The stack closes in reverse. First the goals, the background tasks and the reloads end, all at
    # the same time. The web page, the node, the journal, the exporters and the dashboard close
    # after that, because they tell of the ends of goals.
    async with AsyncExitStack() as stack:
        if log.board is not None:
            drawing = Background(log.board.run(), "the dashboard")
            await stack.enter_async_context(aclosing(drawing))
        graph = partial(_open_graph, service, opened)
        on_node = await stack.enter_async_context(observing(service.watched, log.say))
        options = await stack.enter_async_context(_open_journal(service, log))
        nodes: list[Node] = []
        opening = _open_node(service, graph, log, options, _both(nodes.append, on_node))
        node = await stack.enter_async_context(opening)
        # The web page is opened last, once there is something to show, but the goals end while it
        # is still there. So its place in the stack is taken here.
        pages = await stack.enter_async_context(AsyncExitStack())
        running = Running(node)
        stack.push_async_callback(_end_goals, nodes, running)
        await _begin(service, work.found, running, options, log)
        if service.page is not None:
            url = await pages.enter_async_context(_open_web(service.page, node))
            log.say(f"web page, and rosbridge, at {url}")
        (transport, where), *_ = opened
        if service.keeping is not None:
            from turtleact.goals.fault_reports import watching_disk

            at, file = node.fully_qualified_name, Path(service.keeping.path)
            check = options["journal"].problem
            watching = watching_disk(transport, at, file, "journal", check)
            await stack.enter_async_context(watching)
        await transport.flush()
        log.say(_ready_line(transport, where, service.reach.domain))
        interrupts.cancels = False
        if service.reload:
            reloading = Background(_end_at_change(work, interrupts, log), "reloading")
            await stack.enter_async_context(aclosing(reloading))
        await interrupts.wait()
        log.note(f"no more goals are accepted; running goals {_fate(service, options)}")
    return 0 if interrupts.received else RELOAD


async def _end_at_change(work: Work, interrupts: Interrupts, log: ServerLog) -> None:
    changed = await _wait_for_change(work.modules, work.stamps)
    log.note(f"reloading: {', '.join(file.name for file in changed)} changed")
    interrupts.end()


CHECK_INTERVAL = 0.15
"""How often the files are checked (s, event loop time)."""

Stamps: TypeAlias = dict[Path, tuple[int, int, int] | None]
"""The time of change, size and identity of each file; None for a missing file."""


async def _wait_for_change(modules: Modules, before: Stamps) -> list[Path]:
    """Wait until a file of the user's modules or interfaces has changed, and return those files.

    An editor may write a file in parts, remove it and rename another, or save several files in a
    row. So a change counts once two checks in a row have found all files in the same state.

    Args:
        modules: The user's modules.
        before: What `_stamps_of` returned after the modules were imported.
    """
    last = before
    while True:
        await anyio.sleep(CHECK_INTERVAL)
        stamps = _stamps_of(modules)
        before = stamps | before  # an interface may have been loaded since
        changed = [file for file, stamp in stamps.items() if stamp != before[file]]
        if changed and stamps == last:
            return changed
        last = stamps


def _restart() -> NoReturn:
    """Replace this process by a new one with the same command line."""
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])  # noqa: S606  # no shell needed


def _stamps_of(modules: Modules) -> Stamps:
    """Return the stamps of all files of the user's modules and interfaces."""
    finders = REGISTRY.finders
    interfaces = (*finders.loaded.files.values(), *finders.nearby.files.values())
    own = {each for each in interfaces if modules.has(each)}
    return {file: _stamp(file) for file in sorted(modules.files | own)}


def _stamp(file: Path) -> tuple[int, int, int] | None:
    try:
        status = file.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size, status.st_ino


def _ready_line(transport: Transport, where: str, domain: int) -> str:
    """Return the line that says where the server is ready, and for which actions."""
    actions = listed(list(types_by_name(transport.local_endpoints(), "action")))
    return f"ready at {where}, domain {domain}: {actions}"


def _both(
    first: Callable[[Node], object], second: Callable[[Node], object]
) -> Callable[[Node], None]:
    def call(node: Node) -> None:
        first(node)
        second(node)

    return call


async def _end_goals(nodes: list[Node], running: Running) -> None:
    """End all goals and the user's background tasks, and serve no more goals.

    Actions that web clients serve on the same node are left alone. They end when the connections of
    these clients close.
    """
    built_in: list[ActionServer[Any, Any, Any]] = []
    with anyio.CancelScope(shield=True):
        for node in nodes:
            # A withdrawn built-in action would serve again as soon as the user's action has closed.
            await close_withdrawn(node)
            if node is not running.node:
                built_in += cast("Any", resources_of(node).action_servers())
        await running.aclose(built_in)


def _fate(service: Service, options: Kept) -> str:
    """Return a phrase that says what happens to running goals when the server ends."""
    if service.keeping is None or not service.keeping.resumes:
        return "are ended"
    if problem := options["journal"].problem():
        return f"are lost, unless the journal can be written in time: {problem}"
    return "go on when the server is back"


@asynccontextmanager
async def _open_journal(service: Service, log: ServerLog) -> AsyncIterator[Kept]:
    """Open the journal for a ``with`` block, and yield the options for action servers that use it.

    Without a journal, the options are empty. With ``--wait``, wait until no other process writes to
    the journal.

    Raises:
        JournalError: if the journal cannot be opened.
    """
    keeping = service.keeping
    if keeping is None:
        yield {}
        return
    from turtleact.journal import open_journal
    from turtleact.journal.database import JournalHeld

    opening = partial(
        open_journal,
        keeping.path,
        max_starts=keeping.max_starts,
        abort_at_close=keeping.abort_goals,
    )
    async with AsyncExitStack() as stack:
        told = False
        while True:
            try:
                journal = await stack.enter_async_context(opening())
                break
            except JournalHeld as held:
                if not service.wait:
                    raise
                if not told:
                    log.note(f"{held}: waiting until that process has gone")
                told = True
                await anyio.sleep(STANDBY)
        yield {"journal": journal, "on_restart": keeping.on_restart}


async def _begin(
    service: Service, found: Found, running: Running, options: Kept, log: ServerLog
) -> None:
    """Serve the user's actions, declare the parameters, and start the background tasks."""
    node = running.node
    node.initial_values |= of_node(service.overrides, node.fully_qualified_name)
    for declaration in found.parameters:
        node.parameter(declaration)
    declared = [each.name for each in found.parameters]
    for text in unheard(service.overrides, node.fully_qualified_name, declared):
        log.note(text)
    servers = await serve_declared(node, found.actions, wait=service.wait, **options)
    running.start(found, servers)


async def serve_declared(
    node: Node,
    declared: list[ActionDeclaration[..., object]],
    *,
    wait: bool,
    **options: Unpack[Kept],
) -> list[ActionServer[Any, Any, Any]]:
    """Serve actions, and return once all of them are on the graph.

    Only one node can serve an action name; see `turtleact.node.conflicts`. If another node with the
    name of ``node`` still serves an action, its process may have been killed a moment ago. This
    function therefore waits for the other node to disappear, even without ``wait``. Without
    ``wait``, this function waits at most `LEASE` seconds, because the other node may belong to a
    ``turtleact serve`` that still runs.

    Args:
        node: The node that serves the actions.
        declared: The actions to serve. Actions of different types may have the same name.
        wait: Whether to wait, without a time limit, until no other node serves any of these
            actions.
        **options: Options that replace those in the declarations; see `Node.action_server`.

    Returns:
        The action servers, in the order of ``declared``.

    Raises:
        TurtleactError: if another node serves one of the actions. The message names that node.
        UsageError: if ``declared`` contains an action twice.
    """
    try:
        on_conflict: OnConflict = "wait" if wait else "refuse"
        servers = [node.serve(each, on_conflict=on_conflict, **options) for each in declared]
    except ActionConflict as taken:
        if taken.node == node.fully_qualified_name:
            raise UsageError(f"action '{taken.action}' is given twice") from None
        raise _refused(taken) from None
    if not (wait or all(server.is_serving for server in servers)):
        earlier = f"{node.fully_qualified_name} may be an earlier run that was killed"
        logger.warning("waiting for up to %g s: %s", LEASE, earlier)
    # One after the other is enough: each wait ends by itself, and all share the time limit.
    with anyio.move_on_after(None if wait else LEASE):
        for server in servers:
            await server.wait_until_serving()
    for server in servers:
        if not server.is_serving:
            raise _refused(ActionConflict(server.name, node.fully_qualified_name))
    return servers


def _refused(taken: ActionConflict) -> TurtleactError:
    """Return the error for an action that another node serves. The error suggests ``--wait``."""
    return TurtleactError(
        f"action '{taken.action}' is served by node {taken.node} already: choose another name, or "
        "give --wait to serve it once that node has gone"
    )


@asynccontextmanager
async def _open_web(page: Page, node: Node) -> AsyncIterator[str]:
    """Serve the web page and rosbridge during a block, and yield their address.

    The message of an error names the command-line option to correct.

    Raises:
        UsageError: if the token is missing or invalid.
        TurtleactError: if the port cannot be opened.
    """
    from turtleact.web import open_web

    async with AsyncExitStack() as stack:
        host, port, token, hosts, origins = page
        opening = open_web(node, host, port, token=token, hosts=hosts, origins=origins)
        try:
            web = await stack.enter_async_context(opening)
        except InvalidOption as error:
            if error.name == "token":
                raise UsageError(f"--token: {error.problem}") from None
            raise TurtleactError(f"--web: {error.problem}") from None
        yield web.url


@asynccontextmanager
async def _open_node(
    service: Service,
    graph: Callable[[Clock], AbstractAsyncContextManager[Transport]],
    log: ServerLog,
    options: Kept,
    on_node: Callable[[Node], None],
) -> AsyncIterator[Node]:
    """Open the node that serves the targets and, unless ``service.fleet`` is None, a world.

    The servers of the built-in actions get ``options``, which may contain a journal. ``on_node`` is
    called with each node that is opened.
    """
    async with AsyncExitStack() as stack:
        if service.fleet is not None:
            from turtleact.sim.world_node import open_world

            world = open_world(
                **service.fleet._asdict(),
                turtlesim_only=service.turtlesim_only,
                graph=graph,
                on_transition=log.tell,
                on_start=None if log.board is None else log.board.begin,
                introspection=service.introspection,
                on_node=on_node,
                **options,
            )
            node: Node = await stack.enter_async_context(world)
        else:
            from turtleact.tasks.clock import WallClock

            transport = await stack.enter_async_context(graph(WallClock()))
            opening = open_node(service.node_name, transport=transport)
            node = await stack.enter_async_context(opening)
            node.introspection = service.introspection
            on_node(node)
        node.on_transition(log.tell)
        yield node


@asynccontextmanager
async def _open_graph(
    service: Service, opened: list[tuple[ZenohTransport, str]], clock: Clock
) -> AsyncIterator[Transport]:
    """Open the graph that the user asked for.

    By default, this process becomes the router of this machine. If there is a router already, this
    process joins that router's graph as a peer.

    Args:
        service: The options of ``serve``.
        opened: A list to which this function appends the graph and a text with its endpoints.
        clock: The clock of the graph.
    """
    connect, domain = service.reach.connect, service.reach.domain
    opening = partial(open_zenoh, domain=domain, config=service.config, clock=clock)
    async with AsyncExitStack() as stack:
        if service.listen or connect:
            transport = await stack.enter_async_context(
                opening(
                    mode="router" if service.listen else "peer",
                    listen=service.listen or None,
                    connect=connect,
                )
            )
            where = ", ".join(service.listen or connect)
        else:
            # Whoever comes first is the router. A later server cannot listen at its port, and joins
            # as a peer. If no router lets it in either, something else holds the port, as the first
            # error says.
            try:
                router = opening(mode="router", listen=[ROUTER])
                transport = await stack.enter_async_context(router)
            except TurtleactError as taken:
                try:
                    transport = await stack.enter_async_context(opening(mode="peer"))
                except TurtleactError:
                    raise taken from None
            where = ROUTER
        await transport.explore()
        if service.fleet is not None and "/turtlesim" in transport.nodes():
            raise TurtleactError(
                f"there is a world already in domain {domain} at {where}: give another "
                "--domain, or --no-sim to serve your own actions beside it"
            )
        opened.append((transport, where))
        yield transport


def listed(names: list[str]) -> str:
    """Join names with commas.

    If there are more than `MOST_LISTED` names, the last ones are replaced by their number.
    """
    some = names if len(names) <= MOST_LISTED else names[: MOST_LISTED - 1]
    more = [f"and {len(names) - len(some)} more"] if some is not names else []
    return ", ".join([*some, *more]) or "no actions"


class _Escaping(logging.Formatter):
    """Formats log records as usual, but escapes control characters.

    An exception in a record may contain such characters.
    """

    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


class ServerLog:
    """Tells the user what happens, in lines on stdout or on a dashboard.

    Args:
        board: The dashboard; None to print lines on stdout.
        is_json: Whether each line is a JSON object.
    """

    def __init__(self, board: Dashboard | None, *, is_json: bool = False) -> None:
        self.board = board
        self._is_json = is_json

    def tell(
        self, goal: ServerGoalHandle[Any, Any, Any], _old: GoalStatus, new: GoalStatus
    ) -> None:
        """Report a change of a goal's state."""
        is_resumed = goal.resumed is not None and new is GoalStatus.EXECUTING
        reason = (
            " (resumed)" if is_resumed else f": {printable(goal.reason)}" if goal.reason else ""
        )
        time = f"{datetime.now():%H:%M:%S.%f}"
        if self.board is not None:
            self.board.tell(goal, new)
            goal_id = goal.goal_id.hex()[:8]
            print(f"{time[:8]} {goal.action_name} {goal_id} {new.name}{reason}")
        elif self._is_json:
            members = {"goal_id": goal.goal_id.hex(), "action": goal.action_name}
            members |= {"node": goal.node.fully_qualified_name, "status": new.name}
            if goal.reason:
                members["reason"] = goal.reason
            self.say(f"{goal.action_name} {new.name}{reason}", **members)
        else:
            self.say(f"{time} {goal.action_name} {goal.goal_id.hex()} {new.name}{reason}")

    def note(self, text: str) -> None:
        """Print a line on stderr."""
        if self._is_json:
            logger.info(text)
        else:
            note(text)

    def say(self, line: str, **members: str) -> None:
        """Print a line on stdout at once, or add it to the heading of the dashboard.

        If stdout is closed, nothing is printed, and the server goes on. If each line is a JSON
        object, ``members`` are added to that object.
        """
        if self.board is not None:
            self.board.say(line)
            return
        if sys.stdout is None:
            return
        try:
            print(json_line(line, **members) if self._is_json else line, flush=True)
        except BrokenPipeError:
            abandon(sys.stdout)
        except (OSError, ValueError) as error:  # a closed object is a ValueError
            sys.stdout = None
            why = getattr(error, "strerror", None) or "it was closed by your code"
            note(f"stdout cannot be written ({why}), so goals are no longer listed")
