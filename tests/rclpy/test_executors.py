"""Executors: the order of a round, tasks, groups, timeouts and shutdown."""

import threading

import pytest

from turtleact.rclpy import toplevel as rclpy
from turtleact.rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from turtleact.rclpy.exceptions import InvalidHandle, NotInitializedException
from turtleact.rclpy.executors import (
    ExternalShutdownException,
    MultiThreadedExecutor,
    SingleThreadedExecutor,
)
from turtleact.rclpy.messages.classes import interface_class
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


def test_a_latched_message_reaches_a_late_subscription(node, executor):
    from turtleact.rclpy.qos import DurabilityPolicy, QoSProfile

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_publisher(String, "map", latched).publish(String(data="lab"))
    heard = []
    node.create_subscription(String, "map", lambda message: heard.append(message.data), latched)
    executor.spin_once(timeout_sec=1)
    assert heard == ["lab"]


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


def test_a_shutdown_in_a_callback_ends_the_spin(context, node, executor):
    node.create_timer(0.0, context.shutdown)
    executor.spin()
    assert not context.ok()


def test_spin_once_waits_no_longer_than_its_timeout(executor):
    executor.spin_once(timeout_sec=0.01)


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
    monkeypatch.setattr("turtleact.rclpy.impl.diagnosis.time.monotonic", lambda: now[0])
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
