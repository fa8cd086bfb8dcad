"""Futures and tasks, without an executor."""

from __future__ import annotations

import asyncio

import pytest

from turtleact.rclpy.task import Future, Task


def test_a_future_has_no_result_until_it_is_done():
    future = Future()
    assert (future.done(), future.result(), future.cancelled()) == (False, None, False)
    future.set_result(3)
    future.cancel()
    assert (future.done(), future.result(), future.cancelled()) == (True, 3, False)


def test_a_future_raises_its_exception():
    future = Future()
    future.set_exception(ValueError("broken"))
    with pytest.raises(ValueError, match="broken"):
        future.result()
    assert isinstance(future.exception(), ValueError)


def test_an_exception_that_nobody_asked_for_is_printed(capsys):
    future = Future()
    future.set_exception(ValueError("broken"))
    del future
    assert "never retrieved: broken" in capsys.readouterr().err


def test_callbacks_are_called_once_it_is_done():
    future = Future()
    called: list[object] = []
    future.add_done_callback(called.append)
    future.add_done_callback(print)
    assert future.remove_done_callback(print)
    assert not future.remove_done_callback(print)
    future.cancel()
    future.add_done_callback(called.append)
    assert called == [future, future]


def test_a_callback_that_raises_is_warned_of():
    future = Future()

    def fail(_):
        raise ValueError("broken")

    future.add_done_callback(fail)
    with pytest.warns(UserWarning, match="broken"):
        future.set_result(None)


def test_a_task_runs_a_function_or_the_steps_of_a_coroutine():
    async def twice():
        await asyncio.sleep(0)
        return 2

    plain, stepped = Task(lambda: 1), Task(twice)
    plain()
    plain()
    stepped()
    assert not stepped.done()
    stepped()
    assert (plain.result(), stepped.result()) == (1, 2)
    assert not plain.executing()


def test_a_cancelled_task_runs_no_further():
    steps = []

    async def walk():
        steps.append(1)
        await asyncio.sleep(0)
        steps.append(2)

    task = Task(walk)
    task()
    task.cancel()
    task()
    assert (steps, task.cancelled()) == ([1], True)


def test_a_task_of_asyncio_may_await_a_future():
    future = Future()

    async def main():
        asyncio.get_running_loop().call_soon(future.set_result, 5)
        return await future

    assert asyncio.run(main()) == 5


def test_classes_may_be_subscripted():
    assert Future.__class_getitem__(int) is Future
