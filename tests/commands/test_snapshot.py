"""``turtleact snapshot``: a picture of the world in reach."""

from __future__ import annotations

from contextlib import aclosing, asynccontextmanager

import pytest

from turtleact import open_node
from turtleact.sim.turtlesim import Turtlesim
from turtleact.sim.world import World


@asynccontextmanager
async def world(transport):
    async with (
        open_node("turtlesim", transport=transport) as node,
        aclosing(Turtlesim(node, World(), beside=node)),
    ):
        yield


@pytest.mark.parametrize(
    ("name", "start"), [("a.png", b"\x89PNG"), ("b.svg", b"<svg"), ("c.PNG", b"\x89PNG")]
)
def test_the_suffix_says_what_is_written(on_graph, tmp_path, name, start):
    path = tmp_path / name
    ran = on_graph(world, "snapshot", str(path))
    assert (ran.status, ran.err) == (0, "")
    assert path.read_bytes().startswith(start)
    assert ran.out == f"{path}: {path.stat().st_size} bytes\n"


@pytest.mark.parametrize("name", ["a.jpg", "a", "png", ".png", "a.png.txt"])
def test_another_suffix_is_an_error_of_usage(turtleact, name):
    ran = turtleact("snapshot", name)
    assert (ran.status, ran.out) == (2, "")
    assert ran.problem == f"FILE must end in .png or .svg, unlike '{name}'"


def test_a_file_that_cannot_be_written_is_named(on_graph, tmp_path):
    path = tmp_path / "nowhere" / "a.png"
    ran = on_graph(world, "snapshot", str(path))
    assert (ran.status, ran.out) == (1, "")
    assert ran.err == (
        f"turtleact: {path} cannot be written: No such file or directory; name another file\n"
    )


def test_a_graph_without_a_world_has_no_picture(on_graph, graphs):
    ran = on_graph(graphs.fibonacci, "snapshot", "a.png")
    assert (ran.status, ran.out) == (1, "")
    assert ran.err == (
        "turtleact: service '/world/snapshot': there is no world on this graph: "
        "'turtleact serve' starts one\n"
    )
