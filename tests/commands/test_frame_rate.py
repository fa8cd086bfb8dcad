"""How often is drawn, and that nothing waits for a terminal."""

from __future__ import annotations

import io
from types import SimpleNamespace

import anyio
import pytest

from turtleact.commands import terminal
from turtleact.commands.terminal import Region

from .ttys import filled, open_terminal


@pytest.fixture
def anyio_backend():
    return "asyncio"


async def test_drawing_takes_a_fifth_of_the_processor_at_most_but_for_the_first_frame(monkeypatch):
    now, slept = [0.0], []

    async def sleep(seconds):
        slept.append(seconds)
        if len(slept) == 3:
            raise ZeroDivisionError

    def compose(*, width, height):
        now[0] += 0.001 if len(slept) == 1 else 1.0
        return ""

    monkeypatch.setattr(terminal, "time", SimpleNamespace(thread_time=lambda: now[0]))
    monkeypatch.setattr(anyio, "sleep", sleep)
    with (
        open("/dev/null", "w") as stream,  # noqa: PTH123
        pytest.raises(ZeroDivisionError),
    ):
        await terminal.animate(Region(stream), compose)
    assert slept == pytest.approx([1 / 15, 1 / 15 - 0.001, 4.0])


def test_a_frame_leaves_room_for_lines_that_a_narrower_window_wraps():
    sizes = []

    def compose(*, width, height):
        sizes.append((width, height))
        return ""

    terminal.draw(Region(io.StringIO()), compose)
    assert sizes == [(79, 21)]


async def test_a_terminal_that_nobody_reads_gets_no_more_frames():
    main, other = open_terminal()
    with open(main, "rb"), open(other, "w") as stream:  # noqa: PTH123
        region = Region(stream)
        with region.held():
            filled(region)
            terminal.draw(region, pytest.fail)  # type: ignore[arg-type]  # it is not called
