"""What may stand where the cursor is."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from shutil import which

import pytest

from turtleact import cli
from turtleact.app import open_world
from turtleact.commands import OPTIONS, VERBS, candidates, completion, graph, shells
from turtleact.commands.completion import complete, lines
from turtleact.errors import TurtleactError
from turtleact.interfaces import get_interface, type_hash
from turtleact.testing import run
from turtleact.transports import QoS
from turtleact.transports.base import Endpoint, EndpointKind
from turtleact.transports.rmw_zenoh.keys import Graph, endpoint_token, node_token

ON_THE_GRAPH: list[tuple[EndpointKind, str, str]] = [
    ("publisher", "/turtle1/pose", "turtlesim/msg/Pose"),
    ("subscription", "/turtle1/cmd_vel", "geometry_msgs/msg/Twist"),
    ("service", "/spawn", "turtlesim/srv/Spawn"),
    ("service", "/count/_action/send_goal", "example_interfaces/action/Fibonacci_SendGoal"),
    ("publisher", "/count/_action/status", "action_msgs/msg/GoalStatusArray"),
]
SPAWN = ["service", "call", "/spawn", "turtlesim/srv/Spawn"]
EMPTY_IN_QUOTES = "{x: 0.0, y: 0.0, theta: 0.0, name: QQ}".replace("Q", r"'\''")


@pytest.fixture
def there(monkeypatch):
    """A graph that answers, and notes whom it was asked of."""
    asked = []

    def census(where):
        asked.append(where)
        found = Graph("us")
        for number, name in enumerate(("/turtlesim", "/_hidden")):
            found.add(node_token(0, "them", number, name))
        for number, (kind, name, type_name) in enumerate(ON_THE_GRAPH, 2):
            known = type_hash(get_interface(type_name))
            endpoint = Endpoint(kind, name, type_name, "/turtlesim", QoS(), type_hash=known)
            found.add(endpoint_token(0, "them", 0, number, endpoint))
        return found

    monkeypatch.setattr(candidates, "_census", census)
    return asked


@pytest.fixture
def patient(monkeypatch):
    """A completion that may take its time; its deadline would end the tests, and with success."""
    monkeypatch.setattr(completion, "PATIENCE", 60.0)


@pytest.fixture
def nowhere(monkeypatch):
    """No graph in reach."""

    def census(where):
        raise TurtleactError("no ROS 2 graph in reach")

    monkeypatch.setattr(candidates, "_census", census)


def completed(*words):
    """What may stand in the place of the last word."""
    return [value for value, _ in completion.candidates(words[:-1], words[-1])]


# --- verbs and options ----------------------------------------------------------------------


def test_verbs_are_completed_and_told_of():
    assert [*completion.candidates([], "se")] == [
        (verb, VERBS[verb]) for verb in ("send-goal", "serve", "service")
    ]


def test_options_are_completed_and_told_of():
    assert [*completion.candidates([], "--")] == [
        (option.removeprefix("-h, "), about) for option, about in OPTIONS.items()
    ]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--sh"], ["--show-completion"]),
        (["topic", "h"], ["hz"]),
        (["action", "send"], ["send_goal"]),
        (["topic", "echo", "--qos-d"], ["--qos-durability", "--qos-depth"]),
        (["serve", "--no"], ["--no-sim"]),
        (["topic", "echo", "/x", "--qos-durability", "v"], ["volatile"]),
        (["topic", "echo", "/x", "--qos-reliability", ""], ["reliable", "best_effort"]),
        (["topic", "echo", "/x", "--qos-profile", "se"], ["sensor_data", "services_default"]),
        (["topic", "pub", "/x", "--qos-profile", "b"], ["best_available"]),
        (["send-goal", "x", "--speed", ""], ["max"]),
        (["topic", "echo", "/x", "--timeout", ""], []),
        (["nonsense", ""], list(VERBS)),
    ],
)
def test_what_typer_knows_is_completed(words, expected):
    assert completed(*words) == expected


# --- the graph ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["send-goal", ""], ["/count"]),
        (["action", "info", "/c"], ["/count"]),
        (["action", "send_goal", "cou"], ["count"]),
        (["goals", ""], ["/count"]),
        (["cancel", "--all", ""], ["/count"]),
        (["topic", "echo", "/"], ["/turtle1/cmd_vel", "/turtle1/pose"]),
        (["topic", "pub", "turtle1/c"], ["turtle1/cmd_vel"]),
        (["service", "call", ""], ["/spawn"]),
        (["node", "info", ""], ["/turtlesim"]),
        (["param", "get", "tu"], ["turtlesim"]),
        (["send-goal", "/count", ""], ["example_interfaces/action/Fibonacci"]),
        (["send-goal", "count", "ex"], ["example_interfaces/action/Fibonacci"]),
        (["topic", "pub", "/turtle1/cmd_vel", ""], ["geometry_msgs/msg/Twist"]),
        (["service", "call", "/spawn", "--rate", "1", ""], ["turtlesim/srv/Spawn"]),
    ],
)
def test_names_and_their_types_come_from_the_graph(there, words, expected):
    assert completed(*words) == expected


def test_the_graph_is_the_one_that_the_line_means(there):
    completed("topic", "info", "--connect", "tcp/robot:1", "--domain", "5", "")
    assert there == [(("tcp/robot:1",), 5, None)]


def test_ids_of_goals_are_completed_and_told_of(interrupts, graphs, monkeypatch):
    interrupts.install()
    monkeypatch.setattr(graph, "open_transport", graphs.open_graph(graphs.goals))
    [first, *_] = found = [*completion.candidates(["watch"], "71a9")]
    assert first == (graphs.IDS["later"], "/hold EXECUTING")
    assert [value for value, _ in found] == [graphs.IDS["later"], graphs.IDS["hold"]]
    assert completed("cancel", graphs.IDS["hold"], "fbd") == [graphs.IDS["fail"]]


def test_parameters_of_a_node_are_completed(graphs, monkeypatch):
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
        (["topic", "echo", "/x", "turtlesim/msg/P"], ["turtlesim/msg/Pose"]),
        (["send-goal", "x", "turtlesim/"], ["turtlesim/action/RotateAbsolute"]),
    ],
)
@pytest.mark.usefixtures("nowhere")
def test_without_a_graph_there_is_what_ships(words, expected):
    assert completed(*words) == expected


@pytest.mark.parametrize("option", [["--embedded"], ["--speed", "2"], ["--seed", "1"]])
def test_an_embedded_world_is_asked_of_nobody(there, option):
    assert completed("send-goal", *option, "/fib") == ["/fibonacci"]
    assert there == []


@pytest.mark.usefixtures("nowhere")
def test_a_graph_that_is_said_and_is_not_there_has_no_names():
    assert completed("send-goal", "--connect", "tcp/robot:1", "") == []


def test_the_embedded_world_is_as_it_is_told():
    async def look():
        async with open_world(speed="max") as node:
            return {name: tuple(sorted(types)) for name, types in node.graph().actions.items()}

    assert run(look) == candidates.EMBEDDED


# --- messages, interfaces, modules ----------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["action", "send_goal", "/f", "action_tutorials_interfaces/action/Fibonacci"], "order: 0"),
        (["send-goal", "x", "patrol_interfaces/action/PatrolCommandInterface"], "targets: []"),
        (SPAWN, "x: 0.0, y: 0.0, theta: 0.0, name: ''"),
        (["service", "call", "/clear", "std_srvs/srv/Empty"], ""),
        (
            ["topic", "pub", "/x", "geometry_msgs/msg/Twist"],
            "linear: {x: 0.0, y: 0.0, z: 0.0}, angular: {x: 0.0, y: 0.0, z: 0.0}",
        ),
    ],
)  # fmt: skip
def test_a_message_to_begin_with_is_on_one_line(words, expected):
    assert completed(*words, "") == [f"{{{expected}}}"]


def test_a_message_of_our_own_interfaces_is_found():
    [goal] = completed("send-goal", "/go_to", "turtleact_interfaces/action/GoTo", "{")
    assert "x: 0.0, y: 0.0" in goal


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["interface", "show", "std_srvs/srv/T"], ["std_srvs/srv/Trigger"]),
        (["interface", "proto", "turtlesim/action/"], ["turtlesim/action/RotateAbsolute"]),
        (["interface", "package", "std_s"], ["std_srvs"]),
        (["action", "find", "example_interfaces"], ["example_interfaces/action/Fibonacci"]),
        (["topic", "find", "turtlesim/msg/C"], ["turtlesim/msg/Color"]),
    ],
)
def test_interfaces_and_packages_are_completed(words, expected):
    assert completed(*words) == expected


def test_interfaces_of_a_folder_are_known(tmp_path):
    file = tmp_path / "completed_interfaces" / "action" / "Do.action"
    file.parent.mkdir(parents=True)
    file.write_text("string what\n---\n---\n")
    words = ["send-goal", "x", "--interfaces", str(tmp_path), "completed_interfaces/action/Do"]
    assert completed(*words) == ["completed_interfaces/action/Do"]
    assert completed(*words, "") == ["{what: ''}"]


LAB = """
import turtleact
from lab_bodies import action

@turtleact.action(Count, "count")
async def count(goal): ...

@action(Count, "hold")
async def hold(goal): ...

@cached
def other(): ...

raise SystemExit("nothing is imported")
"""


def test_modules_and_their_actions_are_targets(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("lab.py").write_text(LAB)
    Path("lab_bodies.py").write_text("import os\n")
    Path("not-a-module.py").write_text("import turtleact\n")
    Path("robot").mkdir()
    Path("robot/__init__.py").write_text(LAB)
    assert completed("serve", "") == ["lab"]
    assert completed("serve", "lab:") == ["lab:count", "lab:hold"]
    assert completed("serve", "lab:count", "robot:h") == ["robot:hold"]


# --- to the shell and back ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shell", "words", "expected"),
    [
        ("bash", ["turtleact", "se"], ["send-goal", "serve", "service"]),
        ("fish", ["turtleact", "top"], [f"topic\t{VERBS['topic']}"]),
        ("zsh", ["ros2", "top"], [f"topic\t{VERBS['topic']}"]),
        ("bash", ["x", *SPAWN, ""], ["\"{x: 0.0, y: 0.0, theta: 0.0, name: ''}\""]),
        ("bash", ["x", *SPAWN, '"{x'], ["{x: 0.0, y: 0.0, theta: 0.0, name: ''}"]),
        ("bash", ["x", *SPAWN, "'"], [EMPTY_IN_QUOTES]),
        ("zsh", ["x", *SPAWN, '"{x'], ["{x: 0.0, y: 0.0, theta: 0.0, name: ''}"]),
        ("zsh", ["x", *SPAWN, "\\{x:\\ 0"], ["{x: 0.0, y: 0.0, theta: 0.0, name: ''}"]),
        ("fish", ["x", *SPAWN, "{x"], ["{x: 0.0, y: 0.0, theta: 0.0, name: ''}"]),
        ("bash", ["x", "serve", "lab", ":", "co"], ["count"]),
        ("bash", ["x", "serve", "lab", ":"], ["count", "hold"]),
        ("bash", ["x", "topic", "echo", "--qos-durability", "=", "v"], ["volatile"]),
        ("zsh", ["x", "topic", "echo", "--qos-durability=v"], ["volatile"]),
    ],
)
def test_a_shell_is_told_in_its_own_way(tmp_path, monkeypatch, shell, words, expected):
    monkeypatch.chdir(tmp_path)
    Path("lab.py").write_text(LAB)
    assert [*lines(shell, words)][: len(expected)] == expected


def test_bash_is_told_what_it_would_expand_in_quotes():
    assert completion._for_bash('a "$b" `c` \\', "a") == r'"a \"\$b\" \`c\` \\"'
    assert completion._for_bash('a "$b"', '"') == r"a \"\$b\""


@pytest.mark.parametrize(
    "words",
    [
        ["x", "topic", "info", "--domain", "many", ""],
        ["x", "topic", "pub", "/x", "no_such/msg/Type", ""],
        ["x", "serve", "no_such_module:"],
        ["x", "param", "get", "--config", "no_such_file", "/n", ""],
    ],
)
@pytest.mark.usefixtures("nowhere", "patient")
def test_what_cannot_be_completed_is_silent(capsys, words):
    assert complete("bash", words) == 0
    assert capsys.readouterr() == ("", "")


def test_a_graph_that_does_not_answer_is_not_waited_for():
    code = (
        "import time; from turtleact.commands import completion, candidates;"
        "completion.PATIENCE = 0.1; candidates._census = lambda where: time.sleep(60);"
        "completion.complete('bash', ['turtleact', 'topic', 'info', ''])"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=30, check=False)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, b"", b"")


@pytest.mark.parametrize(
    ("words", "needs"),
    [
        (["", "se"], []),
        (["", "topic", "info", "--connect", "tcp/127.0.0.1:1", ""], ["typer", "zenoh"]),
        (["", *SPAWN, ""], ["typer", "yaml"]),
    ],
)
def test_a_tab_imports_no_more_than_it_needs(words, needs):
    heavy = {"anyio", "asyncio", "numpy", "pydantic", "rich", "typer", "yaml", "zenoh"}
    code = (
        f"import sys; from turtleact.commands import completion; completion.PATIENCE = 60.0;"
        f"completion.complete('bash', {words}); print(*sorted({heavy} & {{*sys.modules}}))"
    )
    out = subprocess.check_output([sys.executable, "-c", code], text=True)
    assert out.splitlines()[-1].split() == needs


# --- scripts --------------------------------------------------------------------------------


def test_bash_completes_by_the_script_an_alias_too(tmp_path):
    script = (
        'eval "$(turtleact --show-completion bash)"\n'
        "complete -o default -F _turtleact_completion ros2\n"
        "complete -p turtleact ros2\n"
        'COMP_WORDS=(ros2 action send_goal /fibonacci "$1" ""); COMP_CWORD=5\n'
        "_turtleact_completion ros2\n"
        'printf "<%s>\\n" "${COMPREPLY[@]}"\n'
        "COMP_WORDS=(turtleact topic h); COMP_CWORD=2\n"
        f"_turtleact_completion {tmp_path}/turtleact\n"
        'printf "<%s>\\n" "${COMPREPLY[@]}"\n'
    )
    program = tmp_path / "turtleact"
    program.write_text(
        f"#!{sys.executable}\n"
        "from turtleact import cli\n"
        "from turtleact.commands import completion\n"
        "completion.PATIENCE = 60.0\n"
        "cli.main()\n"
    )
    program.chmod(0o755)
    ran = subprocess.run(
        ["bash", "--norc", "-c", script, "bash", "action_tutorials_interfaces/action/Fibonacci"],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"},
    )
    assert ran.stderr == ""
    assert ran.stdout == (
        "complete -o default -F _turtleact_completion turtleact\n"
        "complete -o default -F _turtleact_completion ros2\n"
        '<"{order: 0}">\n'
        "<hz>\n"
    )


@pytest.mark.parametrize(
    "shell",
    [
        pytest.param(each, marks=pytest.mark.skipif(not which(each), reason=f"{each} is not there"))
        for each in shells.SCRIPTS
    ],
)
def test_a_shell_can_read_its_script(shell):
    ran = subprocess.run(
        [shell, "-n"], input=shells.SCRIPTS[shell], capture_output=True, text=True, check=False
    )
    assert (ran.returncode, ran.stderr) == (0, "")


@pytest.mark.parametrize("shell", [*shells.SCRIPTS, "/bin/zsh"])
def test_the_script_of_a_shell_is_shown(turtleact, shell):
    shown = turtleact("--show-completion", shell)
    assert shown.out == shells.SCRIPTS[Path(shell).name]
    assert "_TURTLEACT_COMPLETE" in shown.out


def test_the_shell_is_that_of_the_user(turtleact, monkeypatch):
    monkeypatch.setenv("SHELL", "/usr/bin/fish")
    assert turtleact("--show-completion").out == shells.SCRIPTS["fish"]


def test_a_shell_that_is_not_known_is_a_usage_error(turtleact, monkeypatch):
    monkeypatch.delenv("SHELL", raising=False)
    assert turtleact("--install-completion") == (
        2,
        "",
        "turtleact: completion is for bash or zsh or fish, not '': give one of them\n",
    )


@pytest.mark.parametrize(
    ("shell", "place", "read_by"),
    [
        ("bash", ".bash_completions/turtleact.sh", ".bashrc"),
        ("zsh", ".zfunc/_turtleact", ".zshrc"),
        ("fish", ".config/fish/completions/turtleact.fish", None),
    ],
)
def test_completion_is_installed_once(turtleact, tmp_path, monkeypatch, shell, place, read_by):
    monkeypatch.setenv("HOME", str(tmp_path))
    if read_by:
        (tmp_path / read_by).write_text("alias ll='ls -l'")
    for _ in range(2):
        ran = turtleact("--install-completion", shell)
        assert ran.out == (
            f"{shell} completes turtleact as {tmp_path / place} says, from the next terminal on\n"
        )
    assert (tmp_path / place).read_text() == shells.SCRIPTS[shell]
    if read_by:
        [first, second] = (tmp_path / read_by).read_text().splitlines()
        assert first == "alias ll='ls -l'"
        assert str(tmp_path / place) in second or "fpath+=~/.zfunc" in second


def test_a_place_that_cannot_be_written_is_told(turtleact, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / ".zshrc").mkdir()
    assert turtleact("--install-completion", "zsh") == (
        1,
        "",
        f"turtleact: {tmp_path / '.zshrc'} cannot be written: Is a directory; "
        "--show-completion prints what is to stand there\n",
    )


@pytest.mark.usefixtures("patient", "handlers")
def test_main_completes_before_anything_else(monkeypatch, capsys):
    def leave(status):
        raise SystemExit(status)

    monkeypatch.setenv("_TURTLEACT_COMPLETE", "bash")
    monkeypatch.setattr(sys, "argv", ["turtleact", "turtleact", "inter"])
    monkeypatch.setattr("turtleact.commands.interrupts.leave", leave)
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert (left.value.code, capsys.readouterr().out) == (0, "interface\n")
