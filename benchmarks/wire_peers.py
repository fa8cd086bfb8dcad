"""Other ways to have a job done in another process, to compare turtleact with in `bench_wire`.

Each does the job of a goal with two calls, and sends feedback as separate messages. None of them
checks values, discovers others, or publishes its state.
"""

from __future__ import annotations

import asyncio
import importlib
import itertools
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, Protocol, TypeAlias

import msgspec

__all__ = [
    "NUMBERS",
    "TEXT",
    "Contender",
    "Open",
    "Serve",
    "open_grpc",
    "open_socket",
    "open_websockets",
    "serve_grpc",
    "serve_socket",
    "serve_until_told",
    "serve_websockets",
]

NUMBERS = list(range(10))
TEXT = "x" * 4096


class Contender(Protocol):
    """A way to have a job done in another process."""

    async def goal(self) -> None:
        """Send a goal, and wait for its result."""

    async def feedback(self, count: int, *, is_large: bool) -> int:
        """Ask for feedback. Return how many messages came before the result."""

    async def cancel(self) -> float:
        """The time from the cancel request to the end (s)."""


Serve: TypeAlias = Callable[[str, Connection], Coroutine[object, object, None]]
Open: TypeAlias = Callable[[str], AbstractAsyncContextManager[Contender]]


class Job(msgspec.Struct):
    number: int
    feedback: int = 0
    is_large: bool = False
    is_endless: bool = False


class Call(msgspec.Struct):
    number: int
    verb: str
    job: Job


class Answer(msgspec.Struct):
    number: int
    is_feedback: bool = False
    numbers: list[int] = []
    text: str = ""


class Jobs:
    """The jobs of a peer's server."""

    def __init__(self) -> None:
        self._ends: dict[int, asyncio.Future[None]] = {}

    def begin(self, job: Job) -> None:
        self._ends[job.number] = asyncio.get_running_loop().create_future()
        if not job.is_endless:
            self.end(job)

    def end(self, job: Job) -> None:
        self._ends[job.number].set_result(None)

    async def result(self, job: Job) -> None:
        await self._ends[job.number]
        del self._ends[job.number]


def feedback_of(job: Job) -> Answer:
    shown = Answer(job.number, is_feedback=True)
    if job.is_large:
        shown.text = TEXT
    else:
        shown.numbers = NUMBERS
    return shown


async def serve_until_told(pipe: Connection) -> None:
    """Report that the server is ready, and wait until nobody needs it."""
    pipe.send("ready")
    with suppress(EOFError):
        await asyncio.to_thread(pipe.recv)


# --- frames: a bare socket, and websockets --------------------------------------------------


class Frames(Protocol):
    """A connection that sends and receives whole messages."""

    async def send(self, frame: bytes | str) -> None: ...

    def __aiter__(self) -> AsyncIterator[bytes]: ...


class SocketFrames:
    """Messages on a socket. Each comes after its length."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader = reader
        self._writer = writer

    async def send(self, frame: bytes | str) -> None:
        assert isinstance(frame, bytes)
        self._writer.write(len(frame).to_bytes(4) + frame)
        await self._writer.drain()

    async def __aiter__(self) -> AsyncIterator[bytes]:
        held = b""
        while chunk := await self._reader.read(1 << 18):
            held, start = held + chunk, 0
            while len(held) - start >= 4:
                end = start + 4 + int.from_bytes(held[start : start + 4])
                if end > len(held):
                    break
                yield held[start + 4 : end]
                start = end
            held = held[start:]


class Codec:
    """The encoding of messages: msgpack for the floor, JSON for websockets."""

    def __init__(self, *, is_text: bool) -> None:
        kind = msgspec.json if is_text else msgspec.msgpack
        encode = kind.Encoder().encode
        self.write: Callable[[object], Any] = (
            (lambda message: encode(message).decode()) if is_text else encode
        )
        self.read_call: Callable[[Any], Call] = kind.Decoder(Call).decode
        self.read_answer: Callable[[Any], Answer] = kind.Decoder(Answer).decode


async def answer_frames(frames: Frames, codec: Codec) -> None:
    """Serve one connection."""
    jobs, waiting = Jobs(), set()

    async def give_result(call: Call) -> None:
        await jobs.result(call.job)
        await frames.send(codec.write(Answer(call.number)))

    async for frame in frames:
        call = codec.read_call(frame)
        if call.verb == "result":
            task = asyncio.create_task(give_result(call))
            waiting.add(task)
            task.add_done_callback(waiting.discard)
            continue
        if call.verb == "goal":
            jobs.begin(call.job)
        else:
            jobs.end(call.job)
        await frames.send(codec.write(Answer(call.number)))
        for _ in range(call.job.feedback if call.verb == "goal" else 0):
            await frames.send(codec.write(feedback_of(call.job)))


class FramedClient:
    """The asking side of a connection."""

    def __init__(self, frames: Frames, codec: Codec) -> None:
        self._frames = frames
        self._codec = codec
        self._numbers = itertools.count()
        self._waiting: dict[int, asyncio.Future[None]] = {}
        self._seen = 0

    async def read(self) -> None:
        async for frame in self._frames:
            answer = self._codec.read_answer(frame)
            if answer.is_feedback:
                self._seen += 1
            else:
                self._waiting.pop(answer.number).set_result(None)

    async def goal(self) -> None:
        await self._do(Job(next(self._numbers)))

    async def feedback(self, count: int, *, is_large: bool) -> int:
        self._seen = 0
        await self._do(Job(next(self._numbers), count, is_large))
        return self._seen

    async def cancel(self) -> float:
        job = Job(next(self._numbers), is_endless=True)
        await self._call("goal", job)
        result = await self._begin("result", job)
        began = time.perf_counter()
        await self._call("cancel", job)
        await result
        return time.perf_counter() - began

    async def _do(self, job: Job) -> None:
        await self._call("goal", job)
        await self._call("result", job)

    async def _call(self, verb: str, job: Job) -> None:
        await (await self._begin(verb, job))

    async def _begin(self, verb: str, job: Job) -> asyncio.Future[None]:
        number = next(self._numbers)
        future = self._waiting[number] = asyncio.get_running_loop().create_future()
        await self._frames.send(self._codec.write(Call(number, verb, job)))
        return future


async def serve_socket(at: str, pipe: Connection) -> None:
    ends: set[asyncio.Future[None]] = set()

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        end = asyncio.get_running_loop().create_future()
        ends.add(end)
        await answer_frames(SocketFrames(reader, writer), Codec(is_text=False))
        writer.close()
        await writer.wait_closed()
        end.set_result(None)

    async with await asyncio.start_unix_server(answer, at):
        await serve_until_told(pipe)
        await asyncio.gather(*ends)


@asynccontextmanager
async def reading(frames: Frames, codec: Codec) -> AsyncIterator[FramedClient]:
    client = FramedClient(frames, codec)
    task = asyncio.create_task(client.read())
    try:
        yield client
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


@asynccontextmanager
async def open_socket(at: str) -> AsyncIterator[FramedClient]:
    reader, writer = await asyncio.open_unix_connection(at)
    async with reading(SocketFrames(reader, writer), Codec(is_text=False)) as client:
        yield client
    writer.close()
    await writer.wait_closed()


async def serve_websockets(at: str, pipe: Connection) -> None:
    server = importlib.import_module("websockets.asyncio.server")
    codec = Codec(is_text=True)
    host, _, port = at.partition(":")
    answer = partial(answer_frames, codec=codec)
    async with server.serve(answer, host, int(port), compression=None):
        await serve_until_told(pipe)


@asynccontextmanager
async def open_websockets(at: str) -> AsyncIterator[FramedClient]:
    client = importlib.import_module("websockets.asyncio.client")
    async with (
        client.connect(f"ws://{at}", compression=None) as connection,
        reading(connection, Codec(is_text=True)) as framed,
    ):
        yield framed


# --- gRPC -----------------------------------------------------------------------------------

ENCODE = msgspec.msgpack.Encoder().encode


async def serve_grpc(at: str, pipe: Connection) -> None:
    grpc = importlib.import_module("grpc")
    aio = importlib.import_module("grpc.aio")
    jobs = Jobs()

    async def begin(job: Job, _context: object) -> Answer:
        jobs.begin(job)
        return Answer(job.number)

    async def cancel(job: Job, _context: object) -> Answer:
        jobs.end(job)
        return Answer(job.number)

    async def result(job: Job, _context: object) -> Answer:
        await jobs.result(job)
        return Answer(job.number)

    async def feedback(job: Job, _context: object) -> AsyncIterator[Answer]:
        for _ in range(job.feedback):
            yield feedback_of(job)

    read = msgspec.msgpack.Decoder(Job).decode
    handlers = {
        each.__name__: grpc.unary_unary_rpc_method_handler(each, read, ENCODE)
        for each in (begin, cancel, result)
    }
    handlers["feedback"] = grpc.unary_stream_rpc_method_handler(feedback, read, ENCODE)
    server = aio.server()
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("bench", handlers),))
    server.add_insecure_port(at)
    await server.start()
    await serve_until_told(pipe)
    await server.stop(None)


class GrpcClient:
    """The asking side of a channel."""

    def __init__(self, channel: Any) -> None:  # noqa: ANN401  # grpc may be missing
        read = msgspec.msgpack.Decoder(Answer).decode
        self._begin, self._cancel, self._result = (
            channel.unary_unary(f"/bench/{verb}", ENCODE, read)
            for verb in ("begin", "cancel", "result")
        )
        self._feedback = channel.unary_stream("/bench/feedback", ENCODE, read)
        self._numbers = itertools.count()

    async def goal(self) -> None:
        job = Job(next(self._numbers))
        await self._begin(job)
        await self._result(job)

    async def feedback(self, count: int, *, is_large: bool) -> int:
        job = Job(next(self._numbers), count, is_large)
        await self._begin(job)
        seen = len([each async for each in self._feedback(job)])
        await self._result(job)
        return seen

    async def cancel(self) -> float:
        job = Job(next(self._numbers), is_endless=True)
        await self._begin(job)
        result = self._result(job)
        began = time.perf_counter()
        await self._cancel(job)
        await result
        return time.perf_counter() - began


@asynccontextmanager
async def open_grpc(at: str) -> AsyncIterator[GrpcClient]:
    aio = importlib.import_module("grpc.aio")
    async with aio.insecure_channel(at) as channel:
        yield GrpcClient(channel)
