"""Action servers and clients of rclpy, with each other."""

import pytest

from turtleact.goals.state import GoalStatus
from turtleact.rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from turtleact.rclpy.action.server import ServerGoalHandle
from turtleact.rclpy.exceptions import RCLError
from turtleact.rclpy.messages import interface_class
from turtleact.rclpy.task import Future

Fibonacci = interface_class("example_interfaces/action/Fibonacci")
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
