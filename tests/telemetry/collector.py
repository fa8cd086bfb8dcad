"""A collector of OpenTelemetry for tests: it takes what the real OTLP/HTTP exporter sends."""

from __future__ import annotations

import gzip
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.proto.collector.metrics.v1.metrics_service_pb2 import (
    ExportMetricsServiceRequest,
)
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor


class Collector:
    """What has arrived.

    Attributes:
        url: Where it listens.
        spans: The spans, as protobuf messages.
        metrics: The newest message about metrics.
        resources: The attributes of the resources that sent spans.
    """

    def __init__(self) -> None:
        self.url = ""
        self.spans: list[Any] = []
        self.metrics: Any = None
        self.resources: list[dict[str, Any]] = []

    def take(self, path: str, data: bytes) -> None:
        if path == "/v1/traces":
            for sent in ExportTraceServiceRequest.FromString(data).resource_spans:
                self.resources.append(values(sent.resource.attributes))
                for scope in sent.scope_spans:
                    assert scope.scope.name == "turtleact"
                    self.spans += scope.spans
        else:
            assert path == "/v1/metrics"
            self.metrics = ExportMetricsServiceRequest.FromString(data)

    def named(self, name: str) -> list[Any]:
        """The spans of a name, in the order of their start."""
        found = [span for span in self.spans if span.name == name]
        return sorted(found, key=lambda span: span.start_time_unix_nano)

    def the(self, name: str) -> Any:
        """The only span of a name."""
        (span,) = self.named(name)
        return span

    def points(self, name: str) -> dict[tuple[str, ...], Any]:
        """The data points of a metric, by the values of their attributes."""
        for metrics in self.metrics.resource_metrics[0].scope_metrics:
            for metric in metrics.metrics:
                if metric.name == name:
                    kind = metric.WhichOneof("data")
                    points = getattr(metric, kind).data_points
                    return {tuple(values(each.attributes).values()): each for each in points}
        return {}


def values(attributes: Any) -> dict[str, Any]:
    """Attributes as a dict."""
    return {each.key: getattr(each.value, each.value.WhichOneof("value")) for each in attributes}


def events(span: Any) -> list[str]:
    return [event.name for event in span.events]


@contextmanager
def collecting() -> Iterator[Collector]:
    """Listen on a free port."""
    collector = Collector()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            data = self.rfile.read(int(self.headers["Content-Length"]))
            if self.headers.get("Content-Encoding") == "gzip":
                data = gzip.decompress(data)
            collector.take(self.path, data)
            self.send_response(200)
            self.send_header("Content-Type", "application/x-protobuf")
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            """Log nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        collector.url = f"http://127.0.0.1:{server.server_address[1]}"
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield collector
        finally:
            server.shutdown()
            thread.join()


@contextmanager
def exporting_to(collector: Collector, queue: int = 50_000) -> Iterator[TracerProvider]:
    """A provider whose spans have all been sent at the end of the block."""
    provider = TracerProvider(shutdown_on_exit=False)
    exporter = OTLPSpanExporter(f"{collector.url}/v1/traces")
    batches = BatchSpanProcessor(exporter, max_queue_size=queue, max_export_batch_size=2_000)
    provider.add_span_processor(batches)
    try:
        yield provider
    finally:
        provider.shutdown()
