"""A server over HTTP: its port, its token, and the app beside others."""

from __future__ import annotations

import anyio
import httpx
import pytest
from mcp import Client
from starlette.applications import Starlette
from starlette.routing import Mount

from turtleact.mcp import open_app, open_http

from .line import MODES, open_lab
from .test_tasks import TakesTasks, begin, ended


@pytest.mark.parametrize("mode", MODES)
async def test_a_call_over_http_has_progress_and_can_be_cancelled(mode):
    told = []

    async def hear(progress, total, message):
        told.append(progress)

    async with (
        open_lab() as (lab, _, server),
        open_http(server) as address,
        Client(address.url, mode=mode) as client,
    ):
        reply = await client.call_tool("count", {"order": 5}, progress_callback=hear)
        assert reply.structured_content["result"] == {"sequence": [0, 1, 2, 3, 4]}
        assert told == [1, 2, 3, 4, 5]
        lab.started = anyio.Event()
        async with anyio.create_task_group() as calling:
            calling.start_soon(client.call_tool, "count", {"order": 0})
            await lab.started.wait()
            calling.cancel_scope.cancel()
        while not lab.ended:
            await anyio.sleep(0.01)
        assert lab.ended == ["cancelled"]


async def test_a_task_over_http_goes_on_when_its_client_has_gone():
    takes = TakesTasks()
    async with open_lab() as (_, _, server), open_http(server) as address:
        async with Client(address.url, extensions=[takes]) as client:
            begun = await begin(client, takes, 50)
        async with Client(address.url, extensions=[takes]) as client:
            task = await ended(client, begun.task_id)
    assert task.result["structuredContent"]["result"] == {"sequence": list(range(50))}


BODY = {"jsonrpc": "2.0", "id": 1, "method": "ping"}


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 401),
        ({"Authorization": "Bearer wrong"}, 401),
        ({"Authorization": "Bearer secret", "Host": "evil.example"}, 421),
        ({"Authorization": "Bearer secret", "Origin": "https://evil.example"}, 403),
        ({"Authorization": "Bearer secret", "Content-Length": "9999999"}, 413),
    ],
)
async def test_strangers_are_refused(headers, status):
    async with open_lab() as (_, _, server), open_app(server, token="secret") as app:
        transport = httpx.ASGITransport(app)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            accepts = {"Accept": "application/json, text/event-stream"}
            reply = await client.post("/mcp", json=BODY, headers=accepts | headers)
    assert reply.status_code == status


async def test_the_app_can_be_mounted_beside_others():
    async with open_lab() as (_, _, server), open_app(server) as app:
        outer = httpx.ASGITransport(Starlette(routes=[Mount("/robot", app=app)]))
        async with httpx.AsyncClient(transport=outer, base_url="http://localhost") as client:
            reply = await client.post("/robot/mcp", json={})
    assert reply.status_code == 400  # the server of MCP answers; another would say 404


async def test_other_machines_need_a_token_that_is_made_for_the_run():
    async with open_lab() as (_, _, server), open_http(server, "0.0.0.0") as address:
        assert len(address.token) > 16
