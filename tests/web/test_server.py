"""A node on a port; uvicorn runs on asyncio alone, and so do these tests, uvloop included."""

from __future__ import annotations

import asyncio
import json
import signal
import socket

import pytest
import websockets
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

import turtleact
from turtleact.errors import InvalidOption, TurtleactError
from turtleact.interfaces import Message, string
from turtleact.web import Limits, open_web
from turtleact.web.server import Web

from ..lab import other_tasks

pytestmark = pytest.mark.loops("asyncio", "uvloop")


class Text(Message, type_name="lab_interfaces/msg/Text"):
    data: string = ""


def address(web: Web) -> str:
    return web.url.replace("http:", "ws:")


async def ask(client: websockets.ClientConnection, service: str) -> object:
    await client.send(json.dumps({"op": "call_service", "service": service}))
    return json.loads(await client.recv())["values"]


async def test_nothing_is_left_behind():
    before = other_tasks()
    async with turtleact.open_node("lab") as node:
        async with open_web(node, port=0) as web, connect(address(web)) as client:
            await ask(client, "/rosapi/nodes")
        assert other_tasks() == before
        with socket.create_server((web.host, web.port)):
            pass


async def test_a_busy_port_is_one_clear_error():
    with socket.create_server(("127.0.0.1", 0)) as busy:
        port = busy.getsockname()[1]
        async with turtleact.open_node("lab") as node:
            with pytest.raises(
                InvalidOption,
                match=f"option 'port': 127.0.0.1:{port} cannot be bound: .*in use; choose",
            ):
                async with open_web(node, port=port):
                    pass


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"port": 70_000}, "option 'port': 70000 is not a port: give 0 to 65535"),
        (
            {"host": "a..b", "token": "x"},
            "option 'host': a..b:9090 cannot be bound",
        ),
        (
            {"host": "192.0.2.1", "token": "x", "port": 0},
            "option 'host': 192.0.2.1:0 cannot be bound",
        ),
        (
            {"host": "0.0.0.0", "token": ""},
            "option 'token': must not be empty if other machines",
        ),
    ],
)
async def test_what_cannot_be_bound_is_one_clear_error(options, problem):
    async with turtleact.open_node("lab") as node:
        with pytest.raises(InvalidOption, match=problem):
            async with open_web(node, **options):
                pass


@pytest.mark.loops("trio")
async def test_on_trio_there_is_no_server():
    async with turtleact.open_node("lab") as node:
        with pytest.raises(TurtleactError, match="the web server only runs on asyncio"):
            async with open_web(node, port=0):
                pass


async def test_other_machines_need_a_token():
    async with turtleact.open_node("lab") as node, open_web(node, "0.0.0.0", 0) as web:
        assert len(web.token) > 20
        assert web.url == f"http://127.0.0.1:{web.port}/?token={web.token}"
        with pytest.raises(InvalidStatus, match="403"):
            await connect(f"ws://127.0.0.1:{web.port}/")
        async with connect(address(web)) as client:
            assert await ask(client, "/rosapi/nodes") == {"nodes": ["/lab"]}


async def test_a_token_may_be_any_text():
    async with (
        turtleact.open_node("lab") as node,
        open_web(node, port=0, token="ä b&c#+%") as web,
        connect(address(web)) as client,
    ):
        assert await ask(client, "/rosapi/nodes") == {"nodes": ["/lab"]}


async def test_the_address_of_an_ipv6_host_is_in_brackets():
    if not socket.has_ipv6:
        pytest.skip("there is no IPv6 here")
    async with turtleact.open_node("lab") as node:
        try:
            async with open_web(node, "::1", 0) as web, connect(address(web)) as client:
                assert web.url == f"http://[::1]:{web.port}/"
                assert await ask(client, "/rosapi/nodes") == {"nodes": ["/lab"]}
        except InvalidOption as error:
            pytest.skip(f"there is no IPv6 here: {error}")


async def test_signals_are_left_to_the_program():
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    async with turtleact.open_node("lab") as node, open_web(node, port=0):
        assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


async def test_a_message_that_is_too_long_ends_its_connection():
    limits = Limits(message_size=1000)
    async with (
        turtleact.open_node("lab") as node,
        open_web(node, port=0, limits=limits) as web,
        connect(address(web)) as client,
    ):
        await client.send("x" * 1001)
        with pytest.raises(websockets.ConnectionClosed) as closed:
            await client.recv()
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1009


@pytest.mark.parametrize(
    "said",
    [
        pytest.param(b"GET /?token=no HTTP/1.1\r\nHost: localhost\r\n\r\n", id="page"),
        pytest.param("HANDSHAKE", id="websocket"),
    ],
)
async def test_refused_connections_are_one_line_in_the_log(said, caplog):
    caplog.set_level("INFO")
    async with (
        turtleact.open_node("lab") as node,
        open_web(node, port=0, token="secret") as web,
    ):
        caplog.clear()
        for _ in range(20):
            reader, writer = await asyncio.open_connection(web.host, web.port)
            writer.write(HANDSHAKE if isinstance(said, str) else said)
            await reader.read()
            writer.close()
        (message,) = caplog.messages
    assert message.startswith("a web connection was refused (0 more before): the token")


async def test_a_reader_that_never_reads_is_cut_off_and_slows_nobody(caplog, monkeypatch):
    monkeypatch.setattr("turtleact.web.connection.PATIENCE", 0.05)
    monkeypatch.setattr("turtleact.web.connection.SLOWEST", 2**30)
    async with (
        turtleact.open_node("lab") as node,
        open_web(node, port=0) as web,
        connect(address(web)) as reader,
    ):
        publisher = node.publisher(Text, "text")
        with socket.create_connection((web.host, web.port)) as deaf:
            deaf.setblocking(False)
            await asyncio.get_running_loop().sock_sendall(deaf, HANDSHAKE)
            answer = await asyncio.get_running_loop().sock_recv(deaf, 1000)
            assert answer.startswith(b"HTTP/1.1 101 ")
            deaf.sendall(masked(b'{"op":"subscribe","topic":"/text"}'))
            await reader.send(json.dumps({"op": "subscribe", "topic": "/text"}))
            await ask(reader, "/rosapi/nodes")
            text = "x" * 200_000
            while web.bridge.statistics().connections == 2:
                publisher.publish(Text(data=text))
                assert json.loads(await reader.recv())["msg"]["data"] == text
        assert "a web client was disconnected: it read nothing for 0.05 s" in caplog.text


HANDSHAKE = (
    b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


def masked(payload: bytes) -> bytes:
    """A text frame as a client sends it, under a mask of zeros."""
    assert len(payload) < 126
    return bytes([0x81, 0x80 | len(payload), 0, 0, 0, 0]) + payload
