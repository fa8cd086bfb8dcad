"""The page in a real browser, where there is one: driven over its DevTools protocol, no more."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from html.parser import HTMLParser
from importlib import resources
from pathlib import Path
from typing import Any

import anyio
import pytest
from websockets.asyncio.client import ClientConnection, connect

import turtleact
from turtleact.actions.patrol import Patrol
from turtleact.app import open_world
from turtleact.interfaces.standard import Twist
from turtleact.web import open_web

from ..lab import Count, Gate, goal

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)
PAGE = resources.files("turtleact.web").joinpath("page.html").read_text("utf-8")
in_a_browser = pytest.mark.skipif(not CHROMIUM, reason="no Chromium is installed")
on_asyncio = pytest.mark.parametrize(
    "anyio_backend", [pytest.param(("asyncio", {"use_uvloop": False}), id="asyncio")]
)
OPTIONS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--remote-debugging-port=0",
]


class Tab:
    """A page of the browser."""

    def __init__(self, devtools: ClientConnection) -> None:
        self._devtools = devtools
        self._count = 0
        self.complaints: list[str] = []

    async def do(self, method: str, **params: object) -> Any:
        self._count += 1
        asked = {"id": self._count, "method": method, "params": params}
        await self._devtools.send(json.dumps(asked))
        heard = await self._hear(lambda message: message.get("id") == asked["id"])
        assert "error" not in heard, heard
        return heard["result"]

    async def go(self, url: str) -> None:
        """Load a page."""
        await self.do("Page.navigate", url=url)
        await self._hear(lambda message: message.get("method") == "Page.loadEventFired")

    async def _hear(self, is_wanted: Callable[[dict[str, Any]], bool]) -> Any:
        """The next message of that sort; what the page complains of before it is noted."""
        while True:
            heard = json.loads(await self._devtools.recv())
            if is_wanted(heard):
                return heard
            if heard.get("method") in ("Runtime.exceptionThrown", "Log.entryAdded"):
                self.complaints.append(json.dumps(heard["params"]))

    async def run(self, script: str) -> Any:
        """What a script gives, once it is there."""
        answer = await self.do(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    async def until(self, condition: str) -> None:
        """Wait until a condition holds; it is looked at in each frame."""
        await self.run(
            "new Promise(done => { const look = () => "
            f"({condition}) ? done() : requestAnimationFrame(look); look(); }})"
        )

    async def press(self, key: str, kind: str) -> None:
        await self.do("Input.dispatchKeyEvent", type=kind, key=key, code=key)

    async def hit(self, key: str) -> None:
        """Press a key and let it go, with what the browser itself does about it."""
        number, text = {"Tab": (9, ""), "Enter": (13, "\r"), " ": (32, " ")}[key]
        pressed = {"key": key, "code": key, "windowsVirtualKeyCode": number}
        await self.do("Input.dispatchKeyEvent", type="keyDown", text=text, **pressed)
        await self.do("Input.dispatchKeyEvent", type="keyUp", **pressed)


@asynccontextmanager
async def tab(url: str, folder: Path) -> AsyncIterator[Tab]:
    """A browser with one page, for the length of a block."""
    async with await anyio.open_process(
        [CHROMIUM, *OPTIONS, f"--user-data-dir={folder}", "about:blank"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    ) as process:
        try:
            assert process.stderr is not None
            said = b""
            while not (found := re.search(rb"ws://([^/\s]+)/devtools/browser\S+\n", said)):
                said += await process.stderr.receive()
            place = found[1].decode()
            async with connect(found[0].decode().strip(), max_size=None) as browser:
                await browser.send(json.dumps({"id": 1, "method": "Target.getTargets"}))
                targets = json.loads(await browser.recv())["result"]["targetInfos"]
                (page,) = [each for each in targets if each["type"] == "page"]
            devtools = f"ws://{place}/devtools/page/{page['targetId']}"
            async with connect(devtools, max_size=None) as connection:
                opened = Tab(connection)
                await opened.do("Runtime.enable")
                await opened.do("Log.enable")
                await opened.do("Page.enable")
                await opened.go(url)
                yield opened
        finally:
            os.killpg(process.pid, signal.SIGKILL)


@in_a_browser
@on_asyncio
async def test_the_page_drives_patrols_and_cancels(tmp_path):
    async with (
        open_world() as node,
        open_web(node, port=0) as web,
        tab(web.url, tmp_path) as page,
    ):
        await page.until("$('line').textContent === 'connected'")
        await page.until("turtles.get('turtle1')?.pose")

        # what is on the graph can be asked for
        await page.run("look()")
        assert not await page.run("$('do-spawn').disabled")
        await page.run("$('do-spawn').click()")
        await page.until("turtles.get('turtle2')?.pose")

        # driving with the keyboard
        commands = node.subscription(Twist, "/turtle1/cmd_vel")
        await page.run("canvas.focus()")
        await page.press("ArrowUp", "keyDown")
        assert (await anext(commands)).linear.x == 2.0
        await page.press("ArrowUp", "keyUp")
        async for twist in commands:
            if twist == Twist():
                break

        # a click adds a target, so does the form; a patrol goes there and is canceled
        await page.run(
            "const box = canvas.getBoundingClientRect();"
            "for (const kind of ['pointerdown', 'pointerup']) canvas.dispatchEvent("
            "new PointerEvent(kind, {pointerId: 1, clientX: box.left + box.width / 2,"
            " clientY: box.top + box.height / 4}))"
        )
        await page.run("$('add').requestSubmit()")
        assert await page.run("targets.length") == 2
        client = node.action_client(Patrol, "/patrol")
        await page.run("$('send').click()")
        await page.until("[...goals.values()].some(goal => goal.feedback)")
        assert await page.run("document.querySelector('#goals strong').textContent") == (
            "/patrol executing"
        )
        await page.run("document.querySelector('#goals button').click()")
        await page.until("[...goals.values()].some(goal => goal.state === 5)")
        await client.aclose()
        assert page.complaints == []


@in_a_browser
@on_asyncio
async def test_the_page_connects_again_by_itself_and_says_so(tmp_path):
    async with open_world() as node, AsyncExitStack() as stack:
        async with open_web(node, port=0) as web:
            page = await stack.enter_async_context(tab(web.url, tmp_path))
            await page.until("$('line').textContent === 'connected'")
            await page.run("ros.wait = 1")
        await page.until("/^not connected, trying again in/.test($('line').textContent)")
        async with open_web(node, port=web.port):
            await page.until("$('line').textContent === 'connected'")
            await page.run("turtles.forEach(turtle => turtle.pose = null)")
            await page.until("turtles.get('turtle1')?.pose")


@in_a_browser
@on_asyncio
async def test_a_patrol_is_sent_with_the_keyboard_alone(tmp_path):
    async with (
        open_world() as node,
        open_web(node, port=0) as web,
        tab(web.url, tmp_path) as page,
    ):
        await page.until("actions.has('/patrol')")
        tabs = 0
        while await page.run("document.activeElement.id") != "x":
            await page.hit("Tab")
            tabs += 1
        assert tabs == 5  # the world, its three buttons, and here
        for _ in range(3):
            await page.hit("Enter")
        await page.run("$('targets').querySelectorAll('button')[1].focus()")
        await page.hit(" ")
        assert await page.run("document.activeElement.ariaLabel") == "Remove target 2"
        await page.hit("Enter")
        assert await page.run("document.activeElement.ariaLabel") == "Remove target 1"
        await page.hit("Tab")
        assert await page.run("document.activeElement.id") == "send"
        await page.hit("Enter")
        await page.until("[...goals.values()].some(goal => goal.state === 2)")
        assert page.complaints == []


@in_a_browser
@on_asyncio
async def test_a_goal_that_the_page_has_lost_sight_of_is_unknown_until_it_is_seen_again(tmp_path):
    gate = Gate()
    async with turtleact.open_node("lab") as node, AsyncExitStack() as stack:
        node.action_server(Count, "count", gate.wait)
        async with open_web(node, port=0) as web:
            page = await stack.enter_async_context(tab(web.url, tmp_path))
            await page.until("actions.has('/count')")
            handle = await stack.enter_async_context(
                node.action_client(Count, "count").send_goal(goal())
            )
            await page.until("[...goals.values()].some(goal => goal.state === 2)")
            await page.run("ros.wait = 1")
        title = "document.querySelector('#goals strong').textContent"
        await page.until(f"{title} === '/count unknown'")
        assert await page.run("document.querySelector('#goals button').disabled")
        async with open_web(node, port=web.port):
            await page.until(f"{title} === '/count executing'")
            await page.run("document.querySelector('#goals button').click()")
            assert (await handle.outcome()).status.name == "CANCELED"


class Names(HTMLParser):
    """The elements of the page that one can act on, and what names them."""

    def __init__(self) -> None:
        super().__init__()
        self.outside: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        for name in ("src", "href"):
            if given.get(name) not in (None, "favicon.ico"):
                self.outside.append(f"{tag} {name}={given[name]}")


def test_the_page_needs_nothing_from_elsewhere():
    names = Names()
    names.feed(PAGE)
    assert names.outside == []
    assert "innerHTML" not in PAGE
    assert re.findall(r"https?://\S+", PAGE) == []
