"""Goals of a server that is reached by messages alone: the contract is the same."""

from __future__ import annotations

import gc
from collections import defaultdict
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

import anyio
import anyio.lowlevel
import pytest

import turtleact
from turtleact import GoalResponse, GoalStatus
from turtleact.errors import (
    ServerUnavailable,
    TurtleactError,
    UnknownGoal,
)
from turtleact.goals.client_handle import Outcome
from turtleact.goals.remote import RemoteGoal
from turtleact.goals.state import CancelCode
from turtleact.goals.wire import GoalMetadata
from turtleact.interfaces import implied
from turtleact.interfaces.standard import CancelGoal
from turtleact.tasks import current_tasks
from turtleact.transports import MemoryTransport
from turtleact.transports.base import EVERY_SERVER

from ..lab import (
    ON_ASYNCIO,
    Apart,
    Count,
    Gate,
    Lab,
    Other,
    Running,
    apart,
    count,
    far_and_near,
    feedback,
    goal,
    local_server,
    other_tasks,
    result,
    running,
    settle,
)

ID = bytes(range(16))


@pytest.fixture(autouse=True)
def no_patience(monkeypatch) -> None:
    """Do not wait for a dead server to return."""
    monkeypatch.setattr("turtleact.goals.remote.BACK_WITHIN", 0.0)


# --- ends ---------------------------------------------------------------------------------------


async def test_a_client_waits_for_its_server():
    async with far_and_near() as (far, node):
        client = node.action_client(Count, "count")
        async with running(client.wait_for_server) as waiting:
            assert not waiting.done.is_set()
            far.action_server(Count, "count", count)
            await waiting.done.wait()
        assert await client.send_goal(goal()) == result(0, 1, 2)


# --- feedback -----------------------------------------------------------------------------------


async def test_feedback_of_others_is_not_heard():
    async with apart(count) as served, served.client.send_goal(goal(3)) as first:
        async with served.client.send_goal(goal(5)) as second:
            assert len([each async for each in second]) == 5
        assert len([each async for each in first]) == 3


# --- canceling ----------------------------------------------------------------------------------


async def test_a_canceled_caller_asks_once_to_cancel(send, monkeypatch):
    gate, asked = Gate(), list[bytes]()
    async with apart(gate.wait) as served, running(lambda: send(served, goal())) as sent:
        cancel = served.local.cancel

        async def note(goal_id: bytes, stamp: int) -> CancelGoal.Response:
            asked.append(goal_id)
            return await cancel(goal_id, stamp)

        monkeypatch.setattr(served.local, "cancel", note)
        await gate.started.wait()
        await settle()
        sent.scope.cancel()
        await sent.done.wait()
        assert len(asked) == 1


async def test_a_goal_that_is_accepted_after_its_sender_was_canceled_is_canceled(send):
    asked, answer = anyio.Event(), anyio.Event()
    gate = Gate()

    async def ask(request):
        asked.set()
        await answer.wait()
        return GoalResponse.ACCEPT

    async with (
        apart(gate.wait, goal_callback=ask) as served,
        running(lambda: send(served, goal())) as sent,
    ):
        await asked.wait()
        sent.scope.cancel()
        await settle()
        answer.set()
        await sent.done.wait()
        assert gate.log in ([], ["begun", "canceled", "over"])
        assert served.active == []


# --- goals of others ----------------------------------------------------------------------------


async def test_an_attached_reader_hears_what_comes():
    gate = Gate()

    async def act(request):
        yield feedback(1)
        await gate.opened.wait()
        yield feedback(2)
        yield result(3)

    async with apart(act) as served, served.client.send_goal(goal(), goal_id=ID) as own:
        await settle()
        other = served.node.action_client(Count, "count")
        async with other.attach(ID) as handle:
            assert handle.status is GoalStatus.EXECUTING
            assert handle.stamp == own.stamp
            gate.opened.set()
            assert [each.so_far async for each in handle] == [[2]]
            assert await handle.result() == result(3)
        assert await own.result() == result(3)


# --- when one side goes -------------------------------------------------------------------------


@pytest.mark.parametrize("turns", range(4))
async def test_whenever_a_client_is_closed_all_its_goals_say_so(send, turns):
    """Some wait for their turn, some for their acceptance, some for their end."""
    gate, begun = Gate(), list[int]()
    async with apart(gate.wait, policy="parallel", max_active=20) as served:

        async def begin() -> Any:
            begun.append(1)
            return await send(served, goal())

        sending: list[Running[Any]] = [Running(begin) for _ in range(20)]
        async with anyio.create_task_group() as group:
            for each in sending:
                group.start_soon(each.run)
            while len(begun) < len(sending):
                await current_tasks().checkpoint()
            for _ in range(turns):
                await current_tasks().checkpoint()
            await served.client.aclose()
        said = {str(each.error) for each in sending}
        assert said == {"action '/count': the client was closed"}
        gate.opened.set()


@ON_ASYNCIO
async def test_a_client_that_is_closed_has_no_task_left():
    async with strange() as (server, client):
        sending = [client.send_goal(goal()) for _ in range(3)]
        server.answered.release()
        async with sending[0] as handle, anyio.create_task_group() as group:
            handle.detach()
            handle.cancel_nowait()
            for each in sending[1:]:
                group.start_soon(failing, each)
            await settle()
            assert (
                tasks_of_clients()
                == [f"a cancel of goal {handle.goal_id.hex()}"] + ["a goal of /count"] * 3
            )
            await client.aclose()
            assert tasks_of_clients() == []


def tasks_of_clients() -> list[str]:
    names = [task.get_name() for task in other_tasks()]
    return sorted(name for name in names if name.startswith(("a goal of", "a cancel of")))


async def failing(sending: Any) -> None:
    with pytest.raises(ServerUnavailable, match="the client was closed"):
        await sending


async def test_a_closed_client_sends_nothing_and_cancels_nothing():
    gate = Gate()
    async with apart(gate.wait) as served, served.client.send_goal(goal()) as handle:
        await served.client.aclose()
        with pytest.raises(TurtleactError, match="is closed: open another"):
            await served.client.send_goal(goal())
        with pytest.raises(ServerUnavailable, match="action '/count': the client was closed"):
            await handle.cancel()
        gate.opened.set()


async def test_what_goes_wrong_with_a_reply_is_logged_and_ends_the_goal(send, monkeypatch, caplog):
    def read(_text: object) -> None:
        raise RuntimeError("mine")

    async with apart(count) as served:
        monkeypatch.setattr(GoalMetadata, "read", read)
        with pytest.raises(TurtleactError, match="cannot be followed: RuntimeError: mine"):
            await send(served, goal())
    assert "of /count cannot be followed" in caplog.text


def remote_goals_in_memory() -> set[RemoteGoal]:
    gc.collect()
    return {each for each in gc.get_objects() if type(each) is RemoteGoal}


async def test_nothing_is_left_of_goals_that_have_ended(send):
    before = remote_goals_in_memory()
    async with apart(count) as served:
        for _ in range(20):
            await send(served, goal())
        await settle()
        assert remote_goals_in_memory() <= before
        assert served.active == []


# --- servers that die ---------------------------------------------------------------------------


class Cut(Apart):
    """One whose servers can die without a word.

    Attributes:
        is_cut: Whether they have: no call finds a server.
        returns: Whether they come back the next time that somebody waits for them.
        withholds: How many feedback messages get lost.
        delays: Whether the request for a result is late.
    """

    def __init__(self, transport: MemoryTransport) -> None:
        super().__init__(transport)
        self._dying: list[anyio.CancelScope] = []
        self.is_cut = False
        self.returns = False
        self.withholds = 0
        self.delays = False

    def cut(self) -> None:
        """Let the servers die: calls that wait for an answer get none."""
        self.is_cut = True
        for scope in self._dying:
            scope.cancel()

    def join(self, endpoint: Any, format: Any, target: Any = EVERY_SERVER) -> Any:
        return CutCaller(self, self._transport.join(endpoint, format, target), endpoint.name)

    def subscribe(self, endpoint: Any, format: Any, deliver: Any, **_: Any) -> Any:
        def take(message: object) -> None:
            if endpoint.name.endswith("feedback") and self.withholds:
                self.withholds -= 1
            else:
                deliver(message)

        return self._transport.subscribe(endpoint, format, take)

    async def wait_for_change(self) -> None:
        if self.returns:
            self.is_cut = False
        else:
            await self._transport.wait_for_change()


class CutCaller:
    """A caller whose server may die."""

    def __init__(self, graph: Cut, caller: Any, name: str) -> None:
        self._graph = graph
        self._caller = caller
        self._name = name
        self.close = caller.close
        self.why_not_served = caller.why_not_served

    @property
    def is_served(self) -> bool:
        return not self._graph.is_cut and self._caller.is_served

    async def call(self, request: object, note: str = "") -> Any:
        if self._graph.delays and self._name.endswith("get_result"):
            await settle()
        if not self._graph.is_cut:
            with anyio.CancelScope() as scope:
                self._graph._dying.append(scope)
                return await self._caller.call(request)
        raise ServerUnavailable(self._name, "the server went away", kind="service")


@asynccontextmanager
async def cut(execute: Any, **options: Any) -> AsyncIterator[tuple[Lab, Cut]]:
    """As `apart`, with a server that can die."""
    async with far_and_near(near=Cut) as (far, node):
        graph: Any = node.transport
        server = far.action_server(Count, "count", execute, **options)
        yield Lab(node, server, node.action_client(Count, "count"), local_server(server)), graph


async def test_a_server_that_dies_is_told_to_all_who_wait(send):
    gate = Gate()
    async with cut(gate.wait) as (served, graph), running(lambda: send(served, goal())) as sent:
        await gate.started.wait()
        graph.cut()
        await sent.done.wait()
        assert isinstance(sent.error, ServerUnavailable)
        assert str(sent.error) == "action '/count': the server went away"


async def test_a_reader_and_a_teller_of_events_hear_of_the_death():
    gate = Gate()
    async with cut(gate.stream) as (served, graph), served.client.send_goal(goal()) as handle:
        await gate.started.wait()
        graph.cut()
        with pytest.raises(ServerUnavailable):
            async for _ in handle:
                pass
        with pytest.raises(ServerUnavailable):
            async for _ in handle.events():
                pass
        with pytest.raises(ServerUnavailable):
            await handle.result()
        assert (handle.status, handle.done) == (GoalStatus.UNKNOWN, True)


async def test_a_server_that_comes_back_at_once_is_asked_again(send, monkeypatch):
    gate = Gate()
    async with cut(gate.wait) as (served, graph), running(lambda: send(served, goal())) as sent:
        await gate.started.wait()
        monkeypatch.setattr("turtleact.goals.remote.BACK_WITHIN", 5.0)
        graph.returns = True
        graph.cut()
        await settle()
        gate.opened.set()
        await sent.done.wait()
        assert sent.value == Outcome(GoalStatus.SUCCEEDED, result(3))


async def test_a_result_that_a_server_has_forgotten_is_unknown(send):
    async with cut(count, result_timeout=0) as (served, graph):
        graph.delays = True
        with pytest.raises(UnknownGoal, match="holds no goal"):
            await send(served, goal(0))


async def test_a_cancel_that_finds_no_server_is_told(caplog):
    gate = Gate()
    async with cut(gate.wait) as (served, graph), served.client.send_goal(goal()) as handle:
        handle.detach()
        await gate.started.wait()
        graph.is_cut = True
        with pytest.raises(ServerUnavailable, match="action '/count': the server went away"):
            await handle.cancel()
        handle.cancel_nowait()
        await settle()
        assert "could not be canceled: action '/count'" in caplog.text


async def test_leaving_the_block_of_a_lost_goal_does_not_hang():
    gate = Gate()
    async with cut(gate.wait) as (served, graph), served.client.send_goal(goal()):
        await gate.started.wait()
        graph.is_cut = True


async def test_lost_feedback_is_waited_for_and_then_logged(caplog, monkeypatch):
    async with cut(count) as (served, graph):
        graph.withholds = 2
        monkeypatch.setattr("turtleact.goals.remote.LATE_FEEDBACK", 0.0)
        assert await served.client.send_goal(goal(5)) == result(0, 1, 2, 3, 4)
    assert "2 feedback messages of goal" in caplog.text


async def test_tasks_that_attach_to_a_goal_at_once_share_it():
    gate, readers = Gate(), list[Any]()

    async def act(request: Count.Goal) -> AsyncIterator[Count.Feedback | Count.Result]:
        await gate.opened.wait()
        yield feedback(1)
        yield result(3)

    async def attach(client: turtleact.ActionClient[Any, Any, Any]) -> None:
        async with client.attach(ID) as handle:
            readers.append([each.so_far async for each in handle])

    async with apart(act) as served, served.client.send_goal(goal(), goal_id=ID):
        graph: Any = served.node.transport
        news, subscribe = list[Callable[[], object]](), graph.subscribe

        def subscribe_slowly(endpoint: Any, format: Any, deliver: Any, **_: Any) -> Any:
            def deliver_later(message: Any) -> None:
                news.append(partial(deliver, message))

            is_status = endpoint.name.endswith("/status")
            return subscribe(endpoint, format, deliver_later if is_status else deliver)

        graph.subscribe = subscribe_slowly
        other = served.node.action_client(Count, "count")
        async with anyio.create_task_group() as group:
            for _ in range(2):
                group.start_soon(attach, other)
            await settle()
            news.pop()()  # the first status, for which both wait
            await settle()
            gate.opened.set()
    assert readers == [[[1]], [[1]]]


async def test_a_reader_far_behind_loses_the_oldest(monkeypatch):
    monkeypatch.setattr("turtleact.goals.remote.MOST_UNREAD", 3000)

    async def act(request):
        for number in range(8000):
            yield feedback(number)
        yield result()

    async with apart(act) as served, served.client.send_goal(goal()) as handle:
        reader = aiter(handle)
        first = await anext(reader)
        await settle()
        rest = [each async for each in reader]
        assert 1 + len(rest) + handle.missed == 8000
        assert (first, rest[-1]) == (feedback(0), feedback(7999))


# --- two under one name -------------------------------------------------------------------------


@pytest.mark.parametrize("order", [(Count, Other), (Other, Count)])
async def test_two_actions_of_one_name_answer_for_each_other(order):
    gate = Gate()
    async with far_and_near() as (far, node):
        for action_type in order:
            far.action_server(action_type, "count", gate.wait)
        async with node.action_client(Count, "count").send_goal(goal(), goal_id=ID) as handle:
            response = await handle.cancel()
            assert [info.goal_id.uuid for info in response.goals_canceling] == [ID]
            assert (await handle.outcome()).status is GoalStatus.CANCELED
            assert (await handle.cancel()).return_code == CancelCode.GOAL_TERMINATED


# --- a server of ROS 2, which keeps ten requests ------------------------------------------------


class Stranger:
    """The services of an action server that is not turtleact's: it answers when it is told to."""

    def __init__(self, node: turtleact.Node) -> None:
        self.sent: list[bytes] = []
        self.canceled: list[bytes] = []
        self.answered = anyio.Semaphore(0)
        self._ended: dict[bytes, anyio.Event] = defaultdict(anyio.Event)
        names, types = "count/_action", implied(Count)
        node.service(types.send_goal, f"{names}/send_goal", self.take)
        node.service(types.get_result, f"{names}/get_result", self.wait)
        node.service(CancelGoal, f"{names}/cancel_goal", self.cancel)

    async def take(self, request: Any) -> Any:
        self.sent.append(request.goal_id.uuid)
        await self.answered.acquire()
        return implied(Count).send_goal.Response(accepted=True)

    async def wait(self, request: Any) -> Any:
        await self._ended[request.goal_id.uuid].wait()
        return implied(Count).get_result.Response(status=GoalStatus.CANCELED, result=result())

    async def cancel(self, request: Any) -> Any:
        self.canceled.append(request.goal_info.goal_id.uuid)
        await self.answered.acquire()
        self._ended[request.goal_info.goal_id.uuid].set()
        return CancelGoal.Response(goals_canceling=[request.goal_info])


def awaitable(sent: Any) -> Any:
    """What ``start_soon`` takes, of a goal that is about to be sent."""

    async def wait() -> None:
        await sent

    return wait


@asynccontextmanager
async def strange() -> AsyncIterator[tuple[Stranger, turtleact.ActionClient[Any, Any, Any]]]:
    """A stranger that serves `Count`, and the client of another node."""
    async with far_and_near() as (far, node):
        yield Stranger(far), node.action_client(Count, "count")


async def test_to_a_server_of_ros_goals_are_sent_eight_at_a_time_and_in_their_order():
    ids = [bytes([number] * 16) for number in range(1, 31)]
    async with strange() as (server, client), anyio.create_task_group() as tasks:
        handles = [client.send_goal(goal(), goal_id=each) for each in ids]
        for handle in handles:
            tasks.start_soon(awaitable(handle))
            await settle()
        for count_sent in range(8, len(ids) + 1):
            assert server.sent == ids[:count_sent]
            server.answered.release()
            await settle()
        for _ in range(2 * len(ids)):
            server.answered.release()
        tasks.cancel_scope.cancel()


async def test_to_a_server_of_ros_cancels_are_sent_eight_at_a_time():
    async with strange() as (server, client), anyio.create_task_group() as tasks:
        for _ in range(30):
            server.answered.release()
            tasks.start_soon(awaitable(client.send_goal(goal())))
        await settle()
        assert len(server.sent) == 30
        tasks.cancel_scope.cancel()
        with anyio.CancelScope(shield=True):
            await settle()
            assert len(server.canceled) == 8
            for _ in range(30):
                server.answered.release()


async def test_a_server_that_is_known_to_run_turtleact_is_sent_all_goals_at_once():
    asked: list[Any] = []
    answer = anyio.Event()

    async def take(request):
        asked.append(request)
        if len(asked) > 1:
            await answer.wait()
        return GoalResponse.ACCEPT

    async with apart(count, goal_callback=take) as served:
        await served.client.send_goal(goal())
        async with anyio.create_task_group() as tasks:
            for _ in range(30):
                tasks.start_soon(awaitable(served.client.send_goal(goal())))
            await settle()
            assert len(asked) == 31
            answer.set()
