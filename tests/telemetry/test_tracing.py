"""Goals as spans, exported by the real exporter to a collector in this process."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import asynccontextmanager
from typing import Any

import anyio
import pytest
from opentelemetry import trace
from opentelemetry.sdk.trace import SpanProcessor, TracerProvider
from opentelemetry.sdk.trace.sampling import ALWAYS_OFF
from opentelemetry.trace import StatusCode

import turtleact
from turtleact import Abort, GoalAborted, GoalCanceled, GoalRejected, Reject, ServerUnavailable
from turtleact.goals.wire import GoalMetadata
from turtleact.interfaces.standard import Fibonacci
from turtleact.telemetry import instrument, new_traces
from turtleact.transports import MemoryTransport
from turtleact.transports.base import REQUEST_NOTE

from ..lab import Apart, Count, Gate, count, goal, result, settle
from .collector import Collector, collecting, events, exporting_to, values

SERVER, CLIENT, INTERNAL = 2, 3, 1
"""The kinds of spans in OTLP."""


@pytest.fixture(scope="module")
def listening() -> Iterator[Collector]:
    with collecting() as collector:
        yield collector


@pytest.fixture
def collector(listening: Collector) -> Collector:
    listening.spans.clear()
    return listening


class Lab:
    """A server and a client, both traced.

    Attributes:
        far: The server's node.
        near: The client's node.
        client: The client of ``/count``.
        server: Its server.
    """

    def __init__(self, far: turtleact.Node, near: turtleact.Node, execute: Any, **options: Any):
        self.far = far
        self.near = near
        self.server = far.action_server(Count, "count", execute, **options)
        self.client: Any = near.action_client(Count, "count")


@asynccontextmanager
async def lab(provider: Any, execute: Any, where: str = "here", **options: Any):
    transport = MemoryTransport()
    near: Any = transport if where == "here" else Apart(transport)
    async with (
        turtleact.open_node("far", transport=transport) as far,
        turtleact.open_node("near", transport=near) as node,
    ):
        instrument(far, tracer_provider=provider)
        instrument(node, tracer_provider=provider)
        yield Lab(far, node, execute, **options)


WHERE = pytest.mark.parametrize(("where", "kind"), [("here", INTERNAL), ("elsewhere", CLIENT)])


@WHERE
async def test_a_goal_is_a_span_at_its_client_and_a_child_of_that_at_its_server(
    collector, where, kind
):
    with exporting_to(collector) as provider:
        async with lab(provider, count, where) as made:
            assert await made.client.send_goal(goal(3)) == result(0, 1, 2)
    sent, executed = collector.the("send_goal /count"), collector.the("execute /count")
    assert (sent.kind, executed.kind) == (kind, SERVER)
    assert sent.parent_span_id == b""
    assert (executed.parent_span_id, executed.trace_id) == (sent.span_id, sent.trace_id)
    assert not executed.links
    said = values(executed.attributes)
    assert values(sent.attributes) == {**said, "ros.node": "/near"}
    assert len(said.pop("ros.goal.id")) == 32
    assert said == {
        "rpc.system.name": "ros2_action",
        "rpc.method": "/count",
        "ros.action.name": "/count",
        "ros.action.type": "lab_interfaces/action/Count",
        "ros.node": "/far",
        "ros.goal.status": "SUCCEEDED",
        "ros.feedback.count": 3,
    }
    story = ["accepted", "executing", "feedback", "feedback"]
    assert [events(each) for each in (sent, executed)] == [story, story]
    numbers = [values(each.attributes) for each in executed.events if each.name == "feedback"]
    assert numbers == [{"ros.feedback.number": 1}, {"ros.feedback.number": 3}]
    assert (sent.status.code, executed.status.code) == (0, 0)  # unset


def failed(span: Any) -> tuple[object, ...]:
    said = values(span.attributes)
    return span.status.code, span.status.message, said["error.type"], said.get("ros.goal.reason")


ERROR = StatusCode.ERROR.value


@WHERE
async def test_an_aborted_goal_is_an_error_with_its_reason_on_both_sides(collector, where, kind):
    async def execute(request):
        raise Abort("no such place")

    with exporting_to(collector) as provider:
        async with lab(provider, execute, where) as made:
            with pytest.raises(GoalAborted):
                await made.client.send_goal(goal())
    assert [failed(each) for each in collector.spans] == [
        (ERROR, "no such place", "GoalAborted", "no such place")
    ] * 2


async def test_the_exception_of_a_body_is_recorded_at_the_server(collector):
    async def execute(request):
        raise ValueError("a bad idea")

    with exporting_to(collector) as provider:
        async with lab(provider, execute) as made:
            with pytest.raises(GoalAborted):
                await made.client.send_goal(goal())
    assert events(collector.the("send_goal /count")) == ["accepted", "executing"]
    raised = collector.the("execute /count").events[2]
    said = values(raised.attributes)
    assert raised.name == "exception"
    assert (said["exception.type"], said["exception.message"]) == ("ValueError", "a bad idea")
    assert "in execute" in said["exception.stacktrace"]


@WHERE
async def test_a_rejected_goal_is_an_error_at_its_client(collector, where, kind):
    async def refuse(request):
        raise Reject("not today")

    with exporting_to(collector) as provider:
        async with lab(provider, count, where, goal_callback=refuse) as made:
            with pytest.raises(GoalRejected):
                await made.client.send_goal(goal())
            with pytest.raises(GoalRejected):
                async with made.client.send_goal(goal()):
                    pass
    assert [(each.name, *failed(each)) for each in collector.spans] == [
        ("send_goal /count", ERROR, "not today", "GoalRejected", "not today")
    ] * 2


async def test_a_goal_without_a_server_is_an_error_at_its_client(collector):
    with exporting_to(collector) as provider:
        async with lab(provider, count) as made:
            await made.server.aclose()
            with pytest.raises(ServerUnavailable):
                await made.client.send_goal(goal())
    assert failed(collector.the("send_goal /count"))[2] == "ServerUnavailable"


@WHERE
async def test_a_canceled_goal_is_no_error(collector, where, kind):
    with exporting_to(collector) as provider:
        async with (
            lab(provider, Gate().wait, where) as made,
            made.client.send_goal(goal()) as handle,
        ):
            await handle.cancel()
            with pytest.raises(GoalCanceled):
                await handle.result()
    for span in collector.spans:
        assert span.status.code == 0
        assert values(span.attributes)["ros.goal.status"] == "CANCELED"
        assert events(span) == ["accepted", "executing", "canceling"]
    assert len(collector.spans) == 2


async def test_pauses_are_events(collector):
    gate = Gate()

    async def execute(request, handle):
        await gate.opened.wait()
        await handle.checkpoint()
        return result()

    with exporting_to(collector) as provider:
        async with (
            lab(provider, execute, pausable=True) as made,
            made.client.send_goal(goal()) as handle,
        ):
            gate.opened.set()
            await handle.pause()
            await handle.resume()
            await handle.result()
    assert events(collector.the("execute /count"))[2:] == ["paused", "resumed"]


@pytest.mark.loops("asyncio", "uvloop", "trio")
@WHERE
async def test_goals_that_a_body_sends_are_children_of_its_span(collector, where, kind):
    with exporting_to(collector) as provider:
        async with lab(provider, count, where) as made:
            inner = made.near.action_client(Count, "count")

            async def execute(request):
                with provider.get_tracer("turtleact").start_as_current_span("measuring"):
                    return await inner.send_goal(goal(1))

            made.far.action_server(Count, "outer", execute)
            await made.near.action_client(Count, "outer").send_goal(goal())
    names = ["send_goal /outer", "execute /outer", "measuring", "send_goal /count"]
    names.append("execute /count")
    chain = [collector.the(name) for name in names]
    assert [each.parent_span_id for each in chain[1:]] == [each.span_id for each in chain[:-1]]
    assert len({each.trace_id for each in chain}) == 1


@WHERE
async def test_a_goal_in_a_block_of_new_traces_is_linked(collector, where, kind):
    with exporting_to(collector) as provider:
        async with lab(provider, count, where) as made:
            inner = made.far.action_client(Count, "count")

            async def outer(request):
                return await inner.send_goal(goal(1))

            made.far.action_server(Count, "outer", outer)
            client = made.near.action_client(Count, "outer")
            with new_traces():
                await client.send_goal(goal())
    sent, executed = collector.the("send_goal /outer"), collector.the("execute /outer")
    assert executed.parent_span_id == b""
    assert executed.trace_id != sent.trace_id
    assert [each.span_id for each in executed.links] == [sent.span_id]
    nested = collector.the("execute /count")
    assert (nested.trace_id, list(nested.links)) == (executed.trace_id, [])


@WHERE
async def test_the_span_of_a_client_ends_when_it_leaves_a_detached_goal(collector, where, kind):
    gate = Gate()
    with exporting_to(collector) as provider:
        async with lab(provider, gate.wait, where) as made:
            async with made.client.send_goal(goal()) as handle:
                handle.detach()
                provider.force_flush()
                assert collector.spans == []
            provider.force_flush()
            assert events(collector.the("send_goal /count"))[-1] == "detached"
            gate.opened.set()
            await settle()
    assert values(collector.the("execute /count").attributes)["ros.goal.status"] == "SUCCEEDED"


async def test_goals_that_a_server_leaves_to_its_next_start_are_ended_as_spans(collector, tmp_path):
    async with turtleact.open_journal(tmp_path / "goals.db") as journal:
        options: Any = {"journal": journal, "on_restart": "resume"}
        with exporting_to(collector) as provider:
            async with (
                lab(provider, Gate().wait, **options) as made,
                made.client.send_goal(goal()) as handle,
            ):
                handle.detach()
                await made.far.aclose()
                with pytest.raises(ServerUnavailable):
                    await handle.result()
    kinds = [failed(each)[2] for each in collector.spans]
    assert kinds == ["ServerUnavailable", "ServerUnavailable"]


PARENT = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01"


async def test_a_client_takes_its_parent_from_the_request_being_handled(collector):
    with exporting_to(collector) as provider:
        async with lab(provider, count) as made:
            REQUEST_NOTE.set(GoalMetadata(traceparent=PARENT, tracestate="lab=1").write())
            await made.client.send_goal(goal(1))
    sent, executed = collector.the("send_goal /count"), collector.the("execute /count")
    assert sent.trace_id.hex() == executed.trace_id.hex() == PARENT[3:35]
    assert sent.parent_span_id.hex() == PARENT[36:52]
    assert executed.trace_state == "lab=1"


@pytest.mark.parametrize("parent", ["", "00-", "00-" + "0" * 32 + "-b7ad6b7169203331-01", "\0" * 9])
async def test_a_broken_note_begins_a_trace(collector, parent):
    with exporting_to(collector) as provider:
        async with lab(provider, count) as made:
            REQUEST_NOTE.set(GoalMetadata(traceparent=parent).write())
            await made.client.send_goal(goal(1))
    assert collector.the("send_goal /count").parent_span_id == b""


@WHERE
async def test_a_goal_that_is_not_sampled_has_no_span_on_either_side(collector, where, kind):
    seen: list[Any] = []

    async def execute(request):
        seen.append(trace.get_current_span().get_span_context())
        return result()

    off = TracerProvider(ALWAYS_OFF, shutdown_on_exit=False)
    with exporting_to(collector) as provider:
        transport = MemoryTransport()
        near: Any = transport if where == "here" else Apart(transport)
        async with (
            turtleact.open_node("far", transport=transport) as far,
            turtleact.open_node("near", transport=near) as node,
        ):
            instrument(far, tracer_provider=provider)  # its sampler follows the parent
            instrument(node, tracer_provider=off)
            far.action_server(Count, "count", execute)
            await node.action_client(Count, "count").send_goal(goal(1))
    assert collector.spans == []
    assert seen[0].is_valid
    assert not seen[0].trace_flags.sampled


class Broken(SpanProcessor):
    """Fails at each start and end."""

    def on_start(self, span: Any, parent_context: Any = None) -> None:
        raise ValueError("at the start")

    def on_end(self, span: Any) -> None:
        raise ValueError("at the end")


@WHERE
async def test_a_span_processor_that_fails_does_no_harm_to_goals(caplog, where, kind):
    provider = TracerProvider(shutdown_on_exit=False)
    provider.add_span_processor(Broken())
    async with lab(provider, count, where) as made:
        for _ in range(2):
            assert await made.client.send_goal(goal(2)) == result(0, 1)
    assert "at the start" in caplog.text


async def test_goals_that_run_already_are_left_out(collector):
    gate = Gate()
    with exporting_to(collector) as provider:
        async with turtleact.open_node("all") as node:
            node.action_server(Count, "count", gate.wait)
            client = node.action_client(Count, "count")
            async with client.send_goal(goal()) as handle:
                instrument(node, tracer_provider=provider)
                gate.opened.set()
                await handle.result()
                assert await client.send_goal(goal()) == result(3)
    assert Counter(each.name for each in collector.spans) == {
        "send_goal /count": 1,
        "execute /count": 1,
    }


async def test_a_second_call_of_instrument_does_nothing(collector):
    with exporting_to(collector) as provider:
        async with lab(provider, count) as made:
            instrument(made.far, tracer_provider=provider)
            instrument(made.near, tracer_provider=provider)
            await made.client.send_goal(goal(1))
    assert len(collector.spans) == 2


SERVE = """
import sys, anyio, turtleact
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor
from turtleact.interfaces.standard import Fibonacci
from turtleact.telemetry import instrument

async def main(address, url):
    provider = TracerProvider(resource=Resource({"service.name": "the server"}))
    batches = BatchSpanProcessor(OTLPSpanExporter(url), max_queue_size=50_000)
    provider.add_span_processor(batches)
    async with (
        turtleact.open_zenoh(mode="router", listen=[address], domain=0) as graph,
        turtleact.open_node("far", transport=graph) as node,
    ):
        instrument(node, tracer_provider=provider)
        inner = node.action_client(Fibonacci, "inner")

        async def act(request):
            yield Fibonacci.Feedback()
            yield Fibonacci.Result(sequence=[request.order])

        async def outer(request):
            return await inner.send_goal(request)

        node.action_server(Fibonacci, "inner", act)
        node.action_server(Fibonacci, "outer", outer)
        print("ready", flush=True)
        await anyio.to_thread.run_sync(sys.stdin.read)
    provider.shutdown()

anyio.run(main, *sys.argv[1:])
"""


@asynccontextmanager
async def traced_process(collector: Collector, address: str):
    """A node that is connected to another process; all spans have arrived at the end."""
    command = [sys.executable, "-c", SERVE, address, f"{collector.url}/v1/traces"]
    with (
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as process,
        exporting_to(collector) as provider,
    ):
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        async with (
            turtleact.open_zenoh([address], domain=0) as graph,
            turtleact.open_node("near", transport=graph) as node,
        ):
            instrument(node, tracer_provider=provider)
            yield node
        await anyio.to_thread.run_sync(process.communicate, "")


async def test_nested_goals_in_two_processes_are_one_trace_over_zenoh(collector, free_address):
    async with traced_process(collector, free_address) as node:
        client = node.action_client(Fibonacci, "outer")
        for order in range(3):
            answer = await client.send_goal(Fibonacci.Goal(order=order))
            assert answer.sequence == [order]
    names = ["send_goal /outer", "execute /outer", "send_goal /inner", "execute /inner"]
    chains = list(zip(*map(collector.named, names), strict=True))
    assert len(chains) == 3
    for chain in chains:
        assert [each.kind for each in chain] == [CLIENT, SERVER, INTERNAL, SERVER]
        assert len({each.trace_id for each in chain}) == 1
        assert [each.parent_span_id for each in chain[1:]] == [each.span_id for each in chain[:-1]]
        assert values(chain[1].attributes)["ros.domain_id"] == 0
    assert {each["service.name"] for each in collector.resources} >= {"the server"}
