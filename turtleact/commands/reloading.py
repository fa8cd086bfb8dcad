"""Implements ``serve --reload``, which imports the user's modules again when their files change.

Only the user's actions, parameters and background tasks are replaced. The process, the graph and
the world go on, so turtles stay where they are and clients stay connected. Running goals of the old
actions end ABORTED with the reason "reloading", unless a journal resumes the goals with the new
actions.

The new modules are imported before the old actions end. If the import fails, the error is logged,
and the old actions go on until the next change.

Source: uvicorn ``supervisors/statreload.py`` for polling (uvicorn restarts the process instead).
"""

from __future__ import annotations

import logging
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict

import anyio

from turtleact.errors import TurtleactError
from turtleact.interfaces.types import REGISTRY
from turtleact.summaries import summary
from turtleact.tasks import GRACE, Background

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable

    from turtleact.body import BackgroundDeclaration
    from turtleact.commands.targets import Found, Modules
    from turtleact.goal_journal import OnRestart
    from turtleact.journal import Journal
    from turtleact.node import ActionServer, Node
    from turtleact.node.parameters import Parameter

__all__ = ["Kept", "Reloader", "Watch"]

logger = logging.getLogger("turtleact.reload")

INTERVAL = 0.15
"""How often the files are checked (s, event loop time)."""

REASON = "reloading"
"""The reason given for the end of a goal whose body is replaced."""

UNCHANGED = "the actions stay as they are until the next change"

Stamps: TypeAlias = dict[Path, tuple[int, int, int] | None]
"""The time of change, size and identity of each file; None for a missing file."""


class Kept(TypedDict, total=False):
    """The options that make a server keep its goals in a journal. Empty without a journal."""

    journal: Journal
    on_restart: OnRestart


class Watch:
    """Finds the user's files that have changed since they were imported.

    Args:
        modules: The user's modules, before their first import.
    """

    def __init__(self, modules: Modules) -> None:
        self._modules = modules
        self._seen = self._stamps()
        self._last = self._seen

    def look(self) -> list[Path]:
        """Check the files once, and return those that have changed.

        An editor may write a file in parts, remove it and rename another, or save several files in
        a row. Therefore a change is returned only after two checks in a row have found all files in
        the same state.
        """
        stamps = self._stamps()
        is_at_rest = stamps == self._last
        self._last = stamps
        if not is_at_rest:
            return []
        # The next import reads the files as they are now. If a file changes during that import, or
        # while the old goals end, a later look notices the change.
        before, self._seen = self._seen, stamps
        return [file for file, stamp in stamps.items() if stamp != before.get(file)]

    def follow(self) -> None:
        """Start to watch the files that were imported since the last call."""
        self._seen = {**self._stamps(), **self._seen}
        self._last = self._seen

    def _stamps(self) -> Stamps:
        interfaces = {each for each in _interface_files().values() if self._modules.has(each)}
        watched = self._modules.files | interfaces
        return {file: _stamp(file) for file in sorted(watched)}


class Reloader:
    """Replaces the actions and parameters of the user's modules when their files change.

    Args:
        node: The node that serves the actions.
        modules: The user's modules.
        watch: Watches the files of these modules.
        say: A function that prints a line for the user.

    Attributes:
        node: The node that serves the actions.
        watch: Watches the files of the user's modules.
    """

    def __init__(
        self,
        node: Node,
        modules: Modules,
        watch: Watch,
        say: Callable[[str], object],
    ) -> None:
        self.node = node
        self._modules = modules
        self.watch = watch
        self._say = say
        self._found: Found | None = None
        self._servers: list[ActionServer[Any, Any, Any]] = []
        self._options: Kept = {}
        self._parameters: list[Parameter[Any]] = []
        self._tasks: list[Background] = []
        self._watching: Background | None = None
        self._stale: set[Path] = set()  # changed, and not imported successfully since

    def adopt(
        self,
        found: Found,
        servers: Iterable[ActionServer[Any, Any, Any]],
        options: Kept | None = None,
    ) -> None:
        """Take charge of the actions that the node already serves, and start the background tasks.

        Args:
            found: The actions, parameters and background functions found in the modules.
            servers: The servers of these actions.
            options: More options with which to serve the actions after a reload.
        """
        self._found = found
        self._servers = list(servers)
        self._options = options or {}
        self._start(found)
        self._parameters = [self.node.parameter(each) for each in found.parameters]

    async def aclose(self, others: Iterable[ActionServer[Any, Any, Any]] = ()) -> None:
        """Close the servers of the user's actions, and end the background tasks and any reload.

        The node itself closes the parameters.

        Args:
            others: More servers to close at the same time.
        """
        watching = [] if self._watching is None else [self._watching.aclose]
        await _together([*watching, *self._ends("shutdown"), *(each.aclose for each in others)])

    def _ends(self, reason: str) -> list[Callable[[], Awaitable[None]]]:
        """Return functions that end the background tasks and close the servers."""
        tasks, self._tasks = self._tasks, []
        servers, self._servers = self._servers, []
        # The tasks come first. So a task that waits for a goal is cancelled before the goal ends.
        return [
            *(partial(task.aclose, GRACE) for task in tasks),
            *(partial(server.aclose, reason) for server in servers),
        ]

    def start(self) -> None:
        """Replace the actions whenever the files change, until `aclose`."""
        self._watching = Background(self.run(), "the reloading")

    async def run(self) -> None:
        """Watch the files and replace the actions until the task is cancelled."""
        while True:
            await anyio.sleep(INTERVAL)
            await self.look()

    async def look(self) -> None:
        """Check the files once, and reload the modules if a file has changed."""
        if not (changed := self.watch.look()):
            return
        try:
            await self._reload(changed)
        except TurtleactError as error:
            logger.error("%s; nothing is served until the next change", error)
        self.watch.follow()

    async def _reload(self, changed: list[Path]) -> None:
        self._say(f"reloading: {', '.join(file.name for file in changed)} changed")
        found = self._import(changed)
        if found is None:
            return
        await self._close()
        try:
            self._serve(found)
        except TurtleactError as error:
            logger.error("%s; the actions are served as they were before", error)
            await self._close()
            if self._found is not None:
                self._serve(self._found)
            return
        self._found = found
        names = dict.fromkeys(server.name for server in self._servers)
        self._say(f"reloaded: {', '.join(names) or 'background tasks'}")

    def _import(self, changed: list[Path]) -> Found | None:
        """Import the modules again. Return None if the import fails or a signal was received."""
        known = REGISTRY.state()
        self._stale.update(changed)
        for name, file in _interface_files().items():
            if file in self._stale:
                REGISTRY.forget(name)  # it is read again when it is needed
        found = None
        try:
            found = self._modules.find_again()
        except TurtleactError as error:
            logger.error("%s; %s", error, UNCHANGED)
        except BaseException as error:  # a module may raise anything, such as SystemExit
            logger.error("%s; %s", summary(error), UNCHANGED)
        if found is None:
            REGISTRY.restore(known)  # the old actions have the old interfaces
            return None
        self._stale.clear()
        return found

    def _serve(self, found: Found) -> None:
        """Declare the parameters, serve the actions, and start the background tasks.

        If another node has begun to serve one of the actions, that action is served once the other
        node stops serving it.
        """
        for declaration in found.parameters:
            self._parameters.append(self.node.parameter(declaration))
        for action in found.actions:
            self._servers.append(self.node.serve(action, on_conflict="wait", **self._options))
        self._start(found)

    def _start(self, found: Found) -> None:
        """Start the background tasks."""
        for each in found.tasks:
            name = f"the background task {each.run.__name__}"
            self._tasks.append(Background(_run(each, self.node), name))

    async def _close(self) -> None:
        """End the background tasks and the goals, and remove the actions and parameters."""
        await _together(self._ends(REASON))
        for parameter in self._parameters:
            parameter.undeclare()
        self._parameters.clear()


async def _together(calls: Iterable[Callable[[], Awaitable[None]]]) -> None:
    """Call functions that end tasks and servers, all at the same time, and wait for all of them.

    Tasks that ignore their cancellation are waited for together, for `GRACE` seconds in all. During
    this delay, no server accepts a goal.
    """
    # Shielded: a child that is cancelled before its first step would not cancel its task.
    with anyio.CancelScope(shield=True):
        async with anyio.create_task_group() as closing:
            for call in calls:
                closing.start_soon(_shielded, call)


async def _shielded(call: Callable[[], Awaitable[None]]) -> None:
    # `asyncio.Task.cancel` breaks the shield of `_together`, and then cancels its task group.
    with anyio.CancelScope(shield=True):
        await call()


async def _run(declared: BackgroundDeclaration[Any], node: Node) -> None:
    await declared.run(node)


def _interface_files() -> dict[str, Path]:
    """Return the interface files that the modules may use, keyed by type name."""
    files = REGISTRY.nearby | REGISTRY.files
    return {name: Path(file) for name, file in files.items()}


def _stamp(file: Path) -> tuple[int, int, int] | None:
    try:
        status = file.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size, status.st_ino
