"""Every exception of turtleact, in one tree.

::

    TurtleactError
    ├── InvalidName            a graph name breaks the naming rules
    │   └── InvalidGoalId      a goal id is malformed
    ├── InvalidInterface       the text of a .msg, .srv or .action, or a class, is malformed
    ├── UnknownInterface       no interface of that name is known
    │   └── NotLearned         … and no node describes it
    ├── InvalidMessage         a value does not fit its field's type
    │   └── InvalidGoal        … in the goal of an action
    ├── InvalidBody            a function cannot be the body of an action
    ├── InvalidOption          an option has a value that it cannot have
    ├── InvalidParameter       a parameter is not declared, or cannot have a value
    ├── InvalidTransition      an event is not allowed in a goal's state
    ├── GoalError              a goal did not succeed; raised where you wait for the goal
    │   ├── GoalRejected       the server rejected the goal
    │   ├── GoalAborted        the server ended the goal without success
    │   ├── GoalCanceled       the goal was canceled
    │   ├── PauseRefused       the goal could not be paused or resumed
    │   └── UnknownGoal        the server knows no goal with that id
    ├── ActionConflict         another node serves the action already
    ├── ServerUnavailable      nobody serves the action or service, or the server went away
    ├── ServiceError           a service's handler failed to respond
    │   └── ServiceTimeout     … within the caller's timeout
    ├── SimError               the world was asked for something impossible
    ├── UsageError             the command line was given something it cannot use
    └── Verdict                raised by a server's own code to end or reject a goal
        ├── Abort
        ├── Cancel
        └── Reject

Each exception stores details as attributes and builds its text from these attributes. The text says
what happened, where, and what to do.

The functions at the end describe what users' code raised or gave, in one line of text.
"""

from __future__ import annotations

import copyreg
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from enum import Enum

__all__ = [
    "Abort",
    "ActionConflict",
    "Cancel",
    "GoalAborted",
    "GoalCanceled",
    "GoalError",
    "GoalRejected",
    "InvalidBody",
    "InvalidGoal",
    "InvalidGoalId",
    "InvalidInterface",
    "InvalidMessage",
    "InvalidName",
    "InvalidOption",
    "InvalidParameter",
    "InvalidTransition",
    "NotLearned",
    "PauseRefused",
    "Reject",
    "ServerUnavailable",
    "ServiceError",
    "ServiceTimeout",
    "SimError",
    "TurtleactError",
    "UnknownGoal",
    "UnknownInterface",
    "UsageError",
    "Verdict",
]


class TurtleactError(Exception):
    """The base of every exception of turtleact: ``except TurtleactError`` catches them all."""

    def __reduce__(self) -> tuple[object, ...]:  # __init__ may take other arguments than ``args``
        return copyreg.__newobj__, (type(self), *self.args), vars(self)  # type: ignore[attr-defined]


class InvalidName(TurtleactError):
    """A graph name breaks ROS 2's naming rules.

    Attributes:
        name: The name as given.
        problem: What is wrong with it.
        position: Index of the first wrong character, counted from 0.
    """

    def __init__(self, name: str, problem: str, position: int) -> None:
        super().__init__(name, problem, position)
        self.name = name
        self.problem = problem
        self.position = position

    def __str__(self) -> str:
        return f"invalid name: {self.problem}\n  {self.name}\n  {' ' * self.position}^"


class InvalidGoalId(InvalidName):
    """A goal id is malformed: it is neither 16 bytes nor a UUID, or it is all zeros."""


class InvalidInterface(TurtleactError):
    """The definition of an interface is malformed.

    Attributes:
        problem: What is wrong.
        source: The file that holds the definition, or the name of the type.
        line: Line of the mistake, counted from 1; 0 if the definition is not text.
        column: Column of the mistake, counted from 1.
        text: The text of the line with the mistake.
    """

    def __init__(
        self, problem: str, *, source: str, line: int = 0, column: int = 1, text: str = ""
    ) -> None:
        super().__init__(problem)
        self.problem = problem
        self.source = source
        self.line = line
        self.column = column
        self.text = text

    def __str__(self) -> str:
        if not self.line:
            return f"{self.source}: {self.problem}"
        where = f"{self.source}:{self.line}:{self.column}: {self.problem}"
        return f"{where}\n  {self.text}\n  {' ' * (self.column - 1)}^"


class UnknownInterface(TurtleactError):
    """The interface is not known: no package, file or loaded text defines it.

    Attributes:
        type_name: The name that was looked up.
        suggestion: The nearest known name, or an empty string.
    """

    def __init__(self, type_name: str, suggestion: str = "") -> None:
        super().__init__(type_name, suggestion)
        self.type_name = type_name
        self.suggestion = suggestion

    def __str__(self) -> str:
        hint = f", did you mean '{self.suggestion}'?" if self.suggestion else ""
        return f"unknown interface '{self.type_name}'{hint}"


class NotLearned(UnknownInterface):
    """The interface is not known, and it could not be learned from the nodes that use it.

    Attributes:
        problem: Why it could not be learned.
    """

    def __init__(self, type_name: str, problem: str) -> None:
        super().__init__(type_name)
        self.args = (type_name, problem)
        self.problem = problem

    def __str__(self) -> str:
        what = f"{self.type_name} as the graph uses it"
        return f"{what} is not known here and cannot be learned: {self.problem}"


class InvalidMessage(TurtleactError):
    """A value does not fit the type of its field.

    Attributes:
        path: The field, for example ``goal.targets[2].x``.
        problem: What was expected and what was found.
    """

    def __init__(self, path: str, problem: str) -> None:
        super().__init__(path, problem)
        self.path = path
        self.problem = problem

    def __str__(self) -> str:
        return f"{self.path}: {self.problem}"


class InvalidGoal(InvalidMessage):
    """A value in a goal does not fit the type of its field. Nothing was sent."""


class _NamedError(TurtleactError):
    """Something with a name is wrong; ``text`` of a subclass says what that is."""

    text = "{name}: {problem}"

    def __init__(self, name: str, problem: str) -> None:
        super().__init__(name, problem)
        self.name = name
        self.problem = problem

    def __str__(self) -> str:
        return self.text.format(name=self.name, problem=self.problem)


class InvalidBody(_NamedError):
    """A function cannot be the body of an action.

    Attributes:
        name: The action's name.
        problem: What was expected and what was found.
    """

    text = "the body of action '{name}' {problem}"


class InvalidOption(_NamedError):
    """An option has a value that is not allowed.

    Attributes:
        name: The name of the option.
        problem: What was expected and what was found.
    """

    text = "option '{name}': {problem}"


class InvalidParameter(_NamedError):
    """A parameter is not declared, is declared twice, or cannot have the given value.

    Attributes:
        name: The name of the parameter.
        problem: What was expected and what was found.
    """

    text = "parameter '{name}': {problem}"


class InvalidTransition(TurtleactError):
    """The event is not allowed in the goal's state. The goal's state has not changed.

    Attributes:
        status: The state of the goal, a `GoalStatus`.
        event: The forbidden event: a `GoalEvent`, or text if no `GoalEvent` describes the event.
        goal_id: The goal's id in hexadecimal, or an empty string.
    """

    def __init__(self, status: Enum, event: Enum | str, goal_id: str = "") -> None:
        super().__init__(status, event, goal_id)
        self.status = status
        self.event = event
        self.goal_id = goal_id

    def __str__(self) -> str:
        who = f"goal {self.goal_id}" if self.goal_id else "the goal"
        what = self.event if isinstance(self.event, str) else self.event.name
        return f"{who} is {self.status.name}: {what} is not allowed"


class GoalError(TurtleactError):
    """A goal did not succeed.

    Attributes:
        reason: The server's explanation; empty if it gave none.
        result: The result that the server sent although the goal failed; None if it sent none.
    """

    what = "the goal did not succeed"

    def __init__(self, reason: str = "", result: object = None) -> None:
        super().__init__(reason, result)
        self.reason = reason
        self.result: Any = result  # of the action's own class

    def __str__(self) -> str:
        return f"{self.what}: {self.reason}" if self.reason else self.what


class GoalRejected(GoalError):
    """The server rejected the goal."""

    what = "the goal was rejected"


class GoalAborted(GoalError):
    """The server ended the goal without success."""

    what = "the goal was aborted"


class GoalCanceled(GoalError):
    """The goal was canceled."""

    what = "the goal was canceled"


class UnknownGoal(GoalError):
    """The server knows no goal with that id. Perhaps the goal's result has expired."""

    what = "the goal is not known to the server"


class PauseRefused(GoalError):
    """The goal could not be paused or resumed. The goal's state has not changed."""

    what = "the goal cannot be paused or resumed"


class ActionConflict(TurtleactError):
    """Another node already serves the action. Only one node at a time may serve it.

    Attributes:
        action: The action's name.
        node: The node that serves it.
    """

    def __init__(self, action: str, node: str) -> None:
        super().__init__(action, node)
        self.action = action
        self.node = node

    def __str__(self) -> str:
        return (
            f"action '{self.action}' is served by node {self.node} already: "
            'choose another name, or serve with on_conflict="wait" to take over once it has gone'
        )


class ServerUnavailable(TurtleactError):
    """Nobody serves the action or service, or the server went away.

    Attributes:
        name: The name of the action or service.
        problem: What is wrong, such as "no server answers". If ``when`` is not empty, the text ends
            with ``when``.
        kind: Whether ``name`` is the name of an action or of a service.
        when: When the server went away, such as "before the goal ended"; may be empty.
        otherwise: Another possible cause; empty if there is none.
        hint: What to check next; may be empty.
    """

    def __init__(
        self,
        name: str,
        problem: str = "no server answers",
        *,
        kind: Literal["action", "service"] = "action",
        when: str = "",
        otherwise: str = "",
        hint: str = "",
    ) -> None:
        super().__init__(name, problem)
        self.name = name
        self.problem = f"{problem} {when}" if when else problem
        self.when = when
        self.hint = hint
        self.kind = kind
        self.otherwise = otherwise

    def __str__(self) -> str:
        otherwise = f", or {self.otherwise}" if self.otherwise else ""
        hint = f"; {self.hint}" if self.hint else ""
        return f"{self.kind} '{self.name}': {self.problem}{otherwise}{hint}"


class ServiceError(TurtleactError):
    """A service's handler failed, or did not return a valid response.

    Attributes:
        name: The service's name.
        reason: The server's explanation, or what went wrong if the server sent no explanation.
    """

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(name, reason)
        self.name = name
        self.reason = reason

    def __str__(self) -> str:
        return f"service '{self.name}': {self.reason}"


class ServiceTimeout(ServiceError):
    """A service did not respond within the caller's timeout.

    Attributes:
        seconds: The timeout (s, by the graph's clock).
    """

    def __init__(self, name: str, seconds: float) -> None:
        super().__init__(name, f"no response within {seconds:g} s")
        self.seconds = seconds


class SimError(TurtleactError):
    """The world was asked for something impossible.

    Attributes:
        problem: What is wrong, and what to do.
        turtle: The name of the turtle that the error is about; empty if it is about no turtle.
    """

    def __init__(self, problem: str, *, turtle: str = "") -> None:
        super().__init__(problem)
        self.problem = problem
        self.turtle = turtle

    def __str__(self) -> str:
        return f"{self.turtle}: {self.problem}" if self.turtle else self.problem


class UsageError(TurtleactError):
    """The command line was given arguments that it cannot use.

    Attributes:
        problem: What is wrong, and what to write instead.
    """

    def __init__(self, problem: str) -> None:
        super().__init__(problem)
        self.problem = problem

    def __str__(self) -> str:
        return self.problem


class Verdict(TurtleactError):
    """The base of `Abort`, `Cancel` and `Reject`, which bodies and callbacks of a server raise."""


class Abort(Verdict):
    """Raise this in a body to end its goal with the status ABORTED.

    Args:
        reason: The explanation sent to the client.
        result: The result sent to the client. If left out, the action's default result is sent.
    """

    def __init__(self, reason: str = "", result: object = None) -> None:
        super().__init__(reason, result)
        self.reason = reason
        self.result = result

    def __str__(self) -> str:
        return self.reason


class Cancel(Verdict):
    """Raise this at the end of a canceled body's clean-up, to send a result to the client.

    Args:
        result: What the goal has achieved so far. If left out, the client gets the partial result
            that the body has set, or the action's default result if the body has set none.
    """

    def __init__(self, result: object = None) -> None:
        super().__init__(result)
        self.result = result


class Reject(Verdict):
    """Raise this in a ``goal_callback`` to reject a goal.

    Args:
        reason: The explanation sent to the client.
    """

    def __init__(self, reason: str = "") -> None:
        super().__init__(reason)
        self.reason = reason

    def __str__(self) -> str:
        return self.reason


STOPS = (KeyboardInterrupt, SystemExit, GeneratorExit)
"""The exceptions that stop the program or close a coroutine.

If a callback raises any other exception, the callback has failed."""

STOPPED = "the program was stopped"
"""The reason given for goals and service calls that end because the program was stopped."""

CUT_OFF = "canceled from within"
"""The reason recorded for a goal if the user's own code cancelled the task of the goal's body."""

LONGEST = 10_000
"""The maximum length of an exception's text in logs and messages, in characters."""


_RETURN_IN_GENERATOR = "'return' with value in async generator"
"""Python's error message for a body that both yields feedback and returns a result."""


def summary(error: BaseException) -> str:
    """Describe an exception in one line.

    The descriptions of an exception group's members are joined with semicolons.
    """
    if isinstance(error, BaseExceptionGroup):
        return shortened("; ".join(summary(each) for each in error.exceptions))
    said = text_of(error)
    return f"{type(error).__name__}: {said}" if said else type(error).__name__


def text_of(value: object) -> str:
    """Return ``str(value)`` in one line, cut after `LONGEST` characters."""
    return " ".join(shortened(str(value)).split("\n"))


def syntax_hint(error: BaseException) -> str:
    """Advise what to write if a body returns its result after a ``yield``; otherwise return "".

    In rclpy, a body returns its result, so many users also write ``return`` in a generator. The
    error message of Python does not say what to write instead.
    """
    if isinstance(error, SyntaxError) and error.msg == _RETURN_IN_GENERATOR:
        return "a body that yields feedback yields its result, too: write 'yield' for 'return'"
    return ""


def shortened(text: str) -> str:
    """Cut a text after `LONGEST` characters, and add how many characters it had.

    >>> shortened("a" * 10_001)[-25:]
    'aaaa… (10,001 characters)'
    """
    if len(text) <= LONGEST:
        return text
    return f"{text[:LONGEST]}… ({len(text):,} characters)"


def encodable(text: str) -> str:
    r"""Escape lone surrogates, the characters that UTF-8 cannot encode.

    Python uses lone surrogates for file names that are not UTF-8 (PEP 383).

    >>> print(encodable("caf\udce9"))
    caf\udce9
    """
    return text if text.isascii() else text.encode(errors="backslashreplace").decode()
