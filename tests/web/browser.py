"""A real browser, where there is one: driven over its DevTools protocol, no more."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

from websockets.asyncio.client import ClientConnection, connect

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
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
KEYS = {
    "Tab": (9, ""),
    "Enter": (13, "\r"),
    " ": (32, " "),
    "ArrowRight": (39, ""),
    "ArrowUp": (38, ""),
}
SIDE = 499 / 45


class Tab:
    """A page of the browser.

    Attributes:
        complaints: What the page has complained of in its console.
    """

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
        """What a script gives, once it is there; ``$`` finds an element by its id."""
        answer = await self.do(
            "Runtime.evaluate",
            expression=f"{{const $ = id => document.getElementById(id);\n{script}}}",
            awaitPromise=True,
            returnByValue=True,
        )
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    async def until(self, condition: str) -> None:
        """Wait until a condition holds; it is looked at in each frame."""
        await self.run(
            "new Promise(done => { const look = () => "
            f"({condition}) ? done() : requestAnimationFrame(look); look(); }})"
        )

    async def text(self, selector: str) -> str:
        found: str = await self.run(f"document.querySelector({json.dumps(selector)}).innerText")
        return found

    async def click(self, selector: str) -> None:
        await self.run(f"document.querySelector({json.dumps(selector)}).click()")

    async def click_map(self, x: float, y: float) -> None:
        left, top, width, height = await self.run(
            "const box = $('world').getBoundingClientRect();"
            "[box.left, box.top, box.width, box.height]"
        )
        unit = min(width, height) / SIDE
        place = {
            "x": left + width / 2 + (x - SIDE / 2) * unit,
            "y": top + height / 2 - (y - SIDE / 2) * unit,
        }
        for kind in "mousePressed", "mouseReleased":
            await self.do(
                "Input.dispatchMouseEvent", type=kind, **place, button="left", clickCount=1
            )

    async def press(self, key: str, kind: str) -> None:
        """Press a key (``keyDown``) or release it (``keyUp``)."""
        number, text = KEYS[key]
        pressed = {"key": key, "code": key, "windowsVirtualKeyCode": number}
        if kind == "keyDown":
            pressed["text"] = text
        await self.do("Input.dispatchKeyEvent", type=kind, **pressed)

    async def hit(self, key: str) -> None:
        """Press a key and let it go, with what the browser itself does about it."""
        await self.press(key, "keyDown")
        await self.press(key, "keyUp")


@contextmanager
def running_browser(folder: Path) -> Iterator[str]:
    """A browser for the length of a block; gives the address of its DevTools."""
    with subprocess.Popen(
        [CHROMIUM, *OPTIONS, f"--user-data-dir={folder}", "about:blank"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    ) as process:
        try:
            assert process.stderr is not None
            for line in process.stderr:
                if found := re.search(rb"ws://[^/\s]+/devtools/browser\S+", line):
                    yield found[0].decode()
                    break
        finally:
            os.killpg(process.pid, signal.SIGKILL)


@asynccontextmanager
async def open_tab(devtools: str, url: str) -> AsyncIterator[Tab]:
    """A page of a running browser, for the length of a block."""
    async with connect(devtools, max_size=None) as browser:

        async def ask(method: str, **params: object) -> Any:
            await browser.send(json.dumps({"id": 1, "method": method, "params": params}))
            while (heard := json.loads(await browser.recv())).get("id") != 1:
                pass
            return heard["result"]

        target = (await ask("Target.createTarget", url="about:blank"))["targetId"]
        address = f"{devtools.partition('/devtools/')[0]}/devtools/page/{target}"
        async with connect(address, max_size=None) as connection:
            tab = Tab(connection)
            for domain in "Runtime", "Log", "Page":
                await tab.do(f"{domain}.enable")
            await tab.do("Emulation.setFocusEmulationEnabled", enabled=True)
            await tab.go(url)
            yield tab
        await ask("Target.closeTarget", targetId=target)
