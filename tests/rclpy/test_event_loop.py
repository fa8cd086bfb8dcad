"""The thread that runs turtleact's event loop."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
import time
from concurrent.futures import Future
from typing import Any

import pytest

from turtleact.rclpy.impl import event_loop
from turtleact.rclpy.impl.event_loop import EventLoop
from turtleact.tasks import new_event_loop


@pytest.fixture
def loop():
    return EventLoop()


def in_thread(function) -> Any:
    """Return what the function returns in a thread that nothing waits for if it hangs."""
    done: Future[Any] = Future()

    def run() -> None:
        try:
            done.set_result(function())
        except OSError as error:
            done.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return done.result(2)


def test_a_loop_that_cannot_be_made_is_an_error_and_made_later(loop, monkeypatch):
    def fail():
        raise OSError(24, "Too many open files")

    with monkeypatch.context() as broken:
        broken.setattr(event_loop, "new_event_loop", fail)
        with pytest.raises(OSError, match="Too many open files"):
            in_thread(lambda: loop.call(int))
    assert in_thread(lambda: loop.call(int)) == 0


def test_a_thread_that_cannot_be_started_is_an_error_and_started_later(loop, monkeypatch):
    def fail(thread):
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as broken:
        broken.setattr(threading.Thread, "start", fail)
        with pytest.raises(RuntimeError, match="can't start"):
            loop.call(int)
    assert in_thread(lambda: loop.call(int)) == 0


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_an_interrupted_wait_for_the_loop_makes_no_second_loop(loop, monkeypatch):
    made = []

    def make():
        made.append(new_event_loop())
        if len(made) == 1:
            os.kill(os.getpid(), signal.SIGINT)  # the main thread waits for this loop
            time.sleep(0.1)  # the next call comes before the loop is there
        return made[-1]

    monkeypatch.setattr(event_loop, "new_event_loop", make)
    with pytest.raises(KeyboardInterrupt):
        loop.call(int)
    assert loop.call(asyncio.get_running_loop) is made[0]
    assert len(made) == 1
