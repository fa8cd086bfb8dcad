"""The base class of entities, such as timers and subscriptions, and what decides when they run.

Executors serve entities. A callback group decides which callbacks may run at the same time. This
module also has guard conditions, which are the simplest entities, and functions that block a thread
until another thread has run a callback.
"""

from __future__ import annotations

import inspect
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import Self
from weakref import WeakSet

import msgspec

from turtleact.rclpy.exceptions import InvalidHandle
from turtleact.rclpy.impl.typing import Anything, Subscriptable
from turtleact.rclpy.logging import RcutilsLogger
from turtleact.rclpy.qos import QoSProfile
from turtleact.rclpy.task import Future
from turtleact.transports.base import Endpoint

__all__ = [
    "BLOCKED_AFTER",
    "NOTHING",
    "Block",
    "BusyThreads",
    "CallbackGroup",
    "Destroyable",
    "EndSpec",
    "Entity",
    "GuardCondition",
    "Handle",
    "MutuallyExclusiveCallbackGroup",
    "QueueEntity",
    "ReentrantCallbackGroup",
    "Waitable",
    "await_or_execute",
    "note_blocked",
    "wait_for_answer",
    "wait_until",
]

logger = RcutilsLogger("rclpy")

NOTHING = object()
"""The result of `Entity.take` if there was nothing to take after all."""

BLOCKED_AFTER = 2.0
"""How long a callback waits for its callback group before it is reported (s)."""

REPORTED = -1.0
"""The value of `Entity.blocked_since` for an entity that was reported."""

HINT = "give one of them a ReentrantCallbackGroup or a MutuallyExclusiveCallbackGroup of its own"

POLL = 0.02
"""The interval at which `wait_until` checks its condition (s)."""

PATIENCE = 0.5
"""The longest wait between two checks (s), because a signal cannot always interrupt a wait."""


class Block:
    """A context manager that returns itself, and calls `_leave` at the end of the block."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._leave()

    def _leave(self) -> None:
        """Clean up at the end of the block."""


class BusyThreads(Block):
    """The threads that run ``with`` blocks of this object."""

    def __init__(self) -> None:
        self._threads: list[int] = []
        self._changed = threading.Condition()

    def __enter__(self) -> Self:
        with self._changed:
            self._threads.append(threading.get_ident())
        return self

    def _leave(self) -> None:
        with self._changed:
            self._threads.remove(threading.get_ident())
            self._changed.notify_all()

    def wait_for_others(self, timeout: float | None) -> bool:
        """Wait until no other thread runs a block. Return False if the timeout ends first.

        Args:
            timeout: How long to wait (s). None or a negative number means for ever.
        """
        own = {threading.get_ident()}
        limit = None if timeout is None or timeout < 0 else timeout
        with self._changed:
            return self._changed.wait_for(lambda: own.issuperset(self._threads), limit)


class Handle(Block):
    """Shows whether an object may still be used.

    A ``with`` block of the handle raises `InvalidHandle` at its start if the object was destroyed.

    Args:
        close: Closes the object; called once.

    Attributes:
        is_destroyed: Whether the object was destroyed.
    """

    def __init__(self, close: Callable[[], object] | None = None) -> None:
        self._close = close
        self._lock = threading.Lock()
        self.is_destroyed = False

    def check(self) -> None:
        """Check that the object was not destroyed.

        Raises:
            InvalidHandle: if the object was destroyed.
        """
        if self.is_destroyed:
            raise InvalidHandle("cannot use Destroyable because destruction was requested")

    def destroy_when_not_in_use(self) -> None:
        """Destroy and close the object. A second call does nothing."""
        with self._lock:
            is_first, self.is_destroyed = not self.is_destroyed, True
        if is_first and self._close is not None:
            self._close()

    def __enter__(self) -> Self:
        self.check()
        return self


class Destroyable(Block):
    """An object that can be destroyed.

    As a context manager, it destroys itself at the end of the block.

    Args:
        close: Called once, when the object is destroyed.

    Attributes:
        handle: Shows whether the object has been destroyed.
    """

    def __init__(self, close: Callable[[], object] | None = None) -> None:
        self.handle = Handle(close)

    def destroy(self) -> None:
        """Destroy the object. A second call does nothing."""
        self.handle.destroy_when_not_in_use()

    def _leave(self) -> None:
        self.destroy()


class CallbackGroup:
    """The base class of callback groups. All callbacks of this one may run at the same time.

    Attributes:
        entities: The entities of the group, held weakly.
    """

    def __init__(self) -> None:
        self.entities = WeakSet[Entity]()

    def add_entity(self, entity: Entity) -> None:
        """Add an entity to the group."""
        self.entities.add(entity)

    def has_entity(self, entity: Entity) -> bool:
        """Whether an entity belongs to the group."""
        return entity in self.entities

    def can_execute(self, entity: Entity) -> bool:  # noqa: ARG002  # any entity
        """Whether a callback of the entity may begin now."""
        return True

    def beginning_execution(self, entity: Entity) -> bool:  # noqa: ARG002  # any entity
        """Reserve the group for a callback of the entity. Return False if the group is not free."""
        return True

    def ending_execution(self, entity: Entity) -> None:
        """Mark the group as free, because the callback of the entity has ended."""


class ReentrantCallbackGroup(CallbackGroup):
    """Lets all callbacks run at the same time."""


class MutuallyExclusiveCallbackGroup(CallbackGroup):
    """Lets one callback run at a time.

    If the callback is a coroutine, the next callback may run only after the coroutine has ended.

    Attributes:
        active_entity: The entity with the callback that runs now; None if no callback runs.
    """

    def __init__(self) -> None:
        super().__init__()
        self.active_entity: Entity | None = None
        self._lock = threading.Lock()

    def can_execute(self, entity: Entity) -> bool:  # noqa: ARG002  # any entity
        """Whether a callback of the entity may begin now."""
        return self.active_entity is None

    def beginning_execution(self, entity: Entity) -> bool:
        """Reserve the group for a callback of the entity. Return False if the group is not free."""
        with self._lock:
            if self.active_entity is None:
                self.active_entity = entity
                return True
            return False

    def ending_execution(self, entity: Entity) -> None:  # noqa: ARG002  # the active one
        """Mark the group as free, because the callback of the entity has ended."""
        self.active_entity = None


class Entity(Destroyable):
    """A source of callbacks: a timer, subscription, guard condition, client, service or waitable.

    Args:
        callback_group: Decides when the callback of the entity may run.
        close: Called once, when the entity is destroyed.
        wake: Called in any thread when the entity may have become ready.

    Attributes:
        callback_group: The callback group of the entity.
        blocked_since: When the entity began to wait for its callback group (s, `time.monotonic`); 0
            if it does not wait, and -1 after a warning about the wait.
    """

    def __init__(
        self,
        callback_group: CallbackGroup,
        *,
        close: Callable[[], object] | None = None,
        wake: Callable[[], object] | None = None,
    ) -> None:
        super().__init__(close)
        self.callback_group = callback_group
        self.blocked_since = 0.0
        self._wake = wake
        callback_group.add_entity(self)

    def wake(self) -> None:
        """Make the executor check whether the entity is ready."""
        if self._wake is not None:
            self._wake()

    def is_ready_now(self) -> bool:
        """Whether there is something for the callback to handle now. This never blocks."""
        raise NotImplementedError

    def due_in(self) -> float | None:
        """Return the time until the entity is ready (s).

        Return None if the entity's readiness does not depend on time alone.
        """
        return None

    def take(self) -> Anything:
        """Return the next argument for the callback; `NOTHING` if another thread has taken it."""
        raise NotImplementedError

    async def run(self, taken: Anything) -> None:
        """Run the callback."""
        raise NotImplementedError

    def describe(self) -> str:
        """Describe this entity for a diagnostic message, such as "the timer of 0.5 s"."""
        return type(self).__name__.lower()


class EndSpec(msgspec.Struct, frozen=True):
    """What a publisher, subscription, client or service is made from.

    Attributes:
        node: The node.
        endpoint: Describes the entity on the graph.
        interface: The class of the messages, or of the service.
        name: The name of the topic or service, as the program gave it.
        qos: The quality of service.
        callback_group: Decides when callbacks may run.
        events: The callbacks for events of a topic.
    """

    node: Anything
    endpoint: Endpoint
    interface: Anything
    name: str
    qos: QoSProfile
    callback_group: CallbackGroup
    events: Anything = None


class QueueEntity(Entity):
    """An entity with a queue of what its callback has to handle, which any thread may fill.

    A deque needs no lock: with a full one, appending drops the oldest item in one step.

    Args:
        callback_group: Decides when the callback of the entity may run.
        depth: The length of the queue; None for no limit.
        close: Called once, when the entity is destroyed.
        wake: Called in any thread when the entity may have become ready.
    """

    def __init__(
        self,
        callback_group: CallbackGroup,
        *,
        depth: int | None = None,
        close: Callable[[], object] | None = None,
        wake: Callable[[], object] | None = None,
    ) -> None:
        super().__init__(callback_group, close=close, wake=wake)
        self._waiting: deque[Anything] = deque(maxlen=depth)

    def put(self, item: Anything) -> None:
        """Queue an item, and wake the executor."""
        self._waiting.append(item)
        self.wake()

    def is_ready_now(self) -> bool:
        """Whether an item waits; False after `destroy`."""
        return bool(self._waiting) and not self.handle.is_destroyed

    def take(self) -> Anything:
        """Remove and return the oldest item."""
        try:
            return self._waiting.popleft()
        except IndexError:
            return NOTHING


class Waitable(Subscriptable, Entity):
    """The base class of action servers, action clients and event handlers.

    turtleact has no wait sets, so programs cannot define waitables of their own.
    """


class GuardCondition(Entity):
    """Makes an executor call a function once after a call of `trigger`.

    Make a guard condition with `Node.create_guard_condition`.
    """

    def __init__(
        self,
        callback: Anything,
        callback_group: CallbackGroup,
        wake: Callable[[], object] | None = None,
    ) -> None:
        super().__init__(callback_group, wake=wake)
        self.callback = callback
        self._is_triggered = False

    def trigger(self) -> None:
        """Make an executor call the function soon. Any thread may call this."""
        self.handle.check()
        self._is_triggered = True
        self.wake()

    def is_ready_now(self) -> bool:
        """Whether the condition was triggered."""
        return self._is_triggered and not self.handle.is_destroyed

    def take(self) -> Anything:
        """Forget that the condition was triggered; return `NOTHING` if it was not."""
        was_triggered, self._is_triggered = self._is_triggered, False
        return None if was_triggered else NOTHING

    async def run(self, taken: None) -> None:  # noqa: ARG002  # nothing to take
        """Call the callback of the guard condition."""
        if self.callback is not None:
            await await_or_execute(self.callback)

    def describe(self) -> str:
        """Return a description of this entity for a diagnostic message."""
        return "a guard condition"


async def await_or_execute(callback: Anything, *args: Anything) -> Anything:
    """Call a function, and return its result.

    If the function returns a coroutine, await the coroutine, and return the coroutine's result.
    """
    result = callback(*args)
    return await result if inspect.iscoroutine(result) else result


def note_blocked(entity: Entity) -> None:
    """Record that an entity waits for its callback group. Warn once if the wait lasts too long."""
    now = time.monotonic()
    if not entity.blocked_since:
        entity.blocked_since = now
    elif entity.blocked_since > 0 and now - entity.blocked_since >= BLOCKED_AFTER:
        entity.blocked_since = REPORTED
        holder = _holder(entity)
        if holder is not None:
            logger.warning(
                f"{entity.describe()} has waited for {BLOCKED_AFTER:g} s: its callback group is "
                f"held by {holder.describe()}, whose callback has not ended; {HINT}"
            )


def _holder(entity: Entity) -> Entity | None:
    group = entity.callback_group
    return group.active_entity if isinstance(group, MutuallyExclusiveCallbackGroup) else None


def wait_until(
    is_there: Callable[[], bool], timeout: float | None, is_ok: Callable[[], bool]
) -> bool:
    """Check again and again until a condition is true. Return whether it became true.

    Args:
        is_there: The condition.
        timeout: How long to check (s). None means for ever.
        is_ok: Returns whether to continue the wait.
    """
    end = math.inf if timeout is None else time.monotonic() + timeout
    while is_ok() and not is_there():
        left = min(POLL, end - time.monotonic())
        if left <= 0:
            break
        time.sleep(left)
    return is_there()


def wait_for_answer(
    entity: Entity,
    what: str,
    future: Future,
    is_ok: Callable[[], bool],
    timeout: float | None = None,
) -> bool:
    """Wait until an answer has been handled. Return False if the wait ended before that.

    If the answer is there, but is not handled for a long time, a warning says why.

    Args:
        entity: The entity that handles the answer.
        what: The name of the waiting function, for the warning.
        future: The future of the answer, which is done when the answer has been handled.
        is_ok: Returns whether to continue the wait.
        timeout: How long to wait (s). None or a negative number means for ever.
    """
    answered = threading.Event()
    future.add_done_callback(lambda _: answered.set())
    now = time.monotonic()
    end = math.inf if timeout is None or timeout < 0 else now + timeout
    warn_at = now + BLOCKED_AFTER
    while is_ok():
        if answered.wait(max(0.0, min(PATIENCE, end - now))):
            return True
        now = time.monotonic()
        if now >= end:
            return False
        if now >= warn_at and entity.is_ready_now():
            warn_at = math.inf
            _warn_about_wait(entity, what)
    return False


def _warn_about_wait(entity: Entity, what: str) -> None:
    holder = _holder(entity)
    reason = (
        f"the callback group of {entity.describe()} is held by {holder.describe()}; {HINT}"
        if holder is not None
        else "nobody spins the node; spin it in another thread, or with a MultiThreadedExecutor"
    )
    logger.warning(
        f"{what} has waited for {BLOCKED_AFTER:g} s: the response is there, but {reason}"
    )
