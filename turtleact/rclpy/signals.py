"""Signals: SIGINT and SIGTERM shut every context down.

Python may call a signal handler anywhere in the program, even while the program holds a lock. The
handler therefore only wakes a thread, which shuts the contexts down. The handler then calls the
previously installed handler. For SIGINT, the previous handler is usually Python's own handler,
which raises KeyboardInterrupt.
"""

from __future__ import annotations

import queue
import signal
import threading
from collections.abc import Callable
from enum import IntFlag
from types import FrameType
from typing import TypeAlias

from turtleact.rclpy.impl.process import PROCESS

__all__ = [
    "SignalHandlerOptions",
    "get_current_signal_handlers_options",
    "install_signal_handlers",
    "uninstall_signal_handlers",
]

Handler: TypeAlias = Callable[[int, FrameType | None], object] | int | None


class SignalHandlerOptions(IntFlag):
    """Which signals shut contexts down."""

    NO = 0
    SIGINT = 1
    SIGTERM = 2
    ALL = 3


SIGNALS = {
    SignalHandlerOptions.SIGINT: signal.SIGINT,
    SignalHandlerOptions.SIGTERM: signal.SIGTERM,
}


class _Handlers:
    """Installs and restores signal handlers, and owns the thread that shuts contexts down."""

    def __init__(self) -> None:
        self.installed = SignalHandlerOptions.NO
        self._before: dict[int, Handler] = {}
        self._received: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    def install(self, options: SignalHandlerOptions) -> None:
        """Install handlers for the given signals.

        Python allows this only in the main thread. In other threads, this method does nothing.
        """
        if threading.current_thread() is not threading.main_thread():
            return
        if self._thread is None:
            self._thread = threading.Thread(
                target=self._work, name="turtleact-signals", daemon=True
            )
            self._thread.start()
        for option, number in SIGNALS.items():
            if option in options and option not in self.installed:
                # Known before the signal can come: it must reach the former handler, too.
                self._before[number] = signal.getsignal(number)
                signal.signal(number, self._receive)
                self.installed |= option

    def uninstall(self) -> None:
        """Restore the earlier handlers, unless other code has replaced turtleact's handlers."""
        if threading.current_thread() is not threading.main_thread():
            return
        for option, number in SIGNALS.items():
            if option in self.installed:
                if signal.getsignal(number) == self._receive:
                    signal.signal(number, self._before.pop(number))
                self.installed &= ~option

    def _receive(self, number: int, frame: FrameType | None) -> None:
        self._received.put(number)  # safe even if it interrupts another `put`
        before = self._before.get(number)
        if callable(before):
            before(number, frame)

    def _work(self) -> None:
        while True:
            self._received.get()
            PROCESS.shut_down()


HANDLERS = _Handlers()


def install_signal_handlers(options: SignalHandlerOptions = SignalHandlerOptions.ALL) -> None:
    """Install handlers for the given signals. `rclpy.init` calls this function."""
    HANDLERS.install(options)


def get_current_signal_handlers_options() -> SignalHandlerOptions:
    """Return which signals shut contexts down."""
    return HANDLERS.installed


def uninstall_signal_handlers() -> None:
    """Restore the signal handlers that were set before `install_signal_handlers` was called."""
    HANDLERS.uninstall()
