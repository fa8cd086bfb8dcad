"""Clients and subscriptions that were opened without a type.

`Node.action_client`, `Node.service_client` and `Node.subscription` return these objects for a name
alone. Opening them asks nobody. The type is learned when the object is first awaited or read, and
from then on a client or subscription of this type does the work. A goal or a request may be a
mapping, because its class is not known before.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Generator, Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Generic, Self, TypedDict, TypeVar

import anyio

from turtleact.errors import ServerUnavailable, TurtleactError
from turtleact.goals.client import ActionClient
from turtleact.interfaces import Message, from_dict
from turtleact.node.learning import Learner
from turtleact.node.services import ServiceClient
from turtleact.node.topics import Subscription
from turtleact.transports.base import AsyncCloseable, Owner, find_server, wait_until_served
from turtleact.transports.graph import Kind

if TYPE_CHECKING:
    import uuid

    from turtleact.goals.client_handle import ClientGoalHandle
    from turtleact.goals.service_server import Introspection
    from turtleact.interfaces.standard import CancelGoal, Time

__all__ = ["CLASSES", "UntypedActionClient", "UntypedServiceClient", "UntypedSubscription"]

T = TypeVar("T", bound=AsyncCloseable)


class ClientOptions(TypedDict, total=False):
    """The options of `Node.action_client`."""

    cancel_timeout: float | None
    introspection: Introspection | None


class Untyped(Generic[T]):
    """What is common to all: something is opened with the type that a name has.

    Args:
        kind: Whether the name belongs to an action, a service or a topic.
        name: The full name.
        learner: Learns the type.
        owner: Closes this object when the node closes.
        open: Opens what does the work, with the class of the type and the name.

    Attributes:
        name: The full name.
        is_open: Whether this object can still be used.
    """

    def __init__(
        self, kind: Kind, name: str, learner: Learner, owner: Owner, open: Callable[[Any, str], T]
    ) -> None:
        self.is_open = True
        self._kind: Final = kind
        self.name: Final = name
        self._learner = learner
        self._open = open
        self._opened: T | None = None
        self._lock = anyio.Lock()
        self._waits = set[anyio.CancelScope]()
        self._membership = owner.add(self, lambda: None)  # it has no endpoint yet

    async def aclose(self) -> None:
        """Close this object. A second call does nothing."""
        self.is_open = False
        for scope in self._waits:
            scope.cancel()
        self._membership.close()
        if self._opened is not None:
            await self._opened.aclose()

    def _find(self) -> object | None:
        return self._learner.uses(self.name, self._kind) or None

    async def _typed(self) -> T:
        """Learn the type at the first call, and return what does the work.

        Raises:
            ServerUnavailable: if nobody serves the name.
            TurtleactError: if this object is closed, now or meanwhile. Other errors are those of
                `turtleact.learn_interface`.
        """
        with anyio.CancelScope() as scope:
            self._waits.add(scope)
            try:
                async with self._lock:
                    if self._opened is None and self.is_open:
                        self._opened = self._open(await self._learn(), self.name)
            finally:
                self._waits.discard(scope)
        if self._opened is None:
            raise TurtleactError(f"the client of {self._kind} '{self.name}' is closed")
        return self._opened

    async def _learn(self) -> object:
        transport = self._learner.transport
        if self._kind == "topic":
            await wait_until_served(transport, self._find, None)
        elif await find_server(transport, self._find) is None:
            raise ServerUnavailable(self.name, "no server answers", kind=self._kind)
        return await self._learner.wait_for(self.name, self._kind)


class UntypedActionClient(Untyped[ActionClient[Any, Any, Any]]):
    """An `ActionClient` whose type is learned at the first await."""

    @property
    def action_type(self) -> Any:  # noqa: ANN401  # as of `get_action`
        """The action, once it is known; before that, this raises `TurtleactError`."""
        if self._opened is None:
            problem = f"the type of action '{self.name}' is not known before the first await"
            raise TurtleactError(problem)
        return self._opened.action_type

    def send_goal(self, goal: Message | Mapping[str, object], **options: Any) -> Later:  # noqa: ANN401
        """Send a goal, which may be a mapping; see `ActionClient.send_goal`."""

        def send(client: ActionClient[Any, Any, Any]) -> Any:  # noqa: ANN401
            made = _message(client.action_type.Goal, goal, "goal")
            return client.send_goal(made, **options)

        return Later(self._typed, send)

    def attach(self, goal_id: bytes | uuid.UUID) -> Later:
        """Attach to a goal that somebody else sent; see `ActionClient.attach`."""
        return Later(self._typed, lambda client: client.attach(goal_id))

    async def wait_for_server(self, timeout: float | None = None) -> bool:
        """Wait until a server exists, and learn the type; see `ActionClient.wait_for_server`."""
        if not await wait_until_served(self._learner.transport, self._find, timeout):
            return False
        return await (await self._typed()).wait_for_server(timeout)

    async def cancel_all(self) -> CancelGoal.Response:
        """Ask the server to cancel every goal of the action."""
        return await (await self._typed()).cancel_all()

    async def cancel_before(self, stamp: Time) -> CancelGoal.Response:
        """Ask the server to cancel every goal accepted at or before ``stamp``."""
        return await (await self._typed()).cancel_before(stamp)


class UntypedServiceClient(Untyped[ServiceClient[Any, Any]]):
    """A `ServiceClient` whose type is learned at the first await."""

    async def call(
        self, request: Message | Mapping[str, object], timeout: float | None = None
    ) -> Any:  # noqa: ANN401  # a response of the learned type
        """Send a request, which may be a mapping; see `ServiceClient.call`."""
        client = await self._typed()
        return await client.call(_message(client.service_type.Request, request, "request"), timeout)

    async def wait_for_service(self, timeout: float | None = None) -> bool:
        """Wait until a server exists; see `ServiceClient.wait_for_service`."""
        if not await wait_until_served(self._learner.transport, self._find, timeout):
            return False
        return await (await self._typed()).wait_for_service(timeout)


class UntypedSubscription(Untyped[Subscription[Any]]):
    """A `Subscription` whose type is learned when it is first read.

    Reading waits without a limit until a node uses the topic.
    """

    @property
    def topic(self) -> str:
        """The fully qualified name of the topic."""
        return self.name

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Any:  # noqa: ANN401  # a message of the learned type
        try:
            subscription = await self._typed()
        except TurtleactError:
            if self.is_open:
                raise
            raise StopAsyncIteration from None
        return await anext(subscription)


class Later:
    """A goal of a client whose type is still to be learned: ``await`` it or use ``async with``."""

    def __init__(
        self,
        typed: Callable[[], Awaitable[ActionClient[Any, Any, Any]]],
        send: Callable[[ActionClient[Any, Any, Any]], Any],
    ) -> None:
        self._typed = typed
        self._send = send
        self._entered: Any = None

    def __await__(self) -> Generator[object, object, Any]:
        return self._run().__await__()

    async def __aenter__(self) -> ClientGoalHandle[Any, Any]:
        self._entered = self._send(await self._typed())
        handle: ClientGoalHandle[Any, Any] = await self._entered.__aenter__()
        return handle

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Leave the block, as for a goal of a client with a type."""
        await self._entered.__aexit__(kind, error, traceback)

    async def _run(self) -> Any:  # noqa: ANN401  # a result of the learned type
        return await self._send(await self._typed())


def _message(cls: Any, given: Message | Mapping[str, object], root: str) -> Any:  # noqa: ANN401
    return from_dict(cls, given, root=root) if isinstance(given, Mapping) else given


CLASSES: Final[dict[Kind, type[Untyped[Any]]]] = {
    "action": UntypedActionClient,
    "service": UntypedServiceClient,
    "topic": UntypedSubscription,
}
