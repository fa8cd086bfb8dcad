"""Executors: the order of a round, tasks, groups, timeouts and shutdown."""

import threading
from contextlib import nullcontext

import pytest

from turtleact.rclpy import toplevel as rclpy
from turtleact.rclpy.exceptions import InvalidHandle, NotInitializedException
from turtleact.rclpy.executors import (
    ConditionReachedException,
    Executor,
    ExternalShutdownException,
    MultiThreadedExecutor,
    ShutdownException,
    SingleThreadedExecutor,
    TimeoutException,
)
from turtleact.rclpy.impl.entity import (
    MutuallyExclusiveCallbackGroup,
    ReentrantCallbackGroup,
)
from turtleact.rclpy.messages import interface_class
from turtleact.rclpy.task import Future

String = interface_class("std_msgs/msg/String")
AddTwoInts = interface_class("example_interfaces/srv/AddTwoInts")


def add(request, response):
    response.sum = request.a + request.b
    return response


def test_a_message_reaches_a_subscription(node, executor):
    heard = []
    node.create_subscription(String, "chatter", lambda message: heard.append(message.data), 10)
    node.create_publisher(String, "chatter", 10).publish(String(data="hello"))
    executor.spin_once(timeout_sec=1)
    assert heard == ["hello"]


def test_a_subscription_keeps_the_newest_messages_of_its_depth(node, executor):
    heard = []
    node.create_subscription(String, "chatter", lambda message: heard.append(message.data), 2)
    publisher = node.create_publisher(String, "chatter", 10)
    for word in "abc":
        publisher.publish(String(data=word))
    for _ in range(3):
        executor.spin_once(timeout_sec=0)
    assert heard == ["b", "c"]


def test_a_round_serves_tasks_then_timers_then_subscriptions_then_guards(node, executor):
    order = []
    guard = node.create_guard_condition(lambda: order.append("guard"))
    node.create_subscription(String, "chatter", lambda _: order.append("subscription"), 10)

    def once():
        order.append("timer")
        timer.cancel()

    timer = node.create_timer(0.0, once)
    node.create_publisher(String, "chatter", 10).publish(String())
    guard.trigger()
    executor.create_task(order.append, "task")
    for _ in range(4):
        executor.spin_once(timeout_sec=0)
    assert order == ["task", "timer", "subscription", "guard"]


def test_a_service_answers_a_client_of_the_same_process(node, executor):
    node.create_service(AddTwoInts, "add", add)
    client = node.create_client(AddTwoInts, "add")
    assert client.wait_for_service(timeout_sec=1)
    future = client.call_async(AddTwoInts.Request(a=2, b=3))
    executor.spin_until_future_complete(future, timeout_sec=1)
    assert future.result().sum == 5


def test_a_coroutine_callback_may_await_a_call_through_another_group(node, executor):
    node.create_service(AddTwoInts, "add", add)
    client = node.create_client(AddTwoInts, "add", callback_group=ReentrantCallbackGroup())
    ended = Future()

    async def ask():
        timer.cancel()
        ended.set_result((await client.call_async(AddTwoInts.Request(a=1, b=1))).sum)

    group = MutuallyExclusiveCallbackGroup()
    timer = node.create_timer(0.0, ask, callback_group=group)
    node.default_callback_group  # noqa: B018  # the service runs in it
    executor.spin_until_future_complete(ended, timeout_sec=2)
    assert ended.result() == 2


def test_a_call_blocks_a_thread_while_another_spins(node, context):
    node.create_service(AddTwoInts, "add", add, callback_group=ReentrantCallbackGroup())
    client = node.create_client(AddTwoInts, "add", callback_group=ReentrantCallbackGroup())
    executor = MultiThreadedExecutor(2, context=context)
    executor.add_node(node)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    assert client.call(AddTwoInts.Request(a=4, b=4), timeout_sec=5).sum == 8
    executor.shutdown()
    spinning.join(5)
    assert not spinning.is_alive()


def test_an_exception_of_a_callback_leaves_the_spin(node, executor):
    def fail():
        raise ValueError("broken")

    node.create_timer(0.0, fail)
    with pytest.raises(ValueError, match="broken"):
        executor.spin_once(timeout_sec=1)


def test_an_exception_in_a_thread_is_raised_by_a_later_spin(node, context):
    def fail():
        timer.cancel()
        raise ValueError("broken")

    timer = node.create_timer(0.0, fail)
    executor = MultiThreadedExecutor(2, context=context)
    executor.add_node(node)
    with pytest.raises(ValueError, match="broken"):
        executor.spin()
    executor.shutdown()


def test_a_shutdown_from_elsewhere_ends_a_single_threaded_spin_with_an_exception(context, executor):
    threading.Timer(0.05, context.shutdown).start()
    with pytest.raises(ExternalShutdownException):
        executor.spin()


def test_a_shutdown_from_elsewhere_ends_a_multi_threaded_spin(context, node):
    executor = MultiThreadedExecutor(2, context=context)
    executor.add_node(node)
    threading.Timer(0.05, context.shutdown).start()
    executor.spin()
    executor.shutdown()


@pytest.mark.parametrize("kind", [SingleThreadedExecutor, MultiThreadedExecutor])
def test_a_callback_may_be_surprised_by_a_shutdown(context, node, kind):
    publisher = node.create_publisher(String, "chatter", 10)

    def publish():
        context.shutdown()  # as a signal would, in another thread
        publisher.publish(String())

    node.create_guard_condition(publish).trigger()
    executor = kind(context=context)
    executor.add_node(node)
    is_single = kind is SingleThreadedExecutor
    with pytest.raises(ExternalShutdownException) if is_single else nullcontext():
        executor.spin()
    executor.shutdown()


def test_a_shutdown_in_a_callback_ends_the_spin(context, node, executor):
    node.create_timer(0.0, context.shutdown)
    executor.spin()
    assert not context.ok()


def test_a_task_that_awaits_a_future_goes_on_when_it_is_done(executor):
    future = Future()

    async def double():
        return 2 * await future

    task = executor.create_task(double)
    executor.spin_once(timeout_sec=0)
    assert not task.done()
    future.set_result(4)
    executor.spin_until_future_complete(task, timeout_sec=1)
    assert task.result() == 8


def test_a_nested_spin_gives_the_node_back_to_its_executor(node, executor):
    other = SingleThreadedExecutor(context=node.context)
    rclpy.spin_once(node, executor=other, timeout_sec=0)
    assert node.executor is executor


def test_a_blocked_callback_is_reported_after_two_seconds(node, executor, monkeypatch, capsys):
    now = [100.0]
    monkeypatch.setattr("turtleact.rclpy.impl.entity.time.monotonic", lambda: now[0])
    never = Future()

    async def wait():
        timer.cancel()
        await never

    timer = node.create_timer(0.0, wait)
    executor.spin_once(timeout_sec=0)
    guard = node.create_guard_condition(lambda: None)
    guard.trigger()
    executor.spin_once(timeout_sec=0)
    assert "has waited" not in capsys.readouterr().err
    now[0] += 2.5
    executor.spin_once(timeout_sec=0)
    said = capsys.readouterr().err
    assert "a guard condition has waited for 2 s: its callback group is held by the timer" in said


def test_what_was_destroyed_cannot_be_used(node):
    publisher = node.create_publisher(String, "chatter", 10)
    assert node.destroy_publisher(publisher)
    publisher.destroy()
    with pytest.raises(InvalidHandle, match="destruction was requested"):
        publisher.publish(String())
    assert not node.destroy_publisher(publisher)


def test_a_node_needs_an_initialised_context():
    with pytest.raises(NotInitializedException):
        rclpy.create_node("early", context=rclpy.Context())


def test_a_context_is_initialised_and_shut_down_once(context):
    with pytest.raises(RuntimeError, match="must only be called once"):
        context.init([])
    context.shutdown()
    with pytest.raises(RuntimeError, match="must be initialized before it can be shutdown"):
        context.shutdown()


# --- custom groups and executors ------------------------------------------------------------------


def test_a_custom_executor_runs_callbacks_where_it_likes(node, context):
    class Custom(Executor):
        def __init__(self):
            super().__init__(context=context)
            self.seen: list[object] = []

        def spin_once(self, timeout_sec=None):
            handler, _, its_node = self.wait_for_ready_callbacks(timeout_sec)
            self.seen.append(its_node)
            handler()

    called: list[str] = []
    with Custom() as executor:
        executor.add_node(node)
        node.create_guard_condition(lambda: called.append("guard")).trigger()
        executor.spin_once(1)
        assert (called, executor.seen) == (["guard"], [node])
        with pytest.raises(NotImplementedError):
            executor.spin_until_future_complete(Future())
    with pytest.raises(ShutdownException):
        executor.spin_once()


def test_work_is_waited_for_until_a_timeout_or_a_condition(node, executor):
    assert not executor.add_node(node)
    node.create_guard_condition(None).trigger()
    task, _, found = executor.wait_for_ready_callbacks(0)
    assert found is node
    task()
    with pytest.raises(TimeoutException):
        executor.wait_for_ready_callbacks(0)
    with pytest.raises(ConditionReachedException):
        executor.wait_for_ready_callbacks(None, lambda: True)


def test_a_spin_until_a_future_is_done_ends_after_its_timeout(executor):
    never = Future()
    executor.spin_until_future_complete(never, timeout_sec=0.01)
    executor.spin_once_until_future_complete(never, 0.01)
    assert not never.done()
    done = Future()
    done.set_result(1)
    executor.spin_once_until_future_complete(done)


def test_callbacks_wait_while_a_coroutine_holds_their_group(node, executor):
    called: list[str] = []
    released = Future()

    async def hold():
        timer.cancel()
        await released

    timer = node.create_timer(0.0, hold)
    executor.spin_once(0)
    node.create_timer(0.001, lambda: called.append("timer"))
    node.create_guard_condition(lambda: called.append("guard")).trigger()
    executor.spin_once(timeout_sec=0.01)
    assert called == []
    released.set_result(None)
    for _ in range(3):
        executor.spin_once(timeout_sec=1)
    assert sorted(set(called)) == ["guard", "timer"]


@pytest.mark.parametrize("kind", [SingleThreadedExecutor, MultiThreadedExecutor])
def test_a_shutdown_waits_for_callbacks_no_longer_than_asked(node, context, kind):
    executor = kind(context=context)
    executor.add_node(node)
    began, goes_on = threading.Event(), threading.Event()

    def work():
        began.set()
        goes_on.wait(5)

    node.create_guard_condition(work).trigger()
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    assert began.wait(5)
    assert not executor.shutdown(0.01)
    goes_on.set()
    assert executor.shutdown(5)
    spinning.join(5)
    assert executor.get_nodes() == []


def test_one_thread_is_too_few_for_a_multi_threaded_executor(context):
    with pytest.warns(UserWarning, match="use a SingleThreadedExecutor"):
        MultiThreadedExecutor(1, context=context).shutdown()


def test_a_guard_condition_may_have_no_callback_or_a_coroutine(node, executor):
    called: list[int] = []

    async def call():
        called.append(1)

    node.create_guard_condition(None).trigger()
    node.create_guard_condition(call).trigger()
    for _ in range(2):
        executor.spin_once(0)
    assert called == [1]
