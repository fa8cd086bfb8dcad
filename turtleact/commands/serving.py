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
from typing import TYPE_CHECKING, Any, NoReturn, TypedDict, Unpack, cast

import anyio

from turtleact.commands.interrupts import Interrupts
from turtleact.commands.node_parameters import of_node, unheard
from turtleact.commands.output import abandon, note, printable
from turtleact.commands.screen import can_move
from turtleact.commands.settings import naming
from turtleact.commands.user_code import Found, Modules
from turtleact.errors import ActionConflict, TurtleactError, UsageError
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
    from turtleact.commands.settings import LogFormat, Page, Service
    from turtleact.goals.records import OnRestart
    from turtleact.journal import Journal
    from turtleact.node import ActionServer, ServerGoalHandle
    from turtleact.node.conflicts import OnConflict
    from turtleact.tasks.clock import Clock
    from turtleact.transports import Transport, ZenohTransport
    from turtleact.transports.rmw_zenoh.config import Mode

__all__ = ["run"]

logger = logging.getLogger("turtleact.serve")

ROUTER = "tcp/127.0.0.1:7447"
"""The endpoint at which the nodes of a machine look for a router."""

LEASE = 15.0
"""How long the graph may still show the node of a killed process (s, event loop time).

The time is longer than Zenoh's own lease of 10 s.
"""

STANDBY = 0.2
"""The interval at which a standby tries to open the journal of another process (s)."""

CHECK_INTERVAL = 0.15
"""How often ``--reload`` checks the files (s)."""

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
    _set_up_logging(service.log_format)
    interrupts = Interrupts()
    interrupts.forced = 0
    board = _dashboard(service)
    if board is not None:
        interrupts.restore = board.close
    log = ServerLog(board, is_json=service.log_format == "json")
    status = interrupts.run(Server(service, log, interrupts).serve())
    if interrupts.received:
        return 0
    return _restart() if status == RELOAD else status


def _dashboard(service: Service) -> Dashboard | None:
    """Return a dashboard, if the user wants one and the terminal can show it; otherwise None."""
    is_live = service.is_live and service.log_format != "json"
    if not (is_live and can_move(sys.stdout)):
        return None
    from turtleact.commands.live import Dashboard

    return Dashboard()


def _restart() -> NoReturn:
    """Replace this process by a new one with the same command line."""
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])  # noqa: S606  # no shell needed


class Kept(TypedDict, total=False):
    """The options that make a server keep its goals in a journal. Empty without a journal."""

    journal: Journal
    on_restart: OnRestart


class Server:
    """Opens what ``serve`` needs, in order, and closes it again.

    Args:
        service: What to serve, and where.
        log: What tells the user what happens.
        interrupts: The signals that end the server.

    Raises:
        UsageError: if a target has no action.
        TurtleactError: if a module cannot be imported. With ``--reload``, the error is only
            printed, and nothing from the user's modules is served until a file changes.
    """

    def __init__(self, service: Service, log: ServerLog, interrupts: Interrupts) -> None:
        self._service = service
        self._log = log
        self._interrupts = interrupts
        self._modules = Modules(service.targets)
        self._found = self._find()
        self._before = self._times()
        self._kept: Kept = {}
        self._where = ""
        self._nodes: list[Node] = []
        self._watchers: list[Callable[[Node], None]] = [self._nodes.append]
        self._servers: list[ActionServer[Any, Any, Any]] = []
        self._tasks: list[Background] = []

    async def serve(self) -> int:
        """Serve until a signal comes or a file changes."""
        service, log = self._service, self._log
        # The stack closes in reverse. First the goals, the background tasks and the reloads end,
        # all at the same time. The web page, the node, the journal, the exporters and the dashboard
        # close after that, because they tell of the ends of goals.
        async with AsyncExitStack() as stack:
            if log.board is not None:
                drawing = Background(log.board.run(), "the dashboard")
                await stack.enter_async_context(aclosing(drawing))
            await self._observe(stack)
            await self._open_journal(stack)
            node = await stack.enter_async_context(self._open_node())
            # The web page is opened last, once there is something to show, but the goals end while
            # it is still there. So its place in the stack is taken here.
            pages = await stack.enter_async_context(AsyncExitStack())
            stack.push_async_callback(self._end_goals, node)
            await self._begin(node)
            if service.page is not None:
                node.learner.is_on = service.reach.learns
                url = await _open_web(pages, service.page, node)
                log.say(f"web page, and rosbridge, at {url}")
            if service.keeping is not None:
                from turtleact.goals.fault_reports import watching_disk

                name, file = node.fully_qualified_name, Path(service.keeping.path)
                check = self._kept["journal"].problem
                watching = watching_disk(node.transport, name, file, "journal", check)
                await stack.enter_async_context(watching)
            await cast("ZenohTransport", node.transport).flush()
            log.say(self._ready_line(node.transport))
            self._interrupts.cancels = False
            if service.reload:
                reloading = Background(self._end_at_change(), "reloading")
                await stack.enter_async_context(aclosing(reloading))
            await self._interrupts.wait()
            log.note(f"no more goals are accepted; running goals {self._fate()}")
        return 0 if self._interrupts.received else RELOAD

    def _ready_line(self, transport: Transport) -> str:
        """Return the line that says where the server is ready, and for which actions."""
        names = list(types_by_name(transport.local_endpoints(), "action"))
        if len(names) > MOST_LISTED:
            names[MOST_LISTED - 1 :] = [f"and {len(names) - MOST_LISTED + 1} more"]
        actions = ", ".join(names) or "no actions"
        return f"ready at {self._where}, domain {self._service.reach.domain}: {actions}"

    def _fate(self) -> str:
        """Return a phrase that says what happens to running goals when the server ends."""
        keeping = self._service.keeping
        if keeping is None or not keeping.resumes:
            return "are ended"
        if problem := self._kept["journal"].problem():
            return f"are lost, unless the journal can be written in time: {problem}"
        return "go on when the server is back"

    # the graph and the node

    @asynccontextmanager
    async def _open_node(self) -> AsyncIterator[Node]:
        """Open the node that serves the targets and, unless there is no fleet, a world."""
        service, log = self._service, self._log

        def watch(node: Node) -> None:
            for each in self._watchers:
                each(node)

        async with AsyncExitStack() as stack:
            if service.fleet is not None:
                from turtleact.sim.world_node import open_world

                world = open_world(
                    **service.fleet._asdict(),
                    turtlesim_only=service.turtlesim_only,
                    graph=self._open_graph,
                    on_transition=log.tell,
                    on_start=None if log.board is None else log.board.begin,
                    introspection=service.introspection,
                    on_node=watch,
                    **self._kept,
                )
                node: Node = await stack.enter_async_context(world)
            else:
                from turtleact.tasks.clock import WallClock

                transport = await stack.enter_async_context(self._open_graph(WallClock()))
                opening = open_node(service.node_name, transport=transport)
                node = await stack.enter_async_context(opening)
                node.introspection = service.introspection
                watch(node)
            node.on_transition(log.tell)
            yield node

    @asynccontextmanager
    async def _open_graph(self, clock: Clock) -> AsyncIterator[Transport]:
        """Open the graph that the user asked for.

        By default, this process becomes the router of this machine. If there is a router already,
        this process joins that router's graph as a peer.
        """
        service = self._service
        connect, domain = service.reach.connect, service.reach.domain
        opening = partial(open_zenoh, domain=domain, config=service.config, clock=clock)
        self._where = ", ".join(service.listen or connect) or ROUTER
        async with AsyncExitStack() as stack:
            if service.listen or connect:
                mode: Mode = "router" if service.listen else "peer"
                opened = opening(mode=mode, listen=service.listen or None, connect=connect)
                transport = await stack.enter_async_context(opened)
            else:
                transport = await _open_default(stack, opening)
            await transport.explore()
            if service.fleet is not None and "/turtlesim" in transport.nodes():
                raise TurtleactError(
                    f"there is a world already in domain {domain} at {self._where}: give another "
                    "--domain, or --no-sim to serve your own actions beside it"
                )
            yield transport

    async def _open_journal(self, stack: AsyncExitStack) -> None:
        """Open the journal, if there is one.

        With ``--wait``, wait until no other process writes to the journal.

        Raises:
            JournalError: if the journal cannot be opened.
        """
        keeping = self._service.keeping
        if keeping is None:
            return
        from turtleact.journal import open_journal
        from turtleact.journal.database import JournalHeld

        limit, aborts, told = keeping.max_starts, keeping.abort_goals, False
        while True:
            opening = open_journal(keeping.path, max_starts=limit, abort_at_close=aborts)
            try:
                journal = await stack.enter_async_context(opening)
                break
            except JournalHeld as held:
                if not self._service.wait:
                    raise
                if not told:
                    self._log.note(f"{held}: waiting until that process has gone")
                told = True
                await anyio.sleep(STANDBY)
        self._kept = {"journal": journal, "on_restart": keeping.on_restart}

    # the user's actions

    async def _begin(self, node: Node) -> None:
        """Serve the user's actions, declare the parameters, and start the background tasks."""
        service, found = self._service, self._found
        name = node.fully_qualified_name
        node.initial_values |= of_node(service.overrides, name)
        for declaration in found.parameters:
            node.parameter(declaration)
        declared = [each.name for each in found.parameters]
        for text in unheard(service.overrides, name, declared):
            self._log.note(text)
        self._servers = await _serve(node, found.actions, wait=service.wait, **self._kept)
        self._tasks = [
            Background(_run(each, node), f"the background task {each.run.__name__}")
            for each in found.tasks
        ]

    async def _end_goals(self, own: Node) -> None:
        """End the background tasks and the goals of all servers at the same time.

        Tasks that ignore their cancellation are waited for together, for `GRACE` seconds in all.
        Actions that web clients serve on the user's node are left alone. They end when the
        connections of these clients close.
        """
        servers = list(self._servers)
        with anyio.CancelScope(shield=True):
            for node in self._nodes:
                # A withdrawn built-in action would serve again once the user's action has closed.
                await close_withdrawn(node)
                if node is not own:
                    servers += cast("Any", resources_of(node).action_servers())
            async with anyio.create_task_group() as closing:
                # The tasks come first: one that waits for a goal is cancelled before the goal ends.
                for task in self._tasks:
                    closing.start_soon(task.aclose, GRACE)
                for server in servers:
                    closing.start_soon(server.aclose)

    # reload

    def _find(self) -> Found:
        """Import the user's modules, and return what they declare."""
        if not self._service.reload:
            return self._modules.find()
        sys.dont_write_bytecode = True  # a change within the same second may be taken for no change
        try:
            return self._modules.find()
        except UsageError:
            raise
        except TurtleactError as error:
            self._log.note(f"{error}; nothing of it is served until the next change")
            return Found([], [])

    def _times(self) -> dict[Path, int]:
        """Return when the user's modules and interfaces were changed (ns); 0 for missing files."""
        finders = REGISTRY.finders
        interfaces = (*finders.loaded.files.values(), *finders.nearby.files.values())
        own = {each for each in interfaces if self._modules.has(each)}
        files = self._modules.files | own
        return {file: file.stat().st_mtime_ns if file.exists() else 0 for file in sorted(files)}

    async def _end_at_change(self) -> None:
        """End the server when a file changes. An interface may have been loaded since the start."""
        changed: list[str] = []
        while not changed:
            await anyio.sleep(CHECK_INTERVAL)
            times = self._times()
            self._before = times | self._before
            changed = [each.name for each, time in times.items() if time != self._before[each]]
        await anyio.sleep(CHECK_INTERVAL)  # an editor may write a file in parts, or several files
        self._log.note(f"reloading: {', '.join(changed)} changed")
        self._interrupts.end()

    # what watches

    async def _observe(self, stack: AsyncExitStack) -> None:
        """Export traces, and serve metrics, if the user wants that.

        Raises:
            TurtleactError: if a package is missing, or the port cannot be opened.
        """
        if self._service.otel:
            self._watchers.append(await _export(stack))
        if self._service.metrics is not None:
            from turtleact.telemetry import GoalMetrics
            from turtleact.web.server import open_metrics

            metrics = GoalMetrics()
            self._watchers.append(metrics.watch)
            opening = open_metrics(metrics.text, *self._service.metrics)
            with naming("--metrics"):
                url = await stack.enter_async_context(opening)
            lag = Background(metrics.watch_loop(), "measuring the event loop")
            await stack.enter_async_context(aclosing(lag))
            self._log.say(f"metrics at {url}")


async def _open_default(
    stack: AsyncExitStack, opening: Callable[..., AbstractAsyncContextManager[ZenohTransport]]
) -> ZenohTransport:
    """Become the router of this machine, or join it.

    Whoever comes first is the router. A later server cannot listen at its port, and joins as a
    peer. If no router lets it in either, something else holds the port, as the first error says.
    """
    try:
        return await stack.enter_async_context(opening(mode="router", listen=[ROUTER]))
    except TurtleactError as taken:
        try:
            return await stack.enter_async_context(opening(mode="peer"))
        except TurtleactError:
            raise taken from None


async def _run(declared: BackgroundDeclaration[Any], node: Node) -> None:
    await declared.run(node)


async def _serve(
    node: Node,
    declared: list[ActionDeclaration[..., object]],
    *,
    wait: bool,
    **kept: Unpack[Kept],
) -> list[ActionServer[Any, Any, Any]]:
    """Serve actions, and return once all of them are on the graph.

    Only one node can serve an action name; see `turtleact.node.conflicts`. If another node with the
    name of ``node`` still serves an action, its process may have been killed a moment ago. This
    function therefore waits for the other node to disappear, even without ``wait``. Without
    ``wait``, this function waits at most `LEASE` seconds, because the other node may belong to a
    ``turtleact serve`` that still runs.

    Raises:
        TurtleactError: if another node serves one of the actions. The message names that node.
        UsageError: if ``declared`` contains an action twice.
    """
    try:
        on_conflict: OnConflict = "wait" if wait else "refuse"
        servers = [node.serve(each, on_conflict=on_conflict, **kept) for each in declared]
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


async def _open_web(stack: AsyncExitStack, page: Page, node: Node) -> str:
    """Serve the web page and rosbridge, and return their address.

    The message of an error names the command-line option to correct.

    Raises:
        UsageError: if the token is missing or invalid.
        TurtleactError: if the port cannot be opened.
    """
    from turtleact.web import open_web

    host, port, token, hosts, origins = page
    opening = open_web(node, host, port, token=token, hosts=hosts, origins=origins)
    with naming("--web"):
        return (await stack.enter_async_context(opening)).url


async def _export(stack: AsyncExitStack) -> Callable[[Node], None]:
    """Export traces and metrics. Return what makes a node take part."""
    try:
        from turtleact.telemetry import instrument
        from turtleact.telemetry.exporting import exporting
    except ModuleNotFoundError as missing:
        if (missing.name or "").partition(".")[0] != "opentelemetry":
            raise
        raise TurtleactError(
            "--otel needs the extra otel-export: "
            "pip install 'opentelemetry-exporter-otlp-proto-http>=1.30,<2'"
        ) from None
    except ValueError as error:  # the SDK reads some variables when it is imported
        raise TurtleactError(f"OpenTelemetry cannot be set up: {error}") from error
    await stack.enter_async_context(exporting("turtleact"))
    return instrument


# the log


def _set_up_logging(log_format: LogFormat | None) -> None:
    """Write log records of level INFO and above to stderr, in the format ``log_format``.

    If ``log_format`` is None, leave Python's logging as it is.
    """
    if logging.lastResort is not None:  # it serves modules that configure no logging
        logging.lastResort.setFormatter(_Escaping(logging.Formatter()))
    if log_format is None:
        return
    from turtleact.telemetry.logs import GoalFilter, JsonFormatter, TextFormatter

    handler = _ToStderr()
    handler.addFilter(GoalFilter())
    as_json = log_format == "json"
    handler.setFormatter(JsonFormatter() if as_json else _Escaping(TextFormatter()))
    logging.getLogger().addHandler(handler)
    logging.getLogger().setLevel(logging.INFO)
    logging.getLogger("uvicorn").setLevel(logging.WARNING)  # it tells of each start and end


class _ToStderr(logging.StreamHandler[Any]):
    """Writes log records to the current `sys.stderr`, which the dashboard may have redirected."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record."""
        self.setStream(sys.stderr)
        super().emit(record)


class _Escaping(logging.Formatter):
    """Escapes control characters, which an exception in a record may contain."""

    def __init__(self, inner: logging.Formatter) -> None:
        super().__init__()
        self._inner = inner

    def format(self, record: logging.LogRecord) -> str:
        """Return a record as text."""
        return printable(self._inner.format(record))


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
        told = f": {printable(goal.reason)}" if goal.reason else ""
        change = f"{new.name}{' (resumed)' if is_resumed else told}"
        name, goal_id, now = goal.action_name, goal.goal_id.hex(), datetime.now()
        if self.board is not None:
            self.board.tell(goal, new)
            print(f"{now:%H:%M:%S} {name} {goal_id[:8]} {change}")
        elif self._is_json:
            members = {"goal_id": goal_id, "action": name, "status": new.name}
            members |= {"node": goal.node.fully_qualified_name}
            members |= {"reason": goal.reason} if goal.reason else {}
            self.say(f"{name} {change}", **members)
        else:
            self.say(f"{now:%H:%M:%S.%f} {name} {goal_id} {change}")

    def note(self, text: str) -> None:
        """Print a line on stderr."""
        if self._is_json:
            logger.info(text)
        else:
            note(text)

    def say(self, line: str, **members: str) -> None:
        """Print a line on stdout at once, or add it to the heading of the dashboard.

        If stdout cannot be written, nothing more is printed, and the server goes on. If each line
        is a JSON object, ``members`` are added to that object.
        """
        if self.board is not None:
            self.board.say(line)
            return
        try:
            print(_as_json(line, members) if self._is_json else line, flush=True)
        except OSError as error:
            abandon(sys.stdout)
            note(f"stdout cannot be written ({error.strerror}), so goals are no longer listed")


def _as_json(text: str, members: dict[str, str]) -> str:
    """Return a line that ``serve`` itself prints as a log record in JSON."""
    from turtleact.telemetry.logs import JsonFormatter

    said = {"name": logger.name, "levelname": "INFO", "msg": text, **members}
    return JsonFormatter().format(logging.makeLogRecord(said))
