"""Describes a graph at one moment, as far as one process can see it. Pure data."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from turtleact.transports.base import Endpoint

__all__ = ["Answer", "EndpointSeen", "Fields", "NodeSeen", "Report", "Router", "Snapshot"]

Fields = Mapping[str, str]
"""The fields of a type by path, such as ``targets[].x``, and the type of each."""


class NodeSeen(msgspec.Struct, frozen=True):
    """A node on the graph.

    Attributes:
        name: Its fully qualified name.
        session: The id of its session; a process usually has one session.
    """

    name: str
    session: str = ""


class EndpointSeen(msgspec.Struct, frozen=True):
    """An endpoint on the graph.

    Attributes:
        endpoint: The endpoint.
        session: The id of its session.
    """

    endpoint: Endpoint
    session: str = ""


class Answer(msgspec.Struct, frozen=True):
    """Whether and how a session answered a question.

    Attributes:
        session: The id of the session.
        node: The node that was asked.
        is_answered: Whether it has answered in time.
        offset: How far its clock is ahead of ours (s); None if unknown.
        uncertainty: How far the offset may be wrong (s).
    """

    session: str
    node: str
    is_answered: bool = True
    offset: float | None = None
    uncertainty: float = 0.0


class Report(msgspec.Struct, frozen=True):
    """A fault that a process has found in itself; see `turtleact.fault_reports`.

    Attributes:
        name: What is at fault.
        problem: What is wrong.
        advice: What to do.
    """

    name: str
    problem: str
    advice: str = ""


class Router(msgspec.Struct, frozen=True):
    """A router in reach.

    Attributes:
        zid: Its id.
        version: The version of its Zenoh, such as "1.10.2"; empty if it does not tell.
        sessions: How many sessions are connected to it; None if it does not tell.
    """

    zid: str
    version: str = ""
    sessions: int | None = None


class Snapshot(msgspec.Struct, frozen=True, kw_only=True):
    """What a graph looks like at one moment.

    Attributes:
        domain: The ROS domain; None within a process.
        routers: The routers in reach; None within a process, where no router is needed.
        zenoh: The version of our Zenoh; empty if unknown.
        nodes: All nodes. Several may have one name.
        endpoints: All endpoints.
        answers: The sessions that were asked something.
        reports: The faults that processes have found in themselves.
        known: The type hash in this process of each known type on the graph, by type name.
        fields: The fields of types that have several definitions, by type name and hash.
        domains: The ROS domains that others use; empty if that was not asked.
    """

    domain: int | None = None
    routers: tuple[Router, ...] | None = None
    zenoh: str = ""
    nodes: tuple[NodeSeen, ...] = ()
    endpoints: tuple[EndpointSeen, ...] = ()
    answers: tuple[Answer, ...] = ()
    reports: tuple[Report, ...] = ()
    known: Mapping[str, str] = {}
    fields: Mapping[tuple[str, str], Fields] = {}
    domains: tuple[int, ...] = ()
