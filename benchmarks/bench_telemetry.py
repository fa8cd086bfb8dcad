"""What does it cost to trace and measure goals, and does every span arrive?

The first table has goals within one process, sent one by one, each on a node of its own that is
watched in another way. Rounds are interleaved. A time is the processor time of the event loop's
thread. It does not include other programs or the exporter's threads. A cost is the median of the
rounds' differences from a node that is not watched.

The second part sends 10,000 goals and exports their spans by OTLP over HTTP to a collector in the
same process, which decodes them. Each goal must have two spans, and the server's must be the child
of the client's. "To the last span" contains the export and the collector.

Run: ``python -m benchmarks.bench_telemetry``
"""

from __future__ import annotations

import gc
import os
import statistics
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.metadata import version
from typing import Any

import anyio
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.metrics import NoOpMeterProvider
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.sdk.metrics import MeterProvider
from opentelemetry.sdk.metrics.export import InMemoryMetricReader
from opentelemetry.sdk.trace import SpanProcessor, TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor
from opentelemetry.sdk.trace.sampling import ALWAYS_OFF
from opentelemetry.trace import NoOpTracerProvider

from turtleact import ActionClient, Node, open_node
from turtleact.interfaces.standard import Fibonacci
from turtleact.telemetry import GoalMetrics, instrument

Client = ActionClient[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]

ROUNDS = 15
GOALS = 300
EXPORTED = 10_000
AT_ONCE = 50

OFF = TracerProvider(ALWAYS_OFF, shutdown_on_exit=False)
NO_METRICS = NoOpMeterProvider()
NO_TRACES = NoOpTracerProvider()


def recording() -> TracerProvider:
    """A provider that records spans and drops them when they end."""
    provider = TracerProvider(shutdown_on_exit=False)
    provider.add_span_processor(SpanProcessor())
    return provider


def sdk_metrics() -> MeterProvider:
    return MeterProvider([InMemoryMetricReader()], shutdown_on_exit=False)


WATCHED: dict[str, Callable[[Node], object]] = {
    "not watched": lambda _: None,
    "`GoalMetrics`": lambda node: GoalMetrics().watch(node),
    "`instrument`, no SDK": instrument,
    "`instrument`, sampler off": lambda node: instrument(
        node, tracer_provider=OFF, meter_provider=NO_METRICS
    ),
    "`instrument`, every goal recorded": lambda node: instrument(
        node, tracer_provider=recording(), meter_provider=NO_METRICS
    ),
    "`instrument`, metrics of the SDK": lambda node: instrument(
        node, tracer_provider=NO_TRACES, meter_provider=sdk_metrics()
    ),
}


async def act(_: Fibonacci.Goal) -> Fibonacci.Result:
    return Fibonacci.Result()


async def time_of(client: Client) -> float:
    """The time of a goal (us)."""
    request = Fibonacci.Goal(order=1)
    begun = time.thread_time()
    for _ in range(GOALS):
        await client.send_goal(request)
    return (time.thread_time() - begun) / GOALS * 1e6


async def compare() -> None:
    async with AsyncExitStack() as stack:
        clients = {}
        for number, (name, watch) in enumerate(WATCHED.items()):
            node = await stack.enter_async_context(open_node(f"bench_{number}"))
            watch(node)
            node.action_server(Fibonacci, "act", act, result_timeout=0.0)
            clients[name] = node.action_client(Fibonacci, "act")
        rounds: list[dict[str, float]] = []
        for _ in range(ROUNDS + 1):
            gc.collect()
            rounds.append({name: await time_of(client) for name, client in clients.items()})
        del rounds[0]
    print("| node | goal (us) | more than not watched (us) |")
    print("|---|---|---|")
    for name in WATCHED:
        took = statistics.median(each[name] for each in rounds)
        more = statistics.median(each[name] - each["not watched"] for each in rounds)
        print(f"| {name} | {took:.1f} | {more:+.1f} |")


def sampler_off() -> float:
    """The time that the SDK alone takes to start a span that is not sampled (us)."""
    tracer = OFF.get_tracer("bench")
    times = []
    for _ in range(ROUNDS):
        begun = time.thread_time()
        for _ in range(1_000):
            tracer.start_span("bench", attributes={"one": "1", "two": "2"})
        times.append((time.thread_time() - begun) * 1e3)
    return statistics.median(times)


@contextmanager
def collector(spans: list[Any]) -> Iterator[str]:
    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            data = self.rfile.read(int(self.headers["Content-Length"]))
            for sent in ExportTraceServiceRequest.FromString(data).resource_spans:
                for scope in sent.scope_spans:
                    spans.extend(scope.spans)
            self.send_response(200)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            """Log nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/v1/traces"
        server.shutdown()


async def export() -> None:
    spans: list[Any] = []
    with collector(spans) as url:
        provider = TracerProvider(shutdown_on_exit=False)
        exporter = BatchSpanProcessor(
            OTLPSpanExporter(url), max_queue_size=3 * EXPORTED, max_export_batch_size=2_048
        )
        provider.add_span_processor(exporter)
        begun = time.perf_counter()
        async with open_node("bench") as node:
            instrument(node, tracer_provider=provider, meter_provider=NO_METRICS)
            node.action_server(Fibonacci, "act", act, result_timeout=0.0)
            client = node.action_client(Fibonacci, "act")
            for _ in range(EXPORTED // AT_ONCE):
                async with anyio.create_task_group() as group:
                    for _ in range(AT_ONCE):
                        group.start_soon(client.send_goal, Fibonacci.Goal(order=1))
        sent = time.perf_counter() - begun
        provider.shutdown()
        took = time.perf_counter() - begun
    clients = {each.span_id for each in spans if each.name == "send_goal /act"}
    parents = [each.parent_span_id for each in spans if each.name == "execute /act"]
    assert len(spans) == 2 * EXPORTED
    assert set(parents) == clients
    assert all(each.end_time_unix_nano for each in spans)
    print(f"\n{EXPORTED:,} goals in {sent:.1f} s gave {len(spans):,} spans, all with an end,")
    print(f"{len(parents):,} of them children of their client's; {took:.1f} s to the last span")


def main() -> None:
    load = os.getloadavg()[0]
    sdk = version("opentelemetry-sdk")
    print(f"{sys.version.split()[0]}, SDK {sdk}, {os.cpu_count()} cores, load {load:.1f}\n")
    anyio.run(compare)
    print(f"\nThe SDK alone starts a span that is not sampled in {sampler_off():.1f} us")
    anyio.run(export)


if __name__ == "__main__":
    main()
