"""Services: calls and responses, how a call fails, who cancels whom, and what closing does."""

from __future__ import annotations

import functools
import logging
import math
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import aclosing, asynccontextmanager
from typing import Any, NamedTuple

import anyio
import anyio.lowlevel
import pytest

import turtleact
from turtleact.errors import (
    InvalidMessage,
    InvalidOption,
    ServerUnavailable,
    ServiceError,
    ServiceTimeout,
)
from turtleact.goals import service_server
from turtleact.interfaces import Message, Service, int32
from turtleact.node.services import ServiceClient, ServiceServer
from turtleact.tasks import Background
from turtleact.tasks.clock import VirtualClock
from turtleact.transports import MemoryTransport

from ..lab import running, settle


class Add(Service, type_name="lab_interfaces/srv/Add"):
    """Adds numbers up."""

    class Request(Message):
        numbers: list[int32] = []

    class Response(Message):
        total: int32 = 0


def numbers(*given: Any) -> Add.Request:
    return Add.Request(numbers=list(given))


def total(number: Any) -> Add.Response:
    return Add.Response(total=number)


def add(request: Add.Request) -> Add.Response:
    return total(sum(request.numbers))


async def add_later(request: Add.Request) -> Add.Response:
    await anyio.lowlevel.checkpoint()
    return add(request)


class Desk(NamedTuple):
    """What a test works with."""

    node: turtleact.Node
    server: ServiceServer[Add.Request, Add.Response]
    client: ServiceClient[Add.Request, Add.Response]
    local: Any
    """What transports and clients in the same process have of the server."""

    @property
    def is_idle(self) -> bool:
        return self.server.is_idle


@asynccontextmanager
async def desk(
    handler: Callable[[Add.Request], Add.Response | Awaitable[Add.Response]] = add,
    *,
    transport: MemoryTransport | None = None,
) -> AsyncIterator[Desk]:
    """A node that serves `Add` with this handler, and a client of it."""
    async with turtleact.open_node("desk", transport=transport) as node:
        server = node.service(Add, "add", handler)
        (local,) = node.transport.local("/add", Add.type_name)
        yield Desk(node, server, node.service_client(Add, "add"), local)


@asynccontextmanager
async def virtual_desk(
    make_handler: Callable[[VirtualClock], Callable[..., Awaitable[Add.Response]]],
) -> AsyncIterator[tuple[Desk, VirtualClock]]:
    """The same in virtual time."""
    clock = VirtualClock()
    async with (
        aclosing(Background(clock.run(), "the clock")),
        desk(make_handler(clock), transport=MemoryTransport(clock)) as served,
    ):
        yield served, clock


def taking(seconds: float, log: list[str]) -> Callable[[VirtualClock], Any]:
    """A handler that takes some virtual seconds, and a second more to clean up if canceled."""

    def make(clock: VirtualClock) -> Any:
        async def handler(request: Add.Request) -> Add.Response:
            try:
                await clock.sleep(seconds)
            except anyio.get_cancelled_exc_class():
                with anyio.CancelScope(shield=True):
                    await clock.sleep(1)
                log.append(f"cleaned up at {clock.time():g}")
                raise
            return add(request)

        return handler

    return make


class Gate:
    """A handler that waits until it is let go on, and notes what happens to it."""

    def __init__(self) -> None:
        self.opened = anyio.Event()
        self.log: list[str] = []

    async def wait(self, request: Add.Request) -> Add.Response:
        self.log.append("begun")
        try:
            await self.opened.wait()
        except anyio.get_cancelled_exc_class():
            self.log.append("canceled")
            raise
        return add(request)

    async def hold_on(self, request: Add.Request) -> Add.Response:
        self.log.append("begun")
        try:
            await self.opened.wait()
        except anyio.get_cancelled_exc_class():
            self.log.append("canceled")
            with anyio.CancelScope(shield=True):
                await self.opened.wait()
        self.log.append("over")
        return add(request)


@pytest.fixture
def gate(anyio_backend) -> Gate:
    return Gate()


@pytest.fixture
def no_grace(monkeypatch):
    monkeypatch.setattr(service_server, "GRACE", 0.0)


# --- a response -----------------------------------------------------------------------------


class Adder:
    def __call__(self, request: Add.Request) -> Add.Response:
        return add(request)

    async def add(self, request: Add.Request) -> Add.Response:
        return add(request)


HANDLERS = [
    pytest.param(add, id="function"),
    pytest.param(add_later, id="coroutine-function"),
    pytest.param(lambda request: add_later(request), id="function-that-gives-an-awaitable"),
    pytest.param(functools.partial(add_later), id="partial"),
    pytest.param(Adder(), id="object"),
    pytest.param(Adder().add, id="method"),
]


@pytest.mark.parametrize("handler", HANDLERS)
async def test_a_call_gives_the_response_of_the_handler(handler):
    async with desk(handler) as served:
        assert await served.client.call(numbers(2, 3)) == total(5)


async def test_calls_that_never_wait_let_others_run():
    async with desk() as served:
        with anyio.CancelScope() as scope:
            async with anyio.create_task_group() as group:
                group.start_soon(anyio.lowlevel.checkpoint)
                group.start_soon(cancel, scope)
                while True:
                    await served.client.call(numbers())
    assert scope.cancelled_caught


async def cancel(scope: anyio.CancelScope) -> None:
    scope.cancel()


# --- snapshots ------------------------------------------------------------------------------


async def test_a_handler_may_change_the_request_without_harm():
    def handler(request: Add.Request) -> Add.Response:
        request.numbers.append(4)
        return add(request)

    async with desk(handler) as served:
        request = numbers(1)
        await served.client.call(request)
        assert request == numbers(1)


async def test_the_request_is_taken_as_it_was_when_it_was_sent(gate):
    request = numbers(1)
    async with desk(gate.wait) as served, running(lambda: served.client.call(request)) as called:
        request.numbers.append(4)
        gate.opened.set()
        await called.done.wait()
        assert called.value == total(1)


async def test_a_caller_may_change_the_response_without_harm():
    kept = total(1)
    async with desk(lambda request: kept) as served:
        (await served.client.call(numbers())).total = 5
        assert kept == total(1)


async def test_a_request_that_does_not_fit_reaches_no_handler(gate):
    async with desk(gate.wait) as served:
        with pytest.raises(InvalidMessage, match=r"^request\.numbers\[1\]: .*'two'"):
            await served.client.call(numbers(1, "two"))
        await settle()
        assert gate.log == []


# --- a handler that fails -------------------------------------------------------------------


def fail(request: Add.Request) -> Add.Response:
    raise OSError("the abacus is broken")


async def fail_later(request: Add.Request) -> Add.Response:
    await anyio.lowlevel.checkpoint()
    return fail(request)


async def fail_twice(request: Add.Request) -> Add.Response:
    raise ExceptionGroup("all", [OSError("one"), KeyError()])


def stop_iteration(request: Add.Request) -> Add.Response:
    raise StopIteration


@pytest.mark.parametrize(
    ("handler", "reason"),
    [
        (fail, "the handler failed: OSError: the abacus is broken"),
        (fail_later, "the handler failed: OSError: the abacus is broken"),
        (fail_twice, "the handler failed: OSError: one; KeyError"),
        (stop_iteration, "the handler failed: StopIteration"),
    ],
)
async def test_what_a_handler_raises_reaches_the_caller_as_a_service_error(handler, reason):
    async with desk(handler) as served:
        with pytest.raises(ServiceError, match=rf"^service '/add': {reason}$"):
            await served.client.call(numbers())


async def test_the_traceback_of_a_handler_is_logged(caplog):
    async with desk(fail) as served:
        with pytest.raises(ServiceError):
            await served.client.call(numbers())
    (record,) = caplog.records
    assert record.exc_info[0] is OSError


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (None, r"response: .*lab_interfaces/srv/Add_Response\), got None"),
        (numbers(1), r"response: expected lab_interfaces/srv/Add_Response, not .*Add_Request"),
        (total("one"), r"response\.total: .*int32.*'one'"),
        (total(2**31), r"response\.total: .*int32.*2147483648"),
    ],
)
async def test_what_is_no_valid_response_is_a_service_error_and_logged(answer, reason, caplog):
    async with desk(lambda request: answer) as served:
        with pytest.raises(ServiceError, match=f"^service '/add': no valid response: {reason}"):
            await served.client.call(numbers())
    assert "/add gave no valid response: response" in caplog.text


@pytest.mark.parametrize("stop", [KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("wait", [False, True])
@pytest.mark.parametrize("backend", ["asyncio", "trio"])
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_what_stops_the_program_passes_through_the_handler(backend, wait, stop):
    async def handler(request: Add.Request) -> Add.Response:
        if wait:
            await anyio.lowlevel.checkpoint()
        raise stop

    async def main() -> None:
        async with desk(handler) as served:
            await served.client.call(numbers())

    with pytest.raises(BaseException) as caught:  # noqa: PT011  # trio wraps it
        anyio.run(main, backend=backend)
    assert stop in kinds(caught.value)


def kinds(error: BaseException | None) -> set[type[BaseException]]:
    """The types of an exception, of its members and of its causes."""
    if error is None:
        return set()
    members = error.exceptions if isinstance(error, BaseExceptionGroup) else ()
    return {type(error)}.union(
        *map(kinds, members), kinds(error.__cause__), kinds(error.__context__)
    )


# --- nobody there ---------------------------------------------------------------------------


async def test_a_call_of_what_nobody_serves_fails():
    async with turtleact.open_node("desk") as node:
        with pytest.raises(ServerUnavailable, match=r"^service '/add': no server answers$"):
            await node.service_client(Add, "add").call(numbers())


# --- waiting for a service ------------------------------------------------------------------


async def test_a_service_is_waited_for_until_it_is_there():
    async with turtleact.open_node("desk") as node:
        client = node.service_client(Add, "add")
        async with running(client.wait_for_service) as waiting:
            assert not waiting.done.is_set()
            node.service(Add, "add", add)
            await waiting.done.wait()
            assert waiting.value is True


async def test_a_wait_for_a_service_ends_after_its_timeout():
    async with virtual_desk(taking(0, [])) as (served, clock):
        await served.server.aclose()
        assert not await served.client.wait_for_service(timeout=60)
        assert clock.time() == 60


# --- misuse ---------------------------------------------------------------------------------


async def yields_later(request: Add.Request) -> AsyncIterator[Add.Response]:
    yield total(0)


def yields(request: Add.Request) -> Iterator[Add.Response]:
    yield total(0)


class Yields:
    async def __call__(self, request: Add.Request) -> AsyncIterator[Add.Response]:
        yield total(0)


@pytest.mark.parametrize(
    ("handler", "problem"),
    [
        (5, "expected a function, not 5"),
        (None, "expected a function, not None"),
        (yields, "this yields"),
        (yields_later, "this yields"),
        (functools.partial(yields_later), "this yields"),
        (Yields(), "this yields"),
    ],
)
async def test_what_can_give_no_response_is_refused_as_a_handler(handler, problem):
    async with turtleact.open_node("desk") as node:
        with pytest.raises(InvalidOption, match=f"^option 'handler': .*{problem}"):
            node.service(Add, "add", handler)
        assert node.graph().services == {}


@pytest.mark.parametrize("timeout", [math.nan, "x", True, 1j])
async def test_what_is_no_number_is_refused_as_a_timeout(timeout):
    async with desk() as served:
        for call in (
            lambda: served.client.call(numbers(), timeout=timeout),
            lambda: served.client.wait_for_service(timeout=timeout),
        ):
            with pytest.raises(InvalidOption, match=r"^option 'timeout': expected a number"):
                await call()


@pytest.mark.parametrize("timeout", [0, -1])
async def test_a_timeout_of_no_time_is_over_at_once(timeout):
    async with virtual_desk(taking(1, [])) as (served, _):
        with pytest.raises(ServiceTimeout):
            await served.client.call(numbers(), timeout=timeout)


# --- timeouts -------------------------------------------------------------------------------


async def test_a_call_fails_after_its_timeout():
    async with virtual_desk(taking(60, [])) as (served, _):
        text = r"^service '/add': no response within 0\.5 s$"
        with pytest.raises(ServiceTimeout, match=text):
            await served.client.call(numbers(), timeout=0.5)


async def test_a_handler_that_runs_into_a_timeout_is_canceled_and_waited_for():
    log: list[str] = []
    async with virtual_desk(taking(60, log)) as (served, _):
        with pytest.raises(ServiceTimeout):
            await served.client.call(numbers(), timeout=2)
        assert log == ["cleaned up at 3"]


# --- a caller that leaves -------------------------------------------------------------------


async def test_a_caller_that_is_canceled_cancels_its_handler(gate):
    async with desk(gate.wait) as served, running(lambda: served.client.call(numbers())) as called:
        called.scope.cancel()
        await called.done.wait()
        assert gate.log == ["begun", "canceled"]


async def test_a_client_elsewhere_that_has_gone_cancels_the_handlers_of_its_requests_alone():
    begun: list[int] = []
    canceled: list[int] = []
    opened = anyio.Event()

    async def handler(request: Add.Request) -> Add.Response:
        begun.extend(request.numbers)
        try:
            await opened.wait()
        except anyio.get_cancelled_exc_class():
            canceled.extend(request.numbers)
            raise
        return add(request)

    async with (
        desk(handler) as served,
        running(lambda: served.local.reply(numbers(1), b"one")),
        running(lambda: served.local.reply(numbers(2), b"two")) as other,
        running(lambda: served.client.call(numbers(3))) as near,
    ):
        await settle()
        assert sorted(begun) == [1, 2, 3]
        served.local.caller_lost(b"one")
        await settle()
        assert canceled == [1]
        opened.set()
        await other.done.wait()
        assert (other.value.message, near.value) == (total(2), total(3))


# --- closing --------------------------------------------------------------------------------


async def test_closing_a_server_answers_its_callers_and_waits_for_its_handlers(gate):
    async with (
        desk(gate.hold_on) as served,
        running(lambda: served.client.call(numbers())) as called,
        running(served.server.aclose) as closing,
    ):
        await called.done.wait()
        assert not closing.done.is_set()
        gate.opened.set()
        await closing.done.wait()
        assert gate.log == ["begun", "canceled", "over"]


async def test_a_handler_that_does_not_end_is_left_behind_and_logged(gate, no_grace, caplog):
    async with desk(gate.hold_on) as served, running(lambda: served.client.call(numbers())):
        await served.server.aclose()
        assert [record.levelno for record in caplog.records] == [logging.ERROR]
        assert "a handler of service /add has not ended; it is left running" in caplog.text
        gate.opened.set()
        await settle()


async def test_calls_go_on_when_their_client_is_closed(gate):
    async with desk(gate.wait) as served, running(lambda: served.client.call(numbers(1))) as called:
        await served.client.aclose()
        gate.opened.set()
        await called.done.wait()
        assert called.value == total(1)


# --- servers that are not in this process ----------------------------------------------------
