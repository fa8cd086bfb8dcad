"""Metrics on a port: who gets them."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager

import anyio
import httpx
import pytest
from anyio.abc import SocketStream

from turtleact import InvalidOption
from turtleact.web import metrics
from turtleact.web.metrics import CONTENT_TYPE, open_metrics


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        ("metrics", {}, 200),
        ("metrics", {"Host": "localhost:1"}, 200),
        ("metrics", {"Host": "evil.example"}, 403),
        ("metrics", {"Origin": "https://evil.example"}, 403),
        ("", {}, 404),
    ],
)
async def test_metrics_are_for_programs_on_this_machine(path, headers, status):
    async with (
        open_metrics(lambda: "up 1\n", "127.0.0.1", 0) as url,
        httpx.AsyncClient() as client,
    ):
        answer = await client.get(url.removesuffix("metrics") + path, headers=headers)
        assert answer.status_code == status
        if status == 403:
            assert "--metrics 0.0.0.0:PORT" in answer.text
        if status == 200:
            assert (answer.text, answer.headers["content-type"]) == ("up 1\n", CONTENT_TYPE)


async def test_programs_that_do_not_read_keep_no_other_waiting():
    async with (
        open_metrics(lambda: "up 1\n" * 1_000_000, "127.0.0.1", 0) as url,
        httpx.AsyncClient() as client,
    ):
        port = int(url.rpartition(":")[2].partition("/")[0])
        stuck = [await anyio.connect_tcp("127.0.0.1", port) for _ in range(2)]
        for stream, sent in zip(stuck, (b"\r\n\r\n", b""), strict=True):
            await stream.send(b"GET /metrics HTTP/1.1\r\nHost: localhost" + sent)
        sizes: list[int] = []

        async def scrape() -> None:
            sizes.append(len((await client.get(url)).content))

        async with anyio.create_task_group() as group:
            for _ in range(2):
                group.start_soon(scrape)
        assert sizes == [5_000_000, 5_000_000]
        for stream in stuck:
            await stream.aclose()


@asynccontextmanager
async def silent_connections(url: str, count: int) -> AsyncIterator[list[SocketStream]]:
    async with AsyncExitStack() as stack:
        port = int(url.rpartition(":")[2].partition("/")[0])
        streams = [await anyio.connect_tcp("127.0.0.1", port) for _ in range(count)]
        yield [await stack.enter_async_context(each) for each in streams]


async def test_many_silent_connections_reset_no_scrape():
    async with (
        open_metrics(lambda: "up 1\n", "127.0.0.1", 0) as url,
        httpx.AsyncClient() as client,
        silent_connections(url, 200),
    ):
        assert (await client.get(url)).status_code == 200


async def test_too_many_requests_are_answered_and_still_more_are_reset(monkeypatch, caplog):
    monkeypatch.setattr(metrics, "MOST_CONNECTIONS", 2)
    monkeypatch.setattr(metrics, "SPARE", 1)
    async with (
        open_metrics(lambda: "up 1\n", "127.0.0.1", 0) as url,
        httpx.AsyncClient() as client,
        silent_connections(url, 2),
    ):
        assert (await client.get(url, headers={"Connection": "close"})).status_code == 503
        async with silent_connections(url, 1):
            with pytest.raises(httpx.TransportError):
                await client.get(url)
    assert "Exceeded concurrency limit" in caplog.text


async def test_a_silent_connection_is_closed_soon(monkeypatch):
    monkeypatch.setattr(metrics, "REQUEST_WITHIN", 0.02)
    async with (
        open_metrics(lambda: "up 1\n", "127.0.0.1", 0) as url,
        silent_connections(url, 1) as (stream,),
    ):
        with pytest.raises((anyio.EndOfStream, anyio.BrokenResourceError)), anyio.fail_after(5):
            await stream.receive()


async def test_on_all_addresses_any_host_name_will_do():
    async with (
        open_metrics(lambda: "up 1\n", "0.0.0.0", 0) as url,
        httpx.AsyncClient() as client,
    ):
        answer = await client.get(url, headers={"Host": "robot.example"})
        assert answer.text == "up 1\n"


async def test_a_port_that_is_in_use_is_named():
    async with open_metrics(str, "127.0.0.1", 0) as url:
        port = int(url.rpartition(":")[2].partition("/")[0])
        with pytest.raises(InvalidOption, match=f"127.0.0.1:{port} cannot be bound"):
            async with open_metrics(str, "127.0.0.1", port):
                pytest.fail("it was bound")
