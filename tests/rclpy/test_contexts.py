"""Contexts, signals, the functions of ``rclpy`` itself, and the event loop behind them."""

from __future__ import annotations

import os
import signal
import threading
from contextlib import suppress

import pytest

from turtleact.rclpy import context as context_module
from turtleact.rclpy import toplevel as rclpy
from turtleact.rclpy.context import Context, SignalHandlerOptions
from turtleact.rclpy.exceptions import NotInitializedException
from turtleact.rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from turtleact.rclpy.task import Future


@pytest.fixture
def default():
    """The default context, initialised without arguments and signal handlers."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    yield
    rclpy.try_shutdown()


def test_init_is_a_context_manager_that_shuts_down():
    with rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO):
        assert rclpy.ok()
    assert not rclpy.ok()
    own = Context()
    with rclpy.init(args=[], context=own):
        assert own.ok()
    assert not own.ok()


def test_a_context_itself_may_be_a_context_manager(monkeypatch):
    monkeypatch.setattr("sys.argv", ["program"])
    with Context() as context, context:
        assert context.ok()
        assert context.handle is not None
    assert not context.ok()


def test_an_early_context_has_no_domain_and_no_graph():
    context = Context()
    assert context.handle is None
    with pytest.raises(RuntimeError, match="domain id"):
        context.get_domain_id()
    with pytest.raises(NotInitializedException):
        _ = context.connection
    with pytest.raises(RuntimeError, match="should not be lower than zero"):
        context.init([], domain_id=-1)
    context.try_shutdown()


def test_the_domain_comes_from_the_call_or_the_environment(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    first, second = Context(), Context()
    first.init([])
    second.init([], domain_id=9, initialize_logging=False)
    assert (first.get_domain_id(), second.get_domain_id()) == (7, 9)
    first.shutdown()
    second.shutdown()


def test_callbacks_of_a_shutdown_are_called_once_and_do_not_keep_their_objects(context):
    class Told:
        def __init__(self, told):
            self.told = told

        def tell(self):
            self.told.append(self)

    told: list[object] = []
    kept, dropped = Told(told), Told(told)
    context.on_shutdown(kept.tell)
    context.on_shutdown(dropped.tell)
    with pytest.raises(TypeError, match="callable"):
        context.on_shutdown(None)
    del dropped
    context.shutdown()
    context.try_shutdown()
    context.on_shutdown(lambda: told.append("late"))
    assert told == [kept, "late"]


def test_the_default_context_is_new_after_a_shutdown(default):
    before = rclpy.get_default_context()
    rclpy.shutdown()
    assert rclpy.get_default_context() is not before
    with pytest.raises(RuntimeError, match="must be initialized"):
        rclpy.shutdown()


def test_the_functions_of_rclpy_spin_in_one_global_executor(default):
    node = rclpy.create_node("lab")
    executor = rclpy.get_global_executor()
    assert rclpy.get_global_executor() is executor
    ended = Future()
    node.create_guard_condition(lambda: ended.set_result(1)).trigger()
    rclpy.spin_until_future_complete(node, ended, timeout_sec=5)
    assert ended.done()
    assert executor.get_nodes() == []
    guard = node.create_guard_condition(rclpy.shutdown)
    guard.trigger()
    rclpy.spin(node)
    assert not rclpy.ok()


def test_arguments_for_ros_can_be_removed(monkeypatch):
    given = ["program", "a", "--ros-args", "-p", "x:=1", "--", "b"]
    assert context_module.remove_ros_args(given) == ["program", "a", "b"]
    monkeypatch.setattr("sys.argv", given)
    assert context_module.remove_ros_args() == ["program", "a", "b"]


# --- signals -------------------------------------------------------------------------------------


@pytest.fixture
def handled():
    """The handlers of signals as they were before, afterwards."""
    before = {number: signal.getsignal(number) for number in context_module.SIGNALS.values()}
    yield before
    context_module.uninstall_signal_handlers()
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_signal_shuts_contexts_down_and_reaches_the_former_handler(handled):
    received: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: received.append(number))
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.SIGTERM)
    assert context_module.get_current_signal_handlers_options() is SignalHandlerOptions.SIGTERM
    executor = SingleThreadedExecutor()
    threading.Timer(0.01, os.kill, [os.getpid(), signal.SIGTERM]).start()
    with suppress(ExternalShutdownException):  # `spin` just returns between two rounds
        executor.spin()
    assert not rclpy.ok()
    assert received == [signal.SIGTERM]
    rclpy.try_shutdown()


def test_handlers_are_restored_unless_somebody_has_replaced_them(handled):
    context_module.install_signal_handlers()
    context_module.install_signal_handlers()
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    context_module.uninstall_signal_handlers()
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_IGN
    assert signal.getsignal(signal.SIGINT) == handled[signal.SIGINT]


def test_handlers_are_left_alone_in_other_threads(handled):
    for change in (
        context_module.install_signal_handlers,
        context_module.uninstall_signal_handlers,
    ):
        thread = threading.Thread(target=change)
        thread.start()
        thread.join()
        assert context_module.get_current_signal_handlers_options() is SignalHandlerOptions.NO
