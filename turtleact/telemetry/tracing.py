"""A goal as spans: one at its client, from the request to the end, one at its server.

========================  ==========  ==========================================================
span                      kind        parent
========================  ==========  ==========================================================
``send_goal /patrol``     CLIENT      the current span; INTERNAL if the server is in this process
``execute /patrol``       SERVER      the client's span, or only a link to it (`new_traces`)
========================  ==========  ==========================================================

The server's span is current in the body, so goals that the body sends are its children. A request
to another process carries the client's span in its note (`turtleact.goal_wire.GoalNote`). A goal
from a client that sends no note begins a trace.

If the client is in this process and its span is not sampled, the server makes no span either.

This module uses only OpenTelemetry's API, which never blocks. An exception of a sampler or span
processor is logged and does not affect the goal.

Source: W3C Trace Context; OpenTelemetry's semantic conventions 1.44, "RPC".
"""

from __future__ import annotations

import logging
from importlib.metadata import version
from time import time_ns
from types import TracebackType
from typing import Any, Final

import msgspec
from opentelemetry import context as contexts
from opentelemetry import trace
from opentelemetry.context import Context
from opentelemetry.trace import Link, Span, SpanKind, StatusCode
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

from turtleact.errors import GoalRejected, TurtleactError
from turtleact.goal import Goal, GoalStatus
from turtleact.goal_id import new_goal_id
from turtleact.goal_server import GoalOrder
from turtleact.goal_wire import GoalNote
from turtleact.names import action_names
from turtleact.node import Node, local_server_of
from turtleact.observers import (
    BodyFailed,
    Detached,
    FeedbackLost,
    GoalObserver,
    Lost,
    News,
    Observers,
)
from turtleact.telemetry.linking import NEW_TRACES
from turtleact.telemetry.measuring import AnyClient, AnyServer
from turtleact.transports.base import REQUEST_NOTE

__all__ = ["Tracing"]

logger = logging.getLogger("turtleact.telemetry")

LONGEST_STATE: Final = 512
"""A longer ``tracestate`` is left out (characters); the least that W3C asks tracers to pass on."""

PROPAGATOR: Final = TraceContextTextMapPropagator()

NO_NOTE: Final = GoalNote()

ENDS: Final = {GoalStatus.SUCCEEDED, GoalStatus.CANCELED, GoalStatus.ABORTED}


class Tracing:
    """Makes the spans of a node's goals.

    Args:
        node: The node.
        provider: Where spans go; None for the program's global provider.

    Attributes:
        is_off: Whether the program wants no traces.
    """

    def __init__(self, node: Node, provider: trace.TracerProvider | None) -> None:
        self._tracer = trace.get_tracer("turtleact", version("turtleact"), provider)
        self.is_off = isinstance(self._tracer, trace.NoOpTracer)
        self._node = node
        domain = getattr(getattr(node.transport, "context", None), "domain", None)
        self._of_node: dict[str, str | int] = {
            "rpc.system.name": "ros2_action",
            "ros.node": node.fully_qualified_name,
        }
        if domain is not None:
            self._of_node["ros.domain_id"] = domain

    def add_server(self, server: AnyServer) -> None:
        """Trace the goals of a server."""
        attributes = self._attributes(server)
        local = local_server_of(server)
        if local.slot_name:
            attributes["ros.slot"] = local.slot_name
        local.observers.add(_ServerSpans(server, self._tracer, attributes))

    def add_client(self, client: AnyClient) -> None:
        """Trace the goals of a client."""
        client.around = _ClientSpans(
            client, self._tracer, self._attributes(client), self._node
        ).around

    def _attributes(self, end: AnyServer | AnyClient) -> dict[str, str | int]:
        return {
            **self._of_node,
            "rpc.method": end.name,
            "ros.action.name": end.name,
            "ros.action.type": end.action_type.type_name,
        }


class _Record:
    """A span and what is still to be written to it.

    Attributes:
        span: The span.
        is_accepted: Whether the goal was accepted.
    """

    __slots__ = ("_count", "_last", "is_accepted", "span")

    def __init__(self, span: Span) -> None:
        self.span = span
        self.is_accepted = False
        self._count = 0
        self._last = 0

    def feedback(self) -> None:
        """Count a feedback message; the first and the last one become events."""
        self._count += 1
        self._last = time_ns()
        if self._count == 1:
            self.span.add_event("feedback", {"ros.feedback.number": 1}, self._last)

    def end(self, status: str) -> None:
        """End the span."""
        span = self.span
        if self._count > 1:
            span.add_event("feedback", {"ros.feedback.number": self._count}, self._last)
        span.set_attribute("ros.feedback.count", self._count)
        if status:
            span.set_attribute("ros.goal.status", status)
        span.end()

    def fail(self, kind: str, reason: str, status: str = "") -> None:
        """End the span with an error."""
        self.span.set_attribute("error.type", kind)
        if reason:
            self.span.set_attribute("ros.goal.reason", reason)
        self.span.set_status(StatusCode.ERROR, reason)
        self.end(status)


class _Spans(GoalObserver):
    """Writes what happens to goals to their spans.

    Args:
        observers: The observers of the server or client.

    Attributes:
        records: The spans of active goals, by goal id.
    """

    def __init__(self, observers: Observers) -> None:
        self.records: dict[bytes | None, _Record] = {}
        self._observers = observers
        self._has_recorded = False

    def record(self, span: Span, goal_id: bytes) -> _Record:
        """Write what happens to a goal to its span from now on."""
        if not self._has_recorded:
            self._has_recorded = True
            self.begin()
        record = _Record(span)
        span.set_attribute("ros.goal.id", goal_id.hex())
        self.records.setdefault(goal_id, record)
        return record

    def begin(self) -> None:
        """Called before the first goal is recorded."""
        # What these two do costs every goal and message something, so there is nothing before.
        self._observers.add(_Recording(self.records))

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:  # noqa: ARG002
        """Called after a goal has changed its state."""
        record = self.records.get(goal.id)
        if record is None:
            return
        if after is GoalStatus.ACCEPTED:
            record.is_accepted = True
        if after.is_active:
            record.span.add_event(after.name.lower())
            return
        del self.records[goal.id]
        if after is GoalStatus.ABORTED:
            record.fail("GoalAborted", goal.reason, after.name)
        elif after in ENDS:
            record.end(after.name)
        else:
            record.fail(type(goal.error).__name__, str(goal.error), after.name)

    def pause_changed(self, goal: Goal) -> None:
        """Called after a server has paused or resumed a goal."""
        record = self.records.get(goal.id)
        if record is not None:
            record.span.add_event("paused" if goal.is_paused else "resumed")

    def noted(self, goal: Goal, news: News) -> None:
        """Called when something else happens to a goal."""
        record = self.records.get(goal.id)
        if record is None:
            return
        match news:
            case FeedbackLost(count):
                record.span.add_event("feedback lost", {"ros.feedback.count": count})
            case Lost():
                del self.records[goal.id]
                record.fail(type(goal.error).__name__, str(goal.error))
            case Detached():  # the client does not wait for the goal any more
                del self.records[goal.id]
                record.span.add_event("detached")
                record.end("")


class _Recording(GoalObserver):
    """Makes the spans of goals those of their bodies, and counts feedback."""

    def __init__(self, records: dict[bytes | None, _Record]) -> None:
        self._records = records

    def feedback_published(self, goal: Goal, feedback: object) -> None:  # noqa: ARG002
        """Called with each feedback message."""
        record = self._records.get(goal.id)
        if record is not None:
            record.feedback()

    def enter_body(self, goal: Goal) -> None:
        """Make the goal's span the current one of its body."""
        record = self._records.get(goal.id)
        if record is not None:
            contexts.attach(trace.set_span_in_context(record.span))
            REQUEST_NOTE.set(_note(record.span, is_detached=False))
            NEW_TRACES.set(False)


class _ServerSpans(_Spans):
    """The spans of one server's goals.

    Args:
        server: The server.
        tracer: Makes the spans.
        attributes: What all of them have.
    """

    def __init__(
        self, server: AnyServer, tracer: trace.Tracer, attributes: dict[str, str | int]
    ) -> None:
        local = local_server_of(server)
        super().__init__(local.observers)
        self._name = f"execute {server.name}"
        self._name_goal = local.name_goal
        self._tracer = tracer
        self._attributes = attributes

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
        """Called after a goal has changed its state."""
        if after is GoalStatus.ACCEPTED:
            self._begin(goal)
        if self.records:
            super().goal_changed(goal, before, after)

    def noted(self, goal: Goal, news: News) -> None:
        """Called when something else happens to a goal."""
        record = self.records.get(goal.id)
        if record is not None and isinstance(news, BodyFailed):
            record.span.record_exception(news.error)
        super().noted(goal, news)

    def _begin(self, goal: Goal) -> None:
        is_far = isinstance(goal.sender, bytes)  # the gid of a client in another process
        note = _request_note() if is_far else NO_NOTE
        context = _context_in(note) if is_far else _current()
        sender = trace.get_current_span(context).get_span_context()
        if sender.is_valid and not sender.is_remote and not sender.trace_flags.sampled:
            return
        is_new = note.is_detached if is_far else NEW_TRACES.get()
        links = [Link(sender)] if is_new and sender.is_valid else None
        span = self._tracer.start_span(
            self._name,
            Context() if is_new else context,
            SpanKind.SERVER,
            self._attributes,
            links=links,
        )
        if span.is_recording() or sender.is_remote:
            self.record(span, self._name_goal(goal))


def _current() -> Context:
    """The current context; without a current span, that of the request being handled."""
    context = contexts.get_current()
    if trace.get_current_span(context).get_span_context().is_valid:
        return context
    return _context_in(_request_note())


def _request_note() -> GoalNote:
    """The note of the request being handled."""
    text = REQUEST_NOTE.get()
    return GoalNote.read(text) if text else NO_NOTE


def _context_in(note: GoalNote) -> Context:
    """The context that a note carries; it has no span if the note has none."""
    if not note.traceparent:
        return Context()
    carrier = {"traceparent": note.traceparent}
    if note.tracestate:
        carrier["tracestate"] = note.tracestate
    return PROPAGATOR.extract(carrier, Context())


def _note(span: Span, *, is_detached: bool) -> str:
    """The note that carries a span; empty if the span has no id."""
    here = span.get_span_context()
    if not here.is_valid:
        return ""
    parent = f"00-{here.trace_id:032x}-{here.span_id:016x}-{here.trace_flags:02x}"
    state = here.trace_state.to_header() if here.trace_state else ""
    if len(state) > LONGEST_STATE:
        state = ""
    return GoalNote(traceparent=parent, tracestate=state, is_detached=is_detached).write()


class _ClientSpans(_Spans):
    """The spans of one client's goals.

    Args:
        client: The client.
        tracer: Makes the spans.
        attributes: What all of them have.
        node: The client's node.
    """

    def __init__(
        self,
        client: AnyClient,
        tracer: trace.Tracer,
        attributes: dict[str, str | int],
        node: Node,
    ) -> None:
        super().__init__(client.observers)
        self._name = f"send_goal {client.name}"
        self._tracer = tracer
        self._attributes = attributes
        self._transport = node.transport
        type_name = f"{client.action_type.type_name}_SendGoal"
        self._service = action_names(client.name).send_goal, type_name

    def around(self, order: GoalOrder) -> _Sending:
        """A block in which a goal is sent."""
        return _Sending(self, order)

    def closed(self) -> None:
        """End the spans of goals that go on without the client."""
        for record in self.records.values():
            record.span.add_event("client closed")
            record.end("")
        self.records.clear()

    @property
    def is_near(self) -> bool:
        """Whether the server is in this process."""
        return self._transport.local(*self._service) is not None

    def start(self, context: Context, *, is_near: bool) -> Span:
        """Start the span of a goal."""
        kind = SpanKind.INTERNAL if is_near else SpanKind.CLIENT
        return self._tracer.start_span(self._name, context, kind, self._attributes)

    def begin(self) -> None:
        """Called before the first goal is recorded."""
        self._observers.add(self)
        super().begin()


class _Sending:
    """A block in which a goal is sent and, for ``await``, waited for.

    The span ends with the goal. If the goal was not accepted, it ends with the block.
    """

    __slots__ = ("_note_before", "_order", "_record", "_spans", "_token")

    def __init__(self, spans: _ClientSpans, order: GoalOrder) -> None:
        self._spans = spans
        self._order = order
        self._record: _Record | None = None
        self._token: Any = None
        self._note_before: Any = None

    def __enter__(self) -> GoalOrder:
        try:
            return self._begin()
        except Exception:
            logger.exception("a goal cannot be traced")
            return self._order

    def _begin(self) -> GoalOrder:
        order = self._order
        context, is_near = _current(), self._spans.is_near
        span = self._spans.start(context, is_near=is_near)
        self._token = contexts.attach(trace.set_span_in_context(span, context))
        is_recorded = span.is_recording()
        if is_recorded or not is_near:  # the server must know of a goal that is not sampled, too
            note = _note(span, is_detached=NEW_TRACES.get())
            self._note_before = REQUEST_NOTE.set(note)
        if not is_recorded:
            return order
        goal_id = order.goal_id or new_goal_id()
        self._record = self._spans.record(span, goal_id)
        if order.goal_id is None:
            order = self._order = msgspec.structs.replace(order, goal_id=goal_id)
        return order

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self._end(error)
        except Exception:
            logger.exception("a goal cannot be traced")

    def _end(self, error: BaseException | None) -> None:
        if not isinstance(error, GeneratorExit):  # else this may be another task, or none
            if self._note_before is not None:
                REQUEST_NOTE.reset(self._note_before)
            if self._token is not None:
                contexts.detach(self._token)
        record, goal_id = self._record, self._order.goal_id
        if record is None or record.is_accepted:
            return
        # The goal was not accepted, or it has joined one that was sent before with the same id.
        if self._spans.records.get(goal_id) is record:
            del self._spans.records[goal_id]
        if isinstance(error, TurtleactError):
            reason = error.reason if isinstance(error, GoalRejected) else str(error)
            record.fail(type(error).__name__, reason)
        else:
            record.end("")
