"""What a server tells hooks and the sender's callback; what it does once a client is lost."""

from __future__ import annotations

import contextlib
from contextvars import ContextVar
from typing import Any, cast

import anyio
import anyio.lowlevel
import pytest

import turtleact
from turtleact import CancelResponse, GoalResponse, GoalStatus
from turtleact.errors import (
    Abort,
    GoalAborted,
    GoalCanceled,
    GoalRejected,
    InvalidOption,
    ServerUnavailable,
)
from turtleact.goals.state import GoalRequest
from turtleact.interfaces import implied
from turtleact.interfaces.standard import UUID
from turtleact.transports import MemoryTransport

from ..lab import (
    Count,
    Gate,
    answering,
    count,
    feedback,
    goal,
    lab,
    once_canceled,
    result,
    running,
    settle,
)

ACCEPT = ("UNKNOWN", "ACCEPTED")
EXECUTE = ("ACCEPTED", "EXECUTING")
SUCCEED = ("EXECUTING", "SUCCEEDED")
ABORT = ("EXECUTING", "ABORTED")
CANCEL = ("EXECUTING", "CANCELING")
CANCEL_WAITING = ("ACCEPTED", "CANCELING")
CANCELED = ("CANCELING", "CANCELED")


class Journal:
    """A hook that notes the changes, each goal by the number that it counts up to."""

    def __init__(self, node) -> None:
        self.changes: dict[int, list[tuple[str, str]]] = {}
        node.on_transition(self.note)

    def note(self, handle, old, new):
        assert handle.status >= new  # a hook may have changed it meanwhile
        self.changes.setdefault(handle.request.upto, []).append((old.name, new.name))


async def fail(request):
    raise Abort("no pen")


# --- hooks --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "changes"),
    [
        (count, [SUCCEED]),
        (fail, [ABORT]),
        (anyio.sleep_forever, [CANCEL, CANCELED]),
        (once_canceled(result(1)), [CANCEL, ("CANCELING", "SUCCEEDED")]),
    ],
)
async def test_a_hook_hears_of_each_change_of_a_goal(send, body, changes):
    async def wait(request):
        await body()

    async with lab(wait if body is anyio.sleep_forever else body) as served:
        journal = Journal(served.node)
        async with running(lambda: send(served, goal(1))):
            await served.client.cancel_all()
        assert journal.changes == {1: [ACCEPT, EXECUTE, *changes]}


async def let_them_end(served, gate, sent):
    gate.opened.set()
    for each in sent:
        await each.outcome()


async def cancel_the_last(served, gate, sent):
    await sent[-1].cancel()


async def close_the_server(served, gate, sent):
    await served.server.aclose()


async def do_nothing(served, gate, sent):
    await settle()


@pytest.mark.parametrize(
    ("policy", "act", "changes"),
    [
        ("queue", let_them_end, [[ACCEPT, EXECUTE, SUCCEED]] * 2),
        ("queue", cancel_the_last, [[ACCEPT, EXECUTE], [ACCEPT, CANCEL_WAITING, CANCELED]]),
        ("queue", close_the_server, [[ACCEPT, EXECUTE, ABORT]] * 2),
        ("preempt", do_nothing, [[ACCEPT, EXECUTE, ABORT]] * 2 + [[ACCEPT, EXECUTE]]),
    ],
)
async def test_a_hook_hears_of_goals_that_wait_for_their_turn(policy, act, changes):
    gate = Gate()
    async with lab(gate.wait, policy=policy) as served, contextlib.AsyncExitStack() as stack:
        journal = Journal(served.node)
        sending = [served.client.send_goal(goal(number)) for number in range(len(changes))]
        sent = [await stack.enter_async_context(each) for each in sending]
        await settle()
        if policy == "queue":
            assert journal.changes == {0: [ACCEPT, EXECUTE], 1: [ACCEPT]}
        await act(served, gate, sent)
        assert list(journal.changes.values()) == changes


@pytest.mark.parametrize(
    "options", [{"policy": "reject"}, {"goal_callback": answering(GoalResponse.REJECT)}]
)
async def test_a_hook_hears_nothing_of_a_goal_that_is_rejected(send, options):
    async with lab(Gate().wait, **options) as served, contextlib.AsyncExitStack() as stack:
        if "policy" in options:
            await stack.enter_async_context(served.client.send_goal(goal(1)))
        journal = Journal(served.node)
        with pytest.raises(GoalRejected):
            await send(served, goal(2))
        assert 2 not in journal.changes


async def test_a_hook_hears_of_all_servers_of_its_node_and_of_no_other(send):
    transport = MemoryTransport()
    async with (
        lab(count, transport=transport) as served,
        turtleact.open_node("other", transport=transport) as other,
    ):
        journal = Journal(served.node)
        served.node.action_server(Count, "later", count)
        other.action_server(Count, "elsewhere", count)
        for number, name in enumerate(["count", "later", "elsewhere"]):
            await served.node.action_client(Count, name).send_goal(goal(number))
        assert journal.changes == {number: [ACCEPT, EXECUTE, SUCCEED] for number in (0, 1)}


async def test_a_hook_that_is_added_later_hears_of_what_comes():
    gate = Gate()
    async with lab(gate.wait) as served, served.client.send_goal(goal(1)) as handle:
        await settle()
        journal = Journal(served.node)
        gate.opened.set()
        await handle.result()
        assert journal.changes == {1: [SUCCEED]}


async def test_a_hook_may_add_another():
    async with lab(count) as served:
        journals: list[Journal] = []

        def add(handle, old, new):
            if new is GoalStatus.EXECUTING:
                journals.append(Journal(served.node))

        served.node.on_transition(add)
        await served.client.send_goal(goal(1))
        assert [journal.changes for journal in journals] == [{1: [SUCCEED]}]


async def test_several_hooks_are_told_in_the_order_in_which_they_came():
    heard: list[tuple[str, str]] = []
    async with lab(count) as served:
        served.node.on_transition(lambda handle, old, new: heard.append(("first", new.name)))
        served.node.on_transition(lambda handle, old, new: heard.append(("second", new.name)))
        await served.client.send_goal(goal(1))
    states = ["ACCEPTED", "EXECUTING", "SUCCEEDED"]
    assert heard == [(hook, state) for state in states for hook in ("first", "second")]


async def test_a_hook_that_raises_is_logged_and_does_no_harm(send, caplog):
    def hook(handle, old, new):
        raise ValueError("broken")

    async with lab(count) as served:
        served.node.on_transition(hook)
        journal = Journal(served.node)
        assert (await send(served, goal(1))).result == result(0)
        assert journal.changes == {1: [ACCEPT, EXECUTE, SUCCEED]}
    messages = [record.getMessage() for record in caplog.records]
    assert messages == ["an observer of the goals of /count failed"] * 3
    assert all("broken" in record.exc_text for record in caplog.records)


async def test_a_goal_has_ended_once_its_end_is_told():
    held: list[tuple[str, int]] = []
    async with lab(count) as served:

        def hook(handle, old, new):
            held.append((new.name, len(served.active)))

        served.node.on_transition(hook)
        await served.client.send_goal(goal())
    assert held == [("ACCEPTED", 1), ("EXECUTING", 1), ("SUCCEEDED", 0)]


async def test_a_hook_may_cancel_a_goal_that_has_to_wait():
    gate = Gate()
    async with lab(gate.wait, policy="queue") as served, served.client.send_goal(goal(1)):
        journal = Journal(served.node)

        def hook(handle, old, new):
            if new is GoalStatus.ACCEPTED:
                served.local.request_cancel(served.active[-1])

        served.node.on_transition(hook)
        async with served.client.send_goal(goal(2)) as handle:
            assert (await handle.outcome()).status is GoalStatus.CANCELED
        assert journal.changes[2] == [ACCEPT, CANCEL_WAITING, CANCELED]
        await settle()
        assert gate.log == ["begun"]


async def test_a_hook_may_cancel_another_goal():
    async with lab(Gate().wait) as served, served.client.send_goal(goal(1)) as first:
        await settle()

        def hook(handle, old, new):
            if handle.request.upto == 2 and new is GoalStatus.EXECUTING:
                first.cancel_nowait()

        served.node.on_transition(hook)
        async with served.client.send_goal(goal(2)) as second:
            assert (await first.outcome()).status is GoalStatus.CANCELED
            assert second.status is GoalStatus.EXECUTING


@pytest.mark.parametrize(
    ("policy", "state"),
    [
        ("parallel", GoalStatus.ACCEPTED),
        ("queue", GoalStatus.ACCEPTED),
        ("preempt", GoalStatus.ACCEPTED),
        ("parallel", GoalStatus.SUCCEEDED),
        ("queue", GoalStatus.SUCCEEDED),
        ("preempt", GoalStatus.SUCCEEDED),
    ],
)
async def test_a_hook_may_send_a_goal_itself(policy, state):
    async with lab(count, policy=policy) as served:
        journal = Journal(served.node)

        def hook(handle, old, new):
            if handle.request.upto and new is state:
                served.local.accept(GoalRequest(goal(0), None))

        served.node.on_transition(hook)
        with contextlib.suppress(GoalAborted):  # it may be preempted
            await served.client.send_goal(goal(1))
        await settle()
        assert served.active == []
        assert journal.changes[0] == [ACCEPT, EXECUTE, SUCCEED]


# --- the sender's callback ----------------------------------------------------------------------

WHO: ContextVar[str] = ContextVar("WHO", default="nobody")


async def signed(request, handle):
    WHO.set("body")
    await anyio.lowlevel.checkpoint()
    for number in range(2):
        handle.publish_feedback(feedback(number))
        await anyio.lowlevel.checkpoint()
    return result(len(WHO.get()))


async def test_what_a_feedback_callback_sets_stays_there(send_with):
    seen: list[str] = []

    def listen(message):
        seen.append(WHO.get())
        WHO.set("listener")

    async with lab(signed) as served:
        WHO.set("sender")
        assert await send_with(served, listen) == result(len("body"))
        assert WHO.get() == "sender"
    assert seen == ["sender", "listener"]


async def test_a_feedback_callback_of_a_goal_that_waits_runs_in_the_context_of_its_sender():
    gate, seen = Gate(), []

    def note(message):
        seen.append(WHO.get())

    async with lab(gate.stream, policy="queue") as served, served.client.send_goal(goal()):
        WHO.set("second")
        async with served.client.send_goal(goal(), feedback_callback=note) as handle:
            WHO.set("later")
            gate.opened.set()
            await handle.result()
    assert seen == ["second"]


# --- clients that are lost ----------------------------------------------------------------------


async def send_by(client, way):
    """Send a goal in some way, and wait for its result."""
    if way == "awaited":
        return await client.send_goal(goal(7))
    async with client.send_goal(goal(7)) as handle:
        if way == "entered":
            return await handle.result()
        handle.detach()
    return await handle.result()


@pytest.mark.parametrize("way", ["awaited", "entered", "detached"])
async def test_goals_are_canceled_with_their_client_where_the_server_says_so(where, way):
    gate = Gate()
    async with where(gate.wait, on_client_lost="cancel") as served:
        async with running(lambda: send_by(served.client, way)) as sent:
            await gate.started.wait()
            await served.client.aclose()
            await sent.done.wait()
        await settle()
        assert isinstance(sent.error, GoalCanceled if where is lab else ServerUnavailable)
        assert gate.log == ["begun", "canceled", "over"]


async def test_a_goal_that_waits_is_canceled_with_its_client():
    gate = Gate()
    async with lab(gate.wait, on_client_lost="cancel", policy="queue") as served:
        other = served.node.action_client(Count, "count")
        async with (
            served.client.send_goal(goal()) as first,
            other.send_goal(goal()) as second,
        ):
            await other.aclose()
            assert (first.status, second.status) == (GoalStatus.EXECUTING, GoalStatus.CANCELED)


@pytest.mark.parametrize("loss", ["cancel", "keep"])
@pytest.mark.parametrize("way", ["awaited", "entered"])
async def test_a_client_may_leave_while_its_goal_is_with_the_goal_callback(way, loss):
    asked, answered, begun = anyio.Event(), anyio.Event(), []

    async def ask(request):
        asked.set()
        await answered.wait()
        return turtleact.GoalResponse.ACCEPT

    async def act(request):
        begun.append(request.upto)
        return result()

    async with (
        lab(act, goal_callback=ask, on_client_lost=loss) as served,
        running(lambda: send_by(served.client, way)) as sent,
    ):
        await asked.wait()
        await served.client.aclose()
        answered.set()
        await sent.done.wait()
    if loss == "keep":
        assert (sent.value, begun) == (result(), [7])
    else:
        assert isinstance(sent.error, GoalRejected)
        assert (str(sent.error), begun) == ("the goal was rejected: its client has gone", [])


async def test_the_goal_of_a_client_elsewhere_that_goes_while_the_callback_is_asked_is_rejected():
    begun: list[object] = []
    opened = anyio.Event()
    types = implied(Count)

    async def act(request):
        begun.append(request)
        return result(0)

    async def ask(_request):
        await opened.wait()
        return GoalResponse.ACCEPT

    def send(number: int):
        request = types.send_goal.Request(goal_id=UUID(bytes([number] * 16)), goal=goal(number))
        (offered,) = served.node.transport.local(
            "/count/_action/send_goal", f"{Count.type_name}_SendGoal"
        )
        return cast("Any", offered).reply(request, bytes([number] * 16))

    async with (
        lab(act, goal_callback=ask, on_client_lost="cancel") as served,
        running(lambda: send(1)) as gone,
        running(lambda: send(2)) as other,
    ):
        served.local.client_lost(bytes([1] * 16))
        opened.set()
        await gone.done.wait()
        await other.done.wait()
        await settle()
        assert (gone.value.message.accepted, other.value.message.accepted) == (False, True)
        assert begun == [goal(2)]


async def test_the_goals_of_other_clients_go_on():
    gate = Gate()
    async with lab(gate.wait, on_client_lost="cancel") as served:
        other = served.node.action_client(Count, "count")
        async with served.client.send_goal(goal(7), goal_id=b"1" * 16) as handle:
            async with other.send_goal(goal()), other.attach(b"1" * 16):
                await other.aclose()
            await settle()
            gate.opened.set()
            assert await handle.result() == result(7)


async def test_goals_are_canceled_with_the_node_of_their_client():
    transport = MemoryTransport()
    async with lab(Gate().wait, transport=transport, on_client_lost="cancel") as served:
        async with turtleact.open_node("other", transport=transport) as other:
            client = other.action_client(Count, "count")
            async with client.send_goal(goal()) as handle:
                handle.detach()
        await settle()
        assert (handle.status, served.active) == (GoalStatus.CANCELED, [])


@pytest.mark.parametrize("options", [{}, {"on_client_lost": "keep"}], ids=["unsaid", "said"])
@pytest.mark.parametrize("way", ["awaited", "entered", "detached"])
async def test_goals_outlive_their_client_unless_the_server_says_otherwise(options, way):
    gate = Gate()
    async with lab(gate.wait, **options) as served:
        async with running(lambda: send_by(served.client, way)) as sent:
            await served.client.aclose()
            await settle()
            assert not sent.done.is_set()
            gate.opened.set()
        assert sent.value == result(7)


async def test_a_lost_client_does_not_wait_for_the_callback_that_lets_goals_go():
    def refuse(handle):
        return CancelResponse.REJECT

    gate = Gate()
    async with (
        lab(gate.wait, on_client_lost="cancel", cancel_callback=refuse) as served,
        served.client.send_goal(goal()) as handle,
    ):
        await served.client.aclose()
        assert (await handle.outcome()).status is GoalStatus.CANCELED


async def test_nothing_else_can_be_done_with_the_goals_of_lost_clients():
    async with turtleact.open_node("lab") as node:
        with pytest.raises(InvalidOption, match="expected one of keep, cancel, not 'forget'"):
            node.action_server(Count, "count", count, on_client_lost="forget")  # type: ignore[arg-type]  # that is the point


# --- how a goal is sent -------------------------------------------------------------------------


async def awaited_with(served, listen):
    return await served.client.send_goal(goal(), feedback_callback=listen)


async def entered_with(served, listen):
    async with served.client.send_goal(goal(), feedback_callback=listen) as handle:
        return await handle.result()


@pytest.fixture(params=[awaited_with, entered_with])
def send_with(request):
    return request.param


# --- hooks that change what they hear of ---


async def test_a_hook_may_cancel_a_goal_that_is_accepted(send):
    gate = Gate()
    async with lab(gate.wait) as served:
        journal = Journal(served.node)

        def hook(handle, old, new):
            if new is GoalStatus.ACCEPTED:
                served.local.request_cancel(served.active[-1])

        served.node.on_transition(hook)
        assert (await send(served, goal(1))).status is GoalStatus.CANCELED
        assert journal.changes == {1: [ACCEPT, CANCEL_WAITING, CANCELED]}


async def test_a_later_hook_hears_of_changes_in_order_although_an_earlier_one_makes_them(send):
    async with lab(Gate().wait) as served:

        def hook(handle, old, new):
            if new is GoalStatus.EXECUTING:
                served.local.request_cancel(served.active[0])

        served.node.on_transition(hook)
        heard = []
        served.node.on_transition(lambda handle, old, new: heard.append((old.name, new.name)))
        await send(served, goal(1))
        assert heard == [ACCEPT, EXECUTE, CANCEL, CANCELED]
