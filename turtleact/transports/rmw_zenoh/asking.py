"""A request on its way to a server in another process, until its reply, its error or its end."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

import anyio

from turtleact.errors import TurtleactError

if TYPE_CHECKING:
    from turtleact.tasks import Signal
    from turtleact.transports.base import Reply
    from turtleact.transports.rmw_zenoh.link import Link
    from turtleact.transports.rmw_zenoh.session import Querier

__all__ = ["Call", "Owner"]

#: So long a call goes on without its server (s).
LOST = 0.25


class Owner(Protocol):
    """Who makes a call."""

    @property
    def counts(self) -> Callable[[bytes], bool] | None:
        """See `turtleact.transports.base.Target`."""

    def over(self, call: Call) -> None:
        """Note that nobody waits for it any more."""

    def read(self, call: Call) -> Reply:
        """Make a reply of what came, or raise."""


class Call:
    """One request and what comes of it.

    Args:
        link: What carries it.
        payload: The request.
        attachment: What goes beside it.
        owner: Who makes the call.
        is_cancelable: Whether Zenoh forgets it at once if it is dropped, not with its client.

    Attributes:
        answer: Payload and attachment of the reply.
        error: The text of an error, and its kind.
        is_over: Whether there is a reply or an error, or the end without either.
    """

    answer: tuple[bytes, bytes] | None = None
    error: tuple[str, str] | None = None
    is_over = False
    _is_wanted = True
    _changed: Signal | None = None  # made for who waits
    _told: Callable[[], object] | None = None
    _give_up: Callable[[], None] | None = None

    def __init__(
        self,
        link: Link,
        payload: bytes,
        attachment: bytes,
        owner: Owner,
        *,
        is_cancelable: bool,
    ) -> None:
        self._link = link
        self._payload = payload
        self._attachment = attachment
        self._owner = owner
        self._is_cancelable = is_cancelable

    def tell(self, told: Callable[[], object]) -> None:
        """Have something called when it is over; see `turtleact.transports.base.Asked`."""
        self._told = told

    def take(self) -> Reply:
        """The reply, once it is over; see `turtleact.transports.base.Asked`."""
        self.drop()
        return self._owner.read(self)

    async def reply(self) -> Reply:
        """Wait for the reply; see `turtleact.transports.base.Asked`."""
        try:
            await self._wait()
        finally:
            self.drop()
        return self._owner.read(self)

    def drop(self) -> None:
        """Want no reply any more; a second time does nothing."""
        if self._is_wanted:
            self._is_wanted = False
            if self._is_cancelable and not self.is_over:
                self._link.outbox.post(self._cancel)
            self._owner.over(self)

    async def end_soon(self) -> None:
        """End it in a while: Zenoh may have lost it with its server, and never say so."""
        with anyio.move_on_after(LOST):
            await self._wait()
        self.end()

    def end(self) -> None:
        """Nothing more comes."""
        self.is_over = True
        self._tell()

    def _tell(self) -> None:
        if self._changed is not None:
            self._changed.fire()
        if self._told is not None and self._is_wanted:
            self._told()

    async def _wait(self) -> None:
        while not self.is_over:
            if self._changed is None:
                self._changed = self._link.tasks.signal()
            await self._changed.wait()

    # in the outbox

    def send(self, querier: Querier | None) -> None:
        """Send the request."""
        if querier is None:
            self._ended()
            return
        try:
            self._give_up = querier.get(
                self._payload,
                self._attachment,
                replied=self._replied,
                failed=self._failed,
                ended=self._ended,
                is_cancelable=self._is_cancelable,
            )
        except TurtleactError:
            self._ended()
            raise

    def _cancel(self) -> None:
        if self._give_up is not None:
            self._give_up()

    # in a thread of the session

    def _replied(self, payload: bytes, attachment: bytes) -> None:
        if not self.is_over:  # of several servers the quickest is heard
            self.answer = payload, attachment
            counts = self._owner.counts
            if counts is not None and not counts(payload):
                return  # another server may know better; if none does, `_ended` comes next
            self.is_over = True
            self._link.inbox.push(self._tell)

    def _failed(self, text: str, kind: str) -> None:
        if not self.is_over:
            self.error = text, kind
            self.is_over = True
            self._link.inbox.push(self._tell)

    def _ended(self) -> None:
        if not self.is_over:  # else the loop has been told
            self._link.inbox.push(self.end)
