"""Futures and tasks.

A `Future` stands for a result that may come later, such as the response of a service. A `Task` is
the future of a callback or coroutine that an executor runs. While the coroutine awaits another
future, the executor does not run the task.
"""

from __future__ import annotations

import contextlib
import inspect
import sys
import threading
import warnings
from collections.abc import Callable, Generator
from functools import partial
from weakref import ReferenceType, ref

from turtleact.rclpy.impl.typing import Anything, Subscriptable

__all__ = ["Future", "Task"]


class _Running(threading.local):
    """Holds the task that the current thread is running."""

    task: Task | None = None


RUNNING = _Running()


class Future(Subscriptable):
    """The result or exception of an operation that may not have ended yet.

    Args:
        executor: Runs the done callbacks. Without an executor, the callbacks run in the thread that
            sets the result.
    """

    def __init__(self, *, executor: Anything = None) -> None:
        self._done = False
        self._cancelled = False
        self._result: Anything = None
        self._exception: BaseException | None = None
        self._exception_fetched = False
        self._callbacks: list[Callable[[Anything], object]] = []
        self._parked: list[Task] = []
        self._lock = threading.Lock()
        self._executor: ReferenceType[Anything] | None = None
        self.set_executor(executor)

    def __del__(self) -> None:
        # An object whose __init__ failed has no attributes.
        if getattr(self, "_exception", None) is not None and not self._exception_fetched:
            print(
                f"The following exception was never retrieved: {self._exception}", file=sys.stderr
            )

    def __await__(self) -> Generator[None, None, Anything]:
        # A task of an executor is parked here. Any other caller, such as a task of asyncio, gets
        # None and has to ask again.
        while self._is_pending:
            if RUNNING.task is not None:
                RUNNING.task.awaited = self
            yield
        return self.result()

    @property
    def _is_pending(self) -> bool:
        return not self._done and not self._cancelled

    def cancel(self) -> None:
        """Cancel the future, unless it is done."""
        with self._lock:
            if self._done or self._cancelled:
                return
            self._cancelled = True
        self._tell()

    def cancelled(self) -> bool:
        """Whether the future was cancelled."""
        return self._cancelled

    def done(self) -> bool:
        """Whether the future has a result or an exception."""
        return self._done

    def result(self) -> Anything:
        """Return the result, or None if there is none yet. If there is an exception, raise it."""
        if self._exception is not None:
            self._exception_fetched = True
            raise self._exception
        return self._result

    def exception(self) -> BaseException | None:
        """Return the exception, or None if there is none."""
        self._exception_fetched = True
        return self._exception

    def set_result(self, result: Anything) -> None:
        """Set the result and run the done callbacks."""
        with self._lock:
            self._result = result
            self._done, self._cancelled = True, False
        self._tell()

    def set_exception(self, exception: BaseException) -> None:
        """Set the exception and run the done callbacks."""
        with self._lock:
            self._exception = exception
            self._exception_fetched = False
            self._done, self._cancelled = True, False
        self._tell()

    def add_done_callback(self, callback: Callable[[Anything], object]) -> None:
        """Call ``callback(future)`` when the future is done, or at once if it is done already."""
        with self._lock:
            if self._is_pending:
                self._callbacks.append(callback)
                return
        self._run_callback(callback)

    def remove_done_callback(self, callback: Callable[[Anything], object]) -> bool:
        """Remove a done callback. Return whether the callback was still registered."""
        with self._lock:
            try:
                self._callbacks.remove(callback)
            except ValueError:
                return False
            return True

    def park(self, task: Task) -> bool:
        """Register a task to be resumed when the future is done or cancelled, and return True.

        If the future is done or cancelled already, do nothing and return False.
        """
        with self._lock:
            if self._is_pending:
                self._parked.append(task)
                return True
            return False

    def set_executor(self, executor: Anything) -> None:
        """Choose the executor that runs the done callbacks."""
        self._executor = None if executor is None else ref(executor)

    def _tell(self) -> None:
        with self._lock:
            callbacks, self._callbacks = self._callbacks, []
            parked, self._parked = self._parked, []
        for task in parked:
            task.resume()
        for callback in callbacks:
            self._run_callback(callback)

    def _run_callback(self, callback: Callable[[Anything], object]) -> None:
        executor = None if self._executor is None else self._executor()
        if executor is not None:
            executor.create_task(callback, self)
            return
        try:
            callback(self)
        except Exception as error:
            warnings.warn(f"Unhandled exception in done callback: {error}", stacklevel=2)


class Task(Future):
    """The future of a function or coroutine that an executor runs.

    Calling the task runs the function, or the next step of the coroutine.

    Args:
        handler: A function, a coroutine function, or a coroutine.
        args: The arguments of the function.
        kwargs: The keyword arguments of the function.
        executor: Runs the task and its done callbacks.

    Attributes:
        awaited: The future that the coroutine awaits; None if it awaits something else.
        origin: The entity whose callback the task runs, and its node; None and None if there is no
            entity.
    """

    def __init__(
        self,
        handler: Anything,
        args: tuple[Anything, ...] | None = None,
        kwargs: dict[str, Anything] | None = None,
        executor: Anything = None,
    ) -> None:
        super().__init__(executor=executor)
        self.awaited: Future | None = None
        self.origin: tuple[object, object] = None, None
        self._lock_of_step = threading.Lock()
        if not inspect.iscoroutine(handler):
            is_function = not inspect.iscoroutinefunction(handler)
            call = partial(_call, handler) if is_function else handler
            handler = call(*(args or ()), **(kwargs or {}))
        self._coroutine: Anything = handler

    def __del__(self) -> None:
        # A task that waited for an executor that was shut down: Python would warn that nobody has
        # awaited its coroutine. An object whose __init__ failed has no attributes.
        with contextlib.suppress(RuntimeError, AttributeError):
            self._coroutine.close()
        super().__del__()

    def __call__(self) -> None:
        """Run the function, or the next step of the coroutine.

        If the task is done, cancelled or running, do nothing.
        """
        if not self._is_pending or not self._lock_of_step.acquire(blocking=False):
            return
        before, RUNNING.task, self.awaited = RUNNING.task, self, None
        try:
            if self._is_pending:
                self._step()
        finally:
            RUNNING.task = before
            self._lock_of_step.release()
        # Only now that the lock is free may another thread run the next step, which it does as soon
        # as the task is parked or resumed. The future may have become done since the step: then
        # `park` refuses.
        if self._is_pending and (self.awaited is None or not self.awaited.park(self)):
            self.resume()

    def _step(self) -> None:
        try:
            self._coroutine.send(None)
        except StopIteration as end:
            self.set_result(end.value)
        except Exception as error:
            self.set_exception(error)

    def resume(self) -> None:
        """Make the executor run the next step of the coroutine."""
        executor = None if self._executor is None else self._executor()
        if executor is not None:
            executor.resume(self)

    def executing(self) -> bool:
        """Whether a thread is running the task at the moment."""
        return self._lock_of_step.locked()

    def cancel(self) -> None:
        """Cancel the task, unless it is done. The executor runs no further step of a coroutine."""
        super().cancel()
        if self.cancelled() and not self.executing():
            with contextlib.suppress(Exception):
                self._coroutine.close()


async def _call(function: Anything, /, *args: Anything, **kwargs: Anything) -> Anything:
    return function(*args, **kwargs)
