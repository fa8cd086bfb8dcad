"""Command lines as Typer reads them: what is refused, and what they order."""

from __future__ import annotations

import subprocess
import sys

import pytest
import typer
from typer.core import TyperGroup
from typer.main import get_command

from turtleact.commands import VERBS, send_goal, serve, verbs
from turtleact.commands.message_text import GoalText
from turtleact.commands.policies import Policies
from turtleact.commands.targets import find_actions
from turtleact.commands.verbs.arguments import Reach, reach
from turtleact.commands.verbs.goals import moment
from turtleact.commands.verbs.policies import read_policies
from turtleact.commands.verbs.send_goal import Place
from turtleact.commands.verbs.serve import Fleet
from turtleact.errors import UsageError

USAGE = [
    (["send-goal"], "missing argument 'NAME'"),
    (["send-goal", "x", "--fedback"], "no such option: --fedback .*--feedback"),
    (["send-goal", "x", "--timeout"], "requires an argument"),
    (["send-goal", "x", "-t", "abc"], "--timeout is a number of seconds, 0 or more, not 'abc'"),
    (["send-goal", "x", "-t", "-1"], "--timeout is a number of seconds, 0 or more, not '-1'"),
    (["send-goal", "x", "-t", "nan"], "not 'nan'"),
    (["send-goal", "x", "-t", "inf"], "not 'inf'"),
    (["send-goal", "x", "--speed", "0"], "--speed is above 0 and 100 at most, or max, .*, not '0'"),
    (["send-goal", "x", "--speed", "-1"], "not '-1'"),
    (["send-goal", "x", "--speed", "nan"], "not 'nan'"),
    (["send-goal", "x", "--speed", "fast"], "not 'fast'"),
    (
        ["send-goal", "x", "--speed", "101"],
        "--speed is above 0 and 100 at most, or max, as fast as it .* '101'",
    ),
    (["send-goal", "x", "--speed", "1e307"], "--speed is above 0 .* not '1e307'"),
    (["send-goal", "x", "--seed", "-1"], "whole number, 0 or more, of 18 digits at most, not '-1'"),
    (["send-goal", "x", "--seed", "9" * 19], "--seed is a whole number, .* not '9{19}'"),
    (["send-goal", "x", "--seed", "9" * 5000], "--seed is a whole number, .* not '9{60}…'"),
    (["send-goal", "x", "--seed", "1.5"], "not '1.5'"),
    (["send-goal", "x", "a/b", "1", "-5"], r"unexpected extra argument.*\(-5\)"),
    (["send-goal", "x", "order:", "5"], 'quote the goal: "order: 5"'),
    (["send-goal", "x", "{}", "--stdin"], "the goal is given twice"),
    (["send-goal", "x", "--stdin", "--goal-file", "f"], "the goal is given twice"),
    (["send-goal", "x", "--json", "--plain"], "give one of --json and --plain"),
    (["send_goal", "x"], "no such command 'send_goal'. Did you mean 'send-goal'?"),
    (["goal"], "no such command 'goal'. Did you mean 'goals', 'send-goal'?"),
    (["echo", "/x"], "no such command 'echo', did you mean 'action echo' or 'topic echo'?"),
    (["send-gaol"], "no such command 'send-gaol'. Did you mean 'send-goal'?"),
    (["--frobnicate"], "no such option: --frobnicate"),
    (["send-goal", "--rate"], r"no such option: --rate\n"),
    (["serve", "--listen", "tcp/127.0.0.1:99999"], "--listen is an endpoint such as"),
    (["serve", "--turtles", "10001"], "--turtles is a whole number, 1 to 10000"),
    (["serve", "--listen", "7447"], "--listen is an endpoint such as tcp/127.0.0.1:7447"),
    (["serve", "--speed", "max"], "--speed is above 0 and 100 at most, not 'max'"),
    (["serve", "--speed", "0"], "--speed is above 0 and 100 at most"),
    (["serve", "--web", "localhost"], "the port of --web is a whole number, 0 to 65535"),
    (["serve", "--token", "x"], "--token, --allow-host and --allow-origin are for --web"),
    (
        ["serve", "--web", "0", "--allow-origin", "example.com"],
        "--allow-origin is an origin such as https://example.com, not 'example.com'",
    ),
    (["serve", "--placing", "row"], "--placing is random or grid or ring, not 'row'"),
    (["serve", "--turtles", "0"], "--turtles is a whole number, 1 to 10000"),
    (["serve", "--seed", "-1"], "--seed is a whole number"),
    (
        ["serve", "--no-sim", "--turtles", "4", "--paused"],
        "--turtles, --paused and --no-sim: without a world there is no such thing",
    ),
    (["serve", "--no-sim", "--speed", "2"], "--speed and --no-sim"),
    (["serve", "--no-sim", "--placing", "grid"], "--placing and --no-sim"),
    (["serve", "--no-sim", "--seed", "1"], "--seed and --no-sim"),
    (["serve", "--no-sim", "--collide"], "--collide and --no-sim"),
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
    (["run", "turtlesim", "mimic"], "'turtlesim mimic' is not there: turtleact runs"),
    (
        ["run", "turtlesim", "turtlesim_node", "--ros-args", "--remap", "__node:=my_turtle"],
        "'--ros-args --remap __node:=my_turtle' is not taken: names stay as they are",
    ),
    (["run", "action_tutorials_py", "fibonacci_action_server", "-x"], "'-x' is not taken"),
    (["bag", "record", "/turtle1/cmd_vel"], "'bag' is not part of turtleact: 'turtleact topic"),
    (["launch", "turtlesim", "multisim.launch.py"], "'launch' is not part of turtleact: start"),
    (["pkg", "executables", "turtlesim"], "'pkg' is not part of turtleact: 'turtleact interface"),
    (["doctor"], "'doctor' is not part of turtleact: 'turtleact node list' tells"),
    (["service", "echo", "--flow-style", "/x"], "'service echo' is not part of turtleact: its"),
    (["send-goal", "x", "--embedded", "--connect", "tcp/a:1"], "is given twice"),
    (["send-goal", "x", "--speed", "2", "--connect", "tcp/a:1"], "is given twice"),
    (["topic", "list", "--domain", "233"], "--domain is a whole number, 0 to 232, not '233'"),
    (["topic", "list", "--domain", "-1"], "--domain is a whole number, 0 to 232, not '-1'"),
    (["topic", "list", "--connect", "localhost"], "--connect is an endpoint .* not 'localhost'"),
    (["topic", "list", "--connect", "tcp/a:1,"], "--connect is an endpoint .* not ''"),
    (["topic", "echo", "x", "--field", "a..b"], r"--field is names with dots .* not 'a\.\.b'"),
    (["topic", "echo", "x", "--raw", "--csv"], "give one of --raw, --csv and --flow-style"),
    (["topic", "echo", "x", "--raw", "--field", "x"], "give one of --raw and --field"),
    (["topic", "echo", "x", "-l", "many"], "--truncate-length is a whole number, 0 or more"),
    (["topic", "echo", "x", "--timeout", "-1"], "--timeout is a number of seconds, 0 or more"),
    (["topic", "echo", "x", "--qos-depth", "0"], "--qos-depth is a whole number, 1 or more"),
    (["topic", "echo", "x", "--qos-durability", "no"], "is volatile or transient_local, not 'no'"),
    (["topic", "echo", "x", "--qos-reliability", "no"], "is reliable or best_effort, not 'no'"),
    (["topic", "echo", "x", "--qos-profile", "no"], "--qos-profile is .* or sensor_data or .*'no'"),
    (["topic", "hz", "x", "--window", "0"], "--window is a whole number, 1 or more, .* not '0'"),
    (["topic", "pub", "x", "a/b", "{}", "-r", "0"], "--rate is .* a second, above zero, not '0'"),
    (["topic", "pub", "x", "a/b", "{}", "-1", "-t", "2"], "give one of --once and --times"),
    (["topic", "pub", "x", "a/b", "{}", "--stdin"], "give one of VALUES and --stdin"),
    (["topic", "pub", "x", "data:", "5"], 'quote the message: "data: 5"'),
    (["service", "call", "x", "a/b", "{}", "-r", "0"], "--rate is a number of calls a second"),
    (["service", "call", "x", "a/b", "{}", "--stdin"], "the request is given twice"),
    (["cancel"], "give the ids of goals, or --all"),
    (["cancel", "71a"], "'71a' is no goal id: it has 32 hexadecimal digits"),
    (["cancel", "/patrol"], "'/patrol' is no goal id"),
    (["cancel", "--all", "--before", "1"], "give one of --all and --before"),
    (["cancel", "--all", "a", "b"], "--all and --before take one action"),
    (["cancel", "--before", "noon"], "--before is a time such as .*, not 'noon'"),
    (["cancel", "--before", "0"], "--before is a time"),
    (["cancel", "--before", "-1"], "--before is a time"),
    (["cancel", "--before", "nan"], "--before is a time"),
    (["cancel", "--before", "inf"], "--before is a time"),
    (["cancel", "--before", "9" * 10], "--before is a time"),
    (["cancel", "--before", "9999-12-31T23:59:59-23:00"], "--before is a time"),
    (["watch", "g" * 32], "is no goal id"),
    (["result", "0" * 33], "is no goal id"),
    (["action", "send_gaol"], "Did you mean 'send_goal'?"),
    (["param", "set", "a", "\udcff\udcfe", "1"], r"PARAMETER is not UTF-8: b'\\xff\\xfe'\Z"),
    (["topic", "echo", "x", "--field", "a\udce9"], r"--field is not UTF-8: b'a\\xe9'\Z"),
    (["cancel", "-\udcff"], r"ID\.\.\.\|NAME is not UTF-8: b'-\\xff'\Z"),
]


@pytest.mark.parametrize(("arguments", "problem"), USAGE, ids=lambda each: " ".join(each))
def test_a_command_line_that_makes_no_sense_is_refused(arguments, problem):
    with pytest.raises(UsageError, match=problem):
        verbs.parse(arguments)


@pytest.mark.parametrize(
    "arguments", [[], ["--fedback"], ["x", "--timeout"], ["x", "-t"], ["x", "--plain=1"]]
)
def test_a_refusal_says_where_there_is_help(arguments):
    with pytest.raises(UsageError, match=r"\nTry 'turtleact action send_goal --help'\.\Z"):
        verbs.parse(["action", "send_goal", *arguments])


@pytest.fixture
def order(monkeypatch, interrupts):
    """The order that a command line makes."""

    def of(*arguments):
        orders = []

        def run(order, _):
            orders.append(order)
            return 9

        monkeypatch.setattr(send_goal, "run", run)
        assert verbs.parse(["send-goal", *arguments])(interrupts) == 9
        return orders[0]

    return of


def test_what_is_left_out_has_its_default(order):
    assert order("patrol") == send_goal.Order(
        name="patrol",
        type_name=None,
        text=GoalText("{}", "goal"),
        place=Place(speed=1.0, seed=0, reach=Reach((), 231)),
        feedback=False,
        timeout=None,
        view="auto",
    )


@pytest.mark.parametrize(
    ("arguments", "type_name", "goal"),
    [
        (["pkg/action/Name"], "pkg/action/Name", "{}"),
        (["pkg/Name", "order: 5"], "pkg/Name", "order: 5"),
        (["order: 5"], None, "order: 5"),
        (["{}"], None, "{}"),
        (["-5"], None, "-5"),
        (["- x: 1"], None, "- x: 1"),
        (["-.5"], None, "-.5"),
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


def test_options_reach_the_order(order):
    made = order("x", "-ft0.5", "--json", "--speed", "max", "--seed=7", "--embedded")
    assert made[3:] == (Place("max", 7, None), True, 0.5, "json")


@pytest.mark.parametrize("option", ["--embedded", "--speed=2", "--seed=3"])
def test_an_embedded_world_is_asked_for(order, option):
    assert order("x", option).place.reach is None


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:7447", "tcp/127.0.0.1:1,tls/[::]:2"])
def test_nobody_is_let_in_from_beyond_unasked(endpoint, interrupts):
    job = verbs.parse(["serve", "--listen", endpoint])
    with pytest.raises(UsageError, match="lets in whoever can reach this machine"):
        job(interrupts)


def test_where_to_look_reaches_the_order(order):
    made = order("x", "--connect", "tcp/robot:7447,tcp/arm:7447", "--domain", "7", "--config=a b")
    assert made.place.reach == Reach(("tcp/robot:7447", "tcp/arm:7447"), 7, "a b")
    assert made.place.options == (
        " --connect tcp/robot:7447,tcp/arm:7447 --domain 7 --config 'a b'"
    )


def test_the_way_back_to_a_goal_knows_the_same_interfaces(order, tmp_path):
    assert order("x", "--interfaces", str(tmp_path)).place.options == f" --interfaces {tmp_path}"


def test_plain_is_a_view(order):
    assert order("x", "--plain").view == "plain"


def test_a_goal_file_is_read_by_the_job(order, tmp_path):
    path = tmp_path / "goal.yaml"
    path.write_text("order: 5")
    assert order("x", "--goal-file", str(path)).text == ("order: 5", str(path))


@pytest.mark.parametrize("arguments", [["action"], ["action", "-h"], ["action", "--help"]])
def test_a_group_prints_what_there_is(arguments, capsys, interrupts):
    assert verbs.parse(arguments)(interrupts) == 0
    assert "send_goal  Send a goal" in capsys.readouterr().out


@pytest.mark.parametrize("verb", [verb for verb in VERBS if verb != "action"])
def test_only_the_group_that_is_asked_for_is_imported(verb):
    code = (
        f"import sys; from turtleact.commands.verbs import parse; parse(['{verb}', '--help']);"
        "print(*sorted(each for each in sys.modules if each.startswith('turtleact.')))"
    )
    home = verbs.HOMES.get(verb, verb)
    imported = subprocess.check_output([sys.executable, "-c", code], text=True).splitlines()[-1]
    shared = {
        "turtleact.commands.policies",
        "turtleact.commands.verbs.completing",
        "turtleact.commands.verbs.grouping",
        "turtleact.commands.verbs.looking",
        "turtleact.commands.verbs.policies",
    }
    assert {*imported.split()} - shared == {
        "turtleact.commands",
        "turtleact.commands.interrupts",
        "turtleact.commands.verbs",
        "turtleact.commands.verbs.arguments",
        "turtleact.commands.verbs.outside",
        "turtleact.commands.verbs.reading",
        f"turtleact.commands.verbs.{home.replace('-', '_')}",
        "turtleact.errors",
    }


def test_the_help_of_a_verb_shows_examples(capsys, interrupts):
    assert verbs.parse(["send-goal", "-h"])(interrupts) == 0
    assert '  turtleact send-goal fibonacci "order: 5" --feedback\n' in capsys.readouterr().out


@pytest.mark.parametrize(
    ("verb", "usage", "line"),
    [
        (
            "send-goal",
            "NAME [TYPE] [GOAL]",
            "  TYPE  Its type, pkg/action/Name; asked of the graph.",
        ),
        ("serve", "[TARGET]...", "  TARGET  Your actions: module:object, or module for all in it."),
        (
            "cancel",
            "[ID...|NAME]",
            "  ID...|NAME  The goals' ids; with --all or --before the action.",
        ),
    ],
)
def test_the_help_of_a_verb_names_its_arguments_plainly(capsys, interrupts, verb, usage, line):
    assert verbs.parse([verb, "-h"])(interrupts) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"Usage: turtleact {verb} [OPTIONS] {usage}"
    assert line in lines


def test_the_table_of_verbs_names_what_typer_knows():
    command = get_command(verbs.assemble(VERBS))
    assert isinstance(command, TyperGroup)
    assert list(command.commands) == list(VERBS)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), BrokenPipeError()], ids=repr)
def test_what_stops_the_printing_of_help_is_not_for_typer_to_judge(monkeypatch, error):
    def stops(*_, **__):
        raise error

    monkeypatch.setattr(typer, "echo", stops)
    with pytest.raises(type(error)):
        verbs.parse(["action"])


def test_arguments_are_read_without_pydantic():
    code = (
        "import sys; from turtleact.commands.verbs import parse;"
        "parse(['send-goal', 'x', 'pkg/Name', '{}', '-t', '1']); print('pydantic' in sys.modules)"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "False\n"


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
    ("connect", "domain", "environment", "expected"),
    [
        (None, None, "", Reach((), 0)),
        (None, None, "7", Reach((), 7)),
        (None, "0", "7", Reach((), 0)),
        ("tcp/a:1,udp/[::1]:7447", None, "", Reach(("tcp/a:1", "udp/[::1]:7447"), 0)),
    ],
)
def test_the_graph_is_said_by_options_or_by_the_environment(
    monkeypatch, connect, domain, environment, expected
):
    monkeypatch.setenv("ROS_DOMAIN_ID", environment)
    assert reach(connect, domain) == expected


def test_a_domain_of_the_environment_that_makes_no_sense_is_named(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "many")
    with pytest.raises(UsageError, match="ROS_DOMAIN_ID is a whole number, 0 to 232, not 'many'"):
        reach(None, None)


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
        (
            ["examples_rclpy_minimal_action_server", "server"],
            ("turtleact.actions.fibonacci",),
            False,
        ),
    ],
)
def test_programs_of_ros2_are_services_here(turtleact, monkeypatch, program, targets, has_world):
    ran = []

    def run(service, _):
        ran.append(service)
        return 0

    monkeypatch.setattr(serve, "run", run)
    assert turtleact("run", *program, "--domain", "3").status == 0
    [service] = ran
    fleet = Fleet() if has_world else None
    assert (service.targets, service.fleet, service.reach) == (targets, fleet, Reach((), 3))


def test_the_fibonacci_server_serves_both_types():
    declared = find_actions("turtleact.actions.fibonacci")
    assert [each.action_type.type_name for each in declared] == [
        "action_tutorials_interfaces/action/Fibonacci",
        "example_interfaces/action/Fibonacci",
    ]


def test_single_policies_count_more_than_their_profile():
    asked = read_policies("sensor_data", None, "transient_local", "7")
    assert asked == Policies("best_effort", "transient_local", 7)
    assert read_policies("sensor_data", None, None, None) == Policies("best_effort", "volatile", 5)
