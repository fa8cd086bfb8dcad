"""The page in a real browser. All tests share one browser; each opens a page or two."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager
from html.parser import HTMLParser
from importlib import resources
from typing import Any

import pytest

import turtleact
from turtleact import GoalResponse, Reject, open_world
from turtleact.actions.patrol import Patrol
from turtleact.interfaces import load_action, load_message
from turtleact.interfaces.standard import Fibonacci, Point, Twist
from turtleact.sim.pictures import shades_of
from turtleact.web import open_web

from ..lab import Count, Gate, goal
from .browser import CHROMIUM, Tab, open_tab, running_browser

FOLDER = resources.files("turtleact.web").joinpath("page")
SOURCES = {each.name: each.read_text("utf-8") for each in FOLDER.iterdir()}
PALETTES = re.findall(r":root \{(.*?)\}", SOURCES["page.css"], re.DOTALL)

in_a_browser = pytest.mark.skipif(not CHROMIUM, reason="no Chromium is installed")


@pytest.fixture(scope="module")
def devtools(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of the browser that all tests share."""
    with running_browser(tmp_path_factory.mktemp("browser")) as address:
        yield address


@asynccontextmanager
async def connected(devtools: str, url: str) -> AsyncIterator[Tab]:
    """A page that is connected."""
    async with open_tab(devtools, url) as page:
        await page.until("$('line').textContent === 'connected'")
        yield page


@asynccontextmanager
async def world_page(devtools: str) -> AsyncIterator[tuple[turtleact.Node, Tab]]:
    """The node of a world, and a page that is connected to it."""
    async with (
        open_world() as node,
        open_web(node, port=0) as web,
        connected(devtools, web.url) as page,
    ):
        yield node, page


@in_a_browser
async def test_the_page_drives_patrols_pauses_and_cancels(devtools):
    async with world_page(devtools) as (node, page):
        # what is on the graph can be asked for
        await page.until("!$('spawn-here').disabled")
        await page.run("void (Math.random = () => 0.95)")  # away from the clicks below
        await page.click("#spawn-here")
        await page.until("$('turtle').options.length === 2")

        # driving with the keyboard
        commands = node.subscription(Twist, "/turtle1/cmd_vel")
        await page.run("$('world').focus()")
        await page.press("ArrowUp", "keyDown")
        assert (await anext(commands)).linear.x == 2.0
        await page.press("ArrowUp", "keyUp")
        async for twist in commands:
            if twist == Twist():
                break

        # clicks on the map pick targets for the chosen turtle, and a patrol goes there
        await page.until("$('action').value === '/patrol' && $('fields').children.length")
        await page.click_map(9.0, 1.0)
        await page.click_map(1.0, 10.0)
        await page.until("$('draft-text').textContent.startsWith('2')")
        assert await page.text("#draft-text") == "2 places for turtle1 · /patrol"
        await page.click("#draft-send")
        await page.until("document.querySelector('#active progress, #active .track:not([hidden])')")
        await page.until("/index/.test($('active').innerText)")
        shown = await page.text("#active details")
        assert "/patrol · turtle1" in shown
        assert re.search(r"target [12] \(index [01]\)", shown)
        assert "0 of 2" in shown or "1 of 2" in shown
        assert re.search(r"distance remaining\s+[\d.]+ m", shown)
        assert await page.run("$('draft-send').hidden")

        # another one for the same turtle is rejected, and the form says so at the field
        await page.click_map(5.0, 1.0)
        await page.until("!$('draft-send').hidden")
        await page.click("#draft-send")
        await page.until("document.querySelector('#fields .error:not(:empty)')")
        assert await page.text("#fields .error:not(:empty)") == (
            "turtle 'turtle1' is being driven by another goal"
        )
        assert await page.run("document.activeElement.value") == "turtle1"
        await page.until("document.querySelector('#ended .pill')?.textContent === 'rejected'")
        await page.click("#tab-goals")

        # it is paused and resumed
        pill = "document.querySelector('#active .pill').textContent"
        await page.click("#active .foot button + button")
        await page.until(f"{pill} === 'executing (paused)'")
        assert await page.text("#active .foot button + button") == "Resume"
        await page.click("#active .foot button + button")
        await page.until(f"{pill} === 'executing'")

        # it is canceled, and stays in the history
        await page.click("#active .foot button")
        await page.until("document.querySelector('#ended .pill')?.textContent === 'canceled'")
        assert await page.run("$('active').children.length") == 0
        assert page.complaints == []


IS_DRAWN = """(() => {
    const {width, height} = $('world');
    const {data} = $('world').getContext('2d').getImageData(0, 0, width, height);
    const isNear = (value, wanted) => Math.abs(value - wanted) < 4;
    for (let i = 0; i < data.length; i += 4)
      if (isNear(data[i], 179) && isNear(data[i + 1], 184) && data[i + 3] > 250) return true;
    return false;
})()"""  # whether the map shows the colour of the first pen

HAS_COLOUR = """(wanted => {
    const {width, height} = $('world');
    const {data} = $('world').getContext('2d').getImageData(0, 0, width, height);
    for (let i = 0; i < data.length; i += 4)
      if (wanted.every((value, at) => Math.abs(data[i + at] - value) < 4)) return true;
    return false;
})([%d, %d, %d])"""  # whether the map shows a colour

BROKEN = """(() => {
    const found = [], range = document.createRange();
    const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    for (let text; (text = texts.nextNode());)
      for (const {index, 0: word} of text.data.matchAll(/[^\\s/]+/g)) {
        range.setStart(text, index);
        range.setEnd(text, index + word.length);
        const lines = [...range.getClientRects()].filter(({width}) => width);
        if (new Set(lines.map(({top}) => Math.round(top))).size > 1) found.push(word);
      }
    return found;
})()"""  # the words and numbers that stand in more than one line


@in_a_browser
async def test_goals_and_trails_survive_a_reload_and_appear_in_another_browser(devtools):
    async with open_world(speed=20) as node, open_web(node, port=0) as web:
        async with connected(devtools, web.url) as page:
            await page.until("$('turtle').options.length")
            client = node.action_client(Patrol, "/patrol")
            await client.send_goal(Patrol.Goal(targets=[Point(x=9.0, y=9.0), Point(x=2.0, y=2.0)]))
            await page.until("document.querySelector('#ended .pill')?.textContent === 'succeeded'")
            await page.do("Page.reload")
            await page.until("document.querySelector('#ended .pill')?.textContent === 'succeeded'")
            await page.until(IS_DRAWN)
        async with connected(devtools, web.url) as another:
            await another.until("document.querySelector('#ended summary')")
            await another.until(IS_DRAWN)
            await another.click("#ended summary")
            await another.until("document.querySelector('#ended dl')")
            opened = await another.text("#ended details")
            assert re.search(r"reached\s+2\b", opened)
            assert re.search(r"targets\s+9, 9; 2, 2", opened)


@in_a_browser
async def test_the_page_connects_again_by_itself_and_says_so(devtools):
    gate = Gate()
    async with turtleact.open_node("lab") as node, AsyncExitStack() as stack:
        node.action_server(Count, "count", gate.stream)
        async with open_web(node, port=0) as web:
            page = await stack.enter_async_context(connected(devtools, web.url))
            await page.until("$('action').value === '/count'")
            handle = await stack.enter_async_context(
                node.action_client(Count, "count").send_goal(goal())
            )
            await page.until("document.querySelector('#active .pill')?.textContent === 'executing'")
        await page.until("/^not connected, trying again in/.test($('line').textContent)")
        assert await page.run("$('do-send').disabled")
        async with open_web(node, port=web.port):
            await page.until("$('line').textContent === 'connected'")
            await page.until("document.querySelector('#active .foot button:enabled')")
            await page.click("#active .foot button")
            assert (await handle.outcome()).status.name == "CANCELED"


STILL_ENABLED = """[...document.querySelectorAll('button:enabled, select:enabled')]
    .filter(each => each.closest('#draft, .tabs, #fields') === null)
    .map(each => each.ariaLabel || each.id || each.textContent)"""  # except what changes only views
LATER = """
    const {setTimeout, performance} = window, now = performance.now.bind(performance);
    window.setTimeout = (call, wait) => setTimeout(call, wait / 50);
    window.skip = 0;
    performance.now = () => now() + skip;"""  # short waits, and a clock that can be set


@in_a_browser
async def test_a_goal_does_not_seem_to_run_without_a_connection(devtools):
    targets = Patrol.Goal(targets=[Point(x=9.0, y=9.0), Point(x=2.0, y=2.0)])
    pill = "document.querySelector('#active .pill')?.textContent"
    async with AsyncExitStack() as stack:
        async with open_world() as node, open_web(node, port=0) as web:
            page = await stack.enter_async_context(connected(devtools, web.url))
            await page.run(LATER)
            await page.until("$('turtle').options.length && !$('spawn-here').disabled")
            async with node.action_client(Patrol, "/patrol").send_goal(targets) as handle:
                handle.detach()
                await page.until(f"{pill} === 'executing'")
                await page.click("#tab-turtles")
                await page.until("document.querySelector('#rows .run')")
        await page.until(f"{pill} === 'connection lost'")
        before = await page.text("#active .clock")
        await page.run("void (skip = 60_000); $('line').textContent = ''")
        await page.until("/^not connected, trying again in/.test($('line').textContent)")
        assert await page.text("#active .clock") == before
        assert await page.text("#rows .scale span + span") == "connection lost"
        assert await page.run(STILL_ENABLED) == ["turtle", "copy", "defaults"]

        # the world begins anew, and knows nothing of the goal
        async with open_world() as node, open_web(node, port=web.port):
            await page.until("$('line').textContent === 'connected'")
            await page.until("$('active').children.length === 0 && $('timeline').hidden")


@in_a_browser
async def test_a_paused_world_shows_its_turtles_and_those_that_are_spawned(devtools):
    async with open_world(turtles=2, paused=True) as node, open_web(node, port=0) as web:
        for count in (3, 4):
            async with connected(devtools, web.url) as page:
                await page.until("!$('spawn-here').disabled")
                await page.run("void (Math.random = () => 0.95)")
                await page.click("#spawn-here")
                await page.until(f"$('turtle').options.length === {count}")
                for name in ("turtle1", f"turtle{count}"):
                    await page.run(f"$('turtle').value = '{name}'; $('turtle').onchange()")
                    await page.until("$('state').innerText.includes('x ')")


@in_a_browser
async def test_of_many_goals_the_first_are_open_and_each_names_its_turtle(devtools):
    async with (
        open_world(speed=0.1, turtles=5) as node,
        open_web(node, port=0) as web,
        connected(devtools, web.url) as page,
    ):
        await page.until("$('turtle').options.length === 5")
        client = node.action_client(Patrol, "/patrol")
        far = [Point(x=9.0, y=9.0), Point(x=2.0, y=2.0)]
        async with AsyncExitStack() as stack:
            for number in range(5):
                order = Patrol.Goal(turtle=f"turtle{number + 1}", targets=far)
                await stack.enter_async_context(client.send_goal(order))
            names = (
                "[...document.querySelectorAll('#active b')].map(each => each.textContent).sort()"
            )
            wanted = [f"/patrol · turtle{number + 1}" for number in range(5)]
            await page.until(f"JSON.stringify({names}) === JSON.stringify({wanted})")
            assert await page.run("document.querySelectorAll('#active details[open]').length") == 3
            # goals that run at the same time do not cover each other
            tops = "[...document.querySelectorAll('#rows i')].map(each => each.offsetTop)"
            await page.until(f"new Set({tops}).size === 5")


@in_a_browser
async def test_a_form_offers_the_turtles_and_begins_where_the_turtle_is(devtools):
    async with world_page(devtools) as (_, page):
        await page.until("$('turtle').options.length === 1 && $('fields').children.length")
        await page.click("#tab-send")
        options = "[...document.querySelectorAll('#fields option')].map(each => each.value)"
        assert (await page.run(options))[0] == "turtle1"
        await page.until("$('state').innerText.includes('x 5.54')")
        await page.run(
            "[...document.querySelectorAll('#fields button')].find("
            "each => each.textContent === 'Add to targets').click()"
        )
        assert await page.run("document.activeElement.value") == "5.54"


@in_a_browser
async def test_the_button_that_pauses_the_world_follows_at_once(devtools):
    async with world_page(devtools) as (_, page):
        await page.until("!$('pause').hidden && !$('pause').disabled")
        for after in ("Resume world", "Pause world"):
            assert await page.run("$('pause').click(), $('pause').disabled")
            await page.until("!$('pause').disabled")
            assert await page.text("#pause") == after


@in_a_browser
async def test_turtles_keep_their_colours_when_others_come(devtools):
    async with world_page(devtools) as (_, page):
        await page.click("#tab-turtles")
        await page.until("$('turtle').options.length === 1")
        spawn = "const [x, y, name] = document.querySelectorAll('[aria-label^=Spawn] input');"
        click = "document.querySelector('[aria-label^=Spawn] button').click()"

        # a place outside of the world, and a name that is taken, are told before anything happens
        await page.run(f"{spawn} x.value = '99'; name.value = 'anna'; {click}")
        assert await page.run(f"{spawn} x.validity.rangeOverflow && document.activeElement === x")
        await page.run(f"{spawn} x.value = '3'; name.value = 'turtle1'; {click}")
        assert await page.text("#said") == "There is a turtle named turtle1 already"
        await page.run(f"{spawn} name.value = 'no name'; {click}")
        await page.until("$('said').textContent.startsWith('No turtle was spawned. The terminal')")

        await page.run(f"{spawn} name.value = 'anna'; {click}")
        await page.until("$('turtle').options.length === 2")
        for name in "turtle1", "anna":
            red, green, blue = shades_of(name).shell
            await page.until(HAS_COLOUR % (red, green, blue))


@in_a_browser
async def test_a_patrol_is_sent_with_the_keyboard_alone(devtools):
    async with world_page(devtools) as (_, page):
        await page.until("$('action').value === '/patrol' && $('fields').children.length")
        order: list[str] = []
        while not order or order[-1] != "tab-goals":
            await page.hit("Tab")
            order.append(
                await page.run("document.activeElement.id || document.activeElement.ariaLabel")
            )
        assert order == [
            *("pause", "farther", "nearer", "world", "turtle"),
            *("Forward", "Turn left", "Backward", "Turn right"),
            *("spawn-here", "clear", "tab-goals"),
        ]
        await page.hit("ArrowRight")
        assert await page.run("document.activeElement.id") == "tab-send"
        await page.hit("Tab")
        assert await page.run("document.activeElement.id") == "action"
        await page.hit("Tab")
        assert await page.run("document.activeElement.innerText") == "Add to targets"
        await page.hit("Enter")
        await page.do("Input.insertText", text="9")
        assert await page.run("document.activeElement.value") == "9"
        await page.hit("Enter")  # a form is sent with Enter
        await page.until("document.querySelector('#active .pill')?.textContent === 'executing'")
        assert await page.run("document.activeElement.id") == "tab-goals"
        assert page.complaints == []


INNER = "float64 x 1.5 # where to [m]\nstring<=3 tag"
DEEP = """\
lab_page/Inner[<=2] many
lab_page/Inner[2] two
int64 large
bool sure true
string label
uint8 MODE_SLOW=0
uint8 MODE_FAST=3
uint8 mode
float64 TIMEOUT_NEVER=-1.0
float64 timeout 10.0
---
string said
---
string said
"""


@in_a_browser
async def test_any_action_is_sent_from_a_form_made_from_its_type(devtools):
    load_message(INNER, type_name="lab_page/msg/Inner")
    deep: Any = load_action(DEEP, type_name="lab_page/action/Deep")
    heard: list[Any] = []
    markup = "<img src=x onerror=document.title='broken'>"

    async def answer(goal: Any) -> Any:
        heard.append(goal)
        return deep.Result(said=markup)

    def check(goal: Any) -> GoalResponse:
        if goal.many[0].x > 10:
            raise Reject("many[0].x is too far away")
        if goal.label == "crowd":
            raise Reject("many: these are too near each other")
        if goal.label == "nobody":
            raise Reject("nobody is there")
        return GoalResponse.ACCEPT

    async with turtleact.open_node("lab") as node, open_web(node, port=0) as web:
        node.action_server(deep, "deep", answer, goal_callback=check)
        async with connected(devtools, web.url) as page:
            await page.until("$('action').value === '/deep' && $('fields').children.length")
            await page.click("#tab-send")
            fill = """
                const input = name => [...document.querySelectorAll('#fields .field')].find(
                  each => each.querySelector('label').textContent === name).querySelector('input');
                const put = (name, value) => { input(name).value = value;
                  input(name).dispatchEvent(new Event('input', {bubbles: true})); };"""

            # bounds are known before anything is sent
            add = (
                "[...document.querySelectorAll('#fields button')].find("
                "each => each.textContent === 'Add to many')"
            )
            await page.run(f"{add}.click(); {add}.click()")
            assert await page.run(f"{add}.disabled")
            await page.run(f"{fill} put('x', 'far'); put('tag', 'long'); put('large', '1e3')")
            await page.click("#do-send")
            wrong = "[...document.querySelectorAll('#fields .error:not(:empty)')]"
            assert await page.run(f"{wrong}.map(each => each.textContent)") == [
                "Enter a number",
                "Enter at most 3 characters, not 4",
                "Enter a whole number",
            ]
            assert await page.run("document.activeElement.value") == "far"

            # what the server says about a field is shown there, too
            await page.run(f"{fill} put('x', '11'); put('tag', 'é'); put('large', '{2**63 - 1}')")
            await page.run(f"{fill} put('timeout', '2.5')")
            suggested = "[...input('timeout').list.options].map(each => each.label)"
            assert await page.run(f"{fill} {suggested}") == ["never (-1.0)"]
            await page.run(f"{fill} put('label', {markup!r})")
            await page.click("#do-send")
            await page.until(f"{wrong}.length === 1")
            assert await page.run(f"{wrong}[0].textContent") == "many[0].x is too far away"
            assert await page.run("document.activeElement.getAttribute('aria-invalid')") == "true"

            # a change of any field makes that out of date
            await page.run(f"{fill} put('label', 'crowd')")
            assert await page.run(f"{wrong}.length") == 0
            await page.run(f"{fill} put('x', '2.5')")
            await page.click("#do-send")
            await page.until(f"{wrong}.length === 1")
            assert await page.run(f"{wrong}[0].textContent") == (
                "many: these are too near each other"
            )
            assert await page.run("$('form-error').textContent + $('said').textContent") == ""

            # what it says about none is shown above the button, and nowhere else
            await page.run(f"{fill} put('label', 'nobody')")
            assert await page.run(f"{wrong}.length") == 0
            await page.click("#do-send")
            await page.until("$('form-error').textContent")
            assert await page.text("#form-error") == "nobody is there"
            assert await page.run(f"{wrong}.length + $('said').textContent") == "0"
            await page.run(f"{fill} put('label', {markup!r})")
            assert await page.run("$('form-error').textContent") == ""

            await page.click("#copy")
            await page.until("!$('command').hidden && $('said').textContent")
            assert (await page.text("#command")).startswith(
                'turtleact send-goal /deep lab_page/action/Deep \'{"many":[{"x":2.5,"tag":"é"}'
            )
            await page.click("#tab-topics")  # what was said is about the tab before
            assert await page.run("$('said').textContent") == ""
            await page.click("#tab-send")
            await page.run(
                "[...document.querySelectorAll('#fields select option')].at(-1).selected = true"
            )
            await page.click("#do-send")
            await page.until("document.querySelector('#ended .pill.good')")
            (sent,) = heard
            assert (sent.mode, sent.timeout) == (deep.Goal.MODE_FAST, 2.5)
            assert (sent.large, sent.sure, sent.label) == (2**63 - 1, True, markup)
            assert [(each.x, each.tag) for each in sent.many] == [(2.5, "é"), (1.5, "")]
            assert [each.x for each in sent.two] == [1.5, 1.5]

            # what comes from the network is text, never markup
            await page.click("#ended summary")
            await page.until("document.querySelector('#ended dl')")
            assert markup in await page.text("#ended")
            assert await page.run("document.querySelector('img') === null")
            assert await page.run("document.title") == "turtleact"
            assert page.complaints == []


@in_a_browser
async def test_the_page_fits_a_phone_and_a_screen_reader(devtools):
    async with (
        open_world(turtles=2) as node,
        open_web(node, port=0) as web,
        connected(devtools, web.url) as page,
    ):
        await page.do(
            "Emulation.setDeviceMetricsOverride",
            **{"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True},
        )
        await page.until("innerWidth === 390 && $('turtle').options.length === 2")
        assert await page.run("document.documentElement.scrollWidth") == 390
        assert await page.run("document.querySelector('.bar').getBoundingClientRect().bottom") < 844
        await node.action_client(Fibonacci, "/fibonacci").send_goal(Fibonacci.Goal(order=1))
        far = Patrol.Goal(targets=[Point(x=9.0, y=9.0), Point(x=2.0, y=2.0)])
        running = await node.action_client(Patrol, "/patrol").send_goal(far).__aenter__()
        running.detach()
        await page.until(
            "document.querySelector('#active dl') && document.querySelector('#ended summary')"
        )
        await page.click("#ended summary")
        for tab in "send", "turtles", "topics", "goals":
            await page.click(f"#tab-{tab}")
            assert await page.run("document.documentElement.scrollWidth") == 390
            assert await page.run(BROKEN) == []
            nodes = (await page.do("Accessibility.getFullAXTree"))["nodes"]
            roles = ("button", "textbox", "checkbox", "combobox", "tab", "progressbar", "image")
            unnamed = [
                each
                for each in nodes
                if each.get("role", {}).get("value") in roles
                and not each.get("ignored")
                and not each.get("name", {}).get("value")
            ]
            assert unnamed == []

        # topics are shown, and turtles come and go
        assert "geometry_msgs/msg/Twist" in await page.run("$('topics').textContent")
        await page.run(
            "[...document.querySelectorAll('#topics summary')].find("
            "each => each.textContent.startsWith('/turtle2/pose')).click()"
        )
        await page.until("document.querySelector('#topics [open] dl')?.innerText.includes('theta')")
        await page.click("[aria-label='Kill turtle2']")
        await page.until("$('turtle').options.length === 1")
        await page.click("#turtles form[aria-label='Pen'] button")
        await page.until("$('said').textContent === 'The pen of turtle1 was set'")
        assert page.complaints == []


class Outside(HTMLParser):
    """What the page loads."""

    def __init__(self) -> None:
        super().__init__()
        self.loaded: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert not any(name == "style" or name.startswith("on") for name, _ in attrs)
        self.loaded += [value or "" for name, value in attrs if name in ("src", "href")]


def test_the_page_loads_only_files_of_its_own():
    found = Outside()
    found.feed(SOURCES["page.html"])
    loaded = {"page.html", *found.loaded} - {""}
    for text in SOURCES.values():
        loaded |= {name.removeprefix("./") for name in re.findall(r' from "([^"]+)"', text)}
    assert loaded - {"favicon.ico"} == set(SOURCES) - {"icon.svg"}


def test_the_page_sets_text_never_markup_and_names_no_other_host():
    for name, text in SOURCES.items():
        assert not re.search(
            r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b", text
        )
        others = set(re.findall(r"https?://[^\s\"')]+", text)) - {"http://www.w3.org/2000/svg"}
        assert not others, name


def test_the_page_is_small():
    assert sum(len(text.encode()) for text in SOURCES.values()) < 90_000


def luminance(colour: str) -> float:
    """The relative luminance of #rgb or #rrggbb; WCAG 2.2."""
    digits = colour[1:] if len(colour) == 7 else "".join(2 * each for each in colour[1:])
    channels = [int(digits[at : at + 2], 16) / 255 for at in (0, 2, 4)]
    linear = [
        each / 12.92 if each <= 0.04045 else ((each + 0.055) / 1.055) ** 2.4 for each in channels
    ]
    return sum(weight * each for weight, each in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


def contrast(one: str, other: str) -> float:
    light, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("palette", PALETTES, ids=["light", "dark"])
def test_text_can_be_read_in_both_schemes(palette):
    colours = dict(re.findall(r"--([\w-]+): (#\w+)", palette))
    for name in "ink", "dim", "run", "good", "bad", "warn":
        for ground in "card", "back":
            assert contrast(colours[name], colours[ground]) >= 4.5, (name, ground)
    assert contrast(colours["on-run"], colours["run"]) >= 4.5
    for ground in "card", "back":
        assert contrast(colours["edge"], colours[ground]) >= 3.0  # of what one can act on
