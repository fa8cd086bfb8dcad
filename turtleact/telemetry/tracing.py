"""Makes two spans for each goal: one at the goal's client, and one at its server.

========================  ==========  ==========================================================
span                      kind        parent
========================  ==========  ==========================================================
``send_goal /patrol``     CLIENT      the current span
``execute /patrol``       SERVER      the client's span; with `new_traces`, a link instead
========================  ==========  ==========================================================

The client's span begins when the client sends the goal, and the server's span begins when the
server accepts it. Both spans end with the goal, but the client's span ends earlier if the client
detaches the goal or closes. If the server is in the client's process, the client's span has the
kind INTERNAL instead of CLIENT.

The server's span is current in the body, so the spans of goals that the body sends are its
children. A request to another process carries the ids of the client's span in a
`turtleact.goals.wire.GoalMetadata`. If a request from another process carries no ids, the server's
span begins a new trace.

If the client is in the server's process and the client's span is not sampled, the server makes no
span.

This module uses only OpenTelemetry's API, which never blocks. An exception of a sampler or span
processor is logged and does not affect the goal.

Source: W3C Trace Context; OpenTelemetry's semantic conventions 1.44, "RPC".
"""

from __future__ import annotations

from contextvars import Token
from importlib.metadata import version
from time import time_ns
from typing import Final

from opentelemetry import context as contexts
from opentelemetry import trace
from opentelemetry.context import Context
from opentelemetry.trace import Link, Span, SpanKind, StatusCode
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

from turtleact.errors import GoalRejected, TurtleactError
from turtleact.goals.observers import (
    BodyFailed,
    Detached,
    FeedbackLost,
    GoalObserver,
    Lost,
    News,
)
from turtleact.goals.server import new_goal_id
from turtleact.goals.state import Goal, GoalRequest, GoalStatus
from turtleact.goals.wire import GoalMetadata
from turtleact.names import action_names
from turtleact.node import Node, local_server_of
from turtleact.telemetry.measuring import NEW_TRACES, AnyClient, AnyServer
from turtleact.transports.base import REQUEST_NOTE

__all__ = ["Tracing"]

LONGEST_STATE: Final = 512
"""A ``tracestate`` with more characters is left out.

W3C Trace Context asks senders to propagate at least 512 characters."""

PROPAGATOR: Final = TraceContextTextMapPropagator()


class Tracing:
    """Makes spans for the goals of a node's servers and clients.

    Args:
        node: The node.
        provider: OpenTelemetry's tracer provider, which makes the spans; None for the program's
            global provider.

    Attributes:
        is_off: Whether OpenTelemetry is switched off, so that no spans are made.
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
        spans = _ServerSpans(f"execute {server.name}", self._tracer, attributes)
        local.observers.add(spans)

    def add_client(self, client: AnyClient) -> None:
        """Trace the goals of a client."""
        attributes = self._attributes(client)
        client.observers.add(_ClientSpans(client, self._tracer, attributes, self._node))

    def _attributes(self, end: AnyServer | AnyClient) -> dict[str, str | int]:
        return {
            **self._of_node,
            "rpc.method": end.name,
            "ros.action.name": end.name,
            "ros.action.type": end.action_type.type_name,
        }


class _Record:
    """A span, and the values that will be written to it.

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
        """Count a feedback message. The first and the last message become events of the span."""
        self._count += 1
        self._last = time_ns()
        if self._count == 1:
            self.span.add_event("feedback", {"ros.feedback.number": 1}, self._last)

    def end(self, status: str) -> None:
        """End the span. ``status`` is the goal's final status; empty if it is not known."""
        span = self.span
        if self._count > 1:
            span.add_event("feedback", {"ros.feedback.number": self._count}, self._last)
        said: dict[str, str | int] = {"ros.feedback.count": self._count}
        if status:
            said["ros.goal.status"] = status
        span.set_attributes(said)
        span.end()

    def fail(self, kind: str, reason: str, status: str = "") -> None:
        """End the span with an error."""
        self.span.set_attribute("error.type", kind)
        if reason:
            self.span.set_attribute("ros.goal.reason", reason)
        self.span.set_status(StatusCode.ERROR, reason)
        self.end(status)


class _Spans(GoalObserver):
    """Records the events of one server's or client's goals in the goals' spans.

    Args:
        name: The name of each span.
        tracer: Makes the spans.
        attributes: The attributes of each span.
    """

    def __init__(self, name: str, tracer: trace.Tracer, attributes: dict[str, str | int]) -> None:
        self.records: dict[bytes | None, _Record] = {}
        self._name = name
        self._tracer = tracer
        self._attributes = attributes

    def begin(self, span: Span, goal_id: bytes) -> _Record:
        """Record all further events of a goal in ``span``.

        If the client has already sent a goal with this id, the goal keeps its first span.
        """
        span.set_attribute("ros.goal.id", goal_id.hex())
        record = _Record(span)
        self.records.setdefault(goal_id, record)
        return record

    def feedback_published(self, goal: Goal, feedback: object) -> None:  # noqa: ARG002
        """Count a feedback message of a goal that has a span."""
        record = self.records.get(goal.id)
        if record is not None:
            record.feedback()

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
        """Record a change of a goal's state in the goal's span."""
        record = self.records.get(goal.id)
        if record is None:
            return
        if before is GoalStatus.UNKNOWN:
            record.is_accepted = True
            record.span.add_event("accepted")
        if after is GoalStatus.ACCEPTED:
            return
        if after.is_active:
            record.span.add_event(after.name.lower())
            return
        del self.records[goal.id]
        if after is GoalStatus.ABORTED:
            record.fail("GoalAborted", goal.reason, after.name)
        elif after.is_terminal:
            record.end(after.name)
        else:
            record.fail(type(goal.error).__name__, str(goal.error), after.name)

    def pause_changed(self, goal: Goal, is_paused: bool) -> None:
        """Write into a goal's span that a server has paused or resumed the goal."""
        record = self.records.get(goal.id)
        if record is not None:
            record.span.add_event("paused" if is_paused else "resumed")

    def noted(self, goal: Goal, news: News) -> None:
        """Record in a goal's span that the goal was lost or detached, or that feedback was lost."""
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


class _ServerSpans(_Spans):
    """Makes the spans of one server's goals."""

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
        """Begin the span of a new goal, and record each change of a goal's state in its span."""
        if before is GoalStatus.UNKNOWN:
            self._begin(goal)
        super().goal_changed(goal, before, after)

    def enter_body(self, goal: Goal) -> None:
        """Make the goal's span the current span in the goal's body."""
        record = self.records.get(goal.id)
        if record is not None:
            contexts.attach(trace.set_span_in_context(record.span))
            REQUEST_NOTE.set(_note(record.span, is_detached=False))
            NEW_TRACES.set(False)

    def noted(self, goal: Goal, news: News) -> None:
        """Record in a goal's span that the body raised, or that feedback or the goal was lost."""
        record = self.records.get(goal.id)
        if record is not None and isinstance(news, BodyFailed):
            record.span.record_exception(news.error)
        super().noted(goal, news)

    def _begin(self, goal: Goal) -> None:
        if isinstance(goal.sender, bytes):  # the gid of a client in another process
            note = GoalMetadata.read(REQUEST_NOTE.get())
            context, is_detached = _context_in(note), note.is_detached
        else:
            context, is_detached = _current(), NEW_TRACES.get()
        sender = trace.get_current_span(context).get_span_context()
        if sender.is_valid and not sender.is_remote and not sender.trace_flags.sampled:
            return
        links = None
        if is_detached:
            links = [Link(sender)] if sender.is_valid else None
            context = Context()
        span = self._tracer.start_span(
            self._name, context, SpanKind.SERVER, self._attributes, links
        )
        # A span that is not sampled is kept, too: what the body does must not be sampled either.
        if span.get_span_context().is_valid:
            self.begin(span, goal.id)


class _ClientSpans(_Spans):
    """Begins the spans of one client's goals, and ends the spans of goals that are not accepted.

    Args:
        client: The client.
        tracer: Makes the spans.
        attributes: The attributes of each of these spans.
        node: The client's node.
    """

    def __init__(
        self,
        client: AnyClient,
        tracer: trace.Tracer,
        attributes: dict[str, str | int],
        node: Node,
    ) -> None:
        super().__init__(f"send_goal {client.name}", tracer, attributes)
        self._sending: dict[GoalRequest, _Record] = {}
        self._entered: dict[GoalRequest, tuple[Token[Context], Token[str]]] = {}
        self._transport = node.transport
        type_name = f"{client.action_type.type_name}_SendGoal"
        self._service = action_names(client.name).send_goal, type_name

    def enter_call(self, request: GoalRequest) -> None:
        """Begin a goal's span, and make it the current span while the goal is sent."""
        context = _current()
        is_near = bool(self._transport.local(*self._service))
        kind = SpanKind.INTERNAL if is_near else SpanKind.CLIENT
        span = self._tracer.start_span(self._name, context, kind, self._attributes)
        if not span.get_span_context().is_valid:  # without an SDK
            return
        is_recorded, note = span.is_recording(), REQUEST_NOTE.get()
        if is_recorded or not is_near:  # the server must know of a goal that is not sampled, too
            note = _note(span, is_detached=NEW_TRACES.get())
        attached = contexts.attach(trace.set_span_in_context(span, context))
        self._entered[request] = attached, REQUEST_NOTE.set(note)
        if is_recorded:
            request.goal_id = request.goal_id or new_goal_id()
            self._sending[request] = self.begin(span, request.goal_id)

    def leave_call(self, request: GoalRequest, error: BaseException | None) -> None:
        """Restore the context, and end the goal's span if the goal was not accepted.

        The span of an accepted goal ends when the goal ends.
        """
        entered = self._entered.pop(request, None)
        if entered is not None:
            contexts.detach(entered[0])
            REQUEST_NOTE.reset(entered[1])
        record = self._sending.pop(request, None)
        if record is None or record.is_accepted or not record.span.is_recording():
            return
        # The goal was not accepted, or it has joined one that was sent before with the same id.
        if self.records.get(request.goal_id) is record:
            del self.records[request.goal_id]
        if isinstance(error, TurtleactError):
            reason = error.reason if isinstance(error, GoalRejected) else str(error)
            record.fail(type(error).__name__, reason)
        else:
            record.end("")

    def closed(self) -> None:
        """End the spans of the client's goals, because a closed client receives no more updates."""
        for record in {*self.records.values(), *self._sending.values()}:
            if record.span.is_recording():
                record.span.add_event("client closed")
                record.end("")
        self.records.clear()


def _current() -> Context:
    """Return the current context.

    If the current context has no span, return the context of the request that is being handled.
    """
    context, note = contexts.get_current(), REQUEST_NOTE.get()
    if not note or trace.get_current_span(context).get_span_context().is_valid:
        return context
    return _context_in(GoalMetadata.read(note))


def _context_in(note: GoalMetadata) -> Context:
    """Return the context that a note carries.

    If the note carries no span, return an empty context.
    """
    if not note.traceparent:
        return Context()
    carrier = {"traceparent": note.traceparent}
    if note.tracestate:
        carrier["tracestate"] = note.tracestate
    return PROPAGATOR.extract(carrier, Context())


def _note(span: Span, *, is_detached: bool) -> str:
    """Return a note with the ids of a span."""
    here = span.get_span_context()
    parent = f"00-{here.trace_id:032x}-{here.span_id:016x}-{here.trace_flags:02x}"
    state = here.trace_state.to_header() if here.trace_state else ""
    if len(state) > LONGEST_STATE:
        state = ""
    return GoalMetadata(traceparent=parent, tracestate=state, is_detached=is_detached).write()
