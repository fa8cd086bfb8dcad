"""Executors run the callbacks of nodes, one at a time or in several threads.

These executors have no wait set, unlike those of the genuine rclpy. A message, request or response
wakes the executor, and waits in a queue of its subscription, service or client until the executor
takes it. An executor works in rounds. In a round, it serves each ready entity once: first the
waitables of all nodes, then the timers, subscriptions, guard conditions, clients and services of
each node. Before it serves an entity, it runs the tasks that can continue.

The spinning thread waits until an entity is ready, reserves the entity's callback group, and takes
the entity's data. The callback itself may run in another thread. Several threads may spin one
executor at the same time, because a callback may spin the executor that runs it. Each thread
therefore pops from a queue without checking first whether the queue is empty. Each thread also
remembers how many calls of `wake` it has seen. Nodes, tasks and callback groups have their own
locks. A thread that holds one of these locks runs no callback and takes no second lock.
"""

from __future__ import annotations

import os
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeAlias

from turtleact.rclpy.context import Context, get_default_context
from turtleact.rclpy.exceptions import InvalidHandle
from turtleact.rclpy.impl.entity import (
    BLOCKED_AFTER,
    NOTHING,
    Block,
    BusyThreads,
    CallbackGroup,
    Entity,
    note_blocked,
)
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.task import Future, Task

__all__ = [
    "ConditionReachedException",
    "Executor",
    "ExternalShutdownException",
    "MultiThreadedExecutor",
    "ShutdownException",
    "SingleThreadedExecutor",
    "TimeoutException",
]

Work: TypeAlias = tuple[Task, object, object]
"""A task to run, with the entity and the node of the task, if any."""

LONGEST_LOCK = 0.5
"""The maximum duration of a single wait for a lock (s).

A signal interrupts the wait, unless the signal arrives right before the wait, or the system is
Windows. In these cases, Python calls the signal handler only after the wait.
"""


class TimeoutException(Exception):
    """No callback was ready in time."""


class ShutdownException(Exception):
    """The executor was shut down."""


class ExternalShutdownException(Exception):
    """The context was shut down."""


class ConditionReachedException(Exception):
    """The condition that was passed to `Executor.wait_for_ready_callbacks` is true."""


def _never() -> bool:
    return False


class Executor(Block):
    """The base class of executors. A subclass defines `_spin_once`.

    Args:
        context: The context. If the context is shut down, the executor stops spinning. None means
            the default context.
    """

    def __init__(self, *, context: Context | None = None) -> None:
        self._context = get_default_context() if context is None else context
        self._nodes: dict[Anything, None] = {}
        self._nodes_lock = threading.RLock()
        self._is_shutdown = False
        self._wake = threading.Condition(threading.Lock())
        self._wakes = 0
        self._ready: deque[Task] = deque()  # those whose next step can run
        self._round: deque[tuple[Anything, Entity]] = deque()
        self._work = BusyThreads()
        self._context.on_shutdown(self.wake)

    @property
    def context(self) -> Context:
        """The context of the executor."""
        return self._context

    # tasks

    def create_task(self, callback: Anything, *args: Anything, **kwargs: Anything) -> Task:
        """Schedule a function or coroutine to run during `spin`, and return its task."""
        task = Task(callback, args, kwargs, executor=self)
        self.resume(task)
        return task

    def resume(self, task: Task) -> None:
        """Schedule a task, or its next step, to run during `spin`. Any thread may call this."""
        self._ready.append(task)
        self.wake()

    # nodes

    def add_node(self, node: Anything) -> bool:
        """Run the callbacks of a node from now on. Return False if the node was added before."""
        with self._nodes_lock:
            if node in self._nodes:
                return False
            self._nodes[node] = None
        # Without the lock: this takes that of the executor that has had the node until now. Two
        # executors that take nodes from each other would wait for each other for ever.
        node.executor = self
        self.wake()
        return True

    def remove_node(self, node: Anything) -> None:
        """Stop running the callbacks of a node."""
        with self._nodes_lock:
            self._nodes.pop(node, None)
        self.wake()

    def get_nodes(self) -> list[Anything]:
        """Return the nodes of the executor."""
        with self._nodes_lock:
            return list(self._nodes)

    def wake(self) -> None:
        """Make the executor check which callbacks are ready. Any thread may call this."""
        with self._wake:
            self._wakes += 1
            self._wake.notify_all()

    # ending

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Stop spinning, and wait until all running callbacks have ended.

        Args:
            timeout_sec: How long to wait (s). None or a negative number means for ever.

        Returns:
            Whether all callbacks have ended.
        """
        self._is_shutdown = True
        self.wake()
        if not self._work.wait_for_others(timeout_sec):
            return False
        with self._nodes_lock:
            self._nodes.clear()
        self._round.clear()
        return True

    def _leave(self) -> None:
        self.shutdown()

    # spinning

    def spin(self) -> None:
        """Run callbacks until the executor or its context is shut down."""
        while self._context.ok() and not self._is_shutdown:
            self.spin_once()

    def spin_until_future_complete(self, future: Future, timeout_sec: float | None = None) -> None:
        """Run callbacks until a future is done, the time is over, or the context is shut down.

        Args:
            future: The future.
            timeout_sec: The longest time to run callbacks (s). None or a negative number means for
                ever.
        """
        future.add_done_callback(self._future_done)
        end = _end_of(timeout_sec)
        while self._context.ok() and not self._is_shutdown and not _is_over(future):
            self._spin_once(None if end is None else max(0.0, end - time.monotonic()), future)
            if end is not None and time.monotonic() >= end:
                return

    def _future_done(self, _: Future) -> None:
        self.wake()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait until a callback is ready, and run it. An exception of a callback is raised again.

        Args:
            timeout_sec: How long to wait (s). None or a negative number means for ever.
        """
        self._spin_once(timeout_sec)

    def spin_once_until_future_complete(
        self, future: Future, timeout_sec: float | None = None
    ) -> None:
        """Wait until a callback is ready, and run it, unless a future is done first."""
        future.add_done_callback(self._future_done)
        self._spin_once(timeout_sec, future)

    def _spin_once(self, timeout_sec: float | None, future: Future | None = None) -> None:
        raise NotImplementedError

    def can_execute(self, entity: Entity) -> bool:
        """Whether the callback group of an entity lets the entity's callback run now."""
        return entity.callback_group.can_execute(entity)

    def wait_for_ready_callbacks(
        self,
        timeout_sec: float | None = None,
        condition: Callable[[], bool] = _never,
    ) -> Work:
        """Wait for the next task, and return it with its entity and its node.

        The caller runs the task by calling it.

        Raises:
            TimeoutException: if no task is ready in time.
            ShutdownException: if the executor is shut down.
            ExternalShutdownException: if the context is shut down.
            ConditionReachedException: if ``condition()`` is true.
        """
        end = _end_of(timeout_sec)
        while True:
            if self._is_shutdown:
                raise ShutdownException
            if not self._context.ok():
                raise ExternalShutdownException
            if condition():
                raise ConditionReachedException
            seen = self._wakes  # `_sleep` notices whatever comes from now on
            work = self._next_task() or self._next_entity()
            if work is not None:
                return work
            if end is not None and time.monotonic() >= end:
                raise TimeoutException
            self._sleep(seen, end)

    def _wait_for_ready_callbacks(self, **options: Anything) -> Iterator[Work]:
        """Call `wait_for_ready_callbacks` again and again, and yield each result."""
        while True:
            yield self.wait_for_ready_callbacks(**options)

    def _next_task(self) -> Work | None:
        """Return a task whose next step can run; None if there is none."""
        while self._ready:
            try:
                task = self._ready.popleft()
            except IndexError:  # another thread has taken it
                return None
            if not task.done() and not task.cancelled():
                return task, *task.origin
        return None

    def _next_entity(self) -> Work | None:
        """Return a task for the next entity that is ready, in this round or in a new one."""
        work = self._next_in_round()
        if work is None:
            self._round.extend(_in_order(self.get_nodes()))
            work = self._next_in_round()
        return work

    def _next_in_round(self) -> Work | None:
        while self._round:
            try:
                node, entity = self._round.popleft()
            except IndexError:  # another thread has taken it
                return None
            work = self._begin(node, entity) if entity.is_ready_now() else None
            if work is not None:
                return work
        return None

    def _begin(self, node: Anything, entity: Entity) -> Work | None:
        """Return a task that runs an entity's callback; None if the callback cannot run now."""
        group = entity.callback_group
        if not self.can_execute(entity) or not group.beginning_execution(entity):
            note_blocked(entity)
            return None
        entity.blocked_since = 0.0
        # Only now that the group is reserved: whatever is taken here is sure to be handled. Another
        # thread that spins may have been faster; then there is nothing to take, and no task.
        try:
            taken = entity.take()
        except BaseException:
            group.ending_execution(entity)
            raise
        if taken is NOTHING:
            group.ending_execution(entity)
            return None
        task = Task(self._run(entity, taken, group), executor=self)
        task.origin = entity, node
        return task, entity, node

    async def _run(self, entity: Entity, taken: Anything, group: CallbackGroup) -> None:
        try:
            await entity.run(taken)
        finally:
            group.ending_execution(entity)
            self.wake()  # others of the group may run now

    def _is_from_shutdown(self, error: BaseException) -> bool:
        """Whether a callback failed because the context was shut down while the callback ran.

        For example, a signal shuts the context down, which destroys a publisher that the callback
        is about to use.
        """
        return isinstance(error, InvalidHandle) and not self._context.ok()

    def _sleep(self, seen: int, end: float | None) -> None:
        """Wait until `wake` is called, until an entity is due, or until ``end``.

        ``end`` is a time of `time.monotonic` (s). ``seen`` is the number of calls of `wake` that
        the calling thread has noticed. If `wake` has been called more than ``seen`` times, return
        at once. A count is used, not a flag, because several threads may spin at the same time. If
        one thread cleared a flag, the other threads would miss the call of `wake`.
        """
        now = time.monotonic()
        left = None if end is None else end - now
        for _, entity in _in_order(self.get_nodes()):
            due = entity.due_in()
            if entity.blocked_since > 0:
                due = max(0.01, entity.blocked_since + BLOCKED_AFTER - now)
            elif due == 0 and entity.is_ready_now() and not self.can_execute(entity):
                continue  # its group wakes this executor
            if due is not None and (left is None or due < left):
                left = due
        with self._wake:
            if self._wakes != seen or (left is not None and left <= 0):
                return
            self._wake.wait(LONGEST_LOCK if left is None else min(left, LONGEST_LOCK))


class SingleThreadedExecutor(Executor):
    """Runs callbacks in the thread that spins."""

    def _spin_once(self, timeout_sec: float | None, future: Future | None = None) -> None:
        condition = _never if future is None else lambda: _is_over(future)
        try:
            task, _, _ = self.wait_for_ready_callbacks(timeout_sec, condition)
        except (ShutdownException, TimeoutException, ConditionReachedException):
            return
        with self._work:
            task()
        error = task.exception() if task.done() else None
        if error is not None and self._is_from_shutdown(error):
            raise ExternalShutdownException from error
        if error is not None:
            raise error


class MultiThreadedExecutor(Executor):
    """Runs callbacks in a pool of threads.

    Args:
        num_threads: The number of threads. None means the number of cores that this process may
            use, but at least 2.
        context: The context; see `Executor`.
    """

    def __init__(self, num_threads: int | None = None, *, context: Context | None = None) -> None:
        super().__init__(context=context)
        if num_threads is None:
            num_threads = max(2, os.cpu_count() or 0)
        if num_threads == 1:
            warnings.warn(
                "a MultiThreadedExecutor with one thread: use a SingleThreadedExecutor instead",
                stacklevel=2,
            )
        self._executor = ThreadPoolExecutor(num_threads, thread_name_prefix="rclpy")
        self._failed: deque[Task] = deque()  # those whose exceptions were not raised yet
        self._context.on_shutdown(self._let_threads_end)

    def shutdown(self, timeout_sec: float | None = None, *, wait_for_threads: bool = True) -> bool:
        """Stop spinning, and wait until all running callbacks have ended.

        Args:
            timeout_sec: How long to wait (s). None or a negative number means for ever.
            wait_for_threads: Whether to wait for the end of the pool's threads as well.
        """
        if not super().shutdown(timeout_sec):
            return False
        self._executor.shutdown(wait=wait_for_threads and not self._is_own_thread())
        return True

    def _let_threads_end(self) -> None:
        """Let idle threads end, because the interpreter waits for them before it exits."""
        self._executor.shutdown(wait=False)

    def _is_own_thread(self) -> bool:
        return threading.current_thread().name.startswith("rclpy_")

    def _spin_once(self, timeout_sec: float | None, future: Future | None = None) -> None:
        def condition() -> bool:
            return bool(self._failed) or (future is not None and _is_over(future))

        try:
            task, _, _ = self.wait_for_ready_callbacks(timeout_sec, condition)
        except (
            ExternalShutdownException,
            ShutdownException,
            TimeoutException,
            ConditionReachedException,
        ):
            pass
        else:
            try:
                self._executor.submit(self._work_on, task)
            except RuntimeError:  # the pool was shut down
                task.cancel()
        if self._failed:
            self._failed.popleft().result()

    def _work_on(self, task: Task) -> None:
        with self._work:
            task()
        error = task.exception() if task.done() else None
        if error is not None and not self._is_from_shutdown(error):
            self._failed.append(task)
            self.wake()


def _in_order(nodes: list[Anything]) -> Iterator[tuple[Anything, Entity]]:
    """Yield each entity of the nodes with its node, in the order of execution."""
    for node in nodes:
        for waitable in node.held_entities[0]:
            yield node, waitable
    for node in nodes:
        for entities in node.held_entities[1:]:
            for entity in entities:
                yield node, entity


def _is_over(future: Future) -> bool:
    return future.done() or future.cancelled()


def _end_of(timeout_sec: float | None) -> float | None:
    """Return when a timeout ends (s, `time.monotonic`). None or less than 0 means never."""
    is_endless = timeout_sec is None or timeout_sec < 0
    return None if timeout_sec is None or is_endless else time.monotonic() + timeout_sec
