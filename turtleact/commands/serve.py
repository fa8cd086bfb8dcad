"""Implements ``serve``: a world, the built-in actions and the user's own, until a signal comes.

By default the server is the router that the nodes of this machine look for. If there is a router
already, the server joins its graph as a peer. One line on stdout says when goals can be sent. After
that, each change of a goal gets a line. A terminal shows a dashboard instead.
"""

from __future__ import annotations

import asyncio
import logging
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AsyncExitStack, aclosing, asynccontextmanager, contextmanager
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Unpack

import anyio

from turtleact.body import ActionDeclaration
from turtleact.commands import runner
from turtleact.commands.node_parameters import of_node, unheard
from turtleact.commands.observing import json_line, observing, set_up_logging
from turtleact.commands.output import abandon, note, printable
from turtleact.commands.reloading import Kept, Reloader, Watch
from turtleact.commands.targets import Found, Modules
from turtleact.commands.terminal import can_move
from turtleact.errors import ActionConflict, InvalidOption, TurtleactError, UsageError
from turtleact.goal import GoalStatus
from turtleact.graph import types_by_name
from turtleact.node import Node, open_node
from turtleact.tasks import Background
from turtleact.transports import open_zenoh

if TYPE_CHECKING:
    from contextlib import AbstractAsyncContextManager

    from turtleact.clock import Clock
    from turtleact.commands.interrupts import Interrupts
    from turtleact.commands.live import Dashboard
    from turtleact.commands.settings import Page, Service
    from turtleact.node import ActionServer, ServerGoalHandle
    from turtleact.node.conflicts import OnConflict
    from turtleact.transports import Transport, ZenohTransport

__all__ = ["ServerLog", "listed", "run", "serve_declared"]

logger = logging.getLogger("turtleact.serve")

ROUTER = "tcp/127.0.0.1:7447"
"""The endpoint at which the nodes of a machine look for a router."""

LEASE = 15.0
"""How long the graph may still show the node of a killed process (s, event loop time).

Zenoh's own lease is 10 s."""

STANDBY = 0.2
"""The interval at which a standby tries to open the journal of another process (s)."""

MOST_LISTED = 12
"""The ready line names at most this many actions."""


def run(service: Service, interrupts: Interrupts) -> int:
    """Serve until a signal comes, then end the running goals, and return the exit status.

    Raises:
        UsageError: if a target has no action, or a token is missing.
        TurtleactError: if the graph cannot be opened.
    """
    if logging.lastResort is not None:  # it serves modules that configure no logging
        logging.lastResort.setFormatter(_Escaping())
    set_up_logging(service.watched.log_format)
    modules = Modules(service.targets)
    work = Work(modules, Watch(modules), Found([], []))
    log = ServerLog(_dashboard(service), is_json=service.watched.log_format == "json")
    with interrupts.beginning(0):  # a module of the user's may take any time
        work = work._replace(found=_find(modules, service, log))
    if interrupts.received:
        return 0
    work.watch.follow()
    if log.board is None:
        return runner.run(_serve(service, work, log, interrupts), interrupts)
    interrupts.restore = log.board.close
    try:
        return runner.run(_serve(service, work, log, interrupts), interrupts)
    finally:
        log.board.close()


def _dashboard(service: Service) -> Dashboard | None:
    """Make the dashboard, if the user wants one and the terminal can show it."""
    is_live = service.is_live and service.watched.log_format != "json"
    if not (is_live and can_move(sys.stdout)):
        return None
    from turtleact.commands.live import Dashboard

    return Dashboard(sys.stdout)


def _find(modules: Modules, service: Service, log: ServerLog) -> Found:
    """Import the modules. With ``--reload``, only report a module that fails."""
    if not service.reload:
        return modules.find()
    sys.dont_write_bytecode = True  # a change within the same second could be taken for no change
    try:
        return modules.find()
    except UsageError:
        raise
    except TurtleactError as error:
        log.complain(f"{error}; nothing of it is served until the next change")
        return Found([], [])


class Work(NamedTuple):
    """The part of a server that comes from the user's modules.

    Attributes:
        modules: The modules of the targets.
        watch: Watches their files.
        found: The actions, parameters and tasks in them.
    """

    modules: Modules
    watch: Watch
    found: Found


async def _serve(service: Service, work: Work, log: ServerLog, interrupts: Interrupts) -> int:
    opened: list[tuple[ZenohTransport, str]] = []
    # The stack closes in reverse. First nobody reloads or connects any more, then the background
    # tasks end, then the node ends its goals, and then the journal, the exporters and the dashboard
    # close, because they tell of the ends of goals. `listening` is outside, so that a second signal
    # is heard during all of this.
    with interrupts.listening(asyncio.get_running_loop()):
        async with AsyncExitStack() as stack:
            if log.board is not None:
                stack.enter_context(log.board.listening())
                stack.enter_context(log.hearing_reloads())
                drawing = Background(log.board.run(), "the dashboard")
                await stack.enter_async_context(aclosing(drawing))
            graph = partial(_open_graph, service, opened)
            with interrupts.beginning(0):
                on_node = await stack.enter_async_context(observing(service.watched, log.say))
                options = await stack.enter_async_context(_open_journal(service, log))
                opening = _open_node(service, graph, log, options, on_node)
                node = await stack.enter_async_context(opening)
            if interrupts.received:
                return 0
            reloader = Reloader(node, work.modules, work.watch, interrupts, log.reload)
            await stack.enter_async_context(aclosing(reloader))
            await _until_signal(interrupts, _begin(service, work.found, reloader, options, log))
            if interrupts.received:
                return 0
            if service.reload:
                reloading = Background(reloader.run(), "the reloading")
                await stack.enter_async_context(aclosing(reloading))
            if service.page is not None:
                url = await stack.enter_async_context(_open_web(service.page, node))
                log.say(f"web page, and rosbridge, at {url}")
            (transport, where), *_ = opened
            if service.keeping is not None:
                from turtleact.fault_reports import watching_disk

                at, file = node.fully_qualified_name, Path(service.keeping.path)
                check = options["journal"].problem
                watching = watching_disk(transport, at, file, "journal", check)
                await stack.enter_async_context(watching)
            await transport.flush()
            actions = listed(list(types_by_name(transport.local_endpoints(), "action")))
            log.say(f"ready at {where}, domain {service.reach.domain}: {actions}")
            await interrupts.wait(1)
            log.note(f"no more goals are accepted; running goals {_fate(service, options)}")
    return 0


def _fate(service: Service, options: Kept) -> str:
    """What becomes of running goals when the server ends."""
    if service.keeping is None or not service.keeping.resumes:
        return "are ended"
    if problem := options["journal"].problem():
        return f"are lost, unless the journal can be written in time: {problem}"
    return "go on when the server is back"


@asynccontextmanager
async def _open_journal(service: Service, log: ServerLog) -> AsyncIterator[Kept]:
    """Open the journal. The block gets the options for servers that use it.

    With ``--wait``, wait until no other process writes the journal.

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
                    log.note(f"{held}: waiting until that has gone")
                told = True
                await anyio.sleep(STANDBY)
        yield {"journal": journal, "on_restart": keeping.on_restart}


async def _begin(
    service: Service, found: Found, reloader: Reloader, options: Kept, log: ServerLog
) -> None:
    """Serve the user's actions, declare the parameters, and start the background tasks."""
    node = reloader.node
    node.first_values |= of_node(service.overrides, node.fully_qualified_name)
    for declaration in found.parameters:
        node.parameter(declaration)
    declared = [each.name for each in found.parameters]
    for text in unheard(service.overrides, node.fully_qualified_name, declared):
        log.note(text)
    servers = await serve_declared(node, found.actions, wait=service.wait, **options)
    reloader.adopt(found, servers, options)


async def serve_declared(
    node: Node,
    declared: list[ActionDeclaration[..., object]],
    *,
    wait: bool,
    **options: Unpack[Kept],
) -> list[ActionServer[Any, Any, Any]]:
    """Serve actions, and return once all of them are on the graph.

    Only one node serves an action name; `turtleact.node.conflicts` has the rules. A node with this
    node's own name may be its predecessor, which was killed a moment ago. This function waits for
    such a node even without ``wait``. But the node may also belong to another ``turtleact serve``
    that still runs, so without ``wait`` this function waits at most `LEASE` seconds.

    Args:
        node: The node that serves the actions.
        declared: The actions. Several types may share a name.
        wait: Whether to wait for other nodes too, for as long as it takes.
        **options: Options that replace declared ones; see `Node.action_server`.

    Returns:
        Their servers.

    Raises:
        TurtleactError: if another node serves an action. The text names the node.
        UsageError: if an action is given twice.
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
    """Return the error with a hint that names the command-line option."""
    return TurtleactError(
        f"action '{taken.action}' is served by node {taken.node} already: choose another name, or "
        "give --wait to serve it once that node has gone"
    )


async def _until_signal(interrupts: Interrupts, running: Awaitable[None]) -> None:
    """Run something to its end, or cancel it when a signal comes."""
    async with anyio.create_task_group() as beside:
        beside.start_soon(interrupts.cancel_at_signal, beside.cancel_scope)
        await running
        beside.cancel_scope.cancel()


@asynccontextmanager
async def _open_web(page: Page, node: Node) -> AsyncIterator[str]:
    """Open the page and rosbridge. The block gets their address.

    Raises:
        UsageError: if a token is missing.
        TurtleactError: if the port cannot be opened. Both errors name the option.
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
    """Open the node that serves the targets, on a graph with or without a world.

    ``options`` holds the journal for the built-in actions. ``on_node`` is called with each node.
    """
    async with AsyncExitStack() as stack:
        if service.fleet is not None:
            from turtleact.app import open_world

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
            from turtleact.clock import WallClock

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
    """Open the graph that the user wants. By default, be its router, or else a peer of the router.

    Args:
        service: What to serve, and at which endpoints.
        opened: A list to which the graph and its endpoints are appended.
        clock: The clock of the graph.
    """
    connect, domain, _ = service.reach
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
    """List names in one line, but not too many of them."""
    some = names if len(names) <= MOST_LISTED else names[: MOST_LISTED - 1]
    more = [f"and {len(names) - len(some)} more"] if some is not names else []
    return ", ".join([*some, *more]) or "nothing"


class _Escaping(logging.Formatter):
    """Formats records as usual, but escapes control characters, which an exception may contain."""

    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


class _Told(logging.Handler):
    """Passes the text of each record to a function."""

    def __init__(self, tell: Callable[[str], object]) -> None:
        super().__init__()
        self._tell = tell

    def emit(self, record: logging.LogRecord) -> None:
        """Pass the text of a record to the function."""
        self._tell(printable(record.getMessage()))


class ServerLog:
    """Tells the user what happens, in lines on stdout or on a dashboard.

    Args:
        board: The dashboard; None for lines.
        is_json: Whether each line is a JSON object.
    """

    def __init__(self, board: Dashboard | None, *, is_json: bool = False) -> None:
        self.board = board
        self._is_json = is_json

    def tell(
        self, goal: ServerGoalHandle[Any, Any, Any], _old: GoalStatus, new: GoalStatus
    ) -> None:
        """Print a line for a change of a goal."""
        is_resumed = goal.resumed is not None and new is GoalStatus.EXECUTING
        reason = (
            " (resumed)" if is_resumed else f": {printable(goal.reason)}" if goal.reason else ""
        )
        time = f"{datetime.now():%H:%M:%S.%f}"
        line = f"{time} {goal.action_name} {goal.goal_id.hex()} {new.name}{reason}"
        if self.board is not None:
            self.board.tell(goal, new, line, time)
        elif self._is_json:
            members = {"goal_id": goal.goal_id.hex(), "action": goal.action_name}
            members |= {"node": goal.node.fully_qualified_name, "status": new.name}
            if goal.reason:
                members["reason"] = goal.reason
            self.say(f"{goal.action_name} {new.name}{reason}", **members)
        else:
            self.say(line)

    def note(self, text: str) -> None:
        """Print a line on stderr."""
        if self._is_json:
            logger.info(text)
        else:
            note(text)

    def say(self, line: str, **members: str) -> None:
        """Print a line at once. If stdout is closed, the server goes on without it.

        ``members`` are further members of the line if it is JSON.
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

    def reload(self, line: str) -> None:
        """Print a line about a reload. On a dashboard, it replaces the line of the last reload."""
        if self.board is None:
            self.say(line)
        else:
            self.board.retell("reload", f"{datetime.now():%H:%M:%S} {line}")

    def complain(self, problem: str) -> None:
        """Print a problem of modules that cannot be served yet.

        On a dashboard, the line of the next reload replaces it.
        """
        if self.board is None:
            self.note(problem)
        else:
            self.reload(printable(problem))

    @contextmanager
    def hearing_reloads(self) -> Iterator[None]:
        """During a block, print reload errors with `reload`: a dashboard keeps only the newest."""
        logger, told = logging.getLogger("turtleact.reload"), _Told(self.reload)
        logger.addHandler(told)
        try:
            yield
        finally:
            logger.removeHandler(told)
