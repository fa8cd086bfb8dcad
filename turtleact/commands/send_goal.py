"""Implements ``send-goal``, which sends one goal, follows it, and returns the exit status.

This module decides when a goal is sent, canceled or abandoned. A `GoalPrinter` prints what happens
to the goal.

Source: ros2cli ``ros2action/verb/send_goal.py`` for the order of the output.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, NamedTuple, NoReturn, cast

import anyio

from turtleact.commands import graph
from turtleact.commands.goal_printer import (
    EXIT_STATUS,
    WAITING,
    Followed,
    GoalPrinter,
    JsonPrinter,
    after_return,
    follow,
    watch_command,
)
from turtleact.commands.interrupts import Interrupts
from turtleact.commands.output import leave, note, say
from turtleact.errors import (
    GoalRejected,
    ServerUnavailable,
    TurtleactError,
    UnknownInterface,
    UsageError,
)
from turtleact.goals.state import GoalStatus
from turtleact.interfaces import Action, from_text
from turtleact.names import resolve_name
from turtleact.transports.base import find_server

if TYPE_CHECKING:
    from contextlib import AbstractAsyncContextManager, AsyncExitStack

    from anyio.abc import TaskGroup

    from turtleact.commands.goal_printer import View
    from turtleact.commands.message_text import GoalText
    from turtleact.commands.settings import ConnectOptions
    from turtleact.goals.body import ActionType
    from turtleact.interfaces import Message
    from turtleact.node import Node

__all__ = ["GoalRequest", "GoalSender", "choose_printer"]

SUCCEEDED, FAILED, REJECTED, TIMEOUT = 0, 1, 3, 124
"""Exit statuses, besides `EXIT_STATUS`."""

ENDED_WITH_WORLD = "the goal ended together with the embedded world"

PATIENCE = 5.0
"""The time limit of several waits (s, wall clock).

A goal may take this long to end after its timeout. A server on the graph may take this long to
become reachable. If no server has accepted the goal after this long, a note tells the user.
"""

AGAIN = 0.25
"""The interval at which ``--reattach`` looks for a server that has not started (s, wall clock)."""

CANCEL_TIMEOUT = 6.0
"""After a signal, how long to wait for the goal's end or the server's answer (s, wall clock).

The timeout is a little longer than the 5 s that a server gives a body to clean up.
"""


class GoalRequest(NamedTuple):
    """The goal to send, where to send it, and how to follow it.

    Attributes:
        name: The name of the action.
        type_name: The action's type; None for the type with which the action is served.
        text: The goal, as text.
        reach: The graph on which to look for a server first; None to use only an embedded world.
        speed: The speed of the embedded world; see `turtleact.sim.world_node.open_world`.
        seed: The seed of the embedded world.
        options: The command-line options for the graph and the interfaces, with a space before each
            option. Hints append these options to the commands that they suggest.
        feedback: Whether to print each feedback message.
        timeout: If the goal has not ended this long after its acceptance (s, wall clock), the goal
            is canceled. The command also waits this long for the acceptance, but at least
            `PATIENCE`. With 0, the command ends once the goal is accepted. None for no limit.
        view: How the goal is shown: ``auto`` is a live display on a terminal and plain lines
            elsewhere.
        reattach: How long to wait for a server that has gone, or that has not started yet (s, event
            loop time).
    """

    name: str
    type_name: str | None
    text: GoalText
    reach: ConnectOptions | None
    speed: float | str = 1.0
    seed: int = 0
    options: str = ""
    feedback: bool = False
    timeout: float | None = None
    view: View = "auto"
    reattach: float = 0.0


def choose_printer(
    view: View, *, wants_feedback: bool, wants_feedback_live: bool | None = None
) -> GoalPrinter:
    """Choose the printer: JSON if asked for, live on a terminal that can show it, else plain.

    Args:
        view: The view that the user wants.
        wants_feedback: Whether to print each feedback message.
        wants_feedback_live: Whether to print feedback messages above a live display too. If None,
            ``wants_feedback`` decides.
    """
    if view == "json":
        return JsonPrinter()
    if view == "auto":
        from turtleact.commands.screen import can_move

        if can_move(sys.stdout):
            from turtleact.commands.live import LivePrinter

            wanted = wants_feedback if wants_feedback_live is None else wants_feedback_live
            return LivePrinter(wants_feedback=wanted)
    return GoalPrinter(wants_feedback=wants_feedback)


class GoalSender:
    """Opens the graph, sends one goal, follows it, and determines the exit status.

    Attributes:
        interrupts: The signals, with which the caller runs `send`.

    Raises:
        InvalidName: if the action's name breaks ROS 2's rules.
        InvalidGoal: if the type is given, and the goal does not fit it.
        UnknownInterface: if the type is not known.
        InvalidInterface: if the type is not an action.
    """

    def __init__(self, request: GoalRequest) -> None:
        self._request = request
        self._name = resolve_name(request.name)
        self._goal: Message | None = None
        self._unknown: UnknownInterface | None = None
        if request.type_name is not None:
            try:
                self._goal = self._read_goal(graph.interface_class(Action, request.type_name))
            except UnknownInterface as error:
                if request.reach is None or not request.reach.learns:
                    raise
                self._unknown = error
        if self._unknown is None:
            self._say_waiting()
        self._printer = choose_printer(request.view, wants_feedback=request.feedback)
        self.interrupts = Interrupts()
        self.interrupts.restore = self._printer.close
        self.interrupts.last_words = self._last_words
        self._sent: Followed | None = None
        self._canceled_by: int | None = None
        self._awaits_cancel = False
        self._is_embedded = False

    async def send(self) -> int:
        """Open the graph or an embedded world, send the goal, and return the exit status.

        Raises:
            InvalidGoal: if the goal does not fit the action.
            ServerUnavailable: if nobody serves the action with this type.
        """
        opened = graph.open_or_embed(
            self._request.reach, "actions", _find_served, self._open_world, self._enter_graph
        )
        try:
            async with opened as node:
                if self._unknown is not None:
                    self._say_waiting()
                await _find_served(node, self._name)
                action_type = await self._find_action(node)
                goal = self._goal
                if not isinstance(goal, action_type.Goal):  # the server may define it differently
                    goal = self._read_goal(action_type)
                return await self._send(node, action_type, goal)
        except anyio.get_cancelled_exc_class():  # by a signal, which later cancels only the goal
            note("interrupted before the goal was accepted, so it was withdrawn")
            raise

    def _say_waiting(self) -> None:
        if self._request.view != "json":
            say(WAITING)

    def _read_goal(self, action_type: type[Action]) -> Message:
        text = self._request.text
        return from_text(action_type.Goal, text.text, root="goal", source=text.source)

    def _open_world(self, why: str) -> AbstractAsyncContextManager[Node]:
        """Open the embedded world.

        Raises:
            TurtleactError: if the world is no substitute for the graph, for the reason ``why``.
                With ``--reattach``, the user waits for a server. With a timeout of 0, the goal must
                outlive this command. A world of this process has only types that are known here.
        """
        request = self._request
        if request.reattach:
            problem = f"no server after {request.reattach:g} s"
            raise ServerUnavailable(self._name, problem, hint=why)
        if request.timeout == 0:
            raise ServerUnavailable(self._name, "no server is in reach", hint=why)
        if self._unknown is not None:
            raise self._unknown
        self._is_embedded = True
        return graph.embedded_world(request.speed, request.seed)

    async def _enter_graph(self, stack: AsyncExitStack, reach: ConnectOptions) -> Node | None:
        """Join the user's graph, and return a node on it; None if there is no graph.

        With ``--reattach``, wait for the graph and then for the action. If the router is off, an
        attempt to connect fails at once. This method therefore repeats the attempt until the time
        of ``--reattach`` has passed.
        """
        patience = self._request.reattach
        due = anyio.current_time() + patience
        there: Node | None = None
        has_told = False
        while True:
            is_late = anyio.current_time() >= due
            try:
                if there is None:
                    there = await graph.enter_graph(stack, reach)
            except TurtleactError as error:
                if is_late or isinstance(error, UsageError):
                    raise
            if is_late or (there is not None and self._name in there.graph().actions):
                return there
            if not has_told:
                waiting = f"waiting for a server for up to {patience:g} s"
                note(f"nobody serves '{self._name}' yet: {waiting}")
                has_told = True
            await anyio.sleep(AGAIN)

    async def _find_action(self, node: Node) -> type[Action]:
        """Return the class of the action. If it has several types, the user's or the first one.

        Raises:
            ServerUnavailable: if nobody serves the action with the wanted type. If nobody serves
                the action with any type, the message suggests a similar action, or lists the
                actions that are served.
            TurtleactError: if the type is unknown in this process and cannot be learned, or is not
                an action.
        """
        name, request, actions = self._name, self._request, node.graph().actions
        if name not in actions:
            if request.reach is not None:
                raise graph.not_served(name, actions)
            hint = "--embedded, --speed and --seed use no other server"
            raise graph.not_served(name, actions, "the embedded world does not serve it", hint)
        found = await graph.chosen_class(
            node, "action", Action, name, request.type_name, request.timeout
        )
        if found.type_name not in actions[name]:
            types = " and ".join(actions[name])
            raise ServerUnavailable(name, f"it is served as {types}, not as {found.type_name}")
        return found

    async def _send(self, node: Node, action_type: type[Action], goal: Message) -> int:
        self._printer.sending(goal)
        client = node.action_client(
            cast("ActionType[Message, Message, Message]", action_type), self._name
        )
        status = None
        # There are two scopes. `sending` is only around the request and the goal: it is cancelled
        # if no server takes the goal in time. The scope of `beside` is around the tasks that watch
        # for signals, silence and time: it is cancelled once the goal has ended. A signal before
        # the acceptance cancels this task itself. The client then withdraws the goal.
        async with anyio.create_task_group() as beside:
            sending = anyio.CancelScope()
            beside.start_soon(self._heed_signal)
            if not self._is_embedded:
                beside.start_soon(graph.note_pause, node)
            try:
                with sending:
                    await client.wait_for_server(PATIENCE)
                    # Not earlier: a server that defines the type differently is never reached, and
                    # the error of `send_goal` says so.
                    beside.start_soon(self._heed_silence, sending)
                    async with client.send_goal(goal, reattach=self._request.reattach) as handle:
                        self.interrupts.cancels = False
                        self._sent = Followed(node, self._name, action_type, handle)
                        status = await self._follow(self._sent, beside)
            # Before the goal was accepted, this is the answer to the command. Afterwards the goal
            # may go on, so the user is told how to get back to it.
            except ServerUnavailable as error:
                if self._sent is None:
                    raise
                note(str(error))
                if self._sent.handle.done:
                    note(self._way_back(self._sent))
                status = FAILED if self._canceled_by is None else self._canceled_by
            except GoalRejected as error:
                self._printer.rejected(error.reason)
                reason = f"reason: {error.reason}" if error.reason else "the server gave no reason"
                note(str(error) if self._request.view == "json" else reason)
                status = REJECTED
            beside.cancel_scope.cancel()
        if status is None:
            note("given up before the goal was accepted, so it was withdrawn")
            return TIMEOUT
        return status

    async def _follow(self, sent: Followed, beside: TaskGroup) -> int:
        printer = self._printer
        printer.accepted(sent)
        printer.follows(sent)
        if self._request.timeout == 0:
            sent.handle.detach()
            note(self._way_back(sent))
            return SUCCEEDED
        if self._request.timeout is not None:
            beside.start_soon(self._time_out, sent, self._request.timeout)
        if self._request.reattach:
            beside.start_soon(self._tell_of_server, sent)
        outcome = await follow(printer, sent.handle)
        if outcome.status is GoalStatus.ABORTED:
            note(f"the goal was aborted: {outcome.reason or 'no reason given'}")
        if outcome.status is GoalStatus.CANCELED and self._canceled_by is not None:
            return self._canceled_by
        return EXIT_STATUS[outcome.status]

    async def _tell_of_server(self, sent: Followed) -> None:
        """Tell the user when the goal's server goes away, and when it is back.

        This method runs only with ``--reattach``. Without that option, the command soon ends with
        an error that says that the server has gone.
        """
        waits = f"waiting for it for up to {self._request.reattach:g} s"
        was_served = True
        while True:
            is_served = graph.is_served(sent.node, sent.name, sent.action_type.type_name)
            if is_served is not was_served:
                has = "is back" if is_served else f"has gone: {waits}"
                note(f"the server of {self._name} {has}")
            was_served = is_served
            await sent.node.transport.wait_for_change()

    # signals, timeouts and servers that do not answer

    async def _heed_signal(self) -> None:
        """At a signal, cancel the goal. Before its acceptance, the client withdraws it."""
        await self.interrupts.wait()
        if self._sent is None:
            note("waiting for the server's answer; Ctrl-C again exits at once")
            return
        there = self._has_server(self._sent)
        awaited = "the goal's end" if there else "the server, which has gone"
        self._printer.canceling()
        note(f"waiting for {awaited}; Ctrl-C again exits at once")
        await self._cancel(self._sent, self.interrupts.status, CANCEL_TIMEOUT)

    async def _heed_silence(self, sending: anyio.CancelScope) -> None:
        """Tell the user if no server has accepted the goal in time.

        If the user gave a timeout, also stop sending the goal.
        """
        limit = self._request.timeout
        seconds = max(limit or 0.0, PATIENCE)
        await anyio.sleep(seconds)
        if self._sent is not None or self.interrupts.received:
            return
        if limit:
            note(f"no answer from the server after {seconds:g} s; giving up")
            sending.cancel()
        else:
            note(f"no answer from the server for {seconds:g} s; waiting for it")

    async def _time_out(self, sent: Followed, seconds: float) -> None:
        """Cancel the goal after ``seconds``, unless the goal has ended by then."""
        await anyio.sleep(seconds)
        if not sent.handle.status.is_terminal:  # or it ended in the same moment
            note(f"no result after {seconds:g} s")
            self._printer.canceling()
            await self._cancel(sent, TIMEOUT, PATIENCE)

    async def _cancel(self, sent: Followed, status: int, patience: float) -> None:
        """Ask the server to cancel the goal, and wait until its end cancels this task.

        If the server refuses, does not answer, or the goal does not end in time, end the process
        with the exit status ``status``: the goal may go on. A body may ignore its cancellation, and
        a server may hang.
        """
        self._canceled_by, self._awaits_cancel = status, True
        with anyio.move_on_after(patience):
            try:
                await sent.handle.cancel()
            except ServerUnavailable:
                return  # the task that waits for the goal raises that too
            self._awaits_cancel = False
            # The server has agreed. Once the goal has ended, `_send` cancels this task.
            if sent.handle.status is GoalStatus.CANCELING or sent.handle.status.is_terminal:
                await anyio.sleep_forever()
            note("the server refuses to cancel the goal")
        self._let_go(sent, status)

    def _let_go(self, sent: Followed, status: int) -> NoReturn:
        self._printer.close()
        note(self._way_back(sent))
        leave(status)

    def _way_back(self, sent: Followed) -> str:
        """Return a sentence that says whether the goal goes on and how to follow it again."""
        if self._is_embedded:
            return ENDED_WITH_WORLD
        command = watch_command(sent.handle.goal_id, self._request.options)
        if not self._has_server(sent):
            return after_return(command)
        if self._awaits_cancel:
            return (
                "the server has not answered, so it is not known whether the goal was canceled; "
                f"once the server answers again, '{command}' shows the goal"
            )
        return f"the goal goes on; '{command}' follows it again"

    def _has_server(self, sent: Followed) -> bool:
        """Whether the goal's server is in this process or on the graph."""
        return self._is_embedded or graph.is_served(
            sent.node, self._name, sent.action_type.type_name
        )

    def _last_words(self) -> str:
        """Return what to print when a second signal ends the process."""
        if self._sent is not None:
            return f"turtleact: {self._way_back(self._sent)}\n"
        rest = "" if self._is_embedded else "; the server may still accept it"
        return f"turtleact: interrupted before the goal was accepted{rest}\n"


async def _find_served(node: Node, name: str | None = None) -> bool:
    """Whether the action ``name`` is served or, without ``name``, whether any action is served.

    If there is no server yet, wait until a server appears or the graph has been discovered.
    """

    def found() -> bool | None:
        actions = node.graph().actions
        return (bool(actions) if name is None else name in actions) or None

    return await find_server(node.transport, found) is not None
