"""``turtleact mcp``: what is offered, and a client that starts the program."""

from __future__ import annotations

import sys

import anyio
import pytest
from mcp import Client
from mcp.client.stdio import StdioServerParameters


def test_without_a_name_to_offer_it_lists_the_actions_and_exits_with_2(on_graph, graphs):
    ran = on_graph(graphs.fibonacci, "mcp")
    assert (ran.status, ran.out) == (2, "")
    assert ran.err == (
        "turtleact: name what to offer: --actions NAME,… or --all; the actions here are: "
        "/fibonacci\n"
    )


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--all", "--actions", "/a"], "what to offer is given twice"),
        (["--all", "--topics", "/a"], "what to offer is given twice"),
        (["--embedded", "--connect", "tcp/a:1"], "the graph is given twice"),
        (["--read-only", "--services", "/a"], "a call may change things"),
        (["--all", "--token", "x"], "--token and --allow-host need --http"),
        (["--all", "--http", "x"], "the port of --http is a whole number"),
    ],
)
def test_options_that_make_no_sense_are_errors_of_usage(turtleact, arguments, problem):
    ran = turtleact("mcp", *arguments)
    assert (ran.status, ran.out) == (2, "")
    assert problem in ran.problem


def test_a_missing_extra_is_named_with_the_command_that_installs_it(on_graph, graphs, monkeypatch):
    for name in [name for name in sys.modules if name.startswith("turtleact.mcp")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "mcp", None)
    ran = on_graph(graphs.fibonacci, "mcp", "--all")
    assert (ran.status, ran.out) == (1, "")
    assert ran.err == "turtleact: turtleact mcp needs one more package: pip install 'mcp>=2.3,<3'\n"


@pytest.mark.parametrize("is_terminal", [True, False])
def test_a_terminal_is_told_what_the_command_waits_for(
    on_graph, graphs, monkeypatch, tmp_path, is_terminal
):
    with (tmp_path / "empty").open("w+") as empty:
        monkeypatch.setattr(empty, "isatty", lambda: is_terminal, raising=False)
        monkeypatch.setattr(sys, "stdin", empty)
        ran = on_graph(graphs.fibonacci, "mcp", "--all")
    assert (ran.status, ran.out) == (0, "")
    told = (
        "turtleact: waiting for an MCP client on stdin; a client starts this command. "
        "Ctrl-C ends it\n"
    )
    assert ran.err == (told if is_terminal else "")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--http", "0.0.0.0:0", "--token", ""], "--token: must not be empty"),
        (
            ["--http", "nowhere.invalid:0", "--token", "x"],
            "--http: nowhere.invalid:0 cannot be bound: ",
        ),
    ],
)
def test_an_address_that_cannot_be_served_is_named(on_graph, graphs, arguments, text):
    ran = on_graph(graphs.fibonacci, "mcp", "--all", *arguments)
    assert ran.status in (1, 2)
    assert text in ran.err


NEAR = [{"x": 5.6 + 0.15 * step, "y": 5.54} for step in range(5)]


async def test_a_client_starts_it_and_drives_a_turtle():
    arguments = ["-m", "turtleact", "mcp", "--embedded", "--actions", "/go_to,/patrol,/later"]
    program = StdioServerParameters(command=sys.executable, args=arguments)
    moving = anyio.Event()
    told = []

    async def count(progress, total, message):
        told.append(progress)

    async def hear(progress, total, message):
        moving.set()

    async def go(client):
        await client.call_tool("go_to", {"x": 1.0, "y": 1.0}, progress_callback=hear)

    async with Client(program) as client:
        names = {tool.name for tool in (await client.list_tools()).tools}
        assert "go_to" in names
        assert "fibonacci" not in names
        await client.call_tool("patrol", {"targets": NEAR}, progress_callback=count)
        assert len(told) >= 5
        assert told == sorted(set(told))
        far = await client.call_tool("go_to", {"x": 100.0})
        assert "rejected: x is 100.0, outside the world" in str(far.content[0])
        async with anyio.create_task_group() as calling:
            calling.start_soon(go, client)
            await moving.wait()
            calling.cancel_scope.cancel()
        status = "EXECUTING"
        while status in ("EXECUTING", "CANCELING"):
            goals = (await client.call_tool("list_goals", {})).structured_content["goals"]
            [status] = [goal["status"] for goal in goals if goal["action"] == "/go_to"]
        assert status == "CANCELED"
