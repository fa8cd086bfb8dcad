"""A node: its names, what is opened on it, what others see of it, and how it is left."""

from __future__ import annotations

import asyncio
import gc
import weakref
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing, asynccontextmanager
from typing import Any

import anyio
import anyio.lowlevel
import pytest

import turtleact
from turtleact import GoalStatus, Outcome, QoS
from turtleact.errors import (
    ActionConflict,
    InvalidBody,
    InvalidName,
    InvalidOption,
    ServerUnavailable,
    TurtleactError,
)
from turtleact.interfaces import Message, Service, int32
from turtleact.interfaces.standard import Fibonacci
from turtleact.transports import MemoryTransport, open_zenoh

from ..lab import (
    ON_ASYNCIO,
    Count,
    Gate,
    count,
    feedback,
    goal,
    other_tasks,
    result,
    running,
    settle,
)

SHUTDOWN = Outcome(GoalStatus.ABORTED, result(), "shutdown")
CLOSED = "node '/lab' is closed: open another"


class Word(Message, type_name="lab_interfaces/msg/Word"):
    number: int32 = 0


class Double(Service, type_name="lab_interfaces/srv/Double"):
    class Request(Message):
        number: int32 = 0

    class Response(Message):
        number: int32 = 0


def double(request: Double.Request) -> Double.Response:
    return Double.Response(number=2 * request.number)


async def fibonacci(goal: Fibonacci.Goal) -> Fibonacci.Result:
    return Fibonacci.Result()


OPENINGS: dict[str, Callable[[turtleact.Node, str], Any]] = {
    "action_server": lambda node, name: node.action_server(Count, name, count),
    "action_client": lambda node, name: node.action_client(Count, name),
    "publisher": lambda node, name: node.publisher(Word, name),
    "subscription": lambda node, name: node.subscription(Word, name),
    "service": lambda node, name: node.service(Double, name, double),
    "service_client": lambda node, name: node.service_client(Double, name),
}
OPENED = len(OPENINGS) + 4
"""So many endpoints they make: an action's server has five."""

EACH_OPENING = pytest.mark.parametrize("open_it", OPENINGS.values(), ids=OPENINGS)


@asynccontextmanager
async def two_nodes() -> AsyncIterator[tuple[turtleact.Node, turtleact.Node]]:
    """Two nodes, ``lab`` and ``user``, on one transport."""
    transport = MemoryTransport()
    async with (
        turtleact.open_node("lab", transport=transport) as lab,
        turtleact.open_node("user", transport=transport) as user,
    ):
        yield lab, user


def is_deserted(transport: MemoryTransport) -> bool:
    return not transport.endpoints() and not transport.nodes()


# --- names ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("namespace", "full_name"),
    [("/", "/lab"), ("/sim", "/sim/lab"), ("/sim/one", "/sim/one/lab"), ("sim", "/sim/lab")],
)
async def test_the_full_name_is_the_namespace_and_the_name(namespace, full_name):
    async with turtleact.open_node("lab", namespace=namespace) as node:
        assert (node.name, node.fully_qualified_name) == ("lab", full_name)
        assert node.graph().nodes == (full_name,)


@pytest.mark.parametrize("namespace", ["", "/sim/", "/a//b", "/1", "~", "~/sim", "/the sim"])
async def test_what_is_no_namespace_is_refused(namespace):
    transport = MemoryTransport()
    with pytest.raises(InvalidName):
        await turtleact.open_node("lab", namespace=namespace, transport=transport).__aenter__()
    assert is_deserted(transport)


@EACH_OPENING
@pytest.mark.parametrize(
    ("name", "full_name"),
    [("it", "/sim/it"), ("a/it", "/sim/a/it"), ("/it", "/it"), ("~/it", "/sim/lab/it")],
)
async def test_a_name_is_put_below_the_namespace(open_it, name, full_name):
    async with turtleact.open_node("lab", namespace="/sim") as node:
        opened = open_it(node, name)
        assert (opened.topic if hasattr(opened, "topic") else opened.name) == full_name
        assert {endpoint.node for endpoint in node.transport.endpoints()} == {"/sim/lab"}
        names = {each.name.split("/_action/")[0] for each in node.transport.endpoints()}
        assert names - {f"{full_name}/pause", f"{full_name}/resume"} == {full_name}


@EACH_OPENING
@pytest.mark.parametrize("name", ["", "a//b", "1", "it/", "the it", "a/~/b"])
async def test_what_is_no_name_is_refused_and_nothing_opened(open_it, name):
    async with turtleact.open_node("lab") as node:
        with pytest.raises(InvalidName):
            open_it(node, name)
        assert node.transport.endpoints() == ()


# --- actions on a node ----------------------------------------------------------------------


@turtleact.action(Count, "count", goal_callback=lambda request: turtleact.GoalResponse.REJECT)
async def closed_today(request):
    return result()


async def test_a_declared_action_can_be_served_under_another_name():
    async with turtleact.open_node("lab", namespace="/sim") as node:
        assert node.serve(closed_today, name="~/count").name == "/sim/lab/count"


async def test_other_options_than_the_declared_ones_can_be_given():
    async with turtleact.open_node("lab") as node:
        node.serve(closed_today, goal_callback=None)
        assert await node.action_client(Count, "count").send_goal(goal()) == result()
        assert closed_today.options.keys() == {"goal_callback"}


async def test_a_function_that_is_not_declared_cannot_be_served():
    async with turtleact.open_node("lab") as node:
        with pytest.raises(
            TypeError, match=r"^count is no action: declare it with @turtleact.action$"
        ):
            node.serve(count)  # type: ignore[arg-type]  # that is the test
        with pytest.raises(TypeError, match="was called already: pass the function itself"):
            node.serve(count(goal()))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("open_one", "kind", "given"),
    [
        (lambda node, given: node.action_server(given, "a", count), "Action", Count.Goal),
        (lambda node, given: node.action_client(given, "a"), "Action", Word),
        (lambda node, given: node.publisher(given, "a"), "Message", Count),
        (lambda node, given: node.subscription(given, "a"), "Message", "Word"),
        (lambda node, given: node.service(given, "a", double), "Service", Word),
        (lambda node, given: node.service_client(given, "a"), "Service", Count),
    ],
)
async def test_an_interface_of_another_kind_is_refused(open_one, kind, given):
    names: dict[object, str] = {Count.Goal: "Count.Goal: give Count itself"}
    names["Word"] = "'Word': give the class, for example turtleact.get_message(TYPE)"
    name = names.get(given) or given.__qualname__
    async with turtleact.open_node("lab") as node:
        with pytest.raises(TypeError) as refused:
            open_one(node, given)
        assert node.transport.endpoints() == ()
    assert str(refused.value) == f"expected a subclass of turtleact.{kind}, not {name}"


async def test_an_option_that_there_is_not_is_refused():
    async with turtleact.open_node("lab") as node:
        options: Any = {"result_timeuot": 1.0}
        with pytest.raises(TypeError, match="an action server has no option 'result_timeuot'"):
            node.action_server(Count, "count", count, **options)
        assert node.transport.endpoints() == ()


async def test_a_function_that_is_no_body_is_refused_and_nothing_opened():
    async with turtleact.open_node("lab") as node:
        with pytest.raises(InvalidBody):
            node.action_server(Count, "count", lambda request: result())  # type: ignore[arg-type]  # meant
        assert node.transport.endpoints() == ()


async def test_nodes_that_share_no_transport_do_not_see_each_other():
    async with turtleact.open_node("lab") as lab, turtleact.open_node("user") as user:
        lab.action_server(Count, "count", count)
        assert user.graph().actions == {}
        with pytest.raises(ServerUnavailable):
            await user.action_client(Count, "count").send_goal(goal())


async def seven(request: Count.Goal) -> Count.Result:
    return result(7)


async def test_a_second_node_that_serves_a_name_is_refused_with_the_first_ones_name():
    async with two_nodes() as (lab, user):
        first = lab.action_server(Count, "count", count)
        with pytest.raises(ActionConflict, match="action '/count' is served by node /lab already"):
            user.action_server(Count, "count", seven)
        await first.aclose()
        user.action_server(Count, "count", seven)
        assert await user.action_client(Count, "count").send_goal(goal()) == result(7)


async def test_a_node_that_serves_a_name_with_the_same_type_twice_is_refused():
    async with two_nodes() as (lab, _):
        lab.action_server(Count, "count", count)
        with pytest.raises(ActionConflict, match="served by node /lab already"):
            lab.action_server(Count, "count", seven)


async def test_one_that_waits_can_be_waited_for(caplog):
    async with two_nodes() as (lab, user), anyio.create_task_group() as beside:
        first = lab.action_server(Count, "count", count)
        waiting = user.action_server(Count, "count", seven, on_conflict="wait")
        assert (first.is_serving, waiting.is_serving) == (True, False)
        beside.start_soon(first.aclose)
        assert await waiting.wait_until_serving()
        assert (first.is_serving, waiting.is_serving) == (False, True)
    assert caplog.messages == [
        "/count is served by /lab: waiting until that node has gone",
        "/count is free: serving it now",
    ]


async def test_one_that_waits_can_be_closed():
    async with two_nodes() as (lab, user), anyio.create_task_group() as beside:
        lab.action_server(Count, "count", count)
        waiting = user.action_server(Count, "count", seven, on_conflict="wait")
        beside.start_soon(waiting.aclose)
        assert not await waiting.wait_until_serving()
        assert not waiting.is_open


@pytest.mark.loops("asyncio")
async def test_a_restarted_node_waits_for_its_predecessor_with_all_types_of_a_name(tmp_path):
    """Two sessions, as of two processes, that know each other by discovery only."""
    here = f"unixsock-stream/{tmp_path}/router"
    async with (
        open_zenoh(mode="router", listen=[here]) as first,
        open_zenoh(mode="peer", connect=[here]) as second,
        turtleact.open_node("lab", transport=first) as before,
        turtleact.open_node("lab", transport=second) as after,
    ):
        before.action_server(Count, "count", count)
        await first.flush()
        await second.explore()
        declared: list[turtleact.ActionServer[Any, Any, Any]] = [
            after.action_server(Count, "count", count),
            after.action_server(Fibonacci, "count", fibonacci),
        ]
        assert not any(server.is_serving for server in declared)
        await before.aclose()
        with anyio.fail_after(10.0):
            assert all([await server.wait_until_serving() for server in declared])


async def test_a_built_in_makes_way_and_its_running_goals_finish(caplog):
    gate = Gate()
    transport = MemoryTransport()
    async with (
        turtleact.open_node("turtle_actions", transport=transport) as home,
        turtleact.open_node("user", transport=transport) as user,
    ):
        built_in = home.action_server(Count, "count", gate.wait, on_conflict="withdraw")
        client = user.action_client(Count, "count")
        async with client.send_goal(goal()) as running_goal:
            user.action_server(Count, "count", seven)
            await settle()
            assert not built_in.is_open
            assert await client.send_goal(goal()) == result(7)
            gate.opened.set()
            assert (await running_goal.outcome()).status is GoalStatus.SUCCEEDED
        await settle()
        assert transport.endpoints("/count/_action/status")[0].node == "/user"
        (said,) = caplog.messages
    assert said == "/count is served by /user now: the built-in action withdraws"


async def test_a_built_in_serves_again_when_the_other_server_has_gone(caplog):
    transport = MemoryTransport()
    said = []
    async with (
        turtleact.open_node("turtle_actions", transport=transport) as home,
        turtleact.open_node("user", transport=transport) as user,
    ):
        home.on_transition(lambda handle, _, new: said.append((handle.action_name, new)))
        both: list[Any] = [Count, Fibonacci]
        for action_type in both:
            home.action_server(action_type, "count", seven, on_conflict="withdraw")
        client = user.action_client(Count, "count")
        for _ in range(2):
            async with aclosing(user.action_server(Count, "count", count)):
                await settle()
                assert await client.send_goal(goal()) != result(7)
            await settle()
            assert await client.send_goal(goal()) == result(7)
        assert len(user.graph().actions["/count"]) == 2
        assert said[-1] == ("/count", GoalStatus.SUCCEEDED)
    assert caplog.messages == 2 * [
        "/count is served by /user now: the built-in action withdraws",
        "/count is free: the built-in action serves it again",
    ]


async def test_a_node_closes_while_its_built_in_action_is_away():
    transport = MemoryTransport()
    async with turtleact.open_node("user", transport=transport) as user:
        user.action_server(Count, "count", seven)
        async with turtleact.open_node("turtle_actions", transport=transport) as home:
            home.action_server(Count, "count", count, on_conflict="withdraw")
            await settle()
        await user.aclose()
        await settle()
    assert transport.endpoints() == ()


async def test_there_is_no_other_answer_to_a_conflict():
    async with two_nodes() as (lab, _):
        with pytest.raises(InvalidOption, match="'on_conflict': expected one of refuse, wait"):
            lab.action_server(Count, "count", count, on_conflict="fight")  # type: ignore[arg-type]


# --- the graph ------------------------------------------------------------------------------


async def test_a_node_on_which_nothing_is_opened_is_in_the_graph():
    async with two_nodes() as (lab, user):
        assert lab.graph() == user.graph()
        assert lab.graph().nodes == ("/lab", "/user")
        await lab.aclose()
        assert user.graph().nodes == ("/user",)


@EACH_OPENING
async def test_what_was_closed_is_gone_from_the_graph(open_it):
    async with turtleact.open_node("lab") as node:
        before = node.graph()
        await open_it(node, "it").aclose()
        assert node.graph() == before
        assert node.transport.endpoints() == ()


async def test_publishers_of_a_topic_are_counted_on_all_nodes():
    async with two_nodes() as (lab, user):
        publishers = [lab.publisher(Word, "words"), user.publisher(Word, "/words")]
        user.subscription(Word, "words")
        user.publisher(Word, "others")
        assert lab.count_publishers("words") == 2
        await publishers[0].aclose()
        assert user.count_publishers("words") == 1


# --- leaving --------------------------------------------------------------------------------


async def test_leaving_the_block_closes_all_that_was_opened():
    transport = MemoryTransport()
    async with turtleact.open_node("lab", transport=transport) as node:
        for open_it in OPENINGS.values():
            open_it(node, "it")
        assert (node.is_open, len(transport.endpoints())) == (True, OPENED)
    assert not node.is_open
    assert is_deserted(transport)


async def test_leaving_a_node_leaves_others_alone():
    async with two_nodes() as (lab, user):
        for node in (lab, user):
            for open_it in OPENINGS.values():
                open_it(node, f"it_of_{node.name}")
        await lab.aclose()
        assert len(user.transport.endpoints()) == OPENED
        client = user.action_client(Count, f"it_of_{user.name}")
        assert await client.send_goal(goal()) == result(0, 1, 2)


async def test_an_exception_in_the_block_passes_and_the_node_is_closed():
    transport, gate, error = MemoryTransport(), Gate(), ValueError("no pen")

    async def fail() -> None:
        async with turtleact.open_node("lab", transport=transport) as node:
            node.action_server(Count, "count", gate.wait)
            await node.action_client(Count, "count").send_goal(goal()).__aenter__()
            await settle()
            raise error

    with pytest.raises(ValueError, match="no pen") as caught:
        await fail()
    assert caught.value is error
    assert gate.log == ["begun", "canceled", "over"]
    assert is_deserted(transport)


async def test_leaving_ends_readers_and_callers_that_wait():
    async def never(request):
        await anyio.sleep_forever()

    async with two_nodes() as (lab, user):
        receiving = lab.subscription(Word, "words")
        lab.service(Double, "double", never)
        caller = user.service_client(Double, "double")

        async def read():
            return [message async for message in receiving]

        async with (
            running(read) as reading,
            running(lambda: caller.call(Double.Request())) as calling,
        ):
            await lab.aclose()
            await reading.done.wait()
            await calling.done.wait()
            assert reading.value == []
            assert isinstance(calling.error, ServerUnavailable)


async def test_a_body_still_has_its_topics_services_and_clients_for_its_clean_up():
    log: list[object] = []

    async def body(request, handle):
        words = handle.node.publisher(Word, "words")
        doubled = handle.node.service_client(Double, "double")
        twists = handle.node.subscription(Word, "twists")
        try:
            log.append(await anext(twists))
        finally:
            words.publish(Word(number=7))
            with anyio.CancelScope(shield=True):
                log.append(await doubled.call(Double.Request(number=2)))
            log.append("cleaned up")

    async with two_nodes() as (lab, user):
        lab.service(Double, "double", double)
        lab.action_server(Count, "count", body)
        heard = user.subscription(Word, "words")
        async with user.action_client(Count, "count").send_goal(goal()) as handle:
            await settle()
            await lab.aclose()
            assert await handle.outcome() == SHUTDOWN
        assert log == [Double.Response(number=4), "cleaned up"]
        assert heard.drain() == [Word(number=7)]


async def test_all_actions_of_a_node_are_canceled_before_any_is_waited_for():
    canceled = {name: anyio.Event() for name in ("one", "two")}

    def waits_for(mine, other):
        async def body(request):
            try:
                await anyio.sleep_forever()
            finally:
                canceled[mine].set()
                with anyio.CancelScope(shield=True):
                    await canceled[other].wait()

        return body

    async with two_nodes() as (lab, user):
        lab.action_server(Count, "one", waits_for("one", "two"))
        lab.action_server(Count, "two", waits_for("two", "one"))
        async with (
            user.action_client(Count, "one").send_goal(goal()) as one,
            user.action_client(Count, "two").send_goal(goal()) as two,
        ):
            await settle()
            with anyio.fail_after(2):
                await lab.aclose()
            assert await one.outcome() == await two.outcome() == SHUTDOWN


async def test_what_is_closed_early_is_not_held_by_the_node():
    async with turtleact.open_node("lab") as node:
        closed = [open_it(node, "it") for open_it in OPENINGS.values()]
        for each in closed:
            await each.aclose()
        left = [weakref.ref(each) for each in closed]
        del closed, each
        gc.collect()
        assert [each() for each in left] == [None] * len(left)


# --- canceled at every point ----------------------------------------------------------------


class Busy:
    """A body and a handler that wait as often as can be, in their clean-up too."""

    def __init__(self) -> None:
        self.active = 0

    @asynccontextmanager
    async def counted(self) -> AsyncIterator[None]:
        self.active += 1
        try:
            yield
        finally:
            try:
                with anyio.CancelScope(shield=True):
                    await take(2)
            finally:
                self.active -= 1

    async def body(self, request, handle):
        async with self.counted():
            words = handle.node.publisher(Word, "words")
            for number in range(3):
                words.publish(Word(number=number))
                handle.publish_feedback(feedback(number))
                await take(1)
            return result()

    async def handler(self, request):
        async with self.counted():
            await take(2)
            return double(request)


async def take(turns: int) -> None:
    for _ in range(turns):
        await anyio.lowlevel.checkpoint()


async def live(busy: Busy, transport: MemoryTransport) -> None:
    """A node's life with all that it can wait for."""
    async with turtleact.open_node("lab", transport=transport) as node:
        node.action_server(Count, "count", busy.body)
        node.service(Double, "double", busy.handler)
        words = node.subscription(Word, "words", QoS(depth=1))
        client = node.action_client(Count, "count")
        await client.wait_for_server()
        async with client.send_goal(goal()) as handle:
            await anext(words)
            async for _ in handle:
                await take(1)
        await client.send_goal(goal())
        await node.service_client(Double, "double").call(Double.Request(number=1))
        left = client.send_goal(goal())
        (await left.__aenter__()).detach()
        await take(1)


async def cancel_after(turns: int, call: Callable[[], Any], *, is_native: bool) -> bool:
    """Run a call in a task of its own and cancel it after some turns; whether it was still on."""
    if is_native:
        task = asyncio.create_task(call())
        for _ in range(turns):
            await asyncio.sleep(0)
        was_on = task.cancel()
        await asyncio.wait([task])
        return was_on
    scope, is_over = anyio.CancelScope(), anyio.Event()

    async def run() -> None:
        with scope:
            await call()
        is_over.set()

    async with anyio.create_task_group() as group:
        group.start_soon(run)
        for _ in range(turns):
            await anyio.lowlevel.checkpoint()
        was_on = not is_over.is_set()
        scope.cancel()
    return was_on


async def cancel_everywhere(*, is_native: bool) -> int:
    """Cancel a node's life at each point from its beginning on; answer how many there were."""
    on_asyncio = anyio.get_cancelled_exc_class() is asyncio.CancelledError
    before = other_tasks() if on_asyncio else set()
    for turns in range(500):
        busy, transport = Busy(), MemoryTransport()
        was_on = await cancel_after(turns, lambda: live(busy, transport), is_native=is_native)  # noqa: B023  # it is over before the next turn
        assert is_deserted(transport), f"after {turns} turns"
        assert busy.active == 0, f"after {turns} turns"
        await settle()
        assert not on_asyncio or other_tasks() == before, f"after {turns} turns"
        if not was_on:
            return turns
    pytest.fail("the node never came to its end")


async def test_a_node_canceled_by_a_scope_at_any_point_leaves_nothing_behind():
    assert await cancel_everywhere(is_native=False) > 10  # awaits, in any order that trio chooses


@ON_ASYNCIO
async def test_a_node_canceled_as_a_task_at_any_point_leaves_nothing_behind():
    assert await cancel_everywhere(is_native=True) > 20


# --- after the closing ----------------------------------------------------------------------


@EACH_OPENING
async def test_nothing_can_be_opened_on_a_closed_node(open_it):
    async with turtleact.open_node("lab") as node:
        await node.aclose()
        with pytest.raises(TurtleactError) as caught:
            open_it(node, "it")
        assert str(caught.value) == CLOSED
        assert is_deserted(node.transport)  # type: ignore[arg-type]  # its own, in this process


async def test_closing_twice_is_closing_once():
    async with two_nodes() as (lab, user):
        lab.action_server(Count, "count", count)
        await lab.aclose()
        await lab.aclose()
        assert user.graph().nodes == ("/user",)
