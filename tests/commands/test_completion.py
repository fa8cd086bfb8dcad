"""What the Tab key offers, as a shell asks Typer for it."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from turtleact import open_world
from turtleact.commands import VERBS, app, completion, graph
from turtleact.errors import TurtleactError
from turtleact.interfaces import get_interface, type_hash
from turtleact.testing import run
from turtleact.transports import QoS
from turtleact.transports.base import Endpoint, EndpointKind
from turtleact.transports.rmw_zenoh import session
from turtleact.transports.rmw_zenoh.wire import Graph, endpoint_token, node_token

from ..registry import isolated_registry

ON_THE_GRAPH: list[tuple[EndpointKind, str, str]] = [
    ("publisher", "/turtle1/pose", "turtlesim/msg/Pose"),
    ("subscription", "/turtle1/cmd_vel", "geometry_msgs/msg/Twist"),
    ("service", "/spawn", "turtlesim/srv/Spawn"),
    ("service", "/count/_action/send_goal", "example_interfaces/action/Fibonacci_SendGoal"),
    ("publisher", "/count/_action/status", "action_msgs/msg/GoalStatusArray"),
]
SPAWN = ["service", "call", "/spawn", "turtlesim/srv/Spawn"]


@pytest.fixture
def there(monkeypatch):
    """A graph that answers, and notes whom it was asked of."""
    asked = []

    def look(*where):
        asked.append(where)
        found = Graph("us")
        for number, name in enumerate(("/turtlesim", "/_hidden")):
            found.add(node_token(0, "them", number, name))
        for number, (kind, name, type_name) in enumerate(ON_THE_GRAPH, 2):
            known = type_hash(get_interface(type_name))
            endpoint = Endpoint(kind, name, type_name, "/turtlesim", QoS(), type_hash=known)
            found.add(endpoint_token(0, "them", 0, number, endpoint))
        return found

    monkeypatch.setattr(session, "census", look)
    return asked


@pytest.fixture
def nowhere(monkeypatch):

    def look(*where):
        raise TurtleactError("no ROS 2 graph in reach")

    monkeypatch.setattr(session, "census", look)


def asked_by(shell, *words):
    """The environment in which a shell asks what may stand in the place of the last word."""
    line = shlex.join(["turtleact", *words[:-1]]) + f" {words[-1]}"
    return {
        "_TURTLEACT_COMPLETE": f"complete_{shell}",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words)),
        "_TYPER_COMPLETE_ARGS": line,
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
    }


@pytest.fixture
def offered(monkeypatch, capsys):
    """What a shell is told for the last word of a line."""

    def tab(*words, shell="bash"):
        for name, value in asked_by(shell, *words).items():
            monkeypatch.setenv(name, value)
        assert app.run(()) == 0
        out, err = capsys.readouterr()
        assert err == ""
        return out.splitlines()

    return tab


@pytest.fixture
def completed(offered):
    return lambda *words: [line for line in offered(*words) if line]


# --- verbs and options ----------------------------------------------------------------------


def test_verbs_are_completed_and_told_of(offered):
    assert offered("se", shell="fish") == [
        f"{verb}\t{VERBS[verb]}" for verb in ("send-goal", "serve", "service")
    ]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--sh"], ["--show-completion"]),
        (["topic", "h"], ["hz"]),
        (["action", "send"], ["send_goal"]),
        (["topic", "echo", "--qos-d"], ["--qos-durability", "--qos-depth"]),
        (["serve", "--no"], ["--node-name", "--no-sim", "--no-learn"]),
        (["serve", "--placing", ""], ["random", "grid", "ring"]),
        (["topic", "echo", "/x", "--qos-durability", "v"], ["volatile"]),
        (["topic", "echo", "/x", "--qos-profile", "se"], ["sensor_data", "services_default"]),
        (["send-goal", "x", "--speed", ""], ["max"]),
        (["run", "turtlesim", "turtle_"], ["turtle_teleop_key"]),
        (["topic", "echo", "/x", "--timeout", ""], []),
        (["nonsense", "se"], ["send-goal", "serve", "service"]),
    ],
)
def test_what_typer_knows_is_completed(completed, words, expected):
    assert completed(*words) == expected


@pytest.fixture
def yard(tmp_path, monkeypatch):
    """A working directory with a package that has an action and an executable."""
    (tmp_path / "yard" / "action").mkdir(parents=True)
    (tmp_path / "yard" / "action" / "Go.action").write_text("int32 far\n---\n---\n")
    (tmp_path / "yard" / "pyproject.toml").write_text("[project.scripts]\ngo = 'yard.go:main'\n")
    (tmp_path / "yell.py").touch()
    monkeypatch.chdir(tmp_path)
    with isolated_registry():
        yield


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["run", "y"], ["yard", "yell.py"]),
        (["run", "yard", ""], ["go"]),
        (["interface", "show", "yard"], ["yard/action/Go"]),
        (["topic", "pub", "/x", "yard/action/Go", "{"], ["{far: 0}"]),
    ],
)
def test_packages_of_the_working_directory_are_completed_silently(yard, completed, words, expected):
    assert completed(*words) == expected


# --- the graph ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["send-goal", ""], ["/count"]),
        (["action", "send_goal", "cou"], ["count"]),
        (["goals", ""], ["/count"]),
        (["cancel", "--all", ""], ["/count"]),
        (["topic", "echo", "/"], ["/turtle1/cmd_vel", "/turtle1/pose"]),
        (["service", "call", ""], ["/spawn"]),
        (["node", "info", ""], ["/turtlesim"]),
        (["param", "get", "tu"], ["turtlesim"]),
        (["send-goal", "/count", ""], ["example_interfaces/action/Fibonacci"]),
        (["topic", "pub", "/turtle1/cmd_vel", ""], ["geometry_msgs/msg/Twist"]),
    ],
)
def test_names_and_their_types_come_from_the_graph(there, completed, words, expected):
    assert completed(*words) == expected


def test_the_graph_is_the_one_that_the_line_means(there, completed):
    completed("topic", "info", "--connect", "tcp/robot:1", "--domain", "5", "")
    assert [where[:2] for where in there] == [(("tcp/robot:1",), 5)]


def test_ids_of_goals_are_completed_and_told_of(graphs, monkeypatch, offered, completed):
    monkeypatch.setattr(graph, "open_transport", graphs.open_graph(graphs.goals))
    assert offered("watch", "71a9", shell="fish")[0] == f"{graphs.IDS['later']}\t/hold EXECUTING"
    assert completed("watch", "71a9") == [graphs.IDS["later"], graphs.IDS["hold"]]
    assert completed("cancel", graphs.IDS["hold"], "fbd") == [graphs.IDS["fail"]]


def test_parameters_of_a_node_are_completed(completed, graphs, monkeypatch):
    monkeypatch.setattr(graph, "open_transport", graphs.open_graph(graphs.parameters))
    assert completed("param", "set", "/turtlesim", "h") == ["holonomic"]
    assert completed("param", "describe", "turtlesim", "holonomic", "background_r") == [
        "background_r"
    ]


# --- without a graph ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["send-goal", "/c"], ["/command_turtle"]),
        (["send-goal", "/patrol", ""], ["turtleact_interfaces/action/Patrol"]),
        (["topic", "echo", ""], []),
        (["send-goal", "x", "turtlesim/"], ["turtlesim/action/RotateAbsolute"]),
    ],
)
@pytest.mark.usefixtures("nowhere")
def test_without_a_graph_there_is_what_ships(completed, words, expected):
    assert completed(*words) == expected


@pytest.mark.parametrize("option", [["--embedded"], ["--speed", "2"], ["--seed", "1"]])
def test_an_embedded_world_is_asked_of_nobody(there, completed, option):
    assert completed("send-goal", *option, "/fib") == ["/fibonacci"]
    assert there == []


def test_the_embedded_world_is_as_it_is_told():
    async def look():
        async with open_world(speed="max") as node:
            return {name: tuple(sorted(types)) for name, types in node.graph().actions.items()}

    assert run(look) == completion.EMBEDDED


# --- messages, interfaces, modules ----------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["action", "send_goal", "/f", "action_tutorials_interfaces/action/Fibonacci"], "order: 0"),
        (SPAWN, "x: 0.0, y: 0.0, theta: 0.0, name: ''"),
        (
            ["topic", "pub", "/x", "geometry_msgs/msg/Twist"],
            "linear: {x: 0.0, y: 0.0, z: 0.0}, angular: {x: 0.0, y: 0.0, z: 0.0}",
        ),
    ],
)  # fmt: skip
def test_a_message_to_begin_with_is_on_one_line(completed, words, expected):
    assert completed(*words, "") == [f'"{{{expected}}}"']


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_shells_that_quote_for_themselves_get_a_message_without_quotes(offered, shell):
    words = ["action", "send_goal", "/f", "action_tutorials_interfaces/action/Fibonacci", ""]
    assert "{order" in offered(*words, shell=shell)[0]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["interface", "show", "std_srvs/srv/T"], ["std_srvs/srv/Trigger"]),
        (["interface", "package", "std_s"], ["std_srvs"]),
        (["action", "find", "example_interfaces"], ["example_interfaces/action/Fibonacci"]),
    ],
)
def test_interfaces_and_packages_are_completed(completed, words, expected):
    assert completed(*words) == expected


def test_modules_and_files_are_targets(completed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("robot").mkdir()
    for name in ("lab.py", "lab-2.py", "robot/__init__.py"):
        Path(name).write_text("raise SystemExit('nothing is imported')\n")
    assert completed("serve", "") == ["lab-2.py", "lab"]
    assert completed("serve", "lab.") == ["lab.py"]
    assert completed("serve", "./l") == ["./lab-2.py", "./lab.py"]
    assert completed("serve", "robot/") == ["robot/__init__.py"]


# --- to the shell and back ------------------------------------------------------------------


def tab_in_a_process(*words, code="pass"):
    """What a process prints, on both outputs, that a shell starts for the last word of a line."""
    program = f"import sys; from turtleact import cli; {code}; cli.main()"
    return subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
        env=os.environ | asked_by("bash", *words),
    )


@pytest.mark.parametrize(
    "words",
    [
        ["topic", "info", "--connect", "many", ""],
        ["topic", "pub", "/x", "no_such/msg/Type", ""],
        ["param", "get", "--config", "no_such_file", "/n", ""],
    ],
)
def test_what_cannot_be_completed_is_silent(words):
    ran = tab_in_a_process(*words)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "", "")


def test_a_graph_that_does_not_answer_is_not_waited_for():
    code = (
        "import time; from turtleact.transports.rmw_zenoh import session;"
        "cli.PATIENCE = 0.1; session.census = lambda *where: time.sleep(60)"
    )
    ran = tab_in_a_process("topic", "info", "", code=code)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "", "")


@pytest.fixture
def program(tmp_path):
    """A folder with the program ``turtleact``, which may take its time to complete."""
    path = tmp_path / "turtleact"
    path.write_text(
        f"#!{sys.executable}\nfrom turtleact import cli\ncli.PATIENCE = 60.0\ncli.main()\n"
    )
    path.chmod(0o755)
    return path.parent


def test_bash_completes_by_typers_script_an_alias_too(program):
    [recipe] = [
        line
        for line in (Path(__file__).parents[2] / "docs" / "cli.md").read_text().splitlines()
        if line.startswith("_ros2_completion")
    ]
    script = (
        'eval "$(_TURTLEACT_COMPLETE=source_bash turtleact)"\n'
        f"{recipe}\n"
        "complete -F _ros2_completion ros2\n"
        'COMP_WORDS=(ros2 action send_goal /fibonacci "$1" ""); COMP_CWORD=5\n'
        "_ros2_completion ros2\n"
        'printf "<%s>\\n" "${COMPREPLY[@]}"\n'
        "COMP_WORDS=(turtleact topic h); COMP_CWORD=2\n"
        "_turtleact_completion turtleact\n"
        'printf "<%s>\\n" "${COMPREPLY[@]}"\n'
    )
    ran = subprocess.run(
        ["bash", "--norc", "-c", script, "bash", "action_tutorials_interfaces/action/Fibonacci"],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PATH": f"{program}:{os.environ['PATH']}"},
    )
    assert (ran.stdout, ran.stderr) == ('<"{order: 0}">\n<hz>\n', "")
