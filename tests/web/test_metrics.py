"""Metrics on a port: who gets them."""

from __future__ import annotations

import httpx
import pytest

from turtleact.web.server import CONTENT_TYPE, open_metrics


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


async def test_on_all_addresses_any_host_name_will_do():
    async with (
        open_metrics(lambda: "up 1\n", "0.0.0.0", 0) as url,
        httpx.AsyncClient() as client,
    ):
        answer = await client.get(url, headers={"Host": "robot.example"})
        assert answer.text == "up 1\n"
