"""Runs turtleact's event loop in a thread of its own.

The threads of the program never run the loop, and the loop never runs the program's callbacks.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from typing import TypeAlias, TypeVar

from turtleact.tasks import new_event_loop

__all__ = ["EventLoop"]

T = TypeVar("T")
BeginCoroutine: TypeAlias = "Callable[[], Coroutine[object, object, T]]"

SHORTEST = 0.001
"""Delays shorter than this (s) are skipped."""


class EventLoop:
    """An event loop in a daemon thread. The loop starts when it is first used, and never ends."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None

    @property
    def is_here(self) -> bool:
        """Whether the calling thread is the thread that runs the loop."""
        return threading.current_thread() is self._thread

    def call(self, function: Callable[[], T]) -> T:
        """Call a function in the loop, and wait. Return its result, or raise its exception."""
        if self.is_here:
            return function()
        called: Future[T] = Future()

        def call() -> None:
            try:
                called.set_result(function())
            except BaseException as error:
                called.set_exception(error)

        self.post(call)
        return called.result()

    def post(self, function: Callable[[], object]) -> None:
        """Call a function in the loop, after all functions posted earlier. Return at once."""
        self._running().call_soon_threadsafe(function)

    def post_later(self, delay: float, function: Callable[[], object]) -> None:
        """Call a function in the loop after ``delay`` seconds. Return at once."""
        loop = self._running()
        if delay < SHORTEST:
            loop.call_soon_threadsafe(function)
        else:
            loop.call_soon_threadsafe(loop.call_later, delay, function)

    def run(self, begin: BeginCoroutine[T], timeout: float | None = None) -> T:
        """Run the coroutine of ``begin()`` in the loop, wait for its end, and return its result.

        Raises:
            TimeoutError: if the coroutine has not ended in time. The coroutine is then cancelled.
        """
        running = self.start(begin)
        try:
            return running.result(timeout)
        except BaseException:
            running.cancel()
            raise

    def start(self, begin: BeginCoroutine[T]) -> Future[T]:
        """Run the coroutine of ``begin()`` in the loop. Return a future of its result at once."""
        loop = self._running()  # first: a KeyboardInterrupt in it would leave a coroutine unused
        return asyncio.run_coroutine_threadsafe(begin(), loop)

    def _running(self) -> asyncio.AbstractEventLoop:
        if self._loop is None:
            with self._lock:
                if self._loop is None:
                    self._start()
        assert self._loop is not None  # noqa: S101  # `_start` has set it
        return self._loop

    def _start(self) -> None:
        loop = new_event_loop()
        self._thread = threading.Thread(target=loop.run_forever, name="turtleact-loop", daemon=True)
        self._thread.start()
        self._loop = loop
