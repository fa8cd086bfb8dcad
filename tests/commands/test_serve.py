"""Two terminals and more: ``serve`` in one process, the other verbs in others."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import anyio
import pytest
import websockets
from websockets.sync.client import ClientConnection, connect

import turtleact
from turtleact import GoalStatus
from turtleact.errors import TurtleactError
from turtleact.interfaces.standard import Fibonacci

from .. import warm
from ..lab import free_endpoint

LAB = """
import anyio
import turtleact
from turtleact.interfaces.standard import Fibonacci


@turtleact.action(Fibonacci, "quick")
async def quick(goal):
    numbers = [0, 1]
    for _ in range(1, goal.order):
        numbers.append(numbers[-1] + numbers[-2])
        yield Fibonacci.Feedback(partial_sequence=numbers)
    yield Fibonacci.Result(sequence=numbers)


@turtleact.action(Fibonacci, "endless")
async def endless(goal):
    yield Fibonacci.Feedback(partial_sequence=[0])
    await anyio.sleep_forever()
"""

LEAVING = """
import sys
import turtleact
from turtleact.interfaces.standard import Fibonacci


@turtleact.action(Fibonacci, "leaving")
async def leaving(goal):
    yield Fibonacci.Feedback(partial_sequence=[0])
    sys.exit(goal.order)
"""

STUBBORN = """
import anyio
import turtleact
from turtleact.interfaces.standard import Fibonacci

@turtleact.action(Fibonacci, "stubborn", grace=0.1)
async def stubborn(goal):
    while True:
        try:
            await anyio.sleep_forever()
        except anyio.get_cancelled_exc_class():
            pass
"""

FAILING = """
import turtleact
from turtleact.interfaces.standard import Fibonacci


@turtleact.action(Fibonacci, "failing")
async def failing(goal):
    raise ValueError("\\x1b[2J")
"""

HERE = {**os.environ, "ROS_DOMAIN_ID": "0"}
NAMED = "--node-name", "other"

PATIENCE = 30.0
"""Seconds after which a process is taken to hang."""


class Served(NamedTuple):
    """A server in a process of its own.

    Attributes:
        process: The process.
        at: Where it listens.
        ready: The line that said so.
        folder: Its working directory.
    """

    process: subprocess.Popen[str]
    at: str
    ready: str
    folder: Path

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        """Another verb on its graph."""
        return start(self.folder, *arguments, "--connect", self.at)

    def run(self, *arguments: str) -> tuple[int, str, str]:
        """The same, to its end: exit status, stdout, stderr."""
        with self.start(*arguments) as process:
            try:
                out, err = process.communicate(timeout=PATIENCE)
            finally:
                process.kill()
        return process.returncode, out, err

    def send(self, action: str, order: int = 0) -> GoalStatus:
        """Send a goal from this process, which takes a tenth of the time: the status of its end."""

        async def main() -> GoalStatus:
            async with (
                turtleact.open_zenoh([self.at], domain=0) as graph,
                turtleact.open_node("sender", transport=graph) as node,
            ):
                sent = node.action_client(Fibonacci, action).send_goal(Fibonacci.Goal(order=order))
                async with sent as handle:
                    return (await handle.outcome()).status

        return anyio.run(main)

    def end(self, number: signal.Signals) -> tuple[int, str, str]:
        self.process.send_signal(number)
        out, err = self.process.communicate(timeout=PATIENCE)
        return self.process.returncode, out, err


def start(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    return start_python(folder, "-m", "turtleact", *arguments)


def start_python(
    folder: Path, *arguments: str, stderr: int = subprocess.PIPE
) -> subprocess.Popen[str]:
    # A reload runs the command line of the process again, which must be a Python of its own.
    begin = subprocess.Popen if "--reload" in arguments else warm.start
    return begin(
        [sys.executable, *arguments],
        cwd=folder,
        env=HERE,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=stderr,
        text=True,
    )


@contextmanager
def serving(folder: Path, *arguments: str) -> Iterator[Served]:
    at = free_endpoint()
    process = start(folder, "serve", *arguments, "--listen", at)
    try:
        assert process.stdout is not None
        ready = process.stdout.readline()
        if not ready:
            pytest.fail(f"it is not ready: {process.communicate(timeout=PATIENCE)[1]}")
        yield Served(process, at, ready, folder)
    finally:
        process.kill()
        process.communicate()


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """A folder with a module of actions."""
    (tmp_path / "servedlab.py").write_text(LAB)
    return tmp_path


@pytest.fixture
def served(lab: Path) -> Iterator[Served]:
    """A server of that module's actions, without a world."""
    with serving(lab, "servedlab", "--no-sim") as server:
        yield server


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """The same, for tests that leave the server as it was."""
    folder = tmp_path_factory.mktemp("shared")
    (folder / "servedlab.py").write_text(LAB)
    with serving(folder, "servedlab", "--no-sim") as server:
        yield server


def first_lines(process: subprocess.Popen[str], until: str) -> None:
    """Read what a process prints until a line has a certain text."""
    assert process.stdout is not None
    for line in process.stdout:
        if until in line:
            return
    pytest.fail(f"no line has {until!r}")


def test_it_says_when_it_is_ready_and_where(shared):
    assert shared.ready == f"ready at {shared.at}, domain 0: /endless, /quick\n"


def test_all_feedback_comes_and_none_after_the_result(shared):
    status, out, _ = shared.run("send-goal", "quick", "order: 40", "--json")
    events = [json.loads(line) for line in out.splitlines()]
    kinds = [event["event"] for event in events if event["event"] != "status"]
    assert (status, kinds) == (0, ["accepted", *["feedback"] * 39, "result"])


def test_a_goal_is_canceled_from_a_third_process(shared):
    sender = shared.start("send-goal", "endless", "--feedback", "--plain")
    first_lines(sender, "Feedback:")
    status, out, _ = shared.run("cancel", "--all", "/endless")
    assert (status, out.endswith(" of /endless: canceling\n")) == (0, True)
    out, _ = sender.communicate(timeout=PATIENCE)
    assert (sender.returncode, out.endswith("status: CANCELED\n")) == (5, True)


def test_ctrl_c_cancels_the_goal_on_the_server(shared):
    sender = shared.start("send-goal", "endless", "--feedback", "--plain")
    first_lines(sender, "Feedback:")
    sender.send_signal(signal.SIGINT)
    out, _ = sender.communicate(timeout=PATIENCE)
    assert (sender.returncode, out.endswith("status: CANCELED\n")) == (130, True)


def test_a_goal_that_was_left_can_be_found_again(shared):
    status, out, err = shared.run("send-goal", "endless", "--timeout", "0", "--json")
    goal_id = json.loads(out.splitlines()[0])["goal_id"]
    way_back = f"turtleact watch {goal_id} --connect {shared.at}"
    assert (status, err) == (0, f"turtleact: the goal goes on; '{way_back}' follows it again\n")
    watcher = shared.start("watch", goal_id)
    status, out, _ = shared.run("goals")
    assert (goal_id in out, "EXECUTING" in out) == (True, True)
    shared.run("cancel", goal_id)
    out, _ = watcher.communicate(timeout=PATIENCE)
    assert "status: CANCELED" in out


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_server_that_is_ended_answers_all_who_wait(served, number):
    sender = served.start("send-goal", "endless", "--feedback", "--plain")
    first_lines(sender, "Feedback:")
    status, out, err = served.end(number)
    assert (status, err) == (0, "turtleact: no more goals are accepted; running goals are ended\n")
    assert out.splitlines()[-1].endswith("ABORTED: shutdown")
    out, err = sender.communicate(timeout=PATIENCE)
    assert (sender.returncode, out.endswith("status: ABORTED\n")) == (4, True)
    assert "the goal was aborted: shutdown" in err


def test_sys_exit_in_a_body_ends_the_server_with_its_status(lab):
    (lab / "servedleaving.py").write_text(LEAVING)
    with serving(lab, "servedlab", "servedleaving", "--no-sim") as server:
        other = server.start("send-goal", "endless", "--feedback", "--plain")
        first_lines(other, "Feedback:")
        status, _, _ = server.run("send-goal", "leaving", "order: 7", "--feedback", "--plain")
        assert status in (1, 4)
        other.communicate(timeout=PATIENCE)
        assert other.returncode in (1, 4)
        server.process.communicate(timeout=PATIENCE)
    assert server.process.returncode == 7


@pytest.mark.parametrize("options", [[], ["--log-format", "text"]])
def test_the_log_of_a_body_that_fails_commands_no_terminal(tmp_path, options):
    (tmp_path / "servedfailing.py").write_text(FAILING)
    with serving(tmp_path, "servedfailing", "--no-sim", *options) as server:
        assert server.send("failing") is GoalStatus.ABORTED
        _, _, err = server.end(signal.SIGTERM)
    assert "\nValueError: \\x1b[2J\n" in err


def test_a_server_that_is_killed_is_told_at_once(served):
    sender = served.start("send-goal", "endless", "--feedback", "--plain")
    first_lines(sender, "Feedback:")
    served.process.kill()
    _, err = sender.communicate(timeout=PATIENCE)
    assert sender.returncode == 1
    error, hint = err.splitlines()[-2:]
    assert error.endswith("action '/endless': the server went away before the goal ended")
    assert "if the server returns and continues the goal, 'turtleact watch " in hint


def test_a_sender_that_waits_for_a_killed_server_says_so_and_does_not_promise_its_goal(served):
    sender = served.start("send-goal", "endless", "--plain", "--reattach", "60")
    first_lines(sender, "accepted")
    served.process.kill()
    assert sender.stderr is not None
    gone = "turtleact: the server of /endless has gone: waiting for it for up to 60 s\n"
    assert sender.stderr.readline() == gone
    sender.send_signal(signal.SIGINT)
    first_lines(sender, "Canceling")
    awaited = "turtleact: waiting for the server, which has gone; Ctrl-C again exits at once\n"
    assert sender.stderr.readline() == awaited
    sender.send_signal(signal.SIGINT)
    _, err = sender.communicate(timeout=PATIENCE)
    assert sender.returncode == 130
    assert err.startswith("turtleact: if the server returns and continues the goal, 'turtleact")


def test_a_taken_port_is_one_clear_line(shared, lab):
    other = start(lab, "serve", "--no-sim", "--listen", shared.at)
    out, err = other.communicate(timeout=PATIENCE)
    assert (other.returncode, out) == (1, "")
    assert err.startswith(f"turtleact: cannot listen at {shared.at}: ")
    assert err.count("\n") == 1


def test_what_is_said_of_the_world_reaches_it(turtleact, monkeypatch):
    asked: dict[str, object] = {}

    def open_world(**options: object) -> None:
        asked.update(options)
        raise TurtleactError("enough")

    monkeypatch.setattr("turtleact.sim.world_node.open_world", open_world)
    said = "--speed 2 --turtles 3 --placing ring --seed 5 --collide --paused"
    assert turtleact("serve", *said.split()).err == "turtleact: enough\n"
    del asked["graph"], asked["on_transition"], asked["on_start"], asked["on_node"]
    assert asked.pop("introspection") == "off"
    assert not asked.pop("turtlesim_only")
    assert asked == {
        "speed": 2.0,
        "turtles": 3,
        "placing": "ring",
        "seed": 5,
        "collide": True,
        "paused": True,
    }


def test_a_server_whose_output_cannot_be_written_says_so_and_goes_on(lab):
    command = [sys.executable, "-m", "turtleact", "serve", "servedlab", "--no-sim", "--listen"]
    with Path("/dev/full").open("w") as full:
        at = free_endpoint()
        process = warm.start(
            [*command, at], cwd=lab, stdout=full, stderr=subprocess.PIPE, text=True, env=HERE
        )
    assert process.stderr is not None
    try:
        assert process.stderr.readline() == (
            "turtleact: stdout cannot be written (No space left on device), so goals are no longer "
            "listed\n"
        )
        assert Served(process, at, "", lab).send("quick", order=1) is GoalStatus.SUCCEEDED
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE) == 0
    finally:
        process.kill()
        process.communicate()


def test_the_world_is_served_with_its_actions(tmp_path):
    with serving(tmp_path, "--speed", "100", "--turtles", "2") as server:
        for name in ("/patrol", "/go_to", "/fibonacci", "/turtle2/rotate_absolute"):
            assert name in server.ready
        status, out, _ = server.run("send-goal", "patrol", "targets: [{x: 7, y: 7}]", "--plain")
        assert (status, out.endswith("status: SUCCEEDED\n")) == (0, True)
        status, out, _ = server.run("topic", "echo", "/turtle1/pose", "--once")
        assert (status, out.startswith("x: ")) == (0, True)


def test_an_action_that_another_node_serves_is_refused_with_its_name(shared, lab):
    other = start(lab, "serve", "servedlab", "--no-sim", "--connect", shared.at, *NAMED)
    assert ended(other) == (
        1,
        "",
        "turtleact: action '/quick' is served by node /servedlab already: choose another name, or "
        "give --wait to serve it once that node has gone\n",
    )


def test_an_action_that_is_given_twice_is_refused(shared, lab):
    (lab / "servedtwice.py").write_text(LAB)
    twice = "servedlab:quick", "servedtwice:quick"
    other = start(lab, "serve", *twice, "--no-sim", "--listen", free_endpoint())
    assert ended(other) == (2, "", "turtleact: action '/quick' is given twice\n")


def test_a_standby_takes_over_when_the_first_server_is_killed(served, lab):
    standby = start(lab, "serve", "servedlab", "--no-sim", "--wait", "--connect", served.at)
    try:
        assert standby.stderr is not None
        assert standby.stdout is not None
        notes = {standby.stderr.readline() for _ in range(2)}
        assert "/quick is served by /servedlab: waiting until that node has gone\n" in notes
        served.process.kill()
        assert standby.stdout.readline().startswith("ready at ")
        standby.send_signal(signal.SIGTERM)
        assert standby.wait(PATIENCE) == 0
    finally:
        standby.kill()
        standby.communicate()


def test_a_server_of_the_same_node_that_lives_is_not_waited_for_for_ever(
    shared, turtleact, monkeypatch, caplog
):
    """Whether the other server is a predecessor that was killed cannot be seen."""
    monkeypatch.setattr("turtleact.commands.serving.LEASE", 0.1)
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")
    monkeypatch.chdir(shared.folder)
    ran = turtleact("serve", "servedlab.py", "--no-sim", "--connect", shared.at)
    assert ran.status == 1
    assert "waiting for up to 0.1 s: /servedlab may be an earlier run that was" in caplog.text
    assert "'/quick' is served by node /servedlab already" in ran.err


STUDENT = """
import sys
import anyio
import turtleact
from turtleact.interfaces.standard import Fibonacci


async def mine(goal):
    return Fibonacci.Result(sequence=[7])


async def main():
    async with turtleact.open_zenoh([sys.argv[1]]) as graph:
        await graph.explore()
        async with turtleact.open_node("student", transport=graph) as node:
            node.action_server(Fibonacci, "/fibonacci", mine)
            await graph.flush()
            print("serving", flush=True)
            await anyio.sleep_forever()


anyio.run(main)
"""


def test_a_built_in_action_makes_way_for_a_server_in_another_process(tmp_path):
    """The built-in action's terminal says so, and a goal that it runs finishes."""
    (tmp_path / "student.py").write_text(STUDENT)
    goal = ("send-goal", "fibonacci", Fibonacci.type_name, "order: 6", "--feedback", "--plain")
    with serving(tmp_path, "--speed", "2") as server:
        sender = server.start(*goal)
        first_lines(sender, "Feedback:")
        student = start_python(tmp_path, "student.py", server.at)
        try:
            first_lines(student, "serving")
            out, _ = sender.communicate(timeout=PATIENCE)
            assert (sender.returncode, "    - 8\n\nGoal finished" in out) == (0, True)
            status, out, _ = server.run(*goal)
            assert (status, "    - 7\n\nGoal finished" in out) == (0, True)
        finally:
            student.kill()
        assert student.communicate(timeout=PATIENCE) == ("", "")
        _, _, err = server.end(signal.SIGTERM)
    note = "/fibonacci is served by /student now: the built-in action withdraws\n"
    assert err.count(note) == 1


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, -15)])
def test_a_signal_ends_a_server_that_is_not_ready(tmp_path, number, status):
    (tmp_path / "servedslow.py").write_text(
        "import time; print('slow', flush=True); time.sleep(60)"
    )
    process = start(tmp_path, "serve", "servedslow", "--no-sim")
    assert process.stdout is not None
    assert process.stdout.readline() == "slow\n"
    process.send_signal(number)
    assert ended(process) == (status, "", "turtleact: interrupted\n" * (status == 130))


def test_a_signal_ends_a_server_that_waits_for_another(served, lab):
    standby = start(lab, "serve", "servedlab", "--no-sim", "--wait", "--connect", served.at)
    assert standby.stderr is not None
    standby.stderr.readline()
    standby.send_signal(signal.SIGINT)
    status, out, _ = ended(standby)
    assert (status, out) == (0, "")


def follow_to_the_end(
    client: ClientConnection, goals: dict[str, int], end: Callable[[], None]
) -> tuple[dict[str, tuple[str, str]], dict[str, tuple[bool, int]]]:
    """Send goals and watch them as a page does. Once they run, end their server.

    Gives the last news of each action's goal, and the results that a client of rosbridge gets.
    """
    seen: dict[str, tuple[str, str]] = {}
    results: dict[str, tuple[bool, int]] = {}
    place: dict[str, object] = {}
    is_ending = False
    with suppress(websockets.ConnectionClosedOK):
        while True:
            asked = {"op": "call_service", "service": "/turtleact/web/watch", "args": place}
            client.send(json.dumps(asked))
            while (heard := json.loads(client.recv(PATIENCE)))["op"] != "service_response":
                results[heard["id"]] = (heard["result"], heard["status"])
            news = heard["values"]
            if not place:
                for action, order in goals.items():
                    sent: dict[str, object] = {"op": "send_action_goal", "action": action}
                    sent |= {"action_type": Fibonacci.type_name, "id": action}
                    sent |= {"args": {"order": order}}
                    client.send(json.dumps(sent))
            place = {"session": news["session"], "since": news["revision"]}
            seen |= {each["action"]: (each["status"], each["reason"]) for each in news["goals"]}
            if not is_ending and list(seen.values()) == [("EXECUTING", "")] * len(goals):
                is_ending = True
                end()
    return seen, results


def test_web_clients_are_told_how_goals_end_when_the_server_ends(lab):
    goals = {"/endless": 1, "/fibonacci": 40}  # of the user's actions, and of the built-in ones
    with serving(lab, "servedlab", "--web", "0") as server:
        url = server.ready.split()[-1].replace("http", "ws")
        with connect(url) as client:
            end = partial(server.process.send_signal, signal.SIGTERM)
            seen, results = follow_to_the_end(client, goals, end)
    assert seen == dict.fromkeys(goals, ("ABORTED", "shutdown"))
    assert results == dict.fromkeys(goals, (True, GoalStatus.ABORTED))


def test_names_and_origins_are_let_in_by_the_page(lab):
    options = ["--allow-host", "Robot.local", "--allow-origin", "null,https://example.com/"]
    with serving(lab, "servedlab", "--no-sim", "--web", "0", *options) as server:
        url = server.ready.split()[-1]
        for origin in ("https://example.com", "null"):
            headers = {"Host": "robot.local:9090", "Origin": origin}
            with urllib.request.urlopen(urllib.request.Request(url, None, headers)) as page:
                assert page.status == 200
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(urllib.request.Request(url, None, {"Host": "evil.example"}))


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Wait for its end: exit status, stdout, stderr."""
    try:
        out, err = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    return process.returncode, out, err


def test_a_page_without_its_port_names_the_option_of_the_command_line(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        at = "127.0.0.1:{1}".format(*taken.getsockname())
        serve = start(tmp_path, "serve", "--no-sim", "--listen", free_endpoint(), "--web", at)
        status, out, err = ended(serve)
    assert (status, out) == (1, "")
    assert err.startswith(f"turtleact: --web: {at} cannot be bound: ")


def test_a_second_world_is_not_put_on_the_graph_of_the_first(tmp_path):
    with serving(tmp_path) as server:
        status, out, err = server.run("serve")
    assert (status, out) == (1, "")
    assert err == (
        f"turtleact: there is a world already in domain 0 at {server.at}: give another --domain, "
        "or --no-sim to serve your own actions beside it\n"
    )


def test_a_goal_of_two_types_of_one_name_is_canceled(tmp_path):
    with serving(tmp_path) as server:
        status, out, err = server.run(
            "send-goal", "fibonacci", "order: 40", "--timeout", "0.1", "--plain"
        )
    assert (status, out.endswith("status: CANCELED\n")) == (124, True)
    assert err == "turtleact: no result after 0.1 s\n"


def test_a_second_signal_ends_a_server_whose_body_does_not_end(tmp_path):
    (tmp_path / "stubborn.py").write_text(STUBBORN)
    with serving(tmp_path, "stubborn", "--no-sim") as server:
        server.run("send-goal", "stubborn", "--timeout", "0")
        server.process.send_signal(signal.SIGTERM)
        said = server.process.stderr
        assert said is not None
        assert "no more goals are accepted" in said.readline()
        server.process.send_signal(signal.SIGINT)
        assert server.process.wait(PATIENCE) == 0
