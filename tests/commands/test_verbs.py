"""Command lines as Typer reads them: what is refused, and what they order."""

from __future__ import annotations

import re

import pytest

from turtleact.commands import GROUPS, VERBS, app, send_goal, serving
from turtleact.commands.goals import moment
from turtleact.commands.settings import ConnectOptions, Fleet
from turtleact.errors import UsageError

from ..tables import together

USAGE = [
    (["send-goal"], "Missing argument 'NAME'"),
    (["send-goal", "x", "--fedback"], "No such option: --fedback .*--feedback"),
    (["send-goal", "x", "--timeout"], "requires an argument"),
    (
        ["send-goal", "x", "-t", "abc"],
        "'--timeout' / '-t': 'abc' is not a number of seconds, 0 or more",
    ),
    (
        ["send-goal", "x", "--speed", "0"],
        "'--speed': '0' is not a factor above 0 and at most 100, or max",
    ),
    (["send-goal", "x", "--seed", "-1"], "'-1' is not a whole number, 0 or more, of 18 digits"),
    (["send-goal", "x", "a/b", "1", "-5"], r"unexpected extra argument.*\(-5\)"),
    (
        ["send-goal", "x", "order:", "5"],
        "the shell splits the goal at its spaces. Quote it: 'order: 5'",
    ),
    (
        ["action", "send_goal", "-f", "x", "a/b", "{order:", "5}", "--plain"],
        "Quote it: '{order: 5}'",
    ),
    (["send-goal", "x", "order", "5"], "write the goal as one argument in quotes"),
    (["send-goal", "x", "--stdin", "--goal-file", "f"], "the goal is given twice"),
    (["send-goal", "x", "--json", "--plain"], "give one of --json and --plain"),
    (["send_goal", "x"], "No such command 'send_goal'. Did you mean 'send-goal'?"),
    (["goal"], "No such command 'goal'. Did you mean 'goals', 'send-goal'?"),
    (
        ["echo", "/x"],
        "No such command 'echo'. Did you mean 'action echo' or 'topic echo' or 'service echo'?",
    ),
    (["--frobnicate"], "No such option: --frobnicate"),
    (["serve", "--listen", "tcp/127.0.0.1:99999"], "--listen takes an endpoint such as"),
    (["serve", "--turtles", "10001"], "'--turtles': Input should be less than or equal to 10000"),
    (["topic", "list", "--connect", "tcp/[::1"], r"such as tcp/\[::1\]:7447, not 'tcp/\[::1'"),
    (["serve", "--web", "localhost:99999"], "the port of --web is a whole number, 0 to 65535"),
    (["serve", "--token", "x"], "--token, --allow-host and --allow-origin need --web"),
    (
        ["serve", "--web", "0", "--allow-origin", "example.com"],
        "--allow-origin takes an origin such as https://example.com, not 'example.com'",
    ),
    (["serve", "--placing", "row"], "'--placing': .*'row' is not one of 'random', 'grid', 'ring'"),
    (
        ["serve", "--no-sim", "--turtles", "4", "--paused"],
        "--turtles, --paused and --no-sim exclude each other: there is no world",
    ),
    (["serve", "lab", "--node-name", "lab"], "--node-name needs --no-sim: beside a world"),
    (
        ["send-goal", "x", "--speed", "2", "--connect", "tcp/[::1]:1"],
        "give one of --speed and --connect",
    ),
    (
        ["send-goal", "x", "--seed", "2", "--connect", "tcp/[::1]:1"],
        "give one of --seed and --connect",
    ),
    (
        ["send-goal", "x", "--embedded", "--connect", "tcp/[::1]:1"],
        "one of --embedded and --connect",
    ),
    (
        ["send-goal", "x", "-t", "0", "--embedded"],
        "--timeout 0 leaves the goal to a server, and an",
    ),
    (["run"], "what to run is missing: 'turtleact pkg executables' lists what can be run"),
    (
        ["run", "turtlesim"],
        "say which executable of package 'turtlesim' to run: it has turtlesim_n",
    ),
    (["run", "turtlesim", "mimic"], "'turtlesim' has no executable 'mimic': it has turtlesim_node"),
    (["run", "turtlesin", "mimic"], "there is no package 'turtlesin' in the .* mean 'turtlesim'?"),
    (["run", "missing.py"], r"there is no file 'missing\.py'"),
    (
        ["run", "turtlesim", "turtlesim_node", "--ros-args", "--remap", "__node:=my_turtle"],
        "turtlesim_node is built in and takes no '--ros-args': options of 'run' stand before",
    ),
    (
        ["topic", "list", "--domain", "233"],
        "'--domain' .*: '233' is not a ROS domain, 0 to 232",
    ),
    (["topic", "list", "--connect", "tcp/a:1,"], "--connect takes an endpoint .* not ''"),
    (
        ["topic", "echo", "x", "--field", "a..b"],
        r"--field takes names separated by dots, not 'a\.\.b'",
    ),
    (["topic", "echo", "x", "--raw", "--csv"], "give one of --raw, --csv and --flow-style"),
    (
        ["topic", "echo", "x", "-l", "many"],
        "'--truncate-length' / '-l': Input should be a valid integer",
    ),
    (
        ["topic", "echo", "x", "--qos-depth", "0"],
        "'--qos-depth': Input should be greater than or equal to 1",
    ),
    (
        ["topic", "echo", "x", "--qos-durability", "no"],
        "'no' is not one of 'volatile', 'transient_local'",
    ),
    (
        ["topic", "echo", "x", "--qos-profile", "no"],
        "'--qos-profile': .*'no' is not one of .*'sensor_data'",
    ),
    (
        ["topic", "hz", "x", "--window", "0"],
        "'--window' / '-w': Input should be greater than or equal to 1",
    ),
    (
        ["topic", "pub", "x", "a/b", "{}", "-r", "0"],
        "'--rate' / '-r': '0' is not a rate in Hz above zero",
    ),
    (["topic", "echo", "x", "--filter", "m.data >"], "--filter takes .* not 'm.data >': invalid"),
    (["param", "list", "--filter", "("], r"'--filter': '\(' is no regular expression"),
    (["topic", "pub", "x", "a/b", "{}", "-1", "-t", "2"], "give one of --once and --times"),
    (["topic", "pub", "x", "a/b", "{}", "--stdin"], "give one of VALUES and --stdin"),
    (["service", "call", "x", "a/b", "x:", "1"], "Quote it: 'x: 1'"),
    (["service", "call", "x", "a/b", "{}", "--stdin"], "the request is given twice"),
    (["cancel"], "give the ids of goals, or --all"),
    (["cancel", "71a"], "'71a' is not a goal id, which has 32 hexadecimal digits"),
    (["teleop", "bob"], r"unexpected extra argument \(bob\). Did you mean --turtle bob"),
    (["cancel", "--all", "--before", "1"], "give one of --all and --before"),
    (["cancel", "--before", "noon"], "--before takes a time such as .*, not 'noon'"),
    (["watch"], "give the id of a goal, or an action .*'turtleact goals' lists"),
    (["watch", "g g"], "is not a goal id.*'turtleact goals' lists all goals$"),
    (["result"], "give the id of a goal; 'turtleact goals' lists them"),
    (["result", "patrol"], "is not a goal id.*'turtleact goals' lists all goals$"),
    (["action", "send_gaol"], "Did you mean 'send_goal'?"),
]


@together
@pytest.mark.parametrize(("arguments", "problem"), USAGE, ids=lambda each: " ".join(each))
def test_a_command_line_that_makes_no_sense_is_refused(turtleact, arguments, problem):
    ran = turtleact(*arguments)
    assert (ran.status, ran.out) == (2, "")
    assert re.search(problem, ran.problem)


@pytest.mark.parametrize(
    "arguments", [[], ["--fedback"], ["x", "--timeout", "no"], ["x", "{}", "--stdin"]]
)
def test_a_refusal_says_where_there_is_help(turtleact, arguments):
    ran = turtleact("action", "send_goal", *arguments)
    assert "\nTry 'turtleact action send_goal -h' for help.\n" in ran.err


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("lab --no-sim", "lab"),
        ("lab.robot:drive other --no-sim", "robot"),
        ("lab --no-sim --node-name arm", "arm"),
        ("--no-sim", "turtleact"),
        ("lab", "turtleact"),  # beside a world
        ("turtlesim --no-sim", "turtleact"),  # else it would pass for a world
        ("_lab --no-sim", "turtleact"),  # a hidden node
        ("löb --no-sim", "turtleact"),
    ],
)
def test_the_node_of_a_server_without_a_world_has_the_name_of_the_module(monkeypatch, line, name):
    names = []
    monkeypatch.setattr(serving, "run", lambda service: names.append(service.node_name))
    assert app.run(["serve", *line.split()]) == 0
    assert names == [name]


@pytest.fixture
def order(monkeypatch):
    """The order that a command line makes."""

    def of(*arguments):
        orders = []

        def refuse(order):
            orders.append(order)
            raise UsageError("made")

        monkeypatch.setattr(send_goal, "GoalSender", refuse)
        with pytest.raises(UsageError, match="made"):
            app.run(["send-goal", *arguments])
        return orders[0]

    return of


@pytest.mark.parametrize(
    ("arguments", "type_name", "goal"),
    [
        (["pkg/action/Name"], "pkg/action/Name", "{}"),
        (["pkg/Name", "order: 5"], "pkg/Name", "order: 5"),
        (["order: 5"], None, "order: 5"),
        (["{}"], None, "{}"),
        (["-5"], None, "-5"),
        (["---\n{order: 5}"], None, "---\n{order: 5}"),
        (["pkg/Name", "-5"], "pkg/Name", "-5"),
        (["--", "-f"], None, "-f"),
    ],
)
def test_the_type_is_told_from_the_goal(order, arguments, type_name, goal):
    made = order("x", *arguments)
    assert (made.type_name, made.text.text) == (type_name, goal)


@pytest.mark.parametrize("arguments", [["-f", "x", "g:"], ["x", "-f", "g:"], ["x", "g:", "-f"]])
def test_options_stand_anywhere(order, arguments):
    made = order(*arguments)
    assert (made.name, made.text.text, made.feedback) == ("x", "g:", True)


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:7447", "tcp/127.0.0.1:1,tls/[::]:2"])
def test_nobody_is_let_in_from_beyond_unasked(endpoint):
    with pytest.raises(UsageError, match="lets in everybody who can reach this machine"):
        app.run(["serve", "--listen", endpoint])


# Prints what each verb imports, a line each. A child per verb begins with what the parent imported.
def test_the_help_of_a_verb_is_typers_and_shows_examples(turtleact):
    out = turtleact("send-goal", "-h").out
    assert "─ Arguments ─" in out
    assert "─ Embedded world ─" in out
    assert 'turtleact send-goal fibonacci "order: 5" --feedback' in out


@pytest.mark.parametrize("width", [60, 80])
@together
@pytest.mark.parametrize(
    "line", [[], *([verb] for verb in VERBS), *([a, b] for a, each in GROUPS.items() for b in each)]
)
def test_help_fits_the_terminal_and_cuts_nothing_at_80_columns(turtleact, monkeypatch, line, width):
    monkeypatch.setenv("COLUMNS", str(width))
    ran = turtleact(*line, "--help")
    assert (ran.status, ran.err) == (0, "")
    assert max(map(len, ran.out.splitlines())) <= width
    if width == 80:
        assert "…" not in ran.out


@pytest.mark.parametrize("option", ["--no-daemon", "--spin-time 2", "--spin-time=1"])
def test_ros2s_ways_of_looking_at_the_graph_are_accepted(on_graph, graphs, option):
    ran = on_graph(graphs.goals, "action", "list", *option.split())
    assert ran == on_graph(graphs.goals, "action", "list")


@pytest.mark.parametrize(
    ("text", "nanoseconds"),
    [
        ("1795221794.397853814", 1795221794_397853814),
        ("1", 10**9),
        ("1.5", 1_500000000),
        ("2026-11-21T20:15:00Z", 1795292100 * 10**9),
        ("2026-11-21T21:15:00.5+01:00", 1795292100_500000000),
    ],
)
def test_a_moment_is_seconds_or_a_date(text, nanoseconds):
    assert moment(text) == nanoseconds


@pytest.mark.parametrize(
    ("options", "environment", "expected"),
    [
        ([], "", ConnectOptions((), 0)),
        ([], "7", ConnectOptions((), 7)),
        (
            ["--connect", "tcp/a:1,udp/[fe80::1%eth0]:7447"],
            "",
            ConnectOptions(("tcp/a:1", "udp/[fe80::1%eth0]:7447"), 0),
        ),
    ],
)
def test_the_graph_is_said_by_options_or_by_the_environment(
    order, monkeypatch, options, environment, expected
):
    monkeypatch.setenv("ROS_DOMAIN_ID", environment)
    assert order("x", *options).reach == expected


@pytest.mark.parametrize("what", ["status", "stop", "start"])
def test_there_is_no_daemon_and_no_harm_in_that(turtleact, what):
    assert turtleact("daemon", what) == (
        0,
        "The daemon is not running: each command asks the graph itself\n",
        "",
    )


@pytest.mark.parametrize(
    ("program", "targets", "has_world"),
    [
        (["turtlesim", "turtlesim_node"], (), True),
        (
            ["action_tutorials_py", "fibonacci_action_server"],
            ("turtleact.actions.fibonacci",),
            False,
        ),
    ],
)
def test_programs_of_ros2_are_services_here(turtleact, monkeypatch, program, targets, has_world):
    ran = []

    def run(service):
        ran.append(service)
        return 0

    monkeypatch.setattr(serving, "run", run)
    assert turtleact("run", "--domain", "3", *program).status == 0
    [service] = ran
    fleet = Fleet() if has_world else None
    assert (service.targets, service.fleet, service.reach) == (
        targets,
        fleet,
        ConnectOptions((), 3),
    )
    assert service.node_name == ("turtleact" if has_world else program[1])


@pytest.mark.parametrize(
    ("line", "where", "targets"),
    [
        ("--web", ("127.0.0.1", 9090), ()),
        ("--web --speed 3", ("127.0.0.1", 9090), ()),
        ("--web lab.py", ("127.0.0.1", 9090), ("lab.py",)),
        ("--web 0 lab.py", ("127.0.0.1", 0), ("lab.py",)),
        ("--web 0.0.0.0:80 --token x", ("0.0.0.0", 80), ()),
    ],
)
def test_a_web_page_without_a_port_is_at_9090(monkeypatch, line, where, targets):
    services = []

    def run(service):
        services.append(service)
        return 0

    monkeypatch.setattr(serving, "run", run)
    assert app.run(["serve", *line.split()]) == 0
    [service] = services
    assert (service.page[:2], service.targets) == (where, targets)
