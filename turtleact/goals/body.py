"""Bodies: the functions that do an action's work, in one of two styles.

==================  ==================================  =============================
style               feedback                            result
==================  ==================================  =============================
async generator     ``yield A.Feedback(...)``           ``yield A.Result(...)``, last
coroutine function  ``handle.publish_feedback(...)``    ``return A.Result(...)``
==================  ==================================  =============================

A body takes the goal message. If it has a second parameter, it also gets the server's goal handle.
`ActionBody` describes these signatures to type checkers, so that they reject a body that uses
another action's messages.

`turtleact.goals.running` runs bodies.
"""

from __future__ import annotations

import functools
import inspect
import logging
from collections.abc import (
    AsyncIterable,
    AsyncIterator,
    Awaitable,
    Callable,
    Coroutine,
    Mapping,
)
from typing import (
    Any,
    Generic,
    Literal,
    ParamSpec,
    Protocol,
    TypeAlias,
    TypedDict,
    TypeVar,
    Unpack,
    cast,
    overload,
)

from turtleact.errors import InvalidBody
from turtleact.goals.policies import Policy
from turtleact.goals.records import GoalJournal, OnRestart
from turtleact.goals.service_server import Introspection
from turtleact.goals.state import CancelResponse, GoalResponse
from turtleact.interfaces import Action, Message
from turtleact.interfaces.types import expect_interface
from turtleact.names import validate_name

__all__ = [
    "ActionBody",
    "ActionDeclaration",
    "ActionType",
    "Body",
    "ServerOptions",
    "action",
    "check_declaration",
    "check_option_names",
]

logger = logging.getLogger("turtleact.server")

P = ParamSpec("P")
T = TypeVar("T", covariant=True)

G = TypeVar("G", bound=Message)
R = TypeVar("R", bound=Message)
F = TypeVar("F", bound=Message)
H = TypeVar("H")

G_co = TypeVar("G_co", bound=Message, covariant=True)
R_co = TypeVar("R_co", bound=Message, covariant=True)
F_co = TypeVar("F_co", bound=Message, covariant=True)

#: A body as type checkers see it. ``H`` is the class of the goal handle.
ActionBody: TypeAlias = (
    Callable[[G], AsyncIterable[F | R]]
    | Callable[[G, H], AsyncIterable[F | R]]
    | Callable[[G], Coroutine[Any, Any, R]]
    | Callable[[G, H], Coroutine[Any, Any, R]]
)

# Both protocols below say the same thing: an action contains the classes Goal, Result and Feedback.
# mypy treats a nested class as a read-only member, so it needs the methods. It infers G, R and F
# from the action before it looks at a body. pyright infers them from both, so a body of another
# action would make it settle on `Message`; members that can be set prevent that. mypy assumes that
# a variable named MYPY is true, while pyright reads its value.
MYPY = False
if MYPY:

    class ActionType(Protocol[G_co, R_co, F_co]):
        """How mypy sees a subclass of `turtleact.Action`: with methods that make messages."""

        @property
        def type_name(self) -> str:
            """The full name of the action type: ``pkg/action/Name``."""

        def Goal(self, *args: Any, **kwargs: Any) -> G_co:  # noqa: ANN401  # any arguments
            """Make a goal message."""

        def Result(self, *args: Any, **kwargs: Any) -> R_co:  # noqa: ANN401  # any arguments
            """Make a result message."""

        def Feedback(self, *args: Any, **kwargs: Any) -> F_co:  # noqa: ANN401  # any arguments
            """Make a feedback message."""

else:

    class ActionType(Protocol[G, R, F]):
        """How pyright sees a subclass of `turtleact.Action`: with message classes as attributes."""

        type_name: str
        Goal: type[G]
        Result: type[R]
        Feedback: type[F]


class ServerOptions(TypedDict, total=False):
    """Options of an action server.

    Attributes:
        goal_callback: Takes the goal, and returns a `GoalResponse` or raises `turtleact.Reject`;
            may be a coroutine function.
        cancel_callback: Takes the handle, and returns a `CancelResponse`; may be a coroutine
            function.
        policy: What happens to a new goal while another goal runs: "parallel", "reject", "queue" or
            "preempt".
        max_active: Under "parallel", how many goals run at a time; further goals wait.
        queue_limit: How many goals may wait.
        slot: Servers of one node with the same slot apply their policy together, like one server.
        result_timeout: How long a result is kept after the goal's end (s, 10 by default; None keeps
            it for ever).
        on_client_lost: "keep", or "cancel" to cancel a client's goals when the client closes.
        grace: When the server closes, how long a cancelled body has to clean up (s, event loop
            time, 5 by default); see `turtleact.ActionServer.aclose`.
        journal: Keeps the goals on disk; see `turtleact.open_journal`.
        on_restart: What to do with goals in the journal that an earlier process did not end:
            "abort" or "resume".
        pausable: Whether a coroutine body awaits ``handle.checkpoint()``, where it can be paused.
        on_pause: A coroutine function that takes the handle and stops the robot.
        on_resume: A coroutine function that takes the handle and starts the robot again.
        introspection: See `turtleact.Node`.
    """

    goal_callback: Callable[..., GoalResponse | Awaitable[GoalResponse]] | None
    cancel_callback: Callable[..., CancelResponse | Awaitable[CancelResponse]] | None
    policy: Policy
    max_active: int | None
    queue_limit: int | None
    slot: str | None
    result_timeout: float | None
    on_client_lost: Literal["keep", "cancel"]
    grace: float
    journal: GoalJournal | None
    on_restart: OnRestart
    pausable: bool
    on_pause: Callable[..., Awaitable[object]] | None
    on_resume: Callable[..., Awaitable[object]] | None
    introspection: Introspection | None


def check_option_names(options: Mapping[str, object]) -> None:
    """Raise TypeError if one of these names is not an option of an action server."""
    for unknown in options.keys() - ServerOptions.__annotations__.keys():
        raise TypeError(f"an action server has no option '{unknown}'")


class ActionDeclaration(Generic[P, T]):
    """The result of the decorator `turtleact.action`: a body with its action type and its name.

    The action is not served until a node serves this declaration. You can still call the
    declaration like the function itself.

    Attributes:
        action_type: The action, a subclass of `turtleact.Action`.
        name: The name under which the action is served, unless the node gives it another name.
        execute: The function that was declared.
        options: Options for `Node.action_server`.
    """

    def __init__(
        self,
        action_type: ActionType[Message, Message, Message],
        name: str,
        execute: Callable[P, T],
        options: ServerOptions,
    ) -> None:
        Body(name, execute)  # raises here, at the function, rather than when it is served
        functools.update_wrapper(self, execute)  # first, because it copies a callable's attributes
        self.action_type = action_type
        self.name = name
        self.execute = execute
        self.options = options

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> T:
        """Call the function that was declared, without a server."""
        return self.execute(*args, **kwargs)


class Declare(Protocol[G, R, F]):
    """The type of the decorator that `action` returns."""

    @overload
    def __call__(
        self, execute: Callable[[G], AsyncIterator[F | R]], /
    ) -> ActionDeclaration[[G], AsyncIterator[F | R]]: ...
    @overload
    def __call__(
        self, execute: Callable[[G, H], AsyncIterator[F | R]], /
    ) -> ActionDeclaration[[G, H], AsyncIterator[F | R]]: ...
    @overload
    def __call__(
        self, execute: Callable[[G], Coroutine[Any, Any, R]], /
    ) -> ActionDeclaration[[G], Coroutine[Any, Any, R]]: ...
    @overload
    def __call__(
        self, execute: Callable[[G, H], Coroutine[Any, Any, R]], /
    ) -> ActionDeclaration[[G, H], Coroutine[Any, Any, R]]: ...


def action(
    action_type: ActionType[G, R, F], name: str, **options: Unpack[ServerOptions]
) -> Declare[G, R, F]:
    """Declare the decorated function as the body of an action. A node must then serve the action.

    Args:
        action_type: The action, a subclass of `turtleact.Action`.
        name: The name under which `Node.serve` serves the action.
        **options: See `Node.action_server`.

    Raises:
        TypeError: if ``action_type`` is not an action.
        InvalidName: if the name breaks ROS 2's rules.
        InvalidBody: if the function is neither a coroutine function nor an async generator, or does
            not take one or two parameters.
    """
    expect_interface(Action, action_type)
    validate_name(name)

    def declare(execute: Callable[P, T]) -> ActionDeclaration[P, T]:
        return ActionDeclaration(action_type, name, execute, options)

    return cast("Declare[G, R, F]", declare)


class BackgroundDeclaration(Generic[H]):
    """A function that runs in the background while ``turtleact serve`` serves its module.

    `turtleact.background` makes one. You can also call the declaration like the function itself.

    Attributes:
        run: The function that was declared.
    """

    def __init__(self, run: Callable[[H], Coroutine[Any, Any, object]]) -> None:
        if not inspect.iscoroutinefunction(run):
            raise TypeError(f"@turtleact.background needs an 'async def', not {run!r}")
        functools.update_wrapper(self, run)
        self.run = run

    def __call__(self, node: H) -> Coroutine[Any, Any, object]:
        """Call the function that was declared."""
        return self.run(node)


def background(run: Callable[[H], Coroutine[Any, Any, object]], /) -> BackgroundDeclaration[H]:
    """Run an ``async def`` in the background while ``turtleact serve`` serves its module.

    Use this as a decorator. ``turtleact serve`` calls the function with the node as soon as the
    module's actions are served. The function is cancelled when the module is reloaded. When the
    server ends, the function is cancelled before the goals end. If the function raises an
    exception, the exception is logged, and the server goes on. Without ``turtleact serve``, nothing
    calls the function, so start it in a task yourself.

    Raises:
        TypeError: if the function is not a coroutine function.
    """
    return BackgroundDeclaration(run)


class Body:
    """A function that can do the work of an action.

    Attributes:
        is_generator: Whether the function yields its feedback and result.

    Raises:
        InvalidBody: if the function cannot be a body.
    """

    __slots__ = ("_function", "_takes_handle", "is_generator")

    def __init__(self, name: str, execute: Callable[..., object]) -> None:
        function: Any = execute.execute if isinstance(execute, ActionDeclaration) else execute
        target = function if _is_function(function) else getattr(function, "__call__", function)  # noqa: B004  # a callable object's own method
        self.is_generator = inspect.isasyncgenfunction(target)
        if not self.is_generator and not inspect.iscoroutinefunction(target):
            raise InvalidBody(name, f"must be an 'async def', not {_kind_of(function)}")
        self._function = function
        self._takes_handle = _count_parameters(name, function) == 2

    def call(self, goal: object, make_handle: Callable[[], object]) -> Any:  # noqa: ANN401
        """Call the user's function, and return its generator or its coroutine."""
        if self._takes_handle:
            return self._function(goal, make_handle())
        return self._function(goal)


def check_declaration(given: object) -> None:
    """Raise TypeError unless an object was declared with `action`."""
    if not isinstance(given, ActionDeclaration):
        if inspect.iscoroutine(given) or inspect.isasyncgen(given):
            problem = "was called already: pass the function itself, without ()"
        else:
            problem = "is no action: declare it with @turtleact.action"
        raise TypeError(f"{getattr(given, '__qualname__', '') or repr(given)} {problem}")


def _is_function(function: Callable[..., object]) -> bool:
    return inspect.isroutine(function) or isinstance(function, functools.partial | type)


def _kind_of(function: object) -> str:
    return "a plain function" if inspect.isroutine(function) else f"a {type(function).__name__}"


def _count_parameters(name: str, function: Callable[..., object]) -> int:
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    count = 0
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind in positional:
            if count < 2 or parameter.default is parameter.empty:
                count += 1
        elif parameter.kind is parameter.KEYWORD_ONLY and parameter.default is parameter.empty:
            raise InvalidBody(name, f"must not require the keyword argument '{parameter.name}'")
    if not 1 <= count <= 2:
        raise InvalidBody(name, f"must take the goal, or the goal and its handle, not {count}")
    return count
