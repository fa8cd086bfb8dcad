"""The ASGI app: who comes in, what is served over HTTP, where it can be mounted."""

from __future__ import annotations

from typing import Any

import httpx
import pytest
from starlette.applications import Starlette
from starlette.routing import Mount

from turtleact.web import Limits

from .line import Line, bridged, line, websocket_scope

pytestmark = pytest.mark.loops("asyncio", "trio")


async def refused(bridge: Any, scope: dict[str, Any]) -> dict[str, Any]:
    """What a client gets that is not let in."""
    client = Line()
    await client.run(bridge, scope)
    client.close()
    return client.closed


@pytest.mark.parametrize(
    ("scope", "status"),
    [
        (websocket_scope("/elsewhere"), 404),
        (websocket_scope(host="evil.example"), 403),
        (websocket_scope(origin="https://evil.example"), 403),
        (websocket_scope(origin="null"), 403),
    ],
)
async def test_who_may_not_come_in_is_refused(scope, status):
    async with bridged() as (_, bridge):
        assert (await refused(bridge, scope))["status"] == status


@pytest.mark.parametrize(
    "scope",
    [
        websocket_scope(query="token=secret"),
        websocket_scope(authorization="Bearer secret"),
        websocket_scope(authorization="bearer secret"),
    ],
)
async def test_who_knows_the_token_comes_in(scope):
    async with bridged(token="secret") as (_, bridge), line(bridge, scope) as client:
        assert await client.hears_nothing()


@pytest.mark.parametrize(
    "scope",
    [
        websocket_scope(),
        websocket_scope(query="token=wrong"),
        websocket_scope(query="token="),
        websocket_scope(query="token=secret", authorization="Bearer wrong"),
        websocket_scope(authorization="Basic secret"),
    ],
)
async def test_who_does_not_know_the_token_is_refused(scope):
    async with bridged(token="secret") as (_, bridge):
        assert (await refused(bridge, scope))["status"] == 403


async def test_there_is_an_end_to_connections():
    async with bridged(limits=Limits(connections=1)) as (_, bridge):
        async with line(bridge) as client:
            assert await client.hears_nothing()
            assert (await refused(bridge, websocket_scope()))["status"] == 503
        async with line(bridge) as client:
            assert await client.hears_nothing()


async def test_a_closed_bridge_takes_nobody():
    async with bridged() as (_, bridge):
        await bridge.aclose()
        assert (await refused(bridge, websocket_scope()))["status"] == 503


# HTTP


def browser(app: Any) -> httpx.AsyncClient:
    return httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost:9090")


async def test_the_page_is_served():
    async with bridged() as (_, bridge), browser(bridge) as http:
        answer = await http.get("/")
        assert answer.status_code == 200
        assert answer.headers["content-type"] == "text/html; charset=utf-8"
        policy = answer.headers["content-security-policy"]
        assert "script-src 'self'; style-src 'self';" in policy
        assert "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy
        assert answer.text.startswith("<!doctype html>")


@pytest.mark.parametrize(
    ("path", "media_type"),
    [
        ("/favicon.ico", "image/svg+xml"),
        ("/page.css", "text/css; charset=utf-8"),
        ("/main.js", "text/javascript; charset=utf-8"),
    ],
)
async def test_the_files_of_the_page_need_no_token(path, media_type):
    async with bridged(token="secret") as (_, bridge), browser(bridge) as http:
        answer = await http.get(path)
        assert (answer.status_code, answer.headers["content-type"]) == (200, media_type)


@pytest.mark.parametrize(
    ("method", "path", "headers", "status"),
    [
        ("GET", "/nope", {}, 404),
        ("POST", "/", {}, 405),
        ("GET", "/", {"host": "evil.example"}, 403),
        ("HEAD", "/", {}, 200),
    ],
)
async def test_what_else_is_asked_for_is_answered(method, path, headers, status):
    async with bridged() as (_, bridge), browser(bridge) as http:
        assert (await http.request(method, path, headers=headers)).status_code == status


async def test_the_page_needs_the_token_too():
    async with bridged(token="secret") as (_, bridge), browser(bridge) as http:
        assert (await http.get("/")).status_code == 403
        assert (await http.get("/?token=secret")).status_code == 200


async def test_a_bridge_can_be_mounted():
    async with bridged() as (_, bridge):
        app = Starlette(routes=[Mount("/robot", bridge)])
        async with browser(app) as http:
            assert (await http.get("/robot/")).status_code == 200
            assert (await http.get("/robot/nope")).status_code == 404
        async with line(app, websocket_scope("/robot/")) as client:
            assert await client.hears_nothing()
