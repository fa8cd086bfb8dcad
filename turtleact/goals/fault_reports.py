"""Publishes faults that only one process can see, such as a full disk, for ``turtleact doctor``.

Each node with a fault publishes a ``diagnostic_msgs/msg/DiagnosticArray`` on the latched topic
`TOPIC`, with one status for each fault. The topic is opened when the first fault is reported, so
that a program without faults has no extra topic. When a fault is over, the next message no longer
contains it.

In a ``DiagnosticStatus``, ``name`` says what is at fault, ``message`` says what is wrong, and the
value ``advice`` says what to do. The value ``until``, if there is one, says when the fault is over.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Final

import anyio

from turtleact.interfaces import WireFormat, stamp_of
from turtleact.interfaces.standard.diagnostic_msgs.msg import (
    DiagnosticArray,
    DiagnosticStatus,
    KeyValue,
)
from turtleact.interfaces.standard.std_msgs.msg import Header
from turtleact.tasks import Background, run_in_daemon
from turtleact.transports.base import STATUS_QOS, Endpoint

if TYPE_CHECKING:
    from pathlib import Path

    from turtleact.transports.base import Publication, Transport

__all__ = ["ADVICE", "TOPIC", "FaultReports", "LostFeedback", "disk_fault", "watching_disk"]

TOPIC: Final = "/_turtleact/faults"
"""The name of the topic on which processes report faults."""

ADVICE: Final = "advice"
"""The key of the value that says what to do."""

UNTIL: Final = "until"
"""The key of the value that says when the fault ends (s since the epoch, wall clock)."""

LASTS: Final = 600.0
"""How long lost feedback counts as a fault after each report (s, wall clock)."""

AGAIN: Final = 60.0
"""If more feedback is lost, a report older than this is renewed (s, wall clock)."""

ROOM: Final = 1_000_000_000
"""A disk with fewer free bytes than this is nearly full. For small disks, see `SMALL`."""

SMALL: Final = 0.05
"""A small disk is nearly full if less than this share of its space is free."""

LOOK_EVERY: Final = 2.0
"""The interval at which free disk space is checked (s, event loop time)."""


class FaultReports:
    """Publishes the faults of one node.

    Args:
        transport: The transport to publish on.
        node: The fully qualified name of the node.
    """

    def __init__(self, transport: Transport, node: str) -> None:
        self._transport = transport
        self._node = node
        self._faults: dict[str, DiagnosticStatus] = {}
        self._publication: Publication | None = None

    def report(self, name: str, problem: str, advice: str, until: float | None = None) -> None:
        """Report a fault, and replace any earlier fault with the same name.

        Args:
            name: The kind of fault, a space and what is at fault, such as "disk /data/goals.db".
            problem: What is wrong.
            advice: What to do.
            until: When the fault ends by itself (s since the epoch); None if `clear` must end it.
        """
        values = [KeyValue(ADVICE, advice)]
        if until is not None:
            values.append(KeyValue(UNTIL, f"{until:.0f}"))
        fault = DiagnosticStatus(DiagnosticStatus.WARN, name, problem, values=values)
        if self._faults.get(name) != fault:
            self._faults[name] = fault
            self._publish()

    def clear(self, name: str) -> None:
        """Report that a fault is over. A name without a reported fault is ignored."""
        if self._faults.pop(name, None) is not None:
            self._publish()

    def close(self) -> None:
        """Stop publishing faults."""
        if self._publication is not None:
            self._publication.close()

    def _publish(self) -> None:
        if self._publication is None:
            type_name = DiagnosticArray.type_name
            described = Endpoint("publisher", TOPIC, type_name, self._node, STATUS_QOS)
            self._publication = self._transport.advertise(described, WireFormat(DiagnosticArray))
        header = Header(stamp=stamp_of(self._transport.clock.now()))
        self._publication.publish(DiagnosticArray(header, list(self._faults.values())))


class LostFeedback:
    """Reports how many feedback messages of an action one node loses.

    Args:
        transport: The transport to publish on.
        node: The fully qualified name of the node.
        action: The name of the action.
        how: The verb in the report, such as "did not reach" in "2 feedback messages of action
            /count did not reach node /client".
        advice: What the user can do about the loss.
    """

    def __init__(self, transport: Transport, node: str, action: str, how: str, advice: str) -> None:
        self._reports = FaultReports(transport, node)
        self._name = f"lost-feedback {action}"
        self._what = f"feedback messages of action {action} {how} node {node}"
        self._advice = advice
        self._count = self._reported = 0
        self._time = 0.0

    def add(self, count: int) -> None:
        """Add ``count`` to the number of lost messages.

        The number is reported if it has doubled since the last report, or if that report is at
        least a minute old.
        """
        self._count += count
        now = time.time()
        if self._count >= 2 * self._reported or now - self._time >= AGAIN:
            self._reported, self._time = self._count, now
            problem = f"{self._count} {self._what}"
            self._reports.report(self._name, problem, self._advice, now + LASTS)

    def close(self) -> None:
        """Stop publishing reports."""
        self._reports.close()


@asynccontextmanager
async def watching_disk(
    transport: Transport, node: str, path: Path, what: str, check: Callable[[], str] = str
) -> AsyncIterator[None]:
    """Watch the disk of a file during a block, and report a fault while the disk is nearly full.

    Args:
        transport: The transport to publish on.
        node: The fully qualified name of the node that uses the file.
        path: The file or folder on that disk.
        what: What the file is for, such as "journal".
        check: A function that returns what else is wrong with the file, or an empty text. It is
            called in a thread.
    """
    reports = FaultReports(transport, node)
    watch = Background(_watch_disk(reports, path, what, check), f"the disk of {path}")
    try:
        yield
    finally:
        await watch.aclose()
        reports.close()


async def _watch_disk(
    reports: FaultReports, path: Path, what: str, check: Callable[[], str]
) -> None:
    name = f"disk {path}"

    def look() -> tuple[str, str]:
        return disk_fault(path, what), check()

    while True:
        # A thread asks, because a network drive that has gone may keep it waiting for ever.
        problem, unusable = await run_in_daemon(look, name)
        if problem:
            reports.report(name, problem, "free some space, or move it to another disk")
        else:
            reports.clear(name)
        if unusable:
            problem = f"the {what} {path} cannot be written: {unusable}"
            reports.report(f"{what} {path}", problem, "restore the file, or restart the process")
        else:
            reports.clear(f"{what} {path}")
        await anyio.sleep(LOOK_EVERY)


def disk_fault(path: Path, what: str) -> str:
    """Return a text that says how full a file's disk is; empty if there is enough room."""
    try:
        usage = shutil.disk_usage(path if path.exists() else path.parent)
    except OSError:
        return ""
    if usage.free >= min(ROOM, SMALL * usage.total):
        return ""
    megabytes = usage.free / 1e6
    return f"the disk of the {what} {path} is nearly full: {megabytes:.0f} MB are free"
