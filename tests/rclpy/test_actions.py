"""Action servers and clients of rclpy, with each other."""

import threading
import time

import pytest

from turtleact.errors import InvalidMessage
from turtleact.goals.state import GoalEvent, GoalStatus
from turtleact.rclpy import toplevel as rclpy
from turtleact.rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from turtleact.rclpy.action.server import ServerGoalHandle
from turtleact.rclpy.exceptions import RCLError
from turtleact.rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from turtleact.rclpy.impl.connection import RequestHandler
from turtleact.rclpy.messages import interface_class
from turtleact.rclpy.task import Future
from turtleact.transports.base import Reply

Fibonacci = interface_class("example_interfaces/action/Fibonacci")
State = interface_class("action_msgs/msg/GoalStatus")
States = interface_class("action_msgs/msg/GoalStatusArray")
Info = interface_class("action_msgs/msg/GoalInfo")
Rotate = interface_class("turtlesim/action/RotateAbsolute")
UUID = interface_class("unique_identifier_msgs/msg/UUID")


def succeed(goal_handle):
    goal_handle.succeed()
    return Fibonacci.Result(sequence=[goal_handle.request.order])


@pytest.fixture
def client(node):
    return ActionClient(node, Fibonacci, "fibonacci")


@pytest.fixture
def send(client, executor):
    """Sends a goal and returns its handle."""

    def send(order=3, **options):
        sent = client.send_goal_async(Fibonacci.Goal(order=order), **options)
        executor.spin_until_future_complete(sent, timeout_sec=2)
        return sent.result()

    return send


@pytest.fixture
def result_of(executor):
    def result_of(handle):
        future = handle.get_result_async()
        executor.spin_until_future_complete(future, timeout_sec=2)
        return future.result()

    return result_of


def test_a_goal_succeeds_with_its_result(node, send, result_of, client):
    ActionServer(node, Fibonacci, "fibonacci", succeed)
    assert client.wait_for_server(timeout_sec=1)
    response = result_of(send(order=5))
    assert (response.status, list(response.result.sequence)) == (GoalStatus.SUCCEEDED, [5])


def test_every_feedback_of_a_burst_arrives_in_order(node, send, result_of):
    def burst(goal_handle):
        for number in range(1000):
            goal_handle.publish_feedback(Fibonacci.Feedback(sequence=[number]))
        return succeed(goal_handle)

    ActionServer(node, Fibonacci, "fibonacci", burst)
    heard = []
    handle = send(feedback_callback=lambda message: heard.append(message.feedback.sequence[0]))
    result_of(handle)
    assert heard == list(range(1000))


def test_feedback_that_overtakes_the_answer_is_handled_after_it(node, send, executor):
    feedback = node.create_publisher(
        Fibonacci.Impl.FeedbackMessage, "fibonacci/_action/feedback", 10
    )
    story = []

    def answer(request, response):
        for number in (1, 2):
            message = Fibonacci.Impl.FeedbackMessage(goal_id=request.goal_id)
            message.feedback.sequence = [number]
            feedback.publish(message)
        response.accepted = True
        return response

    node.create_service(Fibonacci.Impl.SendGoalService, "fibonacci/_action/send_goal", answer)
    handle = send(feedback_callback=lambda message: story.append(message.feedback.sequence[0]))
    story.append(handle.accepted)
    while len(story) < 3:
        executor.spin_once(timeout_sec=2)
    assert story == [True, 1, 2]


def test_an_async_execute_callback_may_await(node, executor, send, result_of):
    gate = Future()

    async def wait(goal_handle):
        await gate
        return succeed(goal_handle)

    ActionServer(node, Fibonacci, "fibonacci", wait)
    handle = send()
    assert handle.accepted
    gate.set_result(None)
    assert result_of(handle).status == GoalStatus.SUCCEEDED


@pytest.mark.parametrize(
    ("callback", "said"), [(lambda _: GoalResponse.REJECT, ""), (lambda _: None, "Rejecting goal")]
)
def test_a_goal_is_rejected_unless_the_callback_accepts_it(node, send, capsys, callback, said):
    ActionServer(node, Fibonacci, "fibonacci", succeed, goal_callback=callback)
    assert not send().accepted
    assert said in capsys.readouterr().err


def test_a_goal_without_a_state_is_aborted_with_its_result(node, send, result_of, capsys):
    ActionServer(node, Fibonacci, "fibonacci", lambda _: Fibonacci.Result(sequence=[7]))
    response = result_of(send())
    assert (response.status, list(response.result.sequence)) == (GoalStatus.ABORTED, [7])
    assert "Goal state not set, assuming aborted. Goal ID: [" in capsys.readouterr().err


def test_a_callback_that_raises_aborts_its_goal(node, send, result_of, capsys):
    def fail(_):
        raise ValueError("boom")

    ActionServer(node, Fibonacci, "fibonacci", fail)
    assert result_of(send()).status == GoalStatus.ABORTED
    said = capsys.readouterr().err
    assert "Error raised in execute callback: boom" in said
    assert "Traceback" in said


def test_a_callback_that_returns_nothing_gives_an_empty_result(node, send, result_of, capsys):
    ActionServer(node, Fibonacci, "fibonacci", lambda goal_handle: goal_handle.succeed())
    response = result_of(send())
    assert (response.status, list(response.result.sequence)) == (GoalStatus.SUCCEEDED, [])
    assert "returned nothing, not a Result" in capsys.readouterr().err


def test_a_goal_is_canceled_if_the_callback_agrees(node, executor, send, result_of):
    running = Future()

    async def run(goal_handle):
        await running
        if goal_handle.is_cancel_requested:
            goal_handle.canceled()
        return Fibonacci.Result()

    ActionServer(node, Fibonacci, "fibonacci", run, cancel_callback=lambda _: CancelResponse.ACCEPT)
    handle = send()
    canceling = handle.cancel_goal_async()
    executor.spin_until_future_complete(canceling, timeout_sec=2)
    assert [bytes(info.goal_id.uuid) for info in canceling.result().goals_canceling] == [
        bytes(handle.goal_id.uuid)
    ]
    running.set_result(None)
    assert result_of(handle).status == GoalStatus.CANCELED


def test_a_cancel_is_refused_by_default_and_after_the_end(node, executor, send, result_of):
    running = Future()

    async def run(goal_handle):
        await running
        return succeed(goal_handle)

    ActionServer(node, Fibonacci, "fibonacci", run)
    handle = send()
    refused = handle.cancel_goal_async()
    executor.spin_until_future_complete(refused, timeout_sec=2)
    assert (refused.result().return_code, refused.result().goals_canceling) == (1, [])
    running.set_result(None)
    result_of(handle)
    late = handle.cancel_goal_async()
    executor.spin_until_future_complete(late, timeout_sec=2)
    assert late.result().return_code == 3


def test_a_deferred_goal_is_executed_later(node, send, result_of):
    accepted: list[ServerGoalHandle] = []
    ActionServer(node, Fibonacci, "fibonacci", succeed, handle_accepted_callback=accepted.append)
    handle = send()
    assert accepted[0].status == GoalStatus.ACCEPTED
    accepted[0].execute()
    assert result_of(handle).status == GoalStatus.SUCCEEDED


def test_a_goal_cannot_end_twice(node, send, result_of):
    raised = []

    def twice(goal_handle):
        goal_handle.succeed()
        with pytest.raises(RCLError, match="invalid transition from state SUCCEEDED") as caught:
            goal_handle.succeed()
        raised.append(caught)
        return Fibonacci.Result()

    ActionServer(node, Fibonacci, "fibonacci", twice)
    assert result_of(send()).status == GoalStatus.SUCCEEDED
    assert raised


def test_the_result_of_an_unknown_goal_is_empty(node, send, result_of, executor, capsys):
    ActionServer(node, Fibonacci, "fibonacci", succeed, result_timeout=0)
    handle = send()
    result_of(handle)
    executor.spin_once(timeout_sec=0)
    assert result_of(handle).status == GoalStatus.UNKNOWN
    assert "unknown goal ID" in capsys.readouterr().err


def test_wrong_types_are_refused(node, client):
    with pytest.raises(TypeError, match="expected a goal of the action"):
        client.send_goal_async(Fibonacci.Result())
    with pytest.raises(TypeError, match="ClientGoalHandle"):
        client.cancel_goal_async("handle")
    with pytest.raises(TypeError, match="not callable"):
        ActionServer(node, Fibonacci, "fibonacci", "execute")


def test_a_thread_may_block_until_the_result(node, context):
    from turtleact.rclpy.impl.entity import ReentrantCallbackGroup

    group = ReentrantCallbackGroup()
    ActionServer(node, Fibonacci, "fibonacci", succeed, callback_group=group)
    client = ActionClient(node, Fibonacci, "fibonacci", callback_group=group)
    executor = MultiThreadedExecutor(2, context=context)
    executor.add_node(node)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    assert client.wait_for_server(timeout_sec=5)
    response = client.send_goal(Fibonacci.Goal(order=4))
    assert list(response.result.sequence) == [4]
    sent = client.send_goal_async(Fibonacci.Goal(order=1))
    while not sent.done():
        time.sleep(0.001)
    handle = sent.result()
    assert handle.get_result().status == GoalStatus.SUCCEEDED
    assert handle.cancel_goal().return_code == 3
    assert handle == handle
    assert handle.stamp.sec > 0
    assert "accepted=True" in repr(handle)
    assert len({handle, handle}) == 1
    context.shutdown()
    spinning.join(5)


def test_a_client_waits_for_a_server_no_longer_than_asked(client):
    assert not client.wait_for_server(timeout_sec=0.01)


def test_a_server_and_a_client_are_destroyed_once(node):
    server = ActionServer(node, Fibonacci, "fibonacci", succeed)
    client = ActionClient(node, Fibonacci, "fibonacci")
    for thing in (server, client):
        thing.destroy()
        thing.destroy()
    assert list(node.waitables) == []


def test_a_result_of_another_type_is_replaced(node, send, result_of, capsys):
    def end(goal_handle):
        goal_handle.succeed()
        return "done"

    server = ActionServer(node, Fibonacci, "fibonacci", end)
    assert result_of(send()).status == GoalStatus.SUCCEEDED
    assert "returned 'done', not a Result" in capsys.readouterr().err
    server.register_execute_callback(lambda handle: handle.abort(Fibonacci.Result(sequence=[8])))
    server.register_goal_callback(None)
    server.register_cancel_callback(None)
    server.register_handle_accepted_callback(None)
    assert list(result_of(send()).result.sequence) == [8]


def test_an_answer_is_handled_before_the_feedback_that_came_after_it(node, executor, context):
    def report(goal_handle):
        goal_handle.publish_feedback(Fibonacci.Feedback(sequence=[1]))
        return succeed(goal_handle)

    told: list[str] = []
    other = rclpy.create_node("server", context=context)
    ActionServer(other, Fibonacci, "fibonacci", report)
    client = ActionClient(node, Fibonacci, "fibonacci")
    sent = client.send_goal_async(Fibonacci.Goal(order=2), lambda _: told.append("feedback"))
    sent.add_done_callback(lambda _: told.append("answer"))
    serving = SingleThreadedExecutor(context=context)
    serving.add_node(other)
    for _ in range(5):
        serving.spin_once(0)
    while len(told) < 2:
        executor.spin_once(1)
    assert told == ["answer", "feedback"]


def test_feedback_and_results_that_do_not_fit_their_types_are_refused(node, executor, capsys):
    said: list[str] = []

    def turn(goal_handle):
        for wrong in (Rotate.Result(), Rotate.Feedback(remaining="a bit")):
            try:
                goal_handle.publish_feedback(wrong)
            except TypeError as error:
                said.append(str(error))
        goal_handle.succeed()
        return Rotate.Result(delta="a bit")

    ActionServer(node, Rotate, "turn", turn)
    client = ActionClient(node, Rotate, "turn")
    sent = client.send_goal_async(Rotate.Goal())
    executor.spin_until_future_complete(sent, timeout_sec=2)
    ended = sent.result().get_result_async()
    executor.spin_until_future_complete(ended, timeout_sec=2)
    assert ended.result().status == GoalStatus.SUCCEEDED
    assert ended.result().result.delta == 0
    assert "The result cannot be sent" in capsys.readouterr().err
    assert "expected feedback of the action" in said[0]
    assert "feedback.remaining: expected a number (float32), got 'a bit'" in said[1]


def test_a_goal_that_ends_while_its_cancel_callback_runs_is_not_canceled(
    node, send, result_of, executor
):
    held: list[ServerGoalHandle] = []

    def hold(goal_handle):
        held.append(goal_handle)
        goal_handle.update(GoalEvent.EXECUTE)

    def finish(goal_handle):
        held[0].succeed()
        return CancelResponse.ACCEPT

    server = ActionServer(
        node,
        Fibonacci,
        "fibonacci",
        succeed,
        handle_accepted_callback=hold,
        cancel_callback=finish,
    )
    handle = send()
    canceled = handle.cancel_goal_async()
    executor.spin_until_future_complete(canceled, timeout_sec=2)
    assert canceled.result().goals_canceling == []
    with pytest.raises(RCLError, match="from state SUCCEEDED"):
        held[0].abort()
    assert held[0] == held[0]
    assert len({held[0], held[0]}) == 1
    assert held[0].goal_info.goal_id == held[0].goal_id
    server.destroy()
    held[0].abort()  # a server that is gone has no goals
    assert held[0].status == GoalStatus.UNKNOWN


def test_a_second_cancel_request_is_accepted_too(node, send, executor):
    goes_on = Future()

    async def wait(goal_handle):
        await goes_on
        goal_handle.canceled()
        return Fibonacci.Result()

    ActionServer(
        node, Fibonacci, "fibonacci", wait, cancel_callback=lambda _: CancelResponse.ACCEPT
    )
    handle = send()
    for _ in range(2):
        canceled = handle.cancel_goal_async()
        executor.spin_until_future_complete(canceled, timeout_sec=2)
        assert len(canceled.result().goals_canceling) == 1
    ended = handle.get_result_async()
    goes_on.set_result(None)
    executor.spin_until_future_complete(ended, timeout_sec=2)
    assert ended.result().status == GoalStatus.CANCELED
    while handle.status != GoalStatus.CANCELED:
        executor.spin_once(timeout_sec=1)


def test_an_execute_callback_must_be_callable(node, send):
    held: list[ServerGoalHandle] = []
    server = ActionServer(
        node, Fibonacci, "fibonacci", succeed, handle_accepted_callback=held.append
    )
    with pytest.raises(TypeError, match="not callable"):
        server.register_execute_callback(None)
    send()
    with pytest.raises(TypeError, match="not callable"):
        held[0].execute("soon")


def test_a_node_without_an_executor_executes_no_goal(node, context):
    server = ActionServer(node, Fibonacci, "fibonacci", succeed)
    info = interface_class("action_msgs/msg/GoalInfo")()
    handle = ServerGoalHandle(server, info, Fibonacci.Goal())
    handle.execute()
    assert handle.status == GoalStatus.EXECUTING


def test_requests_and_answers_that_cannot_be_read_are_logged(node, executor, send, capsys):
    server = ActionServer(node, Fibonacci, "fibonacci", succeed)
    end = node.connection.local("/fibonacci/_action/send_goal", f"{Fibonacci.type_name}_SendGoal")
    assert end is not None
    refused: list[object] = []
    end.take(b"\0\1\0\0", refused.append)
    assert isinstance(refused[0], InvalidMessage)
    assert "a request cannot be read" in capsys.readouterr().err
    server.destroy()

    def answer(request, respond):
        respond(Reply(b"\0\1\0\0"))

    handler = RequestHandler(answer)
    type_name = f"{Fibonacci.type_name}_SendGoal"
    raw = node.endpoint("service", "/fibonacci/_action/send_goal", type_name)
    node.connection.serve(raw, handler)
    client = ActionClient(node, Fibonacci, "fibonacci")
    sent = client.send_goal_async(Fibonacci.Goal())
    executor.spin_once(timeout_sec=1)
    assert not sent.done()
    assert "a response cannot be read" in capsys.readouterr().err


def test_an_answer_to_a_cancelled_future_is_dropped(node, executor):
    ActionServer(node, Fibonacci, "fibonacci", succeed)
    client = ActionClient(node, Fibonacci, "fibonacci")
    sent = client.send_goal_async(Fibonacci.Goal(), goal_uuid=UUID(uuid=list(range(16))))
    sent.cancel()
    for _ in range(5):
        executor.spin_once(timeout_sec=0)
    assert (sent.cancelled(), sent.done()) == (True, False)


def test_a_blocking_call_whose_answer_nobody_handles_says_why(node, context, monkeypatch, capsys):
    monkeypatch.setattr("turtleact.rclpy.impl.entity.PATIENCE", 0.01)
    monkeypatch.setattr("turtleact.rclpy.impl.entity.BLOCKED_AFTER", 0.02)
    other = rclpy.create_node("server", context=context)
    ActionServer(other, Fibonacci, "fibonacci", succeed)
    serving = SingleThreadedExecutor(context=context)
    serving.add_node(other)
    client = ActionClient(node, Fibonacci, "fibonacci")
    threading.Thread(target=serving.spin_once, daemon=True).start()
    sent = client.send_goal_async(Fibonacci.Goal())
    threading.Timer(0.2, context.shutdown).start()
    assert client.wait_for_future(sent, "send_goal()") is None
    said = capsys.readouterr().err
    assert "send_goal() of /fibonacci has waited" in said
    assert "nobody spins the node" in said


def test_an_execute_callback_that_is_surprised_by_a_shutdown_is_no_error(
    node, context, send, capsys
):
    publisher = node.create_publisher(UUID, "chatter", 10)

    def publish(goal_handle):
        context.shutdown()
        publisher.publish(UUID())

    ActionServer(node, Fibonacci, "fibonacci", publish)
    assert send() is None
    assert "Error raised" not in capsys.readouterr().err
